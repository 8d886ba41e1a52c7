"""A study: the paper's problem on a family of meshes, its errors streamed to disk when known."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from mpi4py import MPI

from dolfinx_signorini.base.costs import Cost
from dolfinx_signorini.base.logs import log
from dolfinx_signorini.base.records import ROWS, Records, Row, Wanted
from dolfinx_signorini.base.timing import Phases
from dolfinx_signorini.studies import TIGHT_RTOL
from dolfinx_signorini.studies.paper.sampling import H1_2, LINF, W1_INF, paper_errors
from dolfinx_signorini.studies.paper.solution import PAPER_RULE, paper_family
from dolfinx_signorini.studies.tradeoff.family import UNIFORM_P1
from dolfinx_signorini.studies.tradeoff.runs import Configuration, Run

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
) -> list[Row]:
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
    rows = [Wanted(f"N = {n}", {"n": n}, partial(_row, comm, n, settings), n**2) for n in cells]
    return records.table("table", rows)


def _row(comm: MPI.Comm, n: int, settings: StudySettings) -> Row:
    """Compute one row."""
    log.debug("N = %d", n)
    method, rtol = settings.method, settings.rtol
    if rtol is None and method == "cascade":
        rtol = TIGHT_RTOL
    wanted = Configuration(UNIFORM_P1, n, method=method, rtol=rtol)
    run, phases = Run(comm, paper_family(), wanted), Phases(comm)
    with phases("errors"):
        errors = paper_errors(run.u, run.posed.exact, settings.norms)
    seconds = run.seconds | phases.seconds
    measured = Cost("phase", "errors against the exact solution", 1, 0, seconds["errors"])
    told = ", ".join(f"{name} {value:.1f} s" for name, value in seconds.items())
    log.info("N = %d: %s", n, told)
    row = run.diagnostics | {
        "errors": errors,
        "active_dofs": run.result.active_dofs,
        "reason": run.result.reason,
        "ranks": comm.size,
        "seconds": seconds,
        "costs": [asdict(cost) for cost in (*run.posed.problem.costs(), measured)],
    }
    run.destroy()
    return row
