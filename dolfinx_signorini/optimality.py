"""How far a vector is from solving the discrete problem: the natural residual.

At a solution the gap u - g and the multiplier lambda = A u - b satisfy gap >= 0, lambda >= 0 and
gap * lambda = 0 at the contact dofs, and lambda = 0 at all others, that is

    min(d gap, lambda) = 0 at contact dofs,    lambda = 0 elsewhere

for any d > 0; the diagonal of A as d gives both the same unit. The 2-norm of this vector relative
to the data, ||b|| + ||d max(g, 0)||, decides on convergence for every solver of this package.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.assembly import DiscreteProblem

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class SolveResult:
    """A discrete solution with its diagnostics.

    Attributes:
        u: The solution; u >= g at the contact dofs holds exactly.
        method: The solver.
        reason: Why the solver stopped, in words.
        iterations: TAO's iterations.
        linear_solves: Linear solves of the active-set method, 0 where TAO did it all.
        linear_iterations: Iterations of the linear solver, TAO's included.
        natural_residual: Natural residual relative to the data.
        active_dofs: Number of contact dofs with u = g.
        seconds: Wall-clock seconds of each phase.
    """

    u: fem.Function
    method: str
    reason: str
    iterations: int
    linear_solves: int
    linear_iterations: int
    natural_residual: float
    active_dofs: int
    seconds: dict[str, float]


class Optimality:
    """Measures natural residuals of one problem.

    Args:
        problem: The problem; its matrix and load must not change while this object is used.

    Attributes:
        scale: The norm of the data that residuals are relative to.
        multiplier: A x - b of the last vector measured, a PETSc vector.
    """

    def __init__(self, problem: DiscreteProblem):
        self.problem = problem
        self.diagonal = problem.contact_diagonal
        self.multiplier = problem.A.createVecLeft()
        load = problem.b.array_r.copy()
        load[problem.fixed_dofs] = 0.0
        pushing = self.diagonal * np.maximum(problem.obstacle, 0.0)
        self.scale = parallel_norm(problem.comm, load) + parallel_norm(problem.comm, pushing)

    def measure(self, x: PETSc.Vec) -> float:
        """Return the relative natural residual of a vector with the right Dirichlet data."""
        problem = self.problem
        problem.A.mult(x, self.multiplier)
        self.multiplier.axpy(-1.0, problem.b)
        residual = self.multiplier.array_r.copy()
        dofs = problem.contact_dofs
        gap = x.array_r[dofs] - problem.obstacle
        residual[dofs] = np.minimum(self.diagonal * gap, residual[dofs])
        residual[problem.fixed_dofs] = 0.0
        return self.relative(parallel_norm(problem.comm, residual))

    def relative(self, norm: float) -> float:
        """Return a norm relative to the data; with no data at all only 0 is small."""
        return norm / self.scale if self.scale > 0.0 else norm

    def destroy(self) -> None:
        """Free the PETSc vector."""
        self.multiplier.destroy()


def parallel_norm(comm: MPI.Comm, values: Array) -> float:
    """Return the 2-norm over all ranks of an array, safe from overflow and underflow."""
    largest = float(comm.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX))
    if largest == 0.0 or not np.isfinite(largest):
        return largest
    scale = power_of_two(largest)
    return scale * float(np.sqrt(comm.allreduce(float(np.square(values / scale).sum()))))


def power_of_two(value: float) -> float:
    """Return the power of two next below a positive number: dividing by it is exact."""
    return float(2.0 ** np.floor(np.log2(value)))
