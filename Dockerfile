# docker build -t dolfinx-signorini .
# docker run --rm dolfinx-signorini                           the paper's tables
# docker run --rm dolfinx-signorini reproduce --max-n 101     any command of the program
#
# On two processes:
#   docker run --rm --entrypoint mpirun dolfinx-signorini -n 2 python3 -m dolfinx_signorini reproduce
# To keep what a command writes, mount a folder on /results and run as its owner:
#   docker run --rm --user "$(id -u):$(id -g)" -v "$PWD:/results" dolfinx-signorini ...
FROM debian:trixie-slim

# The part of the list above its marker: what running needs.
COPY debian-packages.txt /tmp/
RUN apt-get update \
    && sed '/^# --- tests ---/,$d; s/#.*//' /tmp/debian-packages.txt \
        | DEBIAN_FRONTEND=noninteractive xargs apt-get install -y --no-install-recommends \
    && rm -rf /tmp/debian-packages.txt /var/lib/apt/lists/* /var/cache/apt/* /var/log/*

# Any user may run the image, so the folders that it writes to are open to all. The compiled forms go to
# XDG_CACHE_HOME. One thread per process, because the parallelism here is MPI's.
RUN useradd --create-home signorini \
    && install -d -m 1777 /results /var/cache/dolfinx-signorini \
    && printf '%s\n' '#!/bin/sh' 'exec python3 -m dolfinx_signorini "$@"' >/usr/local/bin/dolfinx-signorini \
    && chmod +x /usr/local/bin/dolfinx-signorini
ENV PYTHONPATH=/opt/dolfinx-signorini \
    PYTHONDONTWRITEBYTECODE=1 \
    XDG_CACHE_HOME=/var/cache/dolfinx-signorini \
    LC_ALL=C.UTF-8 \
    OMP_NUM_THREADS=1 \
    OMPI_MCA_btl=self,sm \
    OMPI_MCA_mpi_yield_when_idle=1 \
    PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe
COPY LICENSE /opt/dolfinx-signorini/
COPY dolfinx_signorini /opt/dolfinx-signorini/dolfinx_signorini
RUN chmod -R a+rX /opt/dolfinx-signorini

USER signorini
WORKDIR /results
ENTRYPOINT ["python3", "-m", "dolfinx_signorini"]
CMD ["reproduce"]
