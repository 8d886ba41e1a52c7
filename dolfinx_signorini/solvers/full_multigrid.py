"""The start of a solve on a mesh with coarser ones: contact on all of them, from the coarsest on.

The levels are those of multigrid, with the Galerkin products as matrices; a coarse node has the
obstacle of the fine node at its place. The solution of a level, interpolated and moved to the
obstacle, is the start on the next finer one, where cycles improve the start until they are quick. A
cycle is one of multilevel constraint decomposition: what the solution may still move down to the
obstacle, the defect of the obstacle, is shared out among the levels, so that no sum of corrections
leaves the obstacle. The level that a cycle improves takes one projected Gauss-Seidel sweep forward
on the way down and one backward on the way up, and coarser levels sweep there and back both times.

Where bodies meet the obstacle along axes, the turn of a node swaps components and changes signs:
each row of the finest prolongation has entries of one sign, and a coarse component has the bounds
of the fine dofs along its axis. Along other directions no coarse component has a bound of its own.

The cycles are quick until the contact set is nearly right, and slow from there on, where coarse
functions reach over its ends. Linear solves go on then, see `active_set`.

Sources: Tai, Numer. Math. 93 (2003) 755-786, for the decomposition; Bueler and Farrell, SIAM J.
Sci. Comput. 46 (2024) A3044-A3073, for the cycle and the start.
"""

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.solvers.linear.hierarchy import SMALL
from dolfinx_signorini.solvers.linear.multigrid import Multigrid
from dolfinx_signorini.solvers.linear.rows import Rows
from dolfinx_signorini.solvers.prediction import presses
from dolfinx_signorini.solvers.system import System

# The sweeps on the way down and up: of the level that a cycle improves, and of the coarser ones.
ONE, BOTH = ("forward", "backward"), ("settle", "settle")
COARSEST = 20  # sweeps there and back on the coarsest level
ROUNDS = 5  # of these sweeps on several ranks, which see the values of one another in between

# Cycles on the mesh next to the finest, at most; twice as many on each coarser one, where a cycle
# costs less. They end where a cycle moves no more than a share of what the one before has moved, or
# of what the first one has. Where values fall far, all cycles move much: with half as many, or a
# share of 0.3 alone, single steps of random loops take 5 times the iterations
# (benchmarks/random_obstacles.py), and with the first share alone spiral and steps of
# benchmarks/obstacle.py a third more cycles for as many iterations. On the finest mesh a second
# cycle costs more than it saves.
MOST_CYCLES, SLOW, STILL = 8, 0.5, 0.2

Bounds = tuple[Array, Array]


