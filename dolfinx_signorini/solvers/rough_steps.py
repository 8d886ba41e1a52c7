"""Rough steps to the active set of an obstacle in the domain.

The ends of contact are curves or surfaces there, with as many dofs as the mesh is wide, and many
are wrong at first. A step is a projected Gauss-Seidel sweep, which moves the ends by about a dof
and says which dofs are in contact, and some conjugate gradients with the dofs in contact held. The
preconditioner may be one for another set, as long as the set keeps changing.

Source: Graeser and Kornhuber, J. Comput. Math. 27 (2009) 1-44, for truncated nonsmooth Newton
multigrid.
"""

from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Mask
from dolfinx_signorini.solvers.linear.rows import Rows
from dolfinx_signorini.solvers.linear.solver import LinearSolver
from dolfinx_signorini.solvers.residual import NaturalResidual
from dolfinx_signorini.solvers.system import System

# Of conjugate gradients in a step: with 1 or 3, or until a share of the residual is left, the whole
# solve takes as long or longer (benchmarks/obstacle.py).
ITERATIONS = 2
LONGEST = 30  # steps
# The set of the preconditioner may be another one at this many times the dofs that a sweep changes.
STALE = 4


class Sweeps:
    """Projected Gauss-Seidel sweeps, forward and backward in turn:

        sweeps = Sweeps(system)
        held = sweeps(x, measure.multiplier)

    Args:
        system: The system; the creation is collective.
    """

    def __init__(self, system: System):
        self._system, self._rows = system, Rows(system.A)
        self._bounds = system.bounds_with_data
        self._kinds = ["forward", "backward"]

    def __call__(self, x: PETSc.Vec, multiplier: PETSc.Vec) -> Mask:
        """Improve a feasible x by a sweep, and return which constraints hold x then.

        Args:
            x: The vector.
            multiplier: A x - b for this x, overwritten.
        """
        multiplier.scale(-1.0)
        step = multiplier.duplicate()
        self._rows.sweep(self._kinds[0], multiplier, *self._bounds, x.array_w, step)
        step.destroy()
        self._kinds.reverse()
        return self._system.touching_once(x)


def rough_steps(
    system: System,
    solver: LinearSolver,
    measure: NaturalResidual,
    x: PETSc.Vec,
    held: Mask,
    rtol: float,
) -> tuple[Mask, float]:
    """Improve x by rough steps, until a sweep changes nothing of the active set.

    Args:
        system: The system.
        solver: The linear solver.
        measure: Holds the multiplier of x, before and afterwards.
        x: A feasible vector, overwritten.
        held: The guess of the active set that goes with x.
        rtol: The relative natural residual to reach, which ends the steps earlier.

    Returns:
        The active set, and the relative natural residual of x.
    """
    sweeps, residual = Sweeps(system), measure.relative

    def enough(correction: PETSc.Vec, iteration: int, norm: float, unit: float) -> bool:
        return iteration >= ITERATIONS

    for _ in range(LONGEST):
        before, held = held, sweeps(x, measure.multiplier)
        changed = system.comm.allreduce(int((before != held).sum()))
        if not changed:
            break
        slack = STALE * changed
        solver.solve(system, x, held, rtol * measure.scale, check=enough, slack=slack)
        system.project(x)
        residual = measure(x)
        if residual <= rtol:
            break
    return held, residual
