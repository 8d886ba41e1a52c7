"""The active set on a fine mesh, predicted from a coarser solution.

The values and the density of the contact pressure are carried to the fine mesh at the contact
boundary only, and predict the active set by the sign of pressure minus gap. (Values alone do not:
where u vanishes together with its flux, half of the values are rounding.) Small problems around the
ends of the predicted contact set, with the coarse solution outside, settle the set to the dof. With
an obstacle in the domain the values are those of all dofs with an obstacle, and the start of rough
steps, which settle the set.
"""

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.ranks import anywhere, marked
from dolfinx_signorini.meshes.elements import component_arrays
from dolfinx_signorini.solvers.linear.direct import is_small
from dolfinx_signorini.solvers.patch import LARGE, RINGS, active_in_patch, patch_dofs
from dolfinx_signorini.solvers.pressure import ContactState
from dolfinx_signorini.solvers.system import System
from dolfinx_signorini.solvers.transfer import Carrier, Pairs


def predict(system: System, coarse: ContactState, start: PETSc.Vec | None = None) -> Mask:
    """Predict the active set from a solution on another mesh, or on the same one.

    Args:
        system: The system.
        coarse: The other solution; only cells at the contact boundary and near the ends of the
            contact set are looked up, and none where both meshes are the same.
        start: Set to the values of the other solution where the obstacle is in the domain.

    Returns:
        One entry per contact dof of this rank.
    """
    layout = system.layout
    nodes, target = layout.contact_nodes, layout.nodal
    carry = Carrier(coarse.density.function_space, target)
    parts = components_of(coarse.u, coarse.density.function_space)
    pairs = [(part, fem.Function(target)) for part in parts]
    density = fem.Function(target)
    carry([*pairs, (coarse.density, density)], nodes)
    x = _joined(system, pairs)
    held = presses(system, density.x.array[nodes], x.array_r[system.contact_dofs])
    if layout.in_domain:  # rough steps settle its long ends, from these values on
        system.project(x, held)
        if start is not None:
            x.copy(start)
    else:
        held = _settled(system, carry, pairs, held)
    x.destroy()
    return held


def components_of(u: fem.Function, nodal: fem.FunctionSpace) -> list[fem.Function]:
    """Return the components of a function, each in the scalar space; u itself if it is scalar."""
    size = u.function_space.dofmap.bs
    if size == 1:
        return [u]
    parts = [fem.Function(nodal) for _ in range(size)]
    for part, values in zip(parts, component_arrays(u), strict=True):
        part.x.array[:] = values
    return parts


def _joined(system: System, pairs: Pairs) -> PETSc.Vec:
    """The vector of the components that were carried, the second functions of the pairs."""
    x = system.A.createVecRight()
    size = x.getLocalSize() // len(pairs)
    parts = np.stack([new.x.array[:size] for _, new in pairs], axis=1)
    x.array_w[:] = system.layout.turned(parts.ravel())
    return x


def presses(system: System, density: Array, values: Array) -> Mask:
    """Return the active set by the sign of pressure minus gap.

    Args:
        system: The system; the first call is collective.
        density: The density of the force on u at the dof of each constraint of this rank.
        values: The values there.
    """
    pressure = system.layout.weights * system.signs * density
    return np.asarray(pressure - system.scaled_gap(values) > 0.0)


def _settled(system: System, carry: Carrier, pairs: Pairs, held: Mask) -> Mask:
    """Return the predicted set with its ends settled by patch problems, if the patches are small.

    In comparison with a problem that is small itself no patch is small.

    Args:
        system: The system.
        carry: Carries coarse functions to the nodes of the system.
        pairs: The components of the coarse solution, and their values at the contact nodes, which
            are overwritten near the ends.
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
    wanted = np.unique(np.flatnonzero(patch.array_r) // system.layout.block).astype(np.int32)
    count = patch.sum()
    patch.destroy()
    if not 0.0 < count <= LARGE[dimension] * system.unknowns:
        return held
    carry(pairs, wanted)
    x = _joined(system, pairs)
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
    if system.layout.in_domain:
        return held
    system.project(x, held)
    residual = x.duplicate()
    system.set_forces(x, residual)
    update = active_in_patch(system, x, residual, held, _ends(system, held))
    residual.destroy()
    return update if anywhere(system.comm, update) else held


def _ends(system: System, held: Mask) -> LocalIndices:
    """Owned contact dofs of cells with an obstacle that have held and free contact dofs."""
    space, nodes = system.layout.nodal, system.layout.contact_nodes
    state = fem.Function(space)
    state.x.array[nodes] = -1.0
    state.x.array[nodes[held]] = 1.0
    state.x.scatter_forward()
    cells = space.dofmap.list[system.layout.cells]
    values = state.x.array[cells]
    mixed = (values > 0.0).any(axis=1) & (values < 0.0).any(axis=1)
    ends = marked(space, cells[mixed][values[mixed] != 0.0])
    return np.unique(system.contact_dofs[ends[nodes]])
