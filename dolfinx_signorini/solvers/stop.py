"""The stopping rule: the algebraic error is a small share of the discretisation error.

On nested meshes the linear solve begins on the next coarser one. The distance of its solution to
the present iterate tells the errors of the coarser mesh and of the finer one: with degree 1 a mesh
of half the width has at best a quarter of the error, and the distance is three times the error of
the finer mesh, or less where the solution is singular. The last steps of conjugate gradients tell
the error of the iterate. All errors are measured in the 2-norm of the nodal values: in norms of
gradients multigrid reduces errors faster, and discretisation errors are larger.
"""

import math

from petsc4py import PETSc

from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.base.tolerances import TINY

SHARE = 1 / 50  # of the estimated discretisation error
# Relative residual down to which linear solves go at least: of a larger one the active set is no
# guess. A start with this residual is as good as what such a solve finds.
LOOSEST = 1e-2
SLOWEST_KNOWN = 0.5  # rate of convergence: a first step shows none, and may look better than it is


class Stop:
    """Ends the linear solves of one mesh, from the first one that began on the coarser mesh on.

    For example, with the prolongated solution of the coarser mesh as the start of a linear solve:

        stop = Stop()
        stop.begin(ratio=3.0)
        ksp.addConvergenceTest(lambda ksp, *known: 2 if stop.enough(ksp.vec_sol, *known) else None)

    Attributes:
        allowed: The norm of the residual above which no linear solve is ended.
        error: The estimate of the discretisation error; 0 before the first estimate.
        left: The estimate of the error of the last iterate.
        reached: Whether the last linear solve was ended.
        settled: Whether the active set is settled, too.
    """

    def __init__(self) -> None:
        self.allowed = math.inf
        self.error, self.left = 0.0, math.inf
        self.reached = self.settled = False
        # The distance of both solutions over the error, in a solve that finds it out, and the next.
        self._ratio = self._next_ratio = 0.0
        self._step, self._rate = math.inf, 0.0  # the last step, and what it was of the one before
        self._usual = SLOWEST_KNOWN  # the rate that a first step is taken for
        self._before: PETSc.Vec | None = None  # the iterate before the present one
        self._solution: PETSc.Vec | None = None  # of the linear solve that was ended before

    @property
    def begun(self) -> bool:
        """Whether a linear solve has begun."""
        return self._before is not None

    def begin(self, ratio: float) -> None:
        """Say that the next linear solve starts from the solution of the next coarser mesh.

        Args:
            ratio: The distance of the solutions of both meshes over the error of the finer one.
        """
        self._next_ratio = ratio

    def enough(self, correction: PETSc.Vec, iteration: int, norm: float, unit: float = 1.0) -> bool:
        """Return whether an iteration of conjugate gradients is to be the last one.

        Args:
            correction: The sum of all steps of this linear solve so far.
            iteration: The number of the iteration.
            norm: The norm of the residual.
            unit: The unit of correction and residual.
        """
        if iteration == 0:
            self.reached, self.left = False, math.inf
            self._step, self._rate = math.inf, 0.0
            self._ratio, self._next_ratio = self._next_ratio, 0.0
            self._before = correction.copy(self._before)
            return False
        if self._ratio > 0.0:
            self.error = unit * correction.norm() / self._ratio
        assert self._before is not None
        self._before.aypx(-1.0, correction)
        step = max(unit * self._before.norm(), TINY)
        correction.copy(self._before)
        rates = (step / self._step, self._rate) if iteration > 1 else (self._usual,)
        self._step, self._rate, rate = step, rates[0], max(rates)
        if self._ratio > 0.0:
            self._usual = max(SLOWEST_KNOWN, min(rate, 1.0))
        self.left = step * rate / (1.0 - rate) if rate < 1.0 else math.inf
        self.reached = self.left <= SHARE * self.error and unit * norm <= self.allowed
        return self.reached

    def settle(self, x: PETSc.Vec, same: bool) -> bool:
        """Return whether the active set is settled, after a linear solve that was ended.

        Args:
            x: The solution of the linear solve.
            same: Whether the solution confirms its active set. Else the set is settled if the
                solution is nearly that for the set before.
        """
        if not same and self._solution is not None:
            self._solution.axpy(-1.0, x)
            same = self._solution.norm() <= SHARE * self.error
        self._solution = x.copy(self._solution)
        self.settled = same
        return same

    @property
    def share(self) -> float | None:
        """The estimated algebraic over the discretisation error, where this was what counted."""
        return self.left / self.error if self.settled else None

    def destroy(self) -> None:
        """Free the PETSc vectors."""
        destroy(self._before, self._solution)
