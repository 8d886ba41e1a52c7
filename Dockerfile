# docker build -t dolfinx-signorini .
# docker run --rm dolfinx-signorini                           the paper's tables
# docker run --rm dolfinx-signorini reproduce --max-n 101     any command of the program
# docker run --rm -p 127.0.0.1:8888:8888 dolfinx-signorini notebooks     the tutorials in Jupyter
#
# On two processes:
#   docker run --rm --entrypoint mpirun dolfinx-signorini -n 2 python3 -m dolfinx_signorini reproduce
# To keep what a command writes, mount a folder on /results and run as its owner:
#   docker run --rm --user "$(id -u):$(id -g)" -v "$PWD:/results" dolfinx-signorini ...
FROM debian:trixie-slim

# The part of the list above its marker: what running and notebooks need.
COPY debian-packages.txt /tmp/
RUN apt-get update \
    && sed '/^# --- tests ---/,$d; s/#.*//' /tmp/debian-packages.txt \
        | DEBIAN_FRONTEND=noninteractive xargs apt-get install -y --no-install-recommends \
    && rm -rf /tmp/debian-packages.txt /var/lib/apt/lists/* /var/cache/apt/* /var/log/*

# Any user may run the image, so the folders that it writes to are open to all. The compiled forms go to
# XDG_CACHE_HOME. One thread per process, because the parallelism here is MPI's.
RUN useradd --create-home signorini \
    && install -d -m 1777 /results /var/cache/dolfinx-signorini
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
COPY demos /opt/dolfinx-signorini/demos
COPY packaging/docker/dolfinx-signorini /usr/local/bin/
RUN chmod -R a+rX /opt/dolfinx-signorini \
    && chmod 755 /usr/local/bin/dolfinx-signorini \
    && install -d /opt/dolfinx-signorini/notebooks \
    && cd /opt/dolfinx-signorini/demos \
    && python3 -m jupytext --quiet --to ipynb --set-kernel python3 *.py \
    && mv *.ipynb ../notebooks/

USER signorini
WORKDIR /results
ENTRYPOINT ["dolfinx-signorini"]
CMD ["reproduce"]
