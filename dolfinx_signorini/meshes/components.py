"""The connected components of a mesh: bodies that nothing but data have in common."""

import functools
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from dolfinx import fem, la
from scipy.sparse.csgraph import connected_components

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.meshes.elements import control_points


@dataclass(frozen=True)
class Components:
    """The connected components of a mesh, as the dofs of a space see them:

        parts = components(space)
        loads = parts.sums(b.array_r)

    Attributes:
        space: The space.
        count: The number of components, the same on all ranks.
        numbers: The number of the component of each owned dof.
    """

    space: fem.FunctionSpace
    count: int
    numbers: LocalIndices

    def sums(self, values: Array) -> Array:
        """Return the sum of values over the dofs of each component; the call is collective.

        Args:
            values: One value per owned dof.
        """
        sums = np.bincount(self.numbers, values, self.count)
        return np.asarray(self.space.mesh.comm.allreduce(sums))

    def counts(self, dofs: LocalIndices) -> LocalIndices:
        """Return how many of some dofs each component has; the call is collective.

        Args:
            dofs: Owned dofs.
        """
        counts = np.bincount(self.numbers[dofs], minlength=self.count)
        return np.asarray(self.space.mesh.comm.allreduce(counts))

    @functools.cached_property
    def names(self) -> list[str]:
        """Words for each component, by the box around its dofs; the first call is collective."""
        dimension = self.space.mesh.geometry.dim
        x = control_points(self.space)[: len(self.numbers), :dimension]
        ends = np.full((self.count, 2 * dimension), -np.inf)
        np.maximum.at(ends, self.numbers, np.concatenate((-x, x), axis=1))
        ends = np.max(self.space.mesh.comm.allgather(ends), axis=0)
        corners = np.stack((-ends[:, :dimension], ends[:, dimension:]), axis=1)
        corners[np.abs(corners) < ROUNDING * np.abs(corners).max()] = 0.0
        places = [["(" + ", ".join(f"{v:.6g}" for v in x) + ")" for x in pair] for pair in corners]
        return [f"the body between {lowest} and {highest}" for lowest, highest in places]


def components(space: fem.FunctionSpace) -> Components:
    """Return the connected components of a mesh; the call is collective.

    Two cells belong to the same component if they share a dof. Each rank numbers the parts of its
    own cells, and the dofs that two ranks know tell which of these parts are one.

    Args:
        space: A Lagrange space.
    """
    comm, index_map = space.mesh.comm, space.dofmap.index_map
    owned, known = index_map.size_local, index_map.size_local + index_map.num_ghosts
    cells = space.dofmap.list
    first, others = np.repeat(cells[:, 0], cells.shape[1] - 1), cells[:, 1:].ravel()
    edges = np.ones(len(first), dtype=np.int8), (first, others)
    count, local = connected_components(sp.csr_array(edges, shape=(known, known)), directed=False)
    if comm.size == 1:
        return Components(space, int(count), local)
    counts = comm.allgather(int(count))
    local = local + sum(counts[: comm.rank])
    # A shared vector tells the ranks the numbers that the owners gave their dofs.
    told = la.vector(index_map, 1, np.float64)
    told.array[:] = local
    told.scatter_forward()
    pairs = np.unique(np.stack((local, np.rint(told.array).astype(local.dtype))), axis=1)
    same = np.concatenate(comm.allgather(pairs), axis=1)
    total = sum(counts)
    links = sp.coo_array((np.ones(same.shape[1], dtype=np.int8), tuple(same)), shape=(total, total))
    number, merged = connected_components(links, directed=False)
    return Components(space, int(number), merged[local[:owned]].astype(np.int32))
