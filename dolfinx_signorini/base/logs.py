"""Progress and messages: the logger `dolfinx_signorini`, on rank 0 only.

A script that wants to hear progress asks the standard library:

    import logging

    logging.basicConfig(level=logging.INFO)

On the command line `-v` tells more, and `-q` tells warnings only. A job that takes long shows a bar
with the time that is left on a terminal, and tells a line now and then elsewhere.
"""

import logging
import sys
import time
from functools import cache
from threading import Event, RLock, Thread
from types import TracebackType
from typing import Self

from mpi4py import MPI
from tqdm import tqdm

log = logging.getLogger("dolfinx_signorini")
log.addFilter(lambda record: MPI.COMM_WORLD.rank == 0)

PATIENCE = 2.0  # seconds of silence after which a job tells how far it is, or for whom it waits


class _Bar(tqdm):  # type: ignore[type-arg]
    """The bars of this program, which leaves the bars of the user alone."""

    monitor_interval = 0  # no thread beside the one of Progress

    def __del__(self) -> None:
        """Close nothing: a signal may leave a bar half made, and `Progress` closes the others."""


_Bar.set_lock(RLock())


@cache
def warn_once(text: str) -> None:
    """Log a warning, unless this process has logged the same one before."""
    log.warning("%s", text)


def say(text: str) -> None:
    """Print a line on standard output, above the bar where a bar is shown."""
    _Bar.write(text, file=sys.stdout)
    sys.stdout.flush()


class _AboveBars(logging.StreamHandler):  # type: ignore[type-arg]
    """Writes messages to the standard error stream, above the bar where a bar is shown."""

    def emit(self, record: logging.LogRecord) -> None:
        _Bar.write(self.format(record), file=self.stream)
        self.flush()


def listen(level: int) -> logging.Handler:
    """Write messages from a level on to the standard error stream.

    The handler that is returned is given to `log.removeHandler` at the end.
    """
    handler = _AboveBars(sys.stderr)
    handler.setFormatter(logging.Formatter("%(message)s"))
    log.setLevel(level)
    log.addHandler(handler)
    return handler


class _Lines:
    """A stream for a bar where no terminal listens: what the bar shows becomes messages."""

    def write(self, text: str) -> None:
        if text.strip():
            log.info("  %s", text.strip())

    def flush(self) -> None:
        """Messages do not wait."""


class Progress:
    """How far a long task is, and the time that is left, told from `PATIENCE` seconds on:

        with Progress("errors", count) as progress:
            for k in range(count):
                progress.advance()

    A terminal that listens has a bar; elsewhere a message is told every `PATIENCE` seconds. The end
    of a task that took longer is told with its seconds. Nothing is shown if messages of the level
    INFO are not wanted, and on ranks other than 0.

    Args:
        task: The name of the task.
        total: All the work, in any unit; None if the work is not known, and the time that has
            passed is told.
    """

    def __init__(self, task: str, total: float | None = None):
        self._task, self._began = task, time.perf_counter()
        self._bar: _Bar | None = None
        self._ended = Event()
        if MPI.COMM_WORLD.rank or not log.isEnabledFor(logging.INFO):
            return
        terminal = sys.stderr.isatty() and any(isinstance(h, _AboveBars) for h in log.handlers)
        bar = "{bar} " if terminal else ""
        known = f"{{desc}}: {{percentage:.0f}} %, {bar}{{elapsed}}, {{remaining}} left"
        self._bar = _Bar(
            desc=task,
            total=total,
            file=sys.stderr if terminal else _Lines(),
            delay=PATIENCE,
            mininterval=PATIENCE / 10 if terminal else PATIENCE,
            miniters=0,
            smoothing=0,
            leave=False,
            dynamic_ncols=terminal,
            bar_format=known if total else "{desc}: {elapsed}",
        )
        Thread(target=self._tick, daemon=True).start()

    def advance(self, work: float = 1.0) -> None:
        """Tell that some work is done, in the unit of the total."""
        if self._bar is not None:
            with self._bar.get_lock():
                self._bar.update(work)

    def _tick(self) -> None:
        """Let the clock of the bar go on while one piece of the work takes long."""
        while not self._ended.wait(PATIENCE):
            self.advance(0.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._ended.set()
        if self._bar is not None:
            with self._bar.get_lock():
                self._bar.close()
        seconds = time.perf_counter() - self._began
        level = logging.INFO if seconds > PATIENCE else logging.DEBUG
        log.log(level, "%s: %.1f s", self._task, seconds)
