"""Configurations: how one solution is computed, and the solve that does it.

A configuration says which mesh, elements, method and tolerance. `solve_configuration` does all that
belongs to it, from nothing: coarse levels, mesh, assembly and solve, each with its seconds.
"""

import time
from dataclasses import dataclass

from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.accuracy.family import Family, Posed
from dolfinx_signorini.accuracy.grading import graded_mesh, transferred_sides
from dolfinx_signorini.detachment import DetachmentPoint, detachment_points
from dolfinx_signorini.errors import InputError
from dolfinx_signorini.meshes import SidedMesh
from dolfinx_signorini.orders import grading_exponent
from dolfinx_signorini.paper.study import coarse_levels
from dolfinx_signorini.problem import METHODS
from dolfinx_signorini.references import Reference, carried
from dolfinx_signorini.solvers.pressure import ContactState
from dolfinx_signorini.solvers.residual import SolveResult

COARSEST = 8  # cells across on the coarsest level of a graded mesh
COARSE_RTOL = 1e-5  # of the coarse levels: for contact sets and detachment points


@dataclass(frozen=True)
class Configuration:
    """How a solution is computed.

    Attributes:
        graded: Whether the mesh is refined towards the detachment points, which are found on
            coarser meshes; else it is uniform.
        n: Cells across the domain, away from the detachment points.
        degree: Of the elements, 1 or 2.
        method: See `SignoriniProblem.solve`.
        rtol: Relative natural residual; None for the default of the method.
    """

    graded: bool
    n: int
    degree: int = 1
    method: str = "cascade"
    rtol: float | None = None

    def __str__(self) -> str:
        return f"{'graded' if self.graded else 'uniform'} P{self.degree}, N = {self.n}"


@dataclass(frozen=True)
class Run:
    """A solution computed as a configuration says.

    Attributes:
        configuration: The configuration.
        posed: The problem on the mesh.
        state: The contact state of the solution that the problem's solve started from, or None.
        result: The solve, for u or -u as the problem is posed.
        u: The solution.
        points: The detachment points that the mesh is graded towards.
        seconds: Wall-clock seconds of "coarse" (all levels before the last), "mesh", "forms" (look
            up the compiled forms, find the contact dofs), "assembly" and "solve", the largest over
            the ranks.
    """

    configuration: Configuration
    posed: Posed
    state: ContactState | None
    result: SolveResult
    u: fem.Function
    points: tuple[DetachmentPoint, ...]
    seconds: dict[str, float]

    @property
    def unknowns(self) -> int:
        """The global number of dofs."""
        return self.posed.problem.unknowns

    @property
    def total_seconds(self) -> float:
        """All of the seconds."""
        return sum(self.seconds.values())

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.posed.problem.destroy()


def levels(configuration: Configuration) -> list[int]:
    """Return the cells across of the levels before the last, coarsest first.

    On the way to a graded mesh the cells across double with every level, and each level finds the
    detachment points several times as precisely as the one before. Repeating a coarse level would
    not do: its solution does not know them any better.
    """
    n = configuration.n
    if not configuration.graded:
        return coarse_levels(n) if configuration.method == "cascade" else []
    result = [max(n // 2, min(n, COARSEST // 2))]
    while result[0] >= 2 * COARSEST:
        result.insert(0, result[0] // 2)
    return result


def solve_configuration(comm: MPI.Comm, family: Family, configuration: Configuration) -> Run:
    """Compute a solution from nothing, as a configuration says.

    Args:
        comm: The communicator that shares the mesh.
        family: The problem.
        configuration: How to solve it.

    Raises:
        InputError: The configuration makes no sense for the problem.
        NotConvergedError: The solver failed.
    """
    _check(family, configuration)
    state: ContactState | None = None
    points: list[DetachmentPoint] = []
    start = _now(comm)
    for n in levels(configuration):
        posed, _ = _posed(comm, family, configuration, n, points)
        result = posed.problem.solve(coarse=state, rtol=COARSE_RTOL)
        state = posed.problem.contact_state(result.u)
        if configuration.graded:
            points = detachment_points(posed.problem, state)
        posed.problem.destroy()
    coarse = _now(comm)
    posed, meshed = _posed(comm, family, configuration, configuration.n, points)
    assembled = _now(comm)
    try:
        coarser = state if configuration.method == "cascade" else None
        result = posed.problem.solve(configuration.method, coarse=coarser, rtol=configuration.rtol)
    except Exception:
        posed.problem.destroy()
        raise
    forms = comm.allreduce(posed.problem.seconds["forms"], op=MPI.MAX)
    seconds = {
        "coarse": coarse - start,
        "mesh": meshed - coarse,
        "forms": forms,
        "assembly": assembled - meshed - forms,
        "solve": _now(comm) - assembled,
    }
    u = result.u
    if posed.sign < 0.0:
        u = fem.Function(posed.problem.space)
        u.x.array[:] = -result.u.x.array
    return Run(configuration, posed, state, result, u, tuple(points), seconds)


def exact_solution(run: Run, reference: Run | None) -> Reference:
    """Return what errors of a run are measured against: the exact solution, or a reference run.

    Args:
        run: The run.
        reference: A finer run, whose solution is carried to the cells of the run's mesh; None for
            the exact solution.

    Raises:
        InputError: The exact solution is not known.
    """
    if reference is not None:
        return carried(reference.u, run.u.function_space.mesh)
    if run.posed.exact is None:
        raise InputError("solution: it is not known; errors need a reference")
    return run.posed.exact


def _check(family: Family, configuration: Configuration) -> None:
    if configuration.n < 1:
        raise InputError(f"n: a mesh needs at least one cell across, not {configuration.n}")
    if configuration.degree not in (1, 2):
        raise InputError(f"degree: 1 or 2, not {configuration.degree}")
    if configuration.method not in METHODS:
        raise InputError(f"method: unknown {configuration.method!r}")
    if configuration.graded and family.dimension != 2:
        raise InputError("graded: only in the plane")


def _posed(
    comm: MPI.Comm,
    family: Family,
    configuration: Configuration,
    n: int,
    points: list[DetachmentPoint],
) -> tuple[Posed, float]:
    """The problem on the mesh with n cells across, and the time when the mesh was done."""
    halvings = 0
    while configuration.graded and points and n % 2 == 0 and n >= 2 * COARSEST:
        n, halvings = n // 2, halvings + 1
    sided = family.make(comm, n)
    if points:
        width = family.width / (n * 2**halvings)
        exponent = grading_exponent(configuration.degree)
        fine = graded_mesh(sided.mesh, points, width, exponent, halvings)
        sided = SidedMesh(fine, transferred_sides(sided.mesh, sided.sides, fine))
    meshed = _now(comm)
    return family.pose(sided, configuration.degree), meshed


def _now(comm: MPI.Comm) -> float:
    """The time when all ranks have come here, the same on all."""
    comm.barrier()
    return float(comm.bcast(time.perf_counter()))
