"""Energies that have no lower bound, found along the iterates of a solver.

A form may vanish on functions that the load moves and that no obstacle stops, for example where the
derivative in one direction is missing. Then the iterates grow without end, and direct solvers
divide by what rounding has left of zero.
"""

import math

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.tolerances import TINY
from dolfinx_signorini.solvers.residual import power_of_two
from dolfinx_signorini.solvers.system import System

VANISHING = 1e-15  # of the sum of A_ii v_i^2: a smaller v.A v is rounding
UNBOUNDED = (
    "vanishes on functions that the load moves and no obstacle stops: the energy is unbounded below"
)


def falls_for_ever(
    system: System,
    v: PETSc.Vec,
    curvature: float,
    work: float,
    diagonal: npt.NDArray[np.float64],
) -> bool:
    """Return whether nothing bounds the energy along a vector: neither curvature nor an obstacle.

    Args:
        system: The system; the call is collective.
        v: The vector, whose squares are numbers.
        curvature: v.A v.
        work: The load on v, in any unit.
        diagonal: The diagonal of A in the unit of the curvature, the rows of this rank.
    """
    if not work > 0.0:
        return False
    values, comm = v.array_r, system.comm
    free = bool((values[system.contact_dofs] >= 0.0).all())
    with np.errstate(over="ignore"):
        size = comm.allreduce(float((values**2 * diagonal).sum()))
    return curvature <= VANISHING * size < math.inf and comm.allreduce(free, op=MPI.LAND)


def starts_in_infinity(
    system: System, x: PETSc.Vec, multiplier: PETSc.Vec, diagonal: npt.NDArray[np.float64]
) -> bool:
    """Return whether a solver has left a start along which the energy falls for ever.

    Args:
        system: The system; the call is collective.
        x: The start.
        multiplier: A x - b.
        diagonal: The diagonal of A, the rows of this rank.
    """
    largest = x.norm(PETSc.NormType.INFINITY)
    if not TINY < largest < 1.0 / TINY:
        return False
    v, unit = x.copy(), power_of_two(largest)
    v.scale(1.0 / unit)
    work = v.dot(system.b)
    found = falls_for_ever(system, v, (v.dot(multiplier) + work) / unit, work, diagonal)
    v.destroy()
    return found
