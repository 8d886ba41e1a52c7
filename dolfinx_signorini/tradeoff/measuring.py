"""Speed against accuracy: what configurations cost and give, measured and compared.

Seconds are wall-clock seconds from nothing to the solution: coarse levels (those that find the
detachment points of a graded mesh included), mesh, assembly and solve, the median of repeats, the
largest over the ranks. Compilation of the forms is left out: a run on a coarse mesh comes first.
The evaluation of the errors is not part of a solution, and is reported apart.
"""

import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.accuracy.family import Family
from dolfinx_signorini.accuracy.runs import (
    Configuration,
    Run,
    exact_solution,
    solve_configuration,
)
from dolfinx_signorini.norms import error_norms
from dolfinx_signorini.quadrature import CELL_RULE
from dolfinx_signorini.records import Records
from dolfinx_signorini.references import interpolated

Row = Mapping[str, Any]

RTOL = 1e-5  # of the main grid: its rows report the algebraic error that it leaves
TIGHT = 1e-10  # relative natural residual of what algebraic errors are measured against
INTERPOLATION_DEGREE = 4  # of the interpolated reference
INTERPOLATION_LIMIT = 60_000  # unknowns up to which errors against it are computed, too
SWEEP_RTOL = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
SWEEP_RULE = (1, 2, 3, 4, 5, 7, 9)


@dataclass(frozen=True)
class Item:
    """One point of the grid.

    Attributes:
        configuration: Mesh, elements, method and tolerance.
        rule: Degree of the Gauss-Jacobi rule of the load.
        purpose: "main" for the comparison of meshes and elements, or the sweep that it belongs to.
    """

    configuration: Configuration
    rule: int = CELL_RULE.degree
    purpose: str = "main"

    def key(self, comm: MPI.Comm) -> dict[str, Any]:
        """Return what identifies its row."""
        own = asdict(self.configuration)
        return own | {"rule": self.rule, "purpose": self.purpose, "ranks": comm.size}


def grid(max_unknowns: int, dimension: int = 2, sweeps: bool = True) -> list[Item]:
    """Return the grid: uniform and graded meshes, P1 and P2, and sweeps of one setting each.

    Args:
        max_unknowns: Limit on the dofs, as if no mesh was graded.
        dimension: Of space; meshes are graded in the plane only.
        sweeps: Whether tolerances, quadrature rules and methods are varied.
    """
    cells = {
        (False, 1): (16, 26, 51, 101, 201, 401, 701, 1001),
        (False, 2): (10, 16, 26, 38, 64, 88, 104, 144, 250),
        (True, 1): (16, 26, 40, 64, 104, 160, 256, 400),
        (True, 2): (10, 16, 22, 24, 32, 48, 64, 104, 160, 208),
    }
    if dimension == 3:
        cells = {(False, 1): (4, 6, 9, 13, 18, 26, 40), (False, 2): (3, 4, 6, 9, 13, 18)}
    items = [
        Item(Configuration(graded, n, degree, rtol=RTOL))
        for (graded, degree), sizes in cells.items()
        for n in sizes
        if (degree * n + 1) ** dimension <= max_unknowns
    ]
    # From small to large, so that what is left of larger ones does not count as peak memory.
    items.sort(key=lambda item: item.configuration.degree * item.configuration.n)
    if not sweeps:
        return items
    for c in (Configuration(False, 101), Configuration(True, 48, 2)):
        items += [Item(replace(c, rtol=rtol), purpose="tolerance") for rtol in SWEEP_RTOL]
        items += [Item(c, rule=rule, purpose="rule") for rule in SWEEP_RULE]
    items += [
        Item(Configuration(False, n, method=method, rtol=1e-6), purpose="method")
        for n in (51, 101)
        for method in ("cascade", "bqnls", "bncg", "bntr")
    ]
    return [i for i in items if (i.configuration.degree * i.configuration.n) ** 2 < max_unknowns]


