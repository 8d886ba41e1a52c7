"""Configurations, and runs: solutions computed from nothing as a configuration says.

A configuration names mesh, elements, method and tolerance. Its run comprises the coarse levels, the
mesh, the assembly and the solve, each with its seconds; on adapted meshes the whole adaptive loop.
"""

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.accuracy.adaptive import AdaptiveSolution, solve_adaptively
from dolfinx_signorini.accuracy.steps import MAX_UNKNOWNS
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.timing import Phases
from dolfinx_signorini.meshes.elements import HIGHEST_DEGREE
from dolfinx_signorini.meshes.quadrature import CELL_RULE
from dolfinx_signorini.meshes.sided_meshes import SidedMesh
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.orders import grading_exponent
from dolfinx_signorini.norms.references import Reference, carried
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.problem.detachment import DetachmentPoint, detachment_points
from dolfinx_signorini.problem.signorini import DEFAULT_RTOL, SignoriniProblem
from dolfinx_signorini.solvers.cascade import check_method, coarse_levels, solve_cascade
from dolfinx_signorini.solvers.result import SolveResult
from dolfinx_signorini.studies import TIGHT_RTOL
from dolfinx_signorini.studies.tradeoff.family import Family, Kind, Posed
from dolfinx_signorini.studies.tradeoff.grading import graded_mesh

COARSEST = 6  # cells across on the coarsest level of a graded mesh, at least


@dataclass(frozen=True)
class Configuration:
    """How a solution is computed; on adapted meshes, how accurate it is to be:

        Configuration(GRADED_P2, n=48, rtol=1e-6)
        Configuration(Kind("adapted", 3), n=4, norm="L4", accuracy=1e-5)

    Attributes:
        kind: The kind of mesh and elements.
        n: Cells across the domain, away from the detachment points; on the first adapted mesh.
        method: See `SignoriniProblem.solve`; the adaptive loop knows the cascade only.
        rtol: Relative natural residual; None for the default of the method.
        norm: The norm of the error that the adaptive loop is asked for.
        accuracy: The largest error allowed; None for as many unknowns as are allowed.
        max_unknowns: The largest number of unknowns on adapted meshes.
        rule: Degree of the Gauss-Jacobi rule of the load, for the family.
        purpose: "main" for the comparison of meshes and elements, else the name of a sweep.
    """

    kind: Kind
    n: int
    method: str = "cascade"
    rtol: float | None = None
    norm: str | None = None
    accuracy: float | None = None
    max_unknowns: int | None = None
    rule: int = CELL_RULE.degree
    purpose: str = "main"

    @property
    def size(self) -> int:
        """The dofs across the domain, as if the mesh was not graded."""
        return self.kind.degree * self.n

    def key(self, comm: MPI.Comm) -> dict[str, Any]:
        """Return the entries that identify the row of the configuration among all rows."""
        own = asdict(self)
        return own.pop("kind") | own | {"ranks": comm.size}

    def __str__(self) -> str:
        if self.norm is None:
            return f"{self.kind}, N = {self.n}"
        if self.accuracy is None:
            return f"{self.kind} for {self.norm}, at most {self.max_unknowns} unknowns"
        return f"{self.kind} for {self.norm} = {self.accuracy:.2g}"


