"""The natural residual: how far a vector is from solving the discrete problem.

At a solution the gap s (u - g) and the multiplier s lambda, lambda = A u - b, of each constraint
with the sign s satisfy gap >= 0, s lambda >= 0 and gap * lambda = 0, and lambda = 0 at all other
dofs, that is

    min(d gap, lambda) = 0 at lower obstacles,    max(-d gap, lambda) = 0 at upper ones,
    max(min(d gap_below, lambda), -d gap_above) = 0 between both,    lambda = 0 elsewhere

for any d > 0; the diagonal of A as d gives both the same unit. The 2-norm of this vector relative
to the forces decides on convergence for every solver of this package. The forces are those on a
body that rests where the Dirichlet data have it, see `motions.at_rest`, so that the origin of u
does not matter: the load, and what the obstacle does, the pressure on the dofs that are held, but
no more than ||d max(g, 0)|| with the height g of the obstacle above the body at rest, which is also
the force that lifts the body over the obstacle. (The lifting force alone would not do: a thin body
on a high obstacle presses on the obstacle with little more than its load, and the load would be
lost in the force.) No residual is asked for below what rounding makes of the height of the obstacle
and of the place of rest.
"""

import math

import numpy as np
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.ranks import parallel_norm
from dolfinx_signorini.base.tolerances import PRECISION, UNIT
from dolfinx_signorini.solvers.motions import at_rest
from dolfinx_signorini.solvers.system import System

ROUNDING = 64 * PRECISION  # of A u where u is as high as the obstacle


class NaturalResidual:
    """Measures natural residuals of one system.

    The multiplier of the vector that was measured last stays at hand:

        measure = NaturalResidual(system)
        residual = measure(x)
        pressure = measure.multiplier.array_r[system.contact_dofs]

    Args:
        system: The system; its matrix and load must not change while this object is used.
        rtol: The relative residual that will be asked for.

    Attributes:
        scale: The norm of the forces that residuals are relative to.
        norm: The norm of the last residual.
        multiplier: A x - b of the last vector measured, a PETSc vector.
    """

    def __init__(self, system: System, rtol: float = math.inf):
        self.system = system
        self.rtol = rtol
        self.multiplier = system.A.createVecLeft()
        rest, load = at_rest(system)
        rounding = _rounding_of(system, rest)
        height = system.signs * (system.obstacle - rest[system.contact_dofs])
        pushing = system.contact_diagonal * np.maximum(height, 0.0)
        self.load = parallel_norm(system.comm, load)
        self.pushing = parallel_norm(system.comm, pushing)
        self.least = (rounding + ROUNDING * self.pushing) / rtol
        self.scale = self._scale(self.pushing)
        self.norm = self.scale

    def __call__(self, x: PETSc.Vec) -> float:
        """Return the relative natural residual of a vector with the right Dirichlet data.

        The attributes `scale`, `norm` and `multiplier` then belong to this vector.
        """
        self.system.set_forces(x, self.multiplier)
        return self.with_multiplier(x)

    def with_multiplier(self, x: PETSc.Vec) -> float:
        """As a call, where `multiplier` has been set to A x - b already."""
        system, residual = self.system, self.multiplier.array_r.copy()
        pressing = system.natural(x, self.multiplier.array_r, residual)
        residual[system.fixed_dofs] = 0.0
        self.norm = parallel_norm(system.comm, residual)
        if self.pushing > 0.0:
            self.scale = self._scale(parallel_norm(system.comm, pressing))
        return self.relative

    @property
    def relative(self) -> float:
        """The relative natural residual of the last vector measured."""
        return self.norm / self.scale

    def close_gaps(self, x: PETSc.Vec) -> float:
        """Decide what is in contact, give x exactly this contact, and return the residual of x.

        A dof is in contact where the multiplier exceeds the scaled gap. The natural residual
        counts the smaller one of both, so that within a tolerance a pressed dof may hover before
        the obstacle. In the vector that a solver hands out no gap is left where there is pressure.

        Args:
            x: The vector that was measured last, changed in place.
        """
        if self.system.project(x, self.defect(x) > 0.0):
            return self(x)
        return self.relative

    def defect(self, x: PETSc.Vec) -> Array:
        """Return multiplier minus scaled gap of each constraint: positive where to hold.

        The vector is the one that was measured last.
        """
        return self.system.defect(x, self.multiplier.array_r)

    def _scale(self, pressure: float) -> float:
        scale = max(self.load + min(pressure, self.pushing), self.least)
        return scale if scale > 0.0 else 1.0  # without any forces residuals are absolute

    def destroy(self) -> None:
        """Free the PETSc vector."""
        self.multiplier.destroy()


def _rounding_of(system: System, rest: Array) -> float:
    """What rounding may make of A u in all rows where u is near some values."""
    diagonal = system.A.getDiagonal()
    forces = diagonal.array_r * rest
    forces[system.fixed_dofs] = 0.0
    diagonal.destroy()
    return UNIT * parallel_norm(system.comm, forces)
