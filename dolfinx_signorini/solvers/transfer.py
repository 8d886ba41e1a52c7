"""Values of functions on one mesh at chosen dofs of another one.

On the vertices of a lattice the cells around a point are found by index arithmetic, and a refined
mesh knows its parent cells. On other meshes DOLFINx searches for the cells around the points of a
few cells that together have the dofs.
"""

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.meshes.between_meshes import Pairs, interpolate_between
from dolfinx_signorini.meshes.parents import parent_mesh
from dolfinx_signorini.meshes.refinement import prolong_on_cells
from dolfinx_signorini.meshes.sided_meshes import cells_with_dofs, covering_cells, is_straight
from dolfinx_signorini.solvers.linear.hierarchy import nodes_of
from dolfinx_signorini.solvers.linear.lattice import find_lattice, surrounding


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


def _linear(space: fem.FunctionSpace) -> bool:
    """Whether the dofs of a space are the vertices of a mesh with straight sides."""
    if not is_straight(space.mesh) or space.element.basix_element.degree != 1:
        return False
    nodes = space.mesh.geometry.index_map()
    return bool(space.dofmap.index_map.size_global == nodes.size_global)
