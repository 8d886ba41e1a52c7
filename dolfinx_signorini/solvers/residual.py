"""How far a vector is from solving the discrete problem: the natural residual.

At a solution the gap u - g and the multiplier lambda = A u - b satisfy gap >= 0, lambda >= 0 and
gap * lambda = 0 at the contact dofs, and lambda = 0 at all others, that is

    min(d gap, lambda) = 0 at contact dofs,    lambda = 0 elsewhere

for any d > 0; the diagonal of A as d gives both the same unit. The 2-norm of this vector relative
to the forces decides on convergence for every solver of this package. Forces are the load ||b|| and
what the obstacle does: the pressure on the dofs that are held, but no more than ||d max(g, 0)||,
which is also what lifting the body over it would take. (That alone would not do. A thin body on a
high obstacle presses on it with little more than its load, and the load would be lost in it.) No
residual is asked for below what rounding makes of the height of the obstacle.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.system import DiscreteProblem

Array = npt.NDArray[np.float64]

ROUNDING = 64 * float(np.finfo(np.float64).eps)  # of A u where u is as high as the obstacle


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
        rtol: The relative residual that will be asked for.

    Attributes:
        scale: The norm of the forces that residuals are relative to.
        norm: The norm of the last residual.
        multiplier: A x - b of the last vector measured, a PETSc vector.
    """

    def __init__(self, problem: DiscreteProblem, rtol: float = math.inf):
        self.problem = problem
        self.rtol = rtol
        self.diagonal = problem.contact_diagonal
        self.multiplier = problem.A.createVecLeft()
        problem.ledger.add("vector", "multiplier A u - b", self.multiplier)
        load = problem.b.array_r.copy()
        load[problem.fixed_dofs] = 0.0
        pushing = self.diagonal * np.maximum(problem.obstacle, 0.0)
        self.load = parallel_norm(problem.comm, load)
        self.pushing = parallel_norm(problem.comm, pushing)
        self.scale = self._scale(self.pushing)
        self.norm = self.scale

    def measure(self, x: PETSc.Vec) -> float:
        """Return the relative natural residual of a vector with the right Dirichlet data.

        `scale`, `norm` and `multiplier` are then those of this vector.
        """
        problem = self.problem
        problem.A.mult(x, self.multiplier)
        self.multiplier.axpy(-1.0, problem.b)
        residual = self.multiplier.array_r.copy()
        dofs = problem.contact_dofs
        gap = self.diagonal * (x.array_r[dofs] - problem.obstacle)
        pressure = residual[dofs]
        residual[dofs] = np.minimum(gap, pressure)
        residual[problem.fixed_dofs] = 0.0
        self.norm = parallel_norm(problem.comm, residual)
        if self.pushing == 0.0:
            return self.norm / self.scale
        self.scale = self._scale(parallel_norm(problem.comm, pressure[pressure > gap]))
        return self.norm / self.scale

    def _scale(self, pressure: float) -> float:
        scale = max(self.load + min(pressure, self.pushing), ROUNDING / self.rtol * self.pushing)
        return scale if scale > 0.0 else 1.0  # without any forces residuals are absolute

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