class Level:
    """A level: its matrix, load and bounds, and the prolongation from the next coarser level.

    Args:
        matrix: The matrix.
        load: The load, which the level takes over.
        bounds: The bounds of the values of this rank.
        prolongation: The prolongation; None on the coarsest level.
        signs: The sign of the entries of each row of the prolongation that has bounds.
    """

    def __init__(
        self,
        matrix: PETSc.Mat,
        load: PETSc.Vec,
        bounds: Bounds,
        prolongation: PETSc.Mat | None,
        signs: Array,
    ):
        self.matrix, self.rows, self.load, self.bounds = matrix, Rows(matrix), load, bounds
        self._signs, self._opposite = signs, signs < 0.0
        self._turned = bool(self._opposite.any())
        self.prolongation = prolongation
        self._rest, self._left, self._step, self._more = (load.duplicate() for _ in range(4))
        if prolongation is not None:
            self._parents = Rows(prolongation)
            self._coarse = prolongation.createVecRight()

    def coarser(self) -> tuple[PETSc.Vec, Bounds]:
        """Return the load of the next coarser level, and the bounds of the nodes at its places."""
        assert self.prolongation is not None
        load = self._coarse.duplicate()
        self.prolongation.multTranspose(self.load, load)
        (low, high), inject = self._aligned(self.bounds), self._parents.injected
        return load, (inject(low, -np.inf), inject(high, np.inf))

    def restricted(self, values: PETSc.Vec) -> PETSc.Vec:
        """Replace integrals over this level's functions by those over the next coarser one's."""
        assert self.prolongation is not None
        coarse = self._coarse.duplicate()
        values.array_w[:] *= self._signs
        self.prolongation.multTranspose(values, coarse)
        values.destroy()
        return coarse

    def densities(self, x: PETSc.Vec, weights: Array) -> Array:
        """Return the force on each node of x that is at a bound over the integral of its function.

        Args:
            x: A vector within the bounds.
            weights: The integrals, as far as there is an obstacle; 0 elsewhere.
        """
        self.matrix.mult(x, self._rest)
        self._rest.axpy(-1.0, self.load)
        (lower, upper), values = self.bounds, x.array_r
        found = np.zeros(len(values))
        pressed = ((values <= lower) | (values >= upper)) & (lower < upper) & (weights > 0.0)
        np.divide(self._rest.array_r, weights, out=found, where=pressed)
        return found

    def moved(self, x: PETSc.Vec) -> PETSc.Vec:
        """Move a vector to the bounds where it lies beyond, and return it."""
        x.array_w[:] = np.clip(x.array_r, *self.bounds)
        return x

    def cycle(self, x: PETSc.Vec, coarser: Sequence["Level"]) -> float:
        """Improve x by a cycle over this level and coarser ones; return the norm of the step."""
        self.matrix.mult(x, self._rest)
        self._rest.aypx(-1.0, self.load)
        lower, upper = (values - x.array_r for values in self.bounds)
        self._correct((lower, upper), coarser, ONE)
        x.axpy(1.0, self._step)
        self.moved(x)
        return float(self._step.norm())

    def settle(self, x: PETSc.Vec, coarser: Sequence["Level"], most: int) -> None:
        """Improve x by cycles, at most so many, while these are slow, see `SLOW`."""
        steps: list[float] = []
        while len(steps) < most:
            steps.append(self.cycle(x, coarser))
            if len(steps) > 1 and steps[-1] <= max(SLOW * steps[-2], STILL * steps[0]):
                break

    def free(self) -> None:
        """Free the vectors."""
        destroy(self.load, self._rest, self._left, self._step, self._more)
        if self.prolongation is not None:
            self._coarse.destroy()

    def _correct(
        self, bounds: Bounds, coarser: Sequence["Level"], sweeps: tuple[str, str] = BOTH
    ) -> None:
        """Find a step within bounds for the residual, which stays as it is."""
        if not coarser:
            self._sweep_often(bounds)
            return
        assert self.prolongation is not None
        aligned = self._aligned(bounds)
        shared = self._parents.largest(aligned[0]), -self._parents.largest(-aligned[1])
        left = (own - self._prolonged(part) for own, part in zip(aligned, shared, strict=True))
        lower, upper = self._aligned((next(left), next(left)))
        values = np.zeros(len(lower))
        self.rows.sweep(sweeps[0], self._rest, lower, upper, values, self._step)
        self._leave()
        self.prolongation.multTranspose(self._left, coarser[0]._rest)
        coarser[0]._correct(shared, coarser[1:])
        self.prolongation.multAdd(coarser[0]._step, self._step, self._step)
        self._leave()
        values = self._step.array_r.copy()
        self.rows.sweep(sweeps[1], self._left, *bounds, values, self._more)
        self._step.axpy(1.0, self._more)

    def _sweep_often(self, bounds: Bounds) -> None:
        values = np.zeros(len(bounds[0]))
        self._step.set(0.0)
        for _ in range(1 if self.matrix.comm.size == 1 else ROUNDS):
            self._leave()
            self.rows.sweep("settle", self._left, *bounds, values, self._more, COARSEST)
            self._step.axpy(1.0, self._more)

    def _leave(self) -> None:
        """Find what the step leaves of the residual."""
        self.matrix.mult(self._step, self._left)
        self._left.aypx(-1.0, self._rest)

    def _aligned(self, bounds: Bounds) -> Bounds:
        """The bounds of the values times the signs, which coarse functions raise; and back."""
        if not self._turned:
            return bounds
        (lower, upper), opposite = bounds, self._opposite
        return np.where(opposite, -upper, lower), np.where(opposite, -lower, upper)

    def _prolonged(self, values: Array) -> Array:
        """Coarse bounds on this level; where a node has none, none of its parents needs one."""
        assert self.prolongation is not None
        self._coarse.array_w[:] = np.where(np.isfinite(values), values, 0.0)
        self.prolongation.mult(self._coarse, self._more)
        return np.asarray(self._signs * self._more.array_r)


