"""Speed against accuracy, measured: seconds, memory and errors of the items of a grid.

Seconds are wall-clock seconds from nothing to the solution: coarse levels (those that find the
detachment points of a graded mesh included), mesh, assembly and solve; the median of repeats, the
largest over the ranks. Compilation of the forms is left out, because a run on a coarse mesh comes
first. The evaluation of the errors is no part of a solution, and its seconds are a separate entry.
"""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx_signorini.logs import log
from dolfinx_signorini.norms import error_norms
from dolfinx_signorini.records import Records
from dolfinx_signorini.references import interpolated
from dolfinx_signorini.tradeoff.comparing import Row
from dolfinx_signorini.tradeoff.family import Family
from dolfinx_signorini.tradeoff.grid import Item
from dolfinx_signorini.tradeoff.runs import (
    Configuration,
    Run,
    algebraic_errors,
    exact_solution,
    solve_configuration,
)

WARM_UP = 8  # cells across of the run that compiles the forms
INTERPOLATION_DEGREE = 4  # of the interpolated reference
INTERPOLATION_LIMIT = 60_000  # unknowns up to which errors against it are computed, too


def is_known(comm: MPI.Comm, family: Family) -> bool:
    """Return whether the exact solution of a problem is known; a mesh of a few cells tells.

    Args:
        comm: The communicator; the call is collective.
        family: The problem.
    """
    posed = family.pose(family.make(comm, 4), 1)
    posed.problem.destroy()
    return posed.exact is not None


def measure_grid(
    records: Records,
    make_family: Callable[[int], Family],
    items: Sequence[Item],
    norms: Sequence[str],
    repeats: int,
    reference: Configuration | None = None,
) -> list[Row]:
    """Measure the items of a grid; items whose rows are recorded are not measured again.

    Args:
        records: The file of finished rows.
        make_family: Returns the problem for a degree of the quadrature rule of its load.
        items: The grid.
        norms: Names of the norms.
        repeats: How often to time each item.
        reference: For a problem without a known solution: the configuration whose solution errors
            are measured against.

    Returns:
        The rows of the items, in their order.
    """
    comm = records.comm
    keys = [item.key(comm) for item in items]
    missing = [item for item, key in zip(items, keys, strict=True) if not _recorded(records, key)]
    families = {rule: make_family(rule) for rule in {item.rule for item in missing}}
    found: Run | None = None
    if missing and reference is not None:
        found = solve_configuration(comm, families[missing[0].rule], reference)
    meter = _Meter(comm, norms, found)
    warm: set[tuple[Any, ...]] = set()
    for item in missing:
        family, c = families[item.rule], item.configuration
        forms = (c.kind, c.method, item.rule)
        if forms not in warm:
            meter.row(family, replace(c, n=WARM_UP), 1)
            warm.add(forms)
        row = item.key(comm) | meter.row(family, c, repeats)
        told = item.purpose, c, c.method, c.rtol, row["total"]
        log.info("%s: %s, %s, rtol %s  %.3f s", *told)
        records.append(row)
    if found is not None:
        found.destroy()
    return [_recorded(records, key)[0] for key in keys]


def _recorded(records: Records, key: dict[str, Any]) -> list[Row]:
    """The recorded rows with the entries of a key."""
    return [row for row in records.rows if key.items() <= row.items()]


@dataclass(frozen=True)
class _Meter:
    """Measures configurations in some norms, against the exact solution or a reference run."""

    comm: MPI.Comm
    norms: Sequence[str]
    reference: Run | None

    def row(self, family: Family, configuration: Configuration, repeats: int) -> dict[str, Any]:
        """Solve some times; return cost and errors of the configuration."""
        run: Run | None = None
        samples = []
        for _ in range(repeats):
            if run is not None:
                run.destroy()
            _reset_peak()
            run = solve_configuration(self.comm, family, configuration)
            memory = self.comm.allreduce(_peak_bytes())
            samples.append(run.seconds)
        assert run is not None
        result, phases = run.result, list(run.seconds)
        totals = [sum(sample.values()) for sample in samples]
        row = {
            "unknowns": run.unknowns,
            "iterations": result.iterations,
            "linear_solves": result.linear_solves,
            "linear_iterations": result.linear_iterations,
            "natural_residual": result.natural_residual,
            "seconds": {p: statistics.median(sample[p] for sample in samples) for p in phases},
            "total": statistics.median(totals),
            "fastest": min(totals),
            "slowest": max(totals),
            "repeats": repeats,
            **self._errors(run),
            "peak_bytes": memory,
            "detachment_points": [point.position for point in run.points],
        }
        run.destroy()
        return row

    def _errors(self, run: Run) -> dict[str, Any]:
        """The errors of a run: of the discretisation, and algebraic."""
        start = time.perf_counter()
        exact = exact_solution(run, self.reference)
        errors = error_norms(run.u, exact, self.norms)
        seconds = self.comm.allreduce(time.perf_counter() - start, op=MPI.MAX)
        known = "exact" if self.reference is None else str(self.reference.configuration)
        row = {"seconds_errors": seconds, "errors": errors, "reference": known}
        if self.reference is None and run.unknowns <= INTERPOLATION_LIMIT:
            substitute = interpolated(exact, INTERPOLATION_DEGREE)
            row["errors_interpolated"] = error_norms(run.u, substitute, self.norms)
        return row | {"algebraic": algebraic_errors(run, self.norms)}


def _reset_peak() -> None:
    """Let the kernel forget the peak memory of this process, where the kernel can."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return


def _peak_bytes() -> int:
    """The largest resident memory of this process since the last reset."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return 1024 * int(line.split()[1])
    return 0
