"""What the linear solvers share: held dofs are placed, and the rest is a correction with a unit."""

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.solvers.residual import power_of_two
from dolfinx_signorini.solvers.system import System

Mask = npt.NDArray[np.bool_]


def place(system: System, x: PETSc.Vec, held: Mask) -> bool:
    """Set the held and the Dirichlet dofs of x, and return whether a rank has changed one.

    Args:
        system: The system.
        x: The vector.
        held: Whether a contact dof of this rank is held at the obstacle.
    """
    dofs = np.concatenate((system.contact_dofs[held], system.fixed_dofs))
    values = np.concatenate((system.obstacle[held], system.fixed_values))
    moved = bool((x.array_r[dofs] != values).any())
    x.array_w[dofs] = values
    return bool(system.comm.allreduce(moved, op=MPI.LOR))


def set_residual(
    system: System, x: PETSc.Vec, held: Mask, multiplier: PETSc.Vec | None, rhs: PETSc.Vec
) -> float:
    """Set rhs to b - A x on the free dofs, 0 on others, in a unit of its size; return the unit.

    No square of an entry in this unit overflows or underflows.

    Args:
        system: The system.
        x: The vector.
        held: Whether a contact dof of this rank is held at the obstacle.
        multiplier: A x - b, where that is known.
        rhs: The vector to set.
    """
    if multiplier is None:
        system.A.mult(x, rhs)
        rhs.aypx(-1.0, system.b)
    else:
        multiplier.copy(rhs)
        rhs.scale(-1.0)
    rhs.array_w[np.concatenate((system.contact_dofs[held], system.fixed_dofs))] = 0.0
    largest = rhs.norm(PETSc.NormType.INFINITY)
    unit = power_of_two(largest) if largest > 0.0 else 1.0
    rhs.scale(1.0 / unit)
    return unit
