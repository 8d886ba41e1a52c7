"""The active set on a fine mesh, predicted from a coarser solution.

The values and the density of the contact pressure are carried to the fine mesh at the contact
boundary only, and predict the active set by the sign of pressure minus gap. (Values alone do not:
where u vanishes together with its flux, half of the values are rounding.) Small problems around the
ends of the predicted contact set, with the coarse solution outside, settle the set to the dof.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.meshes import cells_with_dofs
from dolfinx_signorini.solvers.direct import is_small
from dolfinx_signorini.solvers.patch import LARGE, MAX_PATCH, active_in_patch, patch_dofs
from dolfinx_signorini.solvers.pressure import ContactState
from dolfinx_signorini.system import System

Mask = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int32]

PADDING = 0.1  # of the coarse cell size: how far a fine boundary may lie outside the coarse mesh


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
    u, density = fem.Function(system.space), fem.Function(system.space)
    contact = fem.Function(system.space)
    contact.x.array[dofs] = 1.0
    contact.x.scatter_forward()
    marked = contact.x.array > 0.0
    layer = cells_with_dofs(system.space, marked)
    cells = covering_cells(system.space, marked, layer)
    interpolate_between([(coarse.u, u), (coarse.density, density)], cells)
    gap = u.x.array[dofs] - system.obstacle
    pressure = system.layout.weights * density.x.array[dofs]
    held = pressure - system.contact_diagonal * gap > 0.0
    return _settled(system, coarse, u, held, layer)


def interpolate_between(pairs: Sequence[tuple[fem.Function, fem.Function]], cells: Indices) -> None:
    """Interpolate functions between two meshes, on some cells of the target mesh only.

    Between spaces on one mesh no cell is searched for.

    Args:
        pairs: Source and target functions; all sources have one mesh, and so have all targets.
        cells: Cells of the target mesh.
    """
    source, target = (function.function_space for function in pairs[0])
    data = None
    if source.mesh is not target.mesh:
        padding = PADDING * _coarse_size(source)
        data = fem.create_interpolation_data(target, source, cells, padding=padding)
    for old, new in pairs:
        if data is None:
            new.interpolate(old, cells0=cells, cells1=cells)
        else:
            new.interpolate_nonmatching(old, cells, data)
        new.x.scatter_forward()


def covering_cells(
    space: fem.FunctionSpace, marked: npt.NDArray[np.bool_], cells: Indices
) -> Indices:
    """Return few cells of this rank that together have all of some dofs.

    Cells of many dofs that no neighbour claims come first; what is left after two rounds takes a
    cell for each dof.

    Args:
        space: A function space.
        marked: Whether a dof is one of them, for the owned dofs and the ghosts of this rank.
        cells: All cells that have one of them, see `cells_with_dofs`.
    """
    left, chosen = marked.copy(), []
    cells = np.random.default_rng(0).permutation(cells)
    for _ in range(2):
        dofs = space.dofmap.list[cells]
        wanted = left[dofs]
        order = np.argsort(-wanted.sum(axis=1), kind="stable")
        cells, dofs, wanted = cells[order], dofs[order], wanted[order]
        rows = np.broadcast_to(np.arange(len(cells))[:, None], dofs.shape)
        first = np.full(len(left), len(cells))
        first[dofs[wanted][::-1]] = rows[wanted][::-1]  # the first row of each dof comes last
        wins = wanted.any(axis=1) & (~wanted | (first[dofs] == rows)).all(axis=1)
        chosen.append(cells[wins])
        left[dofs[wins]] = False
    chosen.append(cells[np.unique(first[left])])
    return np.sort(np.concatenate(chosen))


def _coarse_size(space: fem.FunctionSpace) -> float:
    """The size of the first cell of each rank, the largest of them."""
    topology = space.mesh.topology
    sample = np.arange(min(topology.index_map(topology.dim).size_local, 1), dtype=np.int32)
    size = float(space.mesh.h(topology.dim, sample).max(initial=0.0))
    return float(space.mesh.comm.allreduce(size, op=MPI.MAX))


def _settled(
    system: System, coarse: ContactState, u: fem.Function, held: Mask, layer: Indices
) -> Mask:
    """Return the predicted set with its ends settled by patch problems, if the patches are small.

    In comparison with a problem that is small itself no patch is small.

    Args:
        system: The system.
        coarse: The coarse solution.
        u: The coarse solution in the layer; overwritten near the ends.
        held: The predicted set.
        layer: The cells at the contact boundary.
    """
    if is_small(system):
        return held
    seeds = _ends(system, held, layer)
    marked = system.A.createVecRight()
    marked.set(0.0)
    near = patch_dofs(system, seeds, more=1)
    marked.setValues(near, np.ones(len(near)))
    marked.assemble()
    if not 0.0 < marked.sum() <= min(system.comm.size * MAX_PATCH, LARGE * system.unknowns):
        marked.destroy()
        return held
    patch = fem.Function(system.space)
    patch.x.array[: len(marked.array_r)] = marked.array_r
    patch.x.scatter_forward()
    marked.destroy()
    wanted = patch.x.array > 0.0
    cells = covering_cells(system.space, wanted, cells_with_dofs(system.space, wanted))
    interpolate_between([(coarse.u, u)], cells)
    x = system.vector_of(u)
    x.array_w[system.contact_dofs[held]] = system.obstacle[held]
    system.project(x)
    residual = x.duplicate()
    system.A.mult(x, residual)
    residual.axpy(-1.0, system.b)
    held = active_in_patch(system, x, residual, held, seeds)
    x.destroy()
    residual.destroy()
    return held


def _ends(system: System, held: Mask, layer: Indices) -> Indices:
    """Owned contact dofs of cells that have held and free contact dofs."""
    state = fem.Function(system.space)
    state.x.array[system.contact_dofs] = np.where(held, 1.0, -1.0)
    state.x.scatter_forward()
    cells = system.space.dofmap.list[layer]
    values = state.x.array[cells]
    mixed = (values > 0.0).any(axis=1) & (values < 0.0).any(axis=1)
    marked = np.zeros(len(state.x.array), dtype=bool)
    marked[cells[mixed][values[mixed] != 0.0]] = True
    owned = system.space.dofmap.index_map.size_local
    return np.flatnonzero(marked[:owned]).astype(np.int32)
