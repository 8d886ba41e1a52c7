"""A study: the paper's problem on a family of meshes, its errors streamed to disk when known."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx_signorini.base.logs import log
from dolfinx_signorini.base.records import ROWS, Records
from dolfinx_signorini.base.timing import Phases
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.problem.signorini import DEFAULT_RTOL, SignoriniProblem
from dolfinx_signorini.solvers.cascade import coarse_levels, solve_cascade
from dolfinx_signorini.studies import TIGHT_RTOL
from dolfinx_signorini.studies.paper.sampling import H1_2, LINF, W1_INF, paper_errors
from dolfinx_signorini.studies.paper.solution import PAPER_RULE, christof_haubner, paper_problem

PAPER_NORMS = ("L4", "L16", LINF, "W1_4", "W1_16", W1_INF, H1_2)


@dataclass(frozen=True)
class StudySettings:
    """What every row of a study of the paper's problem depends on.

    A study of two norms:

        run_study(comm, [101, 201], StudySettings(norms=("L4", LINF)), folder)

    Attributes:
        method: Solver, see `SignoriniProblem.solve`.
        norms: Names of the norms of the error, see `sampling.paper_errors`.
        rtol: Relative natural residual; None for `TIGHT_RTOL` with the cascade, and for the
            default of other methods.
        rule: Quadrature rule of the load and of the norms on cells.
        boundary_rule: Quadrature rule of the paper's H^{1/2} norm on facets.
    """

    method: str = "cascade"
    norms: tuple[str, ...] = PAPER_NORMS
    rtol: float | None = None
    rule: str = str(PAPER_RULE)
    boundary_rule: str = "closed Newton-Cotes rule with 7 points"


def run_study(
    comm: MPI.Comm, cells: Sequence[int], settings: StudySettings, folder: Path
) -> list[dict[str, Any]]:
    """Solve the paper's problem on Friedrichs-Keller meshes and measure the errors.

    Finished rows are appended to `rows.jsonl` in the folder; rows found in this file are not
    computed again.

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
    records = Records(comm, folder / ROWS, asdict(settings), keys=("n", "errors"))
    return [records.row(f"N = {n}", {"n": n}, partial(_row, comm, n, settings)) for n in cells]


def _row(comm: MPI.Comm, n: int, settings: StudySettings) -> dict[str, Any]:
    """Compute one row."""
    log.debug("N = %d", n)
    phases, coarse, rtol = Phases(comm), None, settings.rtol
    if rtol is None and settings.method == "cascade":
        rtol = TIGHT_RTOL
    if settings.method == "cascade" and (levels := coarse_levels(n)):
        with phases("coarse"):
            coarser = solve_cascade(lambda m, _: _problem(comm, m), levels, rtol=DEFAULT_RTOL)
            coarse = coarser.contact_state()
            coarser.destroy()
    with phases("mesh"):
        exact = christof_haubner(friedrichs_keller(comm, n))
    with phases("assembly"):
        problem = paper_problem(exact)
    with phases("solve"):
        u = problem.solve(settings.method, coarse=coarse, rtol=rtol)
    with phases("errors"):
        errors = paper_errors(u, exact, settings.norms, PAPER_RULE)
    seconds, result = phases.seconds, problem.result
    assert result is not None
    problem.ledger.add("phase", "errors against the exact solution", seconds=seconds["errors"])
    told = ", ".join(f"{name} {value:.1f} s" for name, value in seconds.items())
    log.info("N = %d: %s", n, told)
    row = {
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
    problem.destroy()
    return row


def _problem(comm: MPI.Comm, n: int) -> SignoriniProblem:
    return paper_problem(christof_haubner(friedrichs_keller(comm, n)))