def measure_grid(
    records: Records,
    make_family: Callable[[int], Family],
    items: Sequence[Item],
    norms: Sequence[str],
    repeats: int,
    reference: Configuration | None = None,
) -> list[Row]:
    """Measure the items of a grid; those whose rows are recorded are not measured again.

    Args:
        records: Where finished rows go.
        make_family: The problem, for a degree of the quadrature rule of its load.
        items: The grid.
        norms: Names of the norms.
        repeats: How often to time each item.
        reference: For a problem without a known solution: how to compute what errors are against.

    Returns:
        The rows of the items, in their order.
    """
    comm = records.comm
    families = {rule: make_family(rule) for rule in {item.rule for item in items}}
    found: Run | None = None
    warm: set[tuple[Any, ...]] = set()
    rows: list[Row] = []
    for item in items:
        key = item.key(comm)
        done = [row for row in records.rows if key.items() <= row.items()]
        if done:
            rows.append(done[0])
            continue
        family = families[item.rule]
        if reference is not None and found is None:
            found = solve_configuration(comm, family, reference)
        c = item.configuration
        kind = (c.graded, c.degree, c.method, item.rule)
        if kind not in warm:  # compiles the forms
            _measure(comm, family, replace(c, n=8), norms, 1, found)
            warm.add(kind)
        if comm.rank == 0:
            print(f"{item.purpose}: {c}, {c.method}, rtol {c.rtol}", end="", file=sys.stderr)
        row = key | _measure(comm, family, c, norms, repeats, found)
        if comm.rank == 0:
            print(f"  {row['total']:.3f} s", file=sys.stderr, flush=True)
        records.append(row)
        rows.append(records.rows[-1])
    if found is not None:
        found.destroy()
    return rows


def pareto_front(rows: Sequence[Row], norm: str, cost: str = "total") -> list[Row]:
    """Return the rows that no other one beats in both error and cost, cheapest first."""
    front: list[Row] = []
    for row in sorted(rows, key=lambda row: (row[cost], row["errors"][norm])):
        if not front or row["errors"][norm] < front[-1]["errors"][norm]:
            front.append(row)
    return front


def cheapest(rows: Sequence[Row], norm: str, target: float) -> Row | None:
    """Return the row that reaches an error in the fewest seconds, or None."""
    enough = [row for row in rows if row["errors"][norm] <= target]
    return min(enough, key=lambda row: row["total"]) if enough else None


def is_baseline(row: Row) -> bool:
    """Tell whether a row is of the paper's kind: uniform meshes, P1, the cascade."""
    return not row["graded"] and row["degree"] == 1 and row["method"] == "cascade"


def targets(rows: Sequence[Row], norm: str) -> list[float]:
    """Return errors to compare at: powers of ten, and the best of uniform P1."""
    errors = [row["errors"][norm] for row in rows]
    powers = [10.0**k for k in range(3, -13, -1) if min(errors) <= 10.0**k <= max(errors)]
    baseline = [row["errors"][norm] for row in rows if is_baseline(row)]
    return sorted({*powers, *([min(baseline)] if baseline else [])}, reverse=True)


def describe(row: Row) -> str:
    """Return the configuration of a row in words."""
    return str(Configuration(row["graded"], row["n"], row["degree"]))


def _measure(
    comm: MPI.Comm,
    family: Family,
    configuration: Configuration,
    norms: Sequence[str],
    repeats: int,
    reference: Run | None,
) -> dict[str, Any]:
    samples = []
    run: Run | None = None
    for _ in range(repeats):
        if run is not None:
            run.destroy()
        _reset_peak()
        run = solve_configuration(comm, family, configuration)
        memory = comm.allreduce(_peak_bytes())
        samples.append(run.seconds)
    assert run is not None
    seconds = {
        phase: statistics.median(sample[phase] for sample in samples) for phase in samples[0]
    }
    start = time.perf_counter()
    errors = error_norms(run.u, exact_solution(run, reference), norms)
    seconds_errors = comm.allreduce(time.perf_counter() - start, op=MPI.MAX)
    row = {
        "unknowns": run.unknowns,
        "iterations": run.result.iterations,
        "linear_solves": run.result.linear_solves,
        "linear_iterations": run.result.linear_iterations,
        "natural_residual": run.result.natural_residual,
        "seconds": seconds,
        "total": statistics.median(sum(sample.values()) for sample in samples),
        "fastest": min(sum(sample.values()) for sample in samples),
        "slowest": max(sum(sample.values()) for sample in samples),
        "repeats": repeats,
        "seconds_errors": seconds_errors,
        "peak_bytes": memory,
        "errors": errors,
        "algebraic": _algebraic_errors(run, norms),
        "reference": "exact" if reference is None else str(reference.configuration),
        "detachment_points": [point.position for point in run.points],
    }
    if reference is None and run.unknowns <= INTERPOLATION_LIMIT and run.posed.exact is not None:
        substitute = interpolated(run.posed.exact, INTERPOLATION_DEGREE)
        row["errors_interpolated"] = error_norms(run.u, substitute, norms)
    run.destroy()
    return row


def _algebraic_errors(run: Run, norms: Sequence[str]) -> dict[str, float]:
    """The norms of the difference to the tightly solved discrete problem."""
    problem = run.posed.problem
    tight = problem.solve(coarse=run.state, rtol=TIGHT)
    difference = fem.Function(problem.space)
    difference.x.array[:] = tight.u.x.array - run.result.u.x.array
    return error_norms(difference, None, norms)


def _reset_peak() -> None:
    """Let the kernel forget the peak memory of this process, where it can."""
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
