"""Linear solves of small problems with some contact dofs held, by Cholesky factorizations.

Up to some thousand dofs, on one rank, a factorization costs no more than the set-up of multigrid,
and the next one, for another set of held dofs, a quarter: the pattern stays. The solutions
are exact, so that the active set needs neither loose solves nor local corrections.
"""

from collections.abc import Mapping
from typing import Any

from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Mask
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.base.tolerances import PRECISION
from dolfinx_signorini.solvers.linear.iterative import IterativeSolver
from dolfinx_signorini.solvers.linear.solver import Check, LinearSolver, has_few_dofs, set_residual
from dolfinx_signorini.solvers.stop import Stop
from dolfinx_signorini.solvers.system import System

NO_PIVOT = 100.0 * PRECISION  # of the size of the matrix: as PETSc has it for matrices of size 1


class DirectSolver(LinearSolver):
    """A linear solver by Cholesky factorizations on one rank, see `LinearSolver`.

    Where a factorization fails, as for indefinite matrices, an `IterativeSolver` takes over.
    """

    exact = True

    def __init__(self, system: System, prefix: str = "", options: Mapping[str, Any] | None = None):
        super().__init__(system, prefix, options)
        self._iterative: IterativeSolver | None = None
        self._factored: PETSc.Mat | None = None  # for the costs
        self._ksp.setType(PETSc.KSP.Type.PREONLY)
        self._ksp.getPC().setType(PETSc.PC.Type.CHOLESKY)

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
        """Solve by a factorization, or by the solver that took over, see `LinearSolver`."""
        self.solves += 1
        if self._iterative is None and self._factors(system, held):
            known = None if system.place(x, held) else multiplier
            unit = set_residual(system, x, held, known, self._rhs)
            self._ksp.solve(self._rhs, self._correction)
            x.axpy(unit, self._correction)
            self.iterations += 1
            return
        if self._iterative is None:
            self.exact = False
            self._iterative = IterativeSolver(system, self._prefix, self._options)
        before = self._iterative.iterations
        self._iterative.solve(system, x, held, atol, multiplier, stop, check)
        self.iterations += self._iterative.iterations - before

    def multiply(self, system: System, iterate: PETSc.Vec, result: PETSc.Vec) -> None:
        """Ask the solver that took over: a direct solve calls no check."""
        assert self._iterative is not None
        self._iterative.multiply(system, iterate, result)

    @property
    def preconditioner(self) -> str:
        """A factorization, or the preconditioner of the solver that took over."""
        return "cholesky" if self._iterative is None else self._iterative.preconditioner

    def free(self) -> None:
        """Free the factors; a next solve makes them anew."""
        self._ksp.reset()
        self._held = self._factored = None
        if self._iterative is not None:
            self._iterative.free()

    def destroy(self) -> None:
        """Free the PETSc objects."""
        super().destroy()
        destroy(self._iterative)

    def _factors(self, system: System, held: Mask) -> bool:
        """Factor the matrix with held dofs, unless that has been done; return whether it worked."""
        known = self._held is not None and bool((self._held == held).all())
        if known and self._assembled == system.assembled:
            return True
        entry = float(system.contact_diagonal[:1].sum()) or 1.0  # of the size of the others
        self._ksp.getPC().setFactorPivot(NO_PIVOT * entry)  # in the unit of the form
        self._ksp.setOperators(self._hold(system.contact_dofs[held], entry))
        self._ksp.setUp()
        self._held, self._assembled = held.copy(), system.assembled
        self.setups += 1
        pc = self._ksp.getPC()
        if pc.getFailedReason() != PETSc.PC.FailedReason.NOERROR:
            return False
        self._factored = pc.getFactorMatrix()
        negative, zero, _ = self._factored.getInertia()
        return not (negative or zero)


def is_small(system: System) -> bool:
    """Return whether a direct solve costs less than one with multigrid."""
    return system.comm.size == 1 and has_few_dofs(system)


def linear_solver(system: System, prefix: str, options: Mapping[str, Any]) -> LinearSolver:
    """Return the linear solver for a system: the direct one for small problems.

    Whoever sets an option of the linear solver gets a `IterativeSolver`, which takes options.

    Args:
        system: The system.
        prefix: The prefix of PETSc options.
        options: PETSc options without prefix; those that begin with "tao_" are for others.
    """
    set_before = PETSc.Options(prefix).getAll()
    chosen = any(not name.startswith("tao_") for name in options) or any(
        name.startswith(("ksp_", "pc_", "mg_")) for name in set_before
    )
    kind = DirectSolver if is_small(system) and not chosen else IterativeSolver
    return kind(system, prefix, options)
