"""Values of functions on one mesh at chosen dofs of another one.

On the vertices of a lattice the cells around a point are found by index arithmetic, and a refined
mesh knows its parent cells. On other meshes DOLFINx searches for the cells around the points of a
few cells that together have the dofs.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from dolfinx import fem, mesh
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.compat import owners_of_points
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.base.ranks import anywhere, highest
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.meshes.parents import parent_mesh
from dolfinx_signorini.meshes.refinement import prolong_on_cells
from dolfinx_signorini.meshes.sided_meshes import cells_with_dofs, covering_cells, longest_side
from dolfinx_signorini.solvers.linear.hierarchy import is_straight, nodes_of
from dolfinx_signorini.solvers.linear.lattice import find_lattice, surrounding
from dolfinx_signorini.solvers.residual import power_of_two

Pairs = Sequence[tuple[fem.Function, fem.Function]]

PADDING = 0.1  # of the coarse cell size: how far a fine boundary may lie outside the coarse mesh


class Carrier:
    """Carries functions from a coarse mesh to chosen dofs of a finer one:

        carry = Carrier(coarse.function_space, fine.function_space)
        carry([(coarse, fine)], dofs)

    The meshes need not be nested, and may be the same; collective.

    Args:
        source: The space of the coarse functions.
        target: The space of the fine functions.
    """

    def __init__(self, source: fem.FunctionSpace, target: fem.FunctionSpace):
        self._source, self._target = source, target
        self._lattice, self._first = None, source.dofmap.index_map.local_range[0]
        if source.mesh is not target.mesh and _linear(source) and _linear(target):
            self._lattice = find_lattice(source.mesh, nodes_of(source))

    def __call__(self, pairs: Pairs, dofs: LocalIndices) -> None:
        """Set values of the fine functions; collective.

        Args:
            pairs: Coarse and fine functions of the two spaces.
            dofs: Owned dofs of the fine space; some others may be set, too.
        """
        if self._lattice is None:
            marked = np.zeros(len(pairs[0][1].x.array), dtype=bool)
            marked[dofs] = True
            cells, parent = cells_with_dofs(self._target, marked), parent_mesh(self._target.mesh)
            parents = parent.cells if parent and parent.sided.mesh is self._source.mesh else None
            if parents is not None:
                cells = covering_cells(self._target, marked, cells[cells < len(parents)])
                prolong_on_cells(pairs, parents, cells)
            else:
                interpolate_between(pairs, covering_cells(self._target, marked, cells))
            return
        x = np.asarray(self._target.mesh.geometry.x, dtype=np.float64)
        x = x[nodes_of(self._target)[dofs], : len(self._lattice.cells)]
        numbers, weights = surrounding(self._lattice, self._first, x.T)
        starts = np.arange(0, numbers.size + 1, len(numbers), dtype=PETSc.IntType)
        rows = starts, numbers.T.ravel().astype(PETSc.IntType), weights.T.ravel()
        sizes = ((len(dofs), None), (self._source.dofmap.index_map.size_local, None))
        matrix = PETSc.Mat().createAIJ(sizes, csr=rows, comm=self._source.mesh.comm)
        coarse, fine = matrix.createVecs()
        for old, new in pairs:
            coarse.array_w[:] = old.x.array[: coarse.getLocalSize()]
            matrix.mult(coarse, fine)
            new.x.array[dofs] = fine.array_r
        destroy(matrix, coarse, fine)


def interpolate_between(pairs: Pairs, cells: LocalIndices) -> None:
    """Interpolate functions between two meshes, on some cells of the target mesh only.

    Between spaces on one mesh no cell is searched for.

    Args:
        pairs: Source and target functions; all sources have one mesh, and so have all targets.
        cells: Cells of the target mesh.
    """
    source, target = (function.function_space for function in pairs[0])
    if source.mesh is target.mesh:
        for old, new in pairs:
            new.interpolate(old, cells0=cells, cells1=cells)
            new.x.scatter_forward()
        return
    with _of_size_one(source.mesh, target.mesh):
        # Boxes around cells that are padded by more than the cells are large cover many of them: so
        # points are looked for inside of the coarse mesh first.
        for padding in (SOLVED, PADDING):
            padding *= _coarse_size(source)
            data = fem.create_interpolation_data(target, source, cells, padding=padding)
            outside = bool((owners_of_points(data) < 0).any())
            if not anywhere(source.mesh.comm, outside):
                break
        for old, new in pairs:
            new.interpolate_nonmatching(old, cells, data)
            new.x.scatter_forward()


@contextmanager
def _of_size_one(*meshes: mesh.Mesh) -> Iterator[None]:
    """Give meshes a unit of length in which the first one has about the size 1; collective.

    DOLFINx finds no nearest points of cells whose coordinates are large numbers.
    """
    unit = power_of_two(longest_side(meshes[0].comm, meshes[0].geometry.x))
    for each in meshes:
        each.geometry.x[:] /= unit
    try:
        yield
    finally:
        for each in meshes:
            each.geometry.x[:] *= unit


def _coarse_size(space: fem.FunctionSpace) -> float:
    """The size of the first cell of each rank, the largest of them."""
    topology = space.mesh.topology
    sample = np.arange(min(topology.index_map(topology.dim).size_local, 1), dtype=np.int32)
    return highest(space.mesh.comm, space.mesh.h(topology.dim, sample))


def _linear(space: fem.FunctionSpace) -> bool:
    """Whether the dofs of a space are the vertices of a mesh with straight sides."""
    if not is_straight(space.mesh) or space.element.basix_element.degree != 1:
        return False
    nodes = space.mesh.geometry.index_map()
    return bool(space.dofmap.index_map.size_global == nodes.size_global)
