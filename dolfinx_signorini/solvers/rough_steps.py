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


def swept(system: System, rows: Rows, kind: str, x: PETSc.Vec, multiplier: PETSc.Vec) -> Mask:
    """Improve a feasible x by a projected sweep, and return which constraints hold x then.

    Args:
        system: The system.
        rows: The rows of its matrix.
        kind: "forward" or "backward".
        x: The vector.
        multiplier: A x - b for this x, overwritten.
    """
    multiplier.scale(-1.0)
    step = multiplier.duplicate()
    rows.sweep(kind, multiplier, *system.bounds_with_data, x.array_w, step)
    step.destroy()
    return system.touching_once(x)


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
    residual = measure.relative
    for kind in ("forward", "backward") * (LONGEST // 2):
        held, changed, residual = rough_step(system, solver, measure, x, held, rtol, kind, False)
        if not changed or residual <= rtol:
            break
    return held, residual


def rough_step(
    system: System,
    solver: LinearSolver,
    measure: NaturalResidual,
    x: PETSc.Vec,
    held: Mask,
    rtol: float,
    kind: str = "forward",
    always: bool = True,
) -> tuple[Mask, int, float]:
    """Improve x by a sweep and some conjugate gradients, see `rough_steps` for the arguments.

    Conjugate gradients for a set that is far from the right one raise the residual.

    Args:
        kind: "forward" or "backward".
        always: Whether conjugate gradients follow a sweep that changes nothing of the set, too.

    Returns:
        The active set, how many of its dofs the sweep has changed, and the residual of x.
    """
    before, held = held, swept(system, Rows(system.A), kind, x, measure.multiplier)
    changed = system.comm.allreduce(int((before != held).sum()))
    if not (changed or always):
        return held, changed, measure.relative

    def enough(correction: PETSc.Vec, iteration: int, norm: float, unit: float) -> bool:
        return iteration >= ITERATIONS

    slack = STALE * changed
    solver.solve(system, x, held, rtol * measure.scale, check=enough, slack=slack)
    system.project(x)
    return held, changed, measure(x)
