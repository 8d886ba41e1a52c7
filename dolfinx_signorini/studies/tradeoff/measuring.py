"""Speed against accuracy, measured: seconds, memory and errors of configurations.

Seconds are wall-clock seconds from nothing to the solution: coarse levels (those that find the
detachment points of a graded mesh included) or all steps of the adaptive loop, mesh, assembly and
solve; the median of repeats, the largest over the ranks. Compilation of the forms is left out,
because a run on a coarse mesh comes first. The evaluation of the errors is no part of a solution,
and its seconds are a separate entry.
"""

import contextlib
import functools
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx_signorini.base.logs import log
from dolfinx_signorini.base.records import Records, Row, Wanted
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.studies.tradeoff.family import Family
from dolfinx_signorini.studies.tradeoff.runs import (
    COARSEST,
    Configuration,
    Run,
    algebraic_errors,
    exact_solution,
)

ENOUGH = 1.0  # seconds after which a configuration is not timed again


class Meter:
    """Measures configurations in some norms, each once: recorded rows are not measured again.

    For example:

        meter = Meter(records, make_family, ["L4"], repeats=3)
        rows = meter.measured(grid(10_000))

    Args:
        records: The file of finished rows.
        make_family: Returns the problem for a degree of the quadrature rule of its load.
        norms: Names of the norms.
        repeats: How often to time each configuration; one that takes long is timed less often.
        reference: For a problem without a known solution: the configuration whose solution errors
            are measured against.
    """

    def __init__(
        self,
        records: Records,
        make_family: Callable[[int], Family],
        norms: Sequence[str],
        repeats: int,
        reference: Configuration | None = None,
    ):
        self.records, self.comm = records, records.comm
        self.norms, self.repeats, self.reference = norms, repeats, reference
        self._family = functools.cache(make_family)
        self._finer: Run | None = None
        self._warm: set[tuple[Any, ...]] = set()

    def measured(self, configurations: Iterable[Configuration]) -> list[Row]:
        """Return the rows of some configurations, in their order."""
        wanted = [self._wanted(c) for c in configurations]
        return list(self.records.table("meshes and settings", wanted))

    def _wanted(self, c: Configuration) -> Wanted:
        return Wanted(str(c), c.key(self.comm), functools.partial(self._measure, c), c.size)

    def climbed(self, configurations: Iterable[Configuration]) -> list[Row]:
        """Return the rows of the adaptive loop for one accuracy after the other.

        An accuracy that the loop has reached with the one before is left out. The climb ends with
        the first accuracy that the loop does not reach within its limit.

        Args:
            configurations: Those on adapted meshes, see `grid.ladder`.
        """
        rows: list[Row] = []
        for configuration in configurations:
            accuracy = configuration.accuracy
            assert accuracy is not None
            if rows and rows[-1]["estimate"] <= accuracy:
                continue
            rows.append(self.records.row(self._wanted(configuration)))
            if rows[-1]["estimate"] > accuracy:
                break
        return rows

    def destroy(self) -> None:
        """Free the reference solution."""
        if self._finer is not None:
            self._finer.destroy()
            self._finer = None

    def _measure(self, c: Configuration) -> Row:
        """Return the row of a configuration, which compiles its forms before they are timed."""
        if self.reference is not None and self._finer is None:
            self._finer = Run(self.comm, self._family(c.rule), self.reference)
        forms = (c.kind, c.norm, c.method, c.rule)
        if forms not in self._warm:
            self._row(_coarsest(c), 1)
            self._warm.add(forms)
        row = self._row(c, self.repeats)
        told = c.purpose, c, c.method, c.rtol, row["total"]
        log.info("%s: %s, %s, rtol %s  %.3f s", *told)
        return row

    def _row(self, c: Configuration, repeats: int) -> Row:
        """Solve some times; return cost and errors."""
        samples, totals = list[dict[str, float]](), list[float]()
        run: Run | None = None
        while run is None or (len(samples) < repeats and sum(totals) < ENOUGH):
            if run is not None:
                run.destroy()
            _reset_peak()
            run = Run(self.comm, self._family(c.rule), c)
            memory = self.comm.allreduce(_peak_bytes())
            samples.append(run.seconds)
            totals.append(run.total_seconds)
        row = run.diagnostics | {
            "seconds": {p: statistics.median(s[p] for s in samples) for p in run.seconds},
            "total": statistics.median(totals),
            "fastest": min(totals),
            "slowest": max(totals),
            "repeats": len(totals),
            "peak_bytes": memory,
            "detachment_points": [point.position for point in run.points],
            "estimate": None if run.found is None else run.found.estimate,
            **self._errors(run),
        }
        if c.purpose == "tolerance":
            row["algebraic"] = algebraic_errors(run, self.norms)
        run.destroy()
        return row

    def _errors(self, run: Run) -> Row:
        """The errors of a run, in the norm that its mesh is adapted for or in all norms."""
        norm, start = run.configuration.norm, time.perf_counter()
        errors = error_norms(
            run.u, exact_solution(run, self._finer), self.norms if norm is None else [norm]
        )
        seconds = self.comm.allreduce(time.perf_counter() - start, op=MPI.MAX)
        known = "exact" if self._finer is None else str(self._finer.configuration)
        return {"seconds_errors": seconds, "errors": errors, "reference": known}


def _coarsest(configuration: Configuration) -> Configuration:
    """A run that needs the same forms and takes little time."""
    if configuration.norm is not None:
        return replace(configuration, accuracy=sys.float_info.max)
    return replace(configuration, n=COARSEST)


def _reset_peak() -> None:
    """Let the kernel forget the peak memory of this process, where the kernel can."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _peak_bytes() -> int:
    """The largest resident memory of this process since the last reset; 0 where that is unknown."""
    kilobytes, *_ = told_by_kernel("self/status", "VmHWM").split() or ["0"]
    return 1024 * int(kilobytes)


def told_by_kernel(name: str, entry: str) -> str:
    """Return the first entry of a name in a file of /proc; empty where there is none."""
    with contextlib.suppress(OSError):
        for line in Path("/proc", name).read_text().splitlines():
            key, _, value = line.partition(":")
            if key.strip() == entry:
                return value.strip()
    return ""
