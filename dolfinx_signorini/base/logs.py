"""Progress and messages: the logger `dolfinx_signorini`, on rank 0 only.

A script that wants to hear progress asks the standard library:

    import logging

    logging.basicConfig(level=logging.INFO)

On the command line `-v` tells more, and `-q` tells warnings only.
"""

import logging
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer

from mpi4py import MPI

log = logging.getLogger("dolfinx_signorini")
log.addFilter(lambda record: MPI.COMM_WORLD.rank == 0)

PATIENCE = 2.0  # seconds of silence after which a job tells how far it is, or for whom it waits


def tell_duration(seconds: float, text: str, *values: object) -> None:
    """Tell what took so long, where that is longer than `PATIENCE`; else only to who asks for more.

    Args:
        seconds: The seconds that the work took.
        text: What took so long, with places for the values.
        values: The values.
    """
    log.log(logging.INFO if seconds > PATIENCE else logging.DEBUG, text, *values)


@contextmanager
def telling(what: str) -> Iterator[None]:
    """Tell what is being done when that takes longer than `PATIENCE`, and in the end how long.

    Args:
        what: What is being done, in words.
    """
    began = time.perf_counter()
    timer = Timer(PATIENCE, log.info, [f"{what} ..."])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
    seconds = time.perf_counter() - began
    tell_duration(seconds, "%s: %.1f s", what, seconds)


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


class Progress:
    """How far a long task is, told every two seconds:

        progress = Progress("errors")
        for k in range(count):
            progress.at(k / count)

    Args:
        task: The name of the task.
    """

    def __init__(self, task: str):
        self._task, self._told = task, time.monotonic()

    def at(self, share: float) -> None:
        """Tell the share that is done, from 0 to 1, if nothing was told for long."""
        if time.monotonic() - self._told > PATIENCE:
            self._told = time.monotonic()
            log.info("  %s %.0f %%", self._task, 100.0 * share)
