"""Rough steps to the active set of an obstacle in the domain.

The ends of contact are curves or surfaces there, with as many dofs as the mesh is wide, and many
are wrong at first. A step is a projected Gauss-Seidel sweep, which moves the ends by about a dof
and says which dofs are in contact, and one iteration of conjugate gradients with the dofs in
contact held. When a sweep over its iterate changes nothing of the set, the conjugate gradients go
on to the end. With two iterations a step, solves take 2 to 6 % longer (benchmarks/obstacle.py).

Source: Graeser and Kornhuber, J. Comput. Math. 27 (2009) 1-44, for truncated nonsmooth Newton
multigrid.
"""

import itertools

from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Mask
from dolfinx_signorini.base.ranks import anywhere
from dolfinx_signorini.solvers.linear.rows import Rows
from dolfinx_signorini.solvers.linear.solver import LinearSolver
from dolfinx_signorini.solvers.residual import NaturalResidual
from dolfinx_signorini.solvers.system import System

LONGEST = 30  # steps


def swept(system: System, kind: str, x: PETSc.Vec, multiplier: PETSc.Vec) -> Mask:
    """Improve a feasible x by a projected sweep, and return which constraints hold x then.

    Args:
        system: The system.
        kind: "forward" or "backward".
        x: The vector.
        multiplier: A x - b for this x, overwritten.
    """
    multiplier.scale(-1.0)
    step = multiplier.duplicate()
    Rows(system.A).sweep(kind, multiplier, *system.bounds_with_data, x.array_w, step)
    step.destroy()
    return system.touching_once(x)


class Sweep:
    """A sweep over an iterate of a linear solve, which ends if the sweep changes the active set.

    For example:

        sweep = Sweep(measure, x, held, "forward")
        solver.solve(system, x, held, atol, check=sweep.enough)
        held = sweep.take()

    Args:
        measure: Measures natural residuals.
        x: The vector that the solve improves, at its start while the solve goes on.
        held: The active set of the solve.
        kind: "forward" or "backward".
        last: Whether the solve ends with the sweep in any case.

    Attributes:
        changed: Whether the sweep has changed the set.
    """

    def __init__(
        self, measure: NaturalResidual, x: PETSc.Vec, held: Mask, kind: str, last: bool = False
    ):
        self._measure, self._x, self._held, self._kind = measure, x, held, kind
        self._last, self.changed = last, False
        self._iterate: PETSc.Vec | None = None
        self._swept = held

    def enough(self, correction: PETSc.Vec, iteration: int, norm: float, unit: float) -> bool:
        """Return whether the set is another one than that of the solve, see `Probe.enough`."""
        if iteration != 1:
            return False
        measure, system = self._measure, self._measure.system
        self._iterate = self._x.copy(self._iterate)
        self._iterate.axpy(unit, correction)
        system.project(self._iterate)
        system.set_forces(self._iterate, measure.multiplier)
        measure.with_multiplier(self._iterate)
        self._swept = swept(system, self._kind, self._iterate, measure.multiplier)
        self.changed = anywhere(system.comm, self._swept != self._held)
        return self.changed or self._last

    def take(self) -> Mask:
        """Give x the iterate after the sweep, if that has ended the solve; return the set."""
        if self._iterate is not None:
            if self.changed:
                self._iterate.copy(self._x)
            self._iterate.destroy()
        return self._swept


def rough_step(
    system: System,
    solver: LinearSolver,
    measure: NaturalResidual,
    x: PETSc.Vec,
    held: Mask,
    kind: str,
    rtol: float,
    last: bool,
) -> tuple[Mask, bool]:
    """Improve x by an iteration of conjugate gradients and a sweep, or by all iterations.

    Conjugate gradients for a set that is far from the right one raise the residual.

    Args:
        system: The system.
        solver: The linear solver.
        measure: Measures natural residuals, and has measured that of x or of a vector near x.
        x: A feasible vector, overwritten.
        held: Its active set, after a sweep.
        kind: "forward" or "backward", other than the sweep before.
        rtol: The residual of the linear system to reach where the sweep changes nothing, over the
            scale of natural residuals.
        last: Whether the conjugate gradients end with the sweep in any case.

    Returns:
        The active set, and whether it has changed.
    """
    sweep = Sweep(measure, x, held, kind, last)
    solver.solve(system, x, held, rtol * measure.scale, check=sweep.enough)
    solver.solves -= sweep.changed or last
    return sweep.take(), sweep.changed


def rough_steps(
    system: System,
    solver: LinearSolver,
    measure: NaturalResidual,
    x: PETSc.Vec,
    rtol: float,
    to_the_end: bool,
) -> tuple[Mask, bool]:
    """Improve x by rough steps, until a sweep changes nothing of the active set.

    Args:
        system: The system.
        solver: The linear solver.
        measure: Holds the multiplier of x, overwritten.
        x: A feasible vector, overwritten.
        rtol: The residual of the linear system to reach, over the scale of natural residuals.
        to_the_end: Whether the last linear solve goes on until this residual is reached.

    Returns:
        The active set, and whether the residual is reached for this set.
    """
    held = swept(system, "forward", x, measure.multiplier)
    for kind in itertools.islice(itertools.cycle(("backward", "forward")), LONGEST):
        step = system, solver, measure, x, held, kind, rtol, not to_the_end
        held, changed = rough_step(*step)
        if not changed:
            return held, to_the_end
    return held, False
