"""Wall-clock seconds of the phases of a computation, the same on all ranks."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

from mpi4py import MPI

from dolfinx_signorini.base.logs import log


class Phases:
    """A stopwatch for named phases.

    The phases of one computation follow each other without gaps if the whole computation runs
    inside of them, so that their sum is what a clock on the wall shows:

        phases = Phases(comm)
        with phases("mesh"):
            domain = friedrichs_keller(comm, 100)
        print(phases.seconds["mesh"], phases.total)

    Where the phases are those of a whole computation, each ends where the next one begins:

        phases.lap("mesh")
        phases.lap("assembly")

    Args:
        comm: The communicator; a phase ends when the last rank has reached its end.

    Attributes:
        seconds: The seconds of each phase by name; a phase that was entered twice is added up.
    """

    def __init__(self, comm: MPI.Comm):
        self.comm = comm
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """End a phase that began at the lap before, or when the stopwatch was made; collective."""
        began, self._last = self._last, self._now()
        self._add(name, self.comm.bcast(self._last - began))

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Time a block; the entry of the block and its end are collective."""
        start = self._now()
        yield
        self._add(name, self._now() - start)

    @property
    def total(self) -> float:
        """The seconds of all phases together."""
        return sum(self.seconds.values())

    def _add(self, name: str, seconds: float) -> None:
        self.seconds[name] = self.seconds.get(name, 0.0) + seconds
        log.debug("  %s %.2f s", name, seconds)

    def _now(self) -> float:
        """The time on rank 0 when all ranks have come here."""
        self.comm.barrier()
        return float(self.comm.bcast(time.perf_counter()))
