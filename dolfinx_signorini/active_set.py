"""The primal-dual active set method with conjugate gradients and algebraic multigrid.

Given a guess of the active set, the contact dofs in it are held at the obstacle and one linear
system is left. Its solution tells which dofs to release (multiplier negative) and which to hold
(gap negative). Where only a few have to change, a small problem around them finds out how far the
change goes, in place of one dof per linear solve. What ends the iteration is the natural residual:
where gap and multiplier vanish together, the set may keep changing within rounding for ever.

Source: Hintermueller, Ito and Kunisch, SIAM J. Optim. 13 (2003) 865-888.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.assembly import DiscreteProblem
from dolfinx_signorini.errors import InputError
from dolfinx_signorini.optimality import Optimality
from dolfinx_signorini.patch import active_in_patch

Mask = npt.NDArray[np.bool_]

LINEAR_FRACTION = 1e-2  # of rtol is left to the linear solver
LOOSE = 1e-3  # how far a linear solve goes, relative to the residual, while the set is a guess
SEVERE = 0.1  # relative to the largest defect: a dof that has to change
LOCAL_FRACTION = 0.02  # of the contact dofs have to change at most, for a change to count as local
STALL = 8  # steps without a lower residual that end the iteration
MAX_STEPS = 60
MAX_LINEAR_ITERATIONS = 200

DEFAULT_OPTIONS: dict[str, Any] = {
    "ksp_type": "cg",
    "pc_type": "hypre",
    "pc_hypre_type": "boomeramg",
}


class HeldSystem:
    """Linear solves with chosen contact dofs held at the obstacle.

    Args:
        problem: The problem.
        options: PETSc options of the linear solver, without prefix.

    Attributes:
        solves: Number of linear solves so far.
        setups: Number of multigrid set-ups so far.
        iterations: Number of conjugate gradient iterations so far.
    """

    def __init__(self, problem: DiscreteProblem, options: Mapping[str, Any] | None = None):
        self.problem = problem
        self.solves = self.setups = self.iterations = 0
        self._held: Mask | None = None
        self.matrix: PETSc.Mat | None = None
        self.rhs = problem.A.createVecLeft()
        self.ksp = PETSc.KSP().create(problem.comm)
        prefix = "dolfinx_signorini_held_"
        self.ksp.setOptionsPrefix(prefix)
        database = PETSc.Options()
        settings = DEFAULT_OPTIONS | dict(options or {})
        for key, value in settings.items():
            database[prefix + key] = value
        try:
            self.ksp.setFromOptions()
        finally:
            for key in settings:
                database.delValue(prefix + key)
        self.ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        self.ksp.setInitialGuessNonzero(True)

    def solve(self, x: PETSc.Vec, held: Mask, atol: float) -> None:
        """Solve for the dofs that are not held, from x on, until the residual norm is atol.

        Raises:
            InputError: The form turned out to be indefinite.
        """
        self._hold(held)
        problem = self.problem
        dofs = problem.contact_dofs[held]
        x.array_w[dofs] = problem.obstacle[held]
        x.array_w[problem.fixed_dofs] = problem.fixed_values
        self.ksp.setTolerances(rtol=0.0, atol=atol, divtol=1e30, max_it=MAX_LINEAR_ITERATIONS)
        self.ksp.solve(self._right_hand_side(x, dofs), x)
        self.solves += 1
        self.iterations += self.ksp.getIterationNumber()
        reason = self.ksp.getConvergedReason()
        if reason in (
            PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT,
            PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_PC,
        ):
            raise InputError("form a: not positive definite, found by conjugate gradients")

    def _hold(self, held: Mask) -> None:
        comm, problem = self.problem.comm, self.problem
        changed = True if self._held is None else bool((held != self._held).any())
        if not comm.allreduce(changed, op=MPI.LOR):
            return
        if self.matrix is None:
            self.matrix = problem.A.copy()
        else:
            problem.A.copy(self.matrix, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        offset = self.matrix.getOwnershipRange()[0]
        rows = problem.contact_dofs[held] + offset
        self.matrix.zeroRowsColumns(rows, diag=self._diagonal())
        self._held = held.copy()
        # A set-up costs as much as four iterations; a hierarchy that is one dof off costs ten.
        self.ksp.setOperators(self.matrix)
        self.ksp.setUp()
        self.setups += 1

    def _diagonal(self) -> float:
        """A typical diagonal entry, so that held rows are not outliers of the matrix."""
        entries = self.problem.contact_diagonal
        total, count = self.problem.comm.allreduce(np.array([entries.sum(), len(entries)]))
        return float(total / count) if count else 1.0

    def _right_hand_side(self, x: PETSc.Vec, dofs: npt.NDArray[np.int32]) -> PETSc.Vec:
        """b - A x_held on the free dofs, d x_held on the held ones."""
        problem = self.problem
        values = np.zeros(x.getLocalSize())
        values[dofs] = x.array_r[dofs]
        held = x.duplicate()
        held.array_w[:] = values
        problem.A.mult(held, self.rhs)
        self.rhs.aypx(-1.0, problem.b)
        self.rhs.array_w[dofs] = self._diagonal() * values[dofs]
        held.destroy()
        self.rhs.array_w[problem.fixed_dofs] = problem.fixed_values
        return self.rhs

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for item in (self.ksp, self.rhs, self.matrix):
            if item is not None:
                item.destroy()


def solve_active_set(
    system: HeldSystem,
    optimality: Optimality,
    x: PETSc.Vec,
    held: Mask,
    rtol: float,
    trusted: bool,
) -> float:
    """Run the primal-dual active set method.

    Args:
        system: The linear solver.
        optimality: Measures the natural residual.
        x: Start for the linear solver; the solution on return.
        held: Guess of the active set, one entry per contact dof.
        rtol: Relative natural residual to reach.
        trusted: Whether the guess is good enough to solve for it to the end at once.

    Returns:
        The relative natural residual reached; larger than rtol where the set does not settle.
    """
    problem = system.problem
    residual, best, stalled = 1.0, np.inf, 0
    for _ in range(MAX_STEPS):
        target = (
            rtol * LINEAR_FRACTION if trusted else max(rtol * LINEAR_FRACTION, LOOSE * residual)
        )
        system.solve(x, held, target * optimality.scale)
        residual = optimality.measure(x)
        if residual <= rtol:
            break
        stalled = 0 if residual < best else stalled + 1
        best = min(best, residual)
        if stalled == STALL:
            break
        held, trusted = _correct(problem, optimality, x, held, local=stalled < STALL // 2)
    return residual


def _correct(
    problem: DiscreteProblem, optimality: Optimality, x: PETSc.Vec, held: Mask, local: bool
) -> tuple[Mask, bool]:
    """Return the next active set, and whether the change was a local one."""
    gap = x.array_r[problem.contact_dofs] - problem.obstacle
    pressure = optimality.multiplier.array_r[problem.contact_dofs]
    defect = pressure - problem.contact_diagonal * gap
    wrong = (defect > 0.0) != held
    # What is far below the largest defect may be its consequence.
    largest = problem.comm.allreduce(float(np.abs(defect[wrong]).max(initial=0.0)), op=MPI.MAX)
    severe = wrong & (np.abs(defect) >= SEVERE * largest)
    counts = problem.comm.allreduce(np.array([severe.sum(), len(held)]))
    if local and counts[0] <= max(LOCAL_FRACTION * counts[1], 8):
        problem.project(x)
        optimality.measure(x)
        update = active_in_patch(
            problem, x, optimality.multiplier, held, problem.contact_dofs[severe]
        )
        if problem.comm.allreduce(bool((update != held).any()), op=MPI.LOR):
            return update, True
    return defect > 0.0, False
