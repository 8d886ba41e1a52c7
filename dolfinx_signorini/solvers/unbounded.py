"""Energies that have no lower bound.

A form may vanish on functions that the load moves and that no obstacle stops, for example where the
derivative in one direction is missing. Then iterates grow without end, direct solvers divide by
what rounding has left of zero, and conjugate gradients go on until their limit. Such functions are
seen along the iterates of TAO, or looked for where a solver has failed.
"""

import math

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.base.tolerances import SOLVED, TINY, UNIT, power_of_two
from dolfinx_signorini.solvers.system import System

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
    free = bool((system.signs * values[system.contact_dofs] >= 0.0).all())
    with np.errstate(over="ignore"):
        size = comm.allreduce(float((values**2 * diagonal).sum()))
    return curvature <= UNIT * size < math.inf and comm.allreduce(free, op=MPI.LAND)


def check_bounded(system: System) -> None:
    """Refuse a system, of which no solution was found, if its energy has no lower bound.

    Args:
        system: The system; the call is collective.

    Raises:
        InputError: The energy is unbounded below.
    """
    if moves_without_energy(system):
        raise InputError(UNBOUNDED, "form a")


def moves_without_energy(system: System) -> bool:
    """Return whether the load moves a function that has no energy and vanishes at contact dofs.

    With D the diagonal of A, conjugate gradients solve A y = A z for z = D^{-1} b, on the dofs that
    nothing holds. What remains, z - y, is the part of z in the kernel of A, orthogonal to what has
    energy in the product of D: the load does the work |z - y|_D^2 on it. Where A has no kernel
    nothing remains but rounding, which has energy.

    Args:
        system: The system; the call is collective.
    """
    dofs = np.concatenate((system.contact_dofs, system.fixed_dofs))
    matrix = system.A.copy()
    matrix.zeroRowsColumns(dofs + matrix.getOwnershipRange()[0], diag=1.0)
    diagonal, rest, found = matrix.getDiagonal(), system.b.duplicate(), system.b.duplicate()
    ksp = PETSc.KSP().create(system.comm)
    ksp.setType(PETSc.KSP.Type.CG)
    ksp.getPC().setType(PETSc.PC.Type.JACOBI)
    ksp.setOperators(matrix)
    ksp.setTolerances(rtol=SOLVED, atol=0.0, divtol=1.0 / TINY)
    remains = system.b.copy()
    remains.array_w[dofs] = 0.0
    remains.scale(1.0 / power_of_two(remains.norm(PETSc.NormType.INFINITY)))
    remains.pointwiseDivide(remains, diagonal)
    matrix.mult(remains, rest)
    ksp.solve(rest, found)
    remains.axpy(-1.0, found)
    matrix.mult(remains, rest)
    found.pointwiseMult(remains, diagonal)
    energy, size = remains.dot(rest), remains.dot(found)
    destroy(matrix, diagonal, rest, found, ksp, remains)
    return bool(energy <= UNIT * size and size > 0.0)
