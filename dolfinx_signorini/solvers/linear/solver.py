"""The base of the linear solvers: held dofs are set, and a correction is found in its own unit."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

from petsc4py import PETSc

from dolfinx_signorini.base.arrays import LocalIndices, Mask
from dolfinx_signorini.base.petsc import destroy, without_nodes
from dolfinx_signorini.base.tolerances import power_of_two
from dolfinx_signorini.solvers.linear.hierarchy import LEAST
from dolfinx_signorini.solvers.linear.multigrid import Multigrid
from dolfinx_signorini.solvers.stop import Stop
from dolfinx_signorini.solvers.system import System

# Whether an iteration is to be the last one, by the sum of all steps so far, the number of the
# iteration, the norm of the residual, and the unit of sum and norm.
Check = Callable[[PETSc.Vec, int, float, float], bool]

MOST_UNKNOWNS = {1: 3000, 2: 3000, 3: 1000}  # by dimension; in space the factors fill in


def has_few_dofs(system: System) -> bool:
    """Return whether factorizations cost less than the set-up and iterations of multigrid.

    With an obstacle in the domain an active set that starts from nothing moves by one dof in a
    step, as wide as it may be, while coarser levels tell at once where contact ends.
    """
    most = LEAST if system.layout.in_domain else MOST_UNKNOWNS
    return system.unknowns <= most[system.space.mesh.topology.dim]


class LinearSolver(ABC):
    """A linear solver for systems with the same matrix, whose held dofs change from solve to solve.

    A solve improves a vector in place:

        solver = linear_solver(system, "", {})
        solver.solve(system, x, held, atol=1e-10)

    Args:
        system: One of the systems.
        prefix: The prefix of PETSc options.
        options: PETSc options without prefix.

    Attributes:
        exact: Whether a solve leaves nothing but rounding.
        multigrid: The cycle over lower degrees and coarser meshes, where the solver has one.
        solves: The number of linear solves so far, without rough ones.
        setups: The number of factorizations, or of set-ups of the preconditioner, so far.
        iterations: The number of iterations so far; a direct solve counts as one.
    """

    exact = False
    multigrid: Multigrid | None = None

    def __init__(self, system: System, prefix: str = "", options: Mapping[str, Any] | None = None):
        self.A, self.comm = system.A, system.comm
        self.solves = self.setups = self.iterations = 0
        self._prefix, self._options = prefix, dict(options or {})
        self._matrix: PETSc.Mat | None = None  # A with held dofs
        self._held: Mask | None = None  # the held dofs of the set-up
        self._assembled = 0  # how often the matrix of the set-up had been assembled
        self._rhs, self._correction = system.A.createVecLeft(), system.A.createVecRight()
        self._ksp = PETSc.KSP().create(self.comm)

    @abstractmethod
    def solve(
        self,
        system: System,
        x: PETSc.Vec,
        held: Mask,
        atol: float,
        multiplier: PETSc.Vec | None = None,
        stop: Stop | None = None,
        check: Check | None = None,
    ) -> None:
        """Solve for the dofs that are not held, from x on, until the norm of the residual is atol.

        Args:
            system: The system, with the matrix of this solver.
            x: The start, overwritten by the solution.
            held: Which constraints of this rank hold their dofs at the obstacle.
            atol: The norm of the residual to reach.
            multiplier: A x - b for the start, where that is known.
            stop: Ends the solve earlier, if coarser meshes are known to begin on.
            check: Ends the solve earlier, if there are iterations.

        Raises:
            InputError: The form turned out to be indefinite.
        """

    @abstractmethod
    def multiply(self, system: System, iterate: PETSc.Vec, result: PETSc.Vec) -> None:
        """Set a vector to A x - b for the present iterate x of a solve that calls a check.

        Away from the contact dofs A x - b is the residual that the solve knows: only the rows of
        these dofs are multiplied, unless these are many.

        Args:
            system: The system.
            iterate: x, which is the start of the solve plus the unit times the correction.
            result: The vector to set, which is 0 at dofs with Dirichlet data.
        """

    @property
    @abstractmethod
    def preconditioner(self) -> str:
        """What solves take for the inverse of the matrix, in words."""

    @abstractmethod
    def free(self) -> None:
        """Free the set-up; a next solve makes a new one."""

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.free()
        destroy(self._matrix, self._ksp, self._rhs, self._correction)
        self._matrix = None

    def _hold(self, dofs: LocalIndices, diagonal: float) -> PETSc.Mat:
        """Return the matrix whose rows and columns of some owned dofs are those of a diagonal."""
        if self._matrix is None:
            self._matrix = without_nodes(self.A.copy())
        else:
            self.A.copy(self._matrix, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self._matrix.zeroRowsColumns(dofs + self._matrix.getOwnershipRange()[0], diag=diagonal)
        self._matrix.assemble()  # else the inverse diagonals that PETSc's sweeps keep are old ones
        return self._matrix


def set_residual(
    system: System, x: PETSc.Vec, held: Mask, multiplier: PETSc.Vec | None, rhs: PETSc.Vec
) -> float:
    """Set rhs to b - A x on the free dofs, 0 on others, in a unit of its size; return the unit.

    No square of an entry in this unit overflows or underflows.

    Args:
        system: The system.
        x: The vector.
        held: Which constraints of this rank hold their dofs at the obstacle.
        multiplier: A x - b, where that is known.
        rhs: The vector to set.
    """
    if multiplier is None:
        system.set_forces(x, rhs)
    else:
        multiplier.copy(rhs)
    rhs.array_w[system.known_dofs(held)] = 0.0
    unit = power_of_two(rhs.norm(PETSc.NormType.INFINITY))
    rhs.scale(-1.0 / unit)
    return unit