class Run:
    """A solution computed from nothing as a configuration says:

        run = Run(comm, family, Configuration(GRADED_P2, 48))
        print(run.unknowns, run.total_seconds, run.points)

    Args:
        comm: The communicator that shares the mesh.
        family: The problem.
        configuration: Mesh, elements, method and tolerance.

    Attributes:
        configuration: The configuration.
        posed: The problem on the mesh, solved.
        points: The detachment points that the mesh is graded towards.
        found: What the adaptive loop did; None on other meshes.
        seconds: Wall-clock seconds of "coarse" (all levels before the last), "mesh", "forms" (to
            look up the compiled forms and to find the contact dofs), "assembly" and "solve". The
            adaptive loop has no "mesh": its meshes and estimates belong to "coarse".

    Raises:
        InputError: The configuration makes no sense for the problem.
        NotConvergedError: The solver failed.
    """

    posed: Posed
    found: AdaptiveSolution | None = None

    def __init__(self, comm: MPI.Comm, family: Family, configuration: Configuration):
        self.configuration = c = configuration
        self._comm, self._family = comm, family
        _check(c, family)
        self.points: list[DetachmentPoint] = []
        clock = Phases(comm)
        with clock("all"):
            if c.kind.mesh == "adapted":
                assert c.norm is not None
                self.found = solve_adaptively(
                    self._on,
                    family.make(comm, c.n),
                    norm=c.norm,
                    accuracy=sys.float_info.min if c.accuracy is None else c.accuracy,
                    max_unknowns=MAX_UNKNOWNS if c.max_unknowns is None else c.max_unknowns,
                )
            else:
                solve_cascade(
                    self._problem,
                    [*levels(c, family.dimension), c.n],
                    method=c.method,
                    rtol=c.rtol,
                    coarse_rtol=DEFAULT_RTOL,  # after 1e-5, degree 4 misplaces detachment points
                )
        self.seconds = self._seconds(clock.total)

    @property
    def u(self) -> fem.Function:
        """The solution."""
        return self.posed.problem.u

    @property
    def result(self) -> SolveResult:
        """The diagnostics of the last solve."""
        assert self.posed.problem.result is not None
        return self.posed.problem.result

    @property
    def unknowns(self) -> int:
        """The global number of dofs."""
        return self.posed.problem.unknowns

    @property
    def diagnostics(self) -> dict[str, Any]:
        """Unknowns, iterations and the residual of the last solve, as rows of studies have them."""
        names = ("iterations", "linear_solves", "linear_iterations", "natural_residual")
        return {"unknowns": self.unknowns} | {name: getattr(self.result, name) for name in names}

    @property
    def total_seconds(self) -> float:
        """The seconds of all phases together."""
        return sum(self.seconds.values())

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.posed.problem.destroy()

    def _problem(self, n: int, coarser: BoundConstrainedProblem | None) -> BoundConstrainedProblem:
        """The problem with n cells across; a coarser problem tells where to grade the mesh."""
        if self.configuration.kind.mesh == "graded" and isinstance(coarser, SignoriniProblem):
            self.points = detachment_points(coarser)
        phases = Phases(self._comm)
        with phases("mesh"):
            sided = self._mesh(n)
        return self._on(sided, phases)

    def _on(self, sided: SidedMesh, phases: Phases | None = None) -> BoundConstrainedProblem:
        """The problem on a mesh, which took some seconds to make."""
        self._last = phases or Phases(self._comm)
        with self._last("assembly"):
            self.posed = self._family.pose(sided, self.configuration.kind.degree)
        return self.posed.problem

    def _mesh(self, n: int) -> SidedMesh:
        """The mesh with n cells across, graded towards the points known so far."""
        halvings, degree = 0, self.configuration.kind.degree
        while self.points and n % 2 == 0 and n >= 2 * COARSEST:
            n, halvings = n // 2, halvings + 1
        sided = self._family.make(self._comm, n)
        if not self.points:
            return sided
        width = self._family.width / (n * 2**halvings)
        return graded_mesh(sided, self.points, width, grading_exponent(degree), halvings)

    def _seconds(self, total: float) -> dict[str, float]:
        """The seconds of the phases; those of the problem before the last are "coarse"."""
        last, forms = self._last, self.posed.problem.seconds["forms"]
        solve = self._comm.allreduce(sum(self.result.seconds.values()), op=MPI.MAX)
        return {
            "coarse": total - last.total - solve,
            "mesh": last.seconds.get("mesh", 0.0),
            "forms": forms,
            "assembly": last.seconds["assembly"] - forms,
            "solve": solve,
        }


def _check(c: Configuration, family: Family) -> None:
    """Refuse a configuration that makes no sense for a problem."""
    if c.n < 1:
        raise InputError(f"a mesh needs at least one cell across, not {c.n}", "n")
    if not 1 <= c.kind.degree <= HIGHEST_DEGREE:
        raise InputError(f"1 to {HIGHEST_DEGREE}, not {c.kind.degree}", "degree")
    check_method(c.method)
    if not family.has_kind(c.kind):
        raise InputError("only in the plane, with the obstacle on the boundary", "graded")
    if (c.kind.mesh == "adapted") != (c.norm is not None):
        raise InputError("for adapted meshes, and only for these", "norm")


def levels(configuration: Configuration, dimension: int = 2) -> list[int]:
    """Return the cells across of the levels before the last, coarsest first.

    On the way to a graded mesh the cells across double from level to level, and each level finds
    the detachment points several times as precisely as the level before. A repeated level
    would not find the points any better.
    """
    n = configuration.n
    if configuration.kind.mesh == "graded":
        half = max(n // 2, min(n, COARSEST // 2))
        return [*coarse_levels(half, coarsest=2 * COARSEST - 1, ratio=2), half]
    return coarse_levels(n, dimension) if configuration.method == "cascade" else []


def exact_solution(run: Run, reference: Run | None) -> Reference:
    """Return the solution to measure the error of a run against: the exact one, or a finer one.

    Args:
        run: The run.
        reference: A finer run, whose solution is carried to the cells of the run's mesh; None for
            the exact solution.

    Raises:
        InputError: The exact solution is not known.
    """
    if reference is not None:
        degree = max(HIGHEST_DEGREE, run.configuration.kind.degree + 2)
        return carried(reference.u, run.u.function_space.mesh, degree)
    if run.posed.exact is None:
        raise InputError("the solution is not known; errors need a reference", "solution")
    return run.posed.exact


def algebraic_errors(run: Run, norms: Sequence[str]) -> dict[str, float]:
    """Return norms of the difference between a run and the exact solution of its discrete problem.

    Args:
        run: The run, whose problem is solved on to a natural residual of 1e-10: `run.u` is then
            the discrete solution.
        norms: Names of the norms.
    """
    loose = run.u.x.array.copy()
    tight = run.posed.problem.solve(rtol=TIGHT_RTOL)
    difference = fem.Function(tight.function_space)
    difference.x.array[:] = tight.x.array - loose
    return error_norms(difference, None, norms)
