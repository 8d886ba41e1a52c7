"""What the program tells while it works: the logger `dolfinx_signorini`, on rank 0 only.

A script that wants to hear progress asks the standard library:

    import logging

    logging.basicConfig(level=logging.INFO)

On the command line `-v` tells more, and `-q` tells warnings only.
"""

import logging
import sys

from mpi4py import MPI

log = logging.getLogger("dolfinx_signorini")
log.addFilter(lambda record: MPI.COMM_WORLD.rank == 0)

PATIENCE = 2.0  # seconds of silence after which a job tells how far it is


def listen(level: int) -> logging.Handler:
    """Write messages from a level on to the standard error stream, until the handler is removed.

    Args:
        level: The level, for example `logging.INFO`.

    Returns:
        The handler, for `log.removeHandler`.
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(message)s"))
    log.setLevel(level)
    log.addHandler(handler)
    return handler
