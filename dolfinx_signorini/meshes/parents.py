"""The meshes that refined meshes in use come from."""

import itertools
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from dolfinx import mesh

from dolfinx_signorini.base.arrays import Indices, LocalIndices
from dolfinx_signorini.meshes.sided_meshes import SidedMesh


@dataclass(frozen=True)
class Parent:
    """The mesh that a refined mesh comes from.

    Attributes:
        sided: The parent mesh.
        cells: The parent cells of the owned cells of the refined mesh; None where the cells have
            been shared anew, and parent cells may be on other ranks.
        ends: What `ends_of_edges` returns, where the cells have been shared anew.
    """

    sided: SidedMesh
    cells: LocalIndices | None
    ends: Indices | None = None


# The parent mesh of each refined mesh in use.
_parents: WeakKeyDictionary[mesh.Mesh, Parent] = WeakKeyDictionary()


def remember_parent(fine: mesh.Mesh, parent: Parent) -> None:
    """Note where a mesh comes from, for as long as the mesh is in use."""
    _parents[fine] = parent


def parent_mesh(fine: mesh.Mesh) -> Parent | None:
    """Return the mesh that `refined` has made a mesh from."""
    return _parents.get(fine)


def ends_of_edges(fine: mesh.Mesh, parent: Parent) -> Indices:
    """Return for each node of a refined mesh the edge of the parent mesh around the node.

    Args:
        fine: The refined mesh. Of one whose cells have been shared anew, only owned nodes count.
        parent: Its parent mesh.

    Returns:
        The two ends of the edge as nodes of the parent mesh's geometry, by their numbers among
        those of all ranks; twice the same for a node that both meshes have. Shape (2, nodes).
    """
    if parent.ends is not None:
        return parent.ends
    assert parent.cells is not None
    coarse, dim = parent.sided.mesh.geometry, fine.topology.dim
    cells, x = fine.geometry.dofmap[: len(parent.cells)], fine.geometry.x[:, :dim]
    one = np.zeros(len(x), dtype=np.int32)  # of the cells of each node
    one[cells.ravel()] = np.repeat(np.arange(len(cells), dtype=np.int32), cells.shape[1])
    corners = coarse.dofmap[parent.cells[one]].T
    ends, best = np.empty((2, len(x)), dtype=np.int32), np.full(len(x), np.inf)
    for i, j in itertools.combinations_with_replacement(range(dim + 1), 2):
        first, second = (coarse.x[corners[k], :dim] for k in (i, j))
        distance = np.abs(0.5 * (first + second) - x).max(axis=1)
        nearer = distance < best
        best[nearer] = distance[nearer]
        ends[0, nearer], ends[1, nearer] = corners[i, nearer], corners[j, nearer]
    return coarse.index_map().local_to_global(ends.ravel()).reshape(2, -1)