def full_multigrid(system: System, multigrid: Multigrid, x: PETSc.Vec) -> Mask | None:
    """Set x to a rough solution by cycles over all coarser meshes, from the coarsest one on.

    Args:
        system: The system; the call is collective.
        multigrid: The cycle.
        x: The vector, overwritten by a feasible one.

    Returns:
        The active set by the sign of pressure minus gap, one entry per contact dof of this rank;
        None, with x as it was, where the obstacle meets vectors along other directions than those
        of axes, or where many nodes are left on the coarsest mesh.
    """
    if multigrid.prolongations[-1].getSize()[1] > SMALL * system.layout.block:
        return None
    frame = system.layout.frame
    if frame is not None and not system.comm.allreduce(frame.along_axes, op=MPI.LAND):
        return None
    levels = levels_of(system, multigrid)
    density = _begin(system, levels, multigrid.degrees, x)
    for level in levels:
        level.free()
    return presses(system, density, x.array_r[system.contact_dofs])


def levels_of(system: System, multigrid: Multigrid) -> list[Level]:
    """Return the levels of a system, the finest first.

    Args:
        system: The system; where nodes have a direction, along an axis. The call is collective.
        multigrid: The cycle.
    """
    signs = system.layout.turned(np.ones(system.A.getLocalSize()[0]))
    load = system.b.copy()
    load.array_w[system.fixed_dofs] = 0.0
    levels: list[Level] = []
    bounds = system.bounds_with_data
    matrices = system.A, *multigrid.products(system.A, system.assembled)
    for matrix, prolongation in zip(matrices, (*multigrid.prolongations, None), strict=True):
        levels.append(Level(matrix, load, bounds, prolongation, signs))
        if prolongation is not None:
            load, bounds = levels[-1].coarser()
            signs = np.ones(load.getLocalSize())
    return levels


def _begin(system: System, levels: Sequence[Level], degrees: int, x: PETSc.Vec) -> Array:
    """Set x to a solution from the coarsest level on; lower degrees are passed without a cycle.

    The functions of lower degrees are no sums of functions with one sign each.

    Returns:
        The density of the contact force on u at the dof of each constraint, from the finest level
        with cycles.
    """
    values = levels[-1].load.duplicate()
    values.set(0.0)
    for number, level in reversed(list(enumerate(levels))):
        if level.prolongation is not None:
            values, coarse = (level.load.duplicate() if number else x), values
            level.prolongation.mult(coarse, values)
            coarse.destroy()
        level.moved(values)
        if number >= degrees:
            most = MOST_CYCLES * 2 ** (number - 1) if number else 1
            level.settle(values, levels[number + 1 :], most)
        if number == degrees:
            density = _density(system, levels[: degrees + 1], values)
    return density


def _density(system: System, levels: Sequence[Level], values: PETSc.Vec) -> Array:
    """The density of the force at the dof of each constraint, from the last one of some levels.

    Args:
        system: The system.
        levels: The levels from the finest on.
        values: The solution of the last level.
    """
    layout, density = system.layout, system.b.duplicate()
    first = slice(len(layout.free_dofs))
    density.set(0.0)
    density.array_w[system.contact_dofs[first]] = layout.weights[first]
    for level in levels[:-1]:
        density = level.restricted(density)
    density.array_w[:] = levels[-1].densities(values, density.array_r)
    for level in reversed(levels[:-1]):
        assert level.prolongation is not None
        coarse, density = density, level.load.duplicate()
        level.prolongation.mult(coarse, density)
        coarse.destroy()
    found: Array = density.array_r[system.contact_dofs]
    density.destroy()
    return found
