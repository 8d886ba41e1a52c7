"""The active set on a fine mesh, predicted from a coarser solution.

The values and the density of the contact pressure are carried to the fine mesh at the contact
boundary only, and predict the active set by the sign of pressure minus gap. (Values alone do not:
where u vanishes together with its flux, half of the values are rounding.) Small problems around the
ends of the predicted contact set, with the coarse solution outside, settle the set to the dof.
"""

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.ranks import marked
from dolfinx_signorini.solvers.linear.direct import is_small
from dolfinx_signorini.solvers.patch import LARGE, RINGS, active_in_patch, patch_dofs
from dolfinx_signorini.solvers.pressure import ContactState
from dolfinx_signorini.solvers.system import System
from dolfinx_signorini.solvers.transfer import Carrier


def predict(system: System, coarse: ContactState) -> Mask:
    """Predict the active set from a solution on another mesh, or on the same one.

    Args:
        system: The system.
        coarse: The other solution; only cells at the contact boundary and near the ends of the
            contact set are looked up, and none where both meshes are the same.

    Returns:
        One entry per contact dof of this rank.
    """
    dofs = system.contact_dofs
    carry = Carrier(coarse.u.function_space, system.space)
    u, density = fem.Function(system.space), fem.Function(system.space)
    carry([(coarse.u, u), (coarse.density, density)], dofs)
    held = presses(system, density.x.array[dofs], u.x.array[dofs])
    return _settled(system, carry, coarse.u, u, held)


def presses(system: System, density: Array, values: Array) -> Mask:
    """Return the active set by the sign of pressure minus gap.

    Args:
        system: The system; the first call is collective.
        density: The density of the force on u at the dof of each constraint of this rank.
        values: The values there.
    """
    pressure = system.layout.weights * system.signs * density
    return np.asarray(pressure - system.scaled_gap(values) > 0.0)


def _settled(
    system: System, carry: Carrier, coarse: fem.Function, u: fem.Function, held: Mask
) -> Mask:
    """Return the predicted set with its ends settled by patch problems, if the patches are small.

    In comparison with a problem that is small itself no patch is small.

    Args:
        system: The system.
        carry: Carries coarse functions to the space of the system.
        coarse: The coarse solution.
        u: The coarse solution at the contact dofs; overwritten near the ends.
        held: The predicted set.
    """
    if is_small(system):
        return held
    seeds = _ends(system, held)
    patch = system.A.createVecRight()
    patch.set(0.0)
    dimension = system.space.mesh.topology.dim
    near = patch_dofs(system, seeds, RINGS[dimension] + 1)
    patch.setValues(near, np.ones(len(near)))
    patch.assemble()
    wanted = np.flatnonzero(patch.array_r).astype(np.int32)
    count = patch.sum()
    patch.destroy()
    if not 0.0 < count <= LARGE[dimension] * system.unknowns:
        return held
    carry([(coarse, u)], wanted)
    x = system.vector_of(u)
    held = settled(system, x, held)
    x.destroy()
    return held


def settled(system: System, x: PETSc.Vec, held: Mask) -> Mask:
    """Return a predicted set with its ends settled by patch problems; collective.

    Args:
        system: The system.
        x: The values that go with the prediction, right near the ends of the set; x gets the
            obstacle where the set holds, and the solution of the patches.
        held: The predicted set, one entry per contact dof of this rank. A set that loses all its
            dofs stays: a small contact lifts values around that are not those of the fine mesh.
    """
    system.project(x, held)
    residual = x.duplicate()
    system.A.mult(x, residual)
    residual.axpy(-1.0, system.b)
    update = active_in_patch(system, x, residual, held, _ends(system, held))
    residual.destroy()
    return update if system.comm.allreduce(bool(update.any()), op=MPI.LOR) else held


def _ends(system: System, held: Mask) -> LocalIndices:
    """Owned contact dofs of cells with an obstacle that have held and free contact dofs."""
    space = system.space
    state = fem.Function(space)
    state.x.array[system.layout.free_dofs] = -1.0
    state.x.array[system.contact_dofs[held]] = 1.0
    state.x.scatter_forward()
    cells = space.dofmap.list[system.layout.cells]
    values = state.x.array[cells]
    mixed = (values > 0.0).any(axis=1) & (values < 0.0).any(axis=1)
    ends = marked(space, cells[mixed][values[mixed] != 0.0])
    return np.flatnonzero(ends[: space.dofmap.index_map.size_local]).astype(np.int32)
