"""A study: one problem on a family of meshes, its errors streamed to disk as they are known."""

import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.meshes import friedrichs_keller
from dolfinx_signorini.norms import error_norms
from dolfinx_signorini.paper.solution import PAPER_RULE, christof_haubner, paper_problem
from dolfinx_signorini.problem import SignoriniProblem
from dolfinx_signorini.quadrature import FACET_RULE
from dolfinx_signorini.records import Records
from dolfinx_signorini.solvers.cascade import solve_cascade
from dolfinx_signorini.solvers.pressure import ContactState, contact_state

PAPER_NORMS = ("L4", "L16", "Linf", "W1_4", "W1_16", "W1_inf", "H1_2_boundary")
COARSEST = 64  # cells per side: up to here a solution from scratch costs little
RATIO = 8  # between the levels of a cascade; the patch problems bridge it, 11 is too far


@dataclass(frozen=True)
class StudySettings:
    """What every row of a study of the paper's problem depends on.

    Attributes:
        method: Solver, see `SignoriniProblem.solve`.
        norms: Names of the norms of the error.
        rtol: Relative natural residual; None for the default of the method.
        rule: Quadrature rule of the load and of the norms on cells.
        boundary_rule: Quadrature rule of the norms on facets.
    """

    method: str = "cascade"
    norms: tuple[str, ...] = PAPER_NORMS
    rtol: float | None = None
    rule: str = str(PAPER_RULE)
    boundary_rule: str = str(FACET_RULE)


def run_study(
    comm: MPI.Comm, cells: Sequence[int], settings: StudySettings, folder: Path
) -> list[dict[str, Any]]:
    """Solve the paper's problem on Friedrichs-Keller meshes and measure the errors.

    Finished rows are appended to `rows.jsonl` in the folder; those found there are not computed
    again.

    Args:
        comm: The communicator that shares each mesh.
        cells: Cells per side of the meshes, increasing.
        settings: What the rows depend on.
        folder: Where the rows go.

    Returns:
        The rows: n, unknowns, errors by norm, diagnostics, seconds of each phase, and costs.

    Raises:
        InputError: A setting makes no sense or the folder cannot be used.
        NotConvergedError: Some problem could not be solved.
    """
    records = Records(comm, folder / "rows.jsonl", asdict(settings), keys=("n", "errors"))
    done = {row["n"]: row for row in records.rows}
    rows = []
    states: dict[int, ContactState] = {}
    for n in cells:
        if n in done:
            _report(comm, f"N = {n}: already done")
            rows.append(done[n])
            continue
        coarse = next((state for m, state in states.items() if RATIO * m >= n), None)
        row, problem, u = _row(comm, n, settings, coarse)
        if settings.method == "cascade" and RATIO * max(states, default=0) < cells[-1]:
            states[n] = contact_state(problem, u)  # the coarse level of rows to come
        problem.destroy()
        records.append(row)
        rows.append(records.rows[-1])
    return rows


def coarse_levels(n: int) -> list[int]:
    """Return the levels of a cascade below n cells per side, coarsest first.

    All of them are odd or all even, like n: a detachment point in the middle of the unit square's
    side lies in the middle of a cell or on a node on every level.
    """
    levels: list[int] = []
    while n > COARSEST:
        n = n // RATIO + (n // RATIO + n) % 2
        levels.insert(0, n)
    return levels


def _row(
    comm: MPI.Comm, n: int, settings: StudySettings, coarse: ContactState | None
) -> tuple[dict[str, Any], SignoriniProblem, fem.Function]:
    """Compute one row, and return it with its problem and solution."""
    _report(comm, f"N = {n}:", end="")
    seconds: dict[str, float] = {}
    start = time.perf_counter()
    if settings.method == "cascade" and coarse is None and (levels := coarse_levels(n)):
        problem, result = solve_cascade(lambda m: _problem(comm, m), levels)
        coarse = contact_state(problem, result.u)
        problem.destroy()
        seconds["coarse"] = _lap(comm, "coarse levels", start)
    start = time.perf_counter()
    exact = christof_haubner(friedrichs_keller(comm, n))
    seconds["mesh"] = _lap(comm, "mesh", start)
    start = time.perf_counter()
    problem = paper_problem(exact)
    seconds["assembly"] = _lap(comm, "assembly", start)
    start = time.perf_counter()
    result = problem.solve(settings.method, coarse=coarse, rtol=settings.rtol)
    seconds["solve"] = _lap(comm, "solve", start)
    start = time.perf_counter()
    errors = error_norms(result.u, exact, settings.norms)
    seconds["errors"] = _lap(comm, "errors", start)
    problem.ledger.add("phase", "errors against the exact solution", seconds=seconds["errors"])
    _report(comm, "")
    row = {
        "n": n,
        "unknowns": problem.unknowns,
        "errors": errors,
        "active_dofs": result.active_dofs,
        "natural_residual": result.natural_residual,
        "reason": result.reason,
        "iterations": result.iterations,
        "linear_solves": result.linear_solves,
        "linear_iterations": result.linear_iterations,
        "ranks": comm.size,
        "seconds": seconds,
        "costs": [asdict(cost) for cost in problem.costs()],
    }
    return row, problem, result.u


def _problem(comm: MPI.Comm, n: int) -> SignoriniProblem:
    return paper_problem(christof_haubner(friedrichs_keller(comm, n)))


def _lap(comm: MPI.Comm, phase: str, start: float) -> float:
    seconds = time.perf_counter() - start
    _report(comm, f"  {phase} {seconds:.1f} s", end="")
    return seconds


def _report(comm: MPI.Comm, text: str, end: str = "\n") -> None:
    if comm.rank == 0:
        print(text, end=end, file=sys.stderr, flush=True)
