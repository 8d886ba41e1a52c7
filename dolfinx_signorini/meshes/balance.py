"""Refined meshes whose cells are shared anew where some rank has too many of them.

Child cells stay on the rank of their parent, and where a mesh is refined at one place, one rank has
the new cells. DOLFINx's partitioner shares them anew. The new mesh has the same cells, and a
`Lookup` tells where the parent of each is.
"""

import math
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import mesh

from dolfinx_signorini.base.arrays import Indices, LocalIndices
from dolfinx_signorini.base.lookups import Lookup
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.meshes.parents import Parent, ends_of_edges, parent_mesh, remember_parent
from dolfinx_signorini.meshes.refinement import Refinement, first_places
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, boundary_facets, facet_cells

UNEVEN = 1.2  # the cells of a rank over their mean: above, sharing anew costs less than the waiting


@dataclass(frozen=True)
class Shared:
    """A refined mesh, the cells of which the ranks share about evenly:

        shared = balanced(refined(sided, cells))
        parts = shared.parents.of(volumes(sided.mesh))

    Attributes:
        sided: The refined mesh with its sides.
        parents: Asks for the parent cell of each owned cell.
    """

    sided: SidedMesh
    parents: Lookup


def balanced(refinement: Refinement) -> Shared:
    """Share the cells of a refined mesh anew where they are out of balance; collective.

    Args:
        refinement: The refined mesh, which is left as it is.
    """
    fine, parent = refinement.sided.mesh, parent_mesh(refinement.sided.mesh)
    comm, count = fine.comm, len(refinement.parents)
    assert parent is not None
    index_map = parent.sided.mesh.topology.index_map(fine.topology.dim)
    numbers = index_map.local_range[0] + refinement.parents.astype(np.int64)
    parents = Lookup(comm, index_map.size_local, numbers)
    mean = comm.allreduce(count) / comm.size
    if highest(comm, np.array([float(count)])) <= UNEVEN * math.ceil(mean):
        return Shared(refinement.sided, parents)
    new, cells = _shared_anew(fine)
    remember_parent(new, Parent(parent.sided, None, _carried_ends(fine, parent, new, cells)))
    sides = _carried_sides(refinement.sided, new, cells)
    regions = _carried_regions(refinement.sided, cells)
    return Shared(SidedMesh(new, sides, regions), parents.through(cells))


def _shared_anew(domain: mesh.Mesh) -> tuple[mesh.Mesh, Lookup]:
    """Return a mesh with the same cells, and what asks for each of its owned cells on the old one.

    The order of the vertices of each cell is kept.
    """
    geometry, own = domain.geometry, domain.topology.index_map(domain.topology.dim).size_local
    index_map = geometry.index_map()
    corners = geometry.dofmap[:own]
    nodes = index_map.local_to_global(corners.ravel()).reshape(corners.shape)
    x = geometry.x[: index_map.size_local, : geometry.dim]
    element = domain.ufl_domain().ufl_coordinate_element()
    new = mesh.create_mesh(domain.comm, nodes, x=x, e=ufl.Mesh(element))
    count = new.topology.index_map(new.topology.dim).size_local
    cells = np.asarray(new.topology.original_cell_index[:count])
    return new, Lookup(domain.comm, own, cells)


def _carried_sides(sided: SidedMesh, new: mesh.Mesh, cells: Lookup) -> dict[str, LocalIndices]:
    """Return the facets of the sides of a mesh that has been shared anew."""
    on = np.zeros((cells.count, sided.mesh.topology.dim + 1, len(sided.sides)), dtype=bool)
    if not sided.sides:
        return {}
    for k, facets in enumerate(sided.sides.values()):
        on[(*facet_cells(sided.mesh, facets).T, k)] = True
    facets = boundary_facets(new)
    found = cells.of(on)[tuple(facet_cells(new, facets).T)]
    return {name: facets[found[:, k]] for k, name in enumerate(sided.sides)}


def _carried_regions(sided: SidedMesh, cells: Lookup) -> dict[str, LocalIndices]:
    """Return the owned cells of the regions of a mesh that has been shared anew."""
    if not sided.regions:
        return {}
    inside = np.zeros((cells.count, len(sided.regions)), dtype=bool)
    for k, region in enumerate(sided.regions.values()):
        inside[region, k] = True
    found = cells.of(inside)
    return {
        name: np.flatnonzero(found[:, k]).astype(np.int32) for k, name in enumerate(sided.regions)
    }


def _carried_ends(fine: mesh.Mesh, parent: Parent, new: mesh.Mesh, cells: Lookup) -> Indices:
    """Return for the owned nodes of a mesh that has been shared anew what `ends_of_edges` does."""
    ends = ends_of_edges(fine, parent).T[fine.geometry.dofmap[: cells.count]]
    corners = new.geometry.dofmap[: len(cells.numbers)].ravel()
    nodes, first = first_places(corners)
    owned = nodes < new.geometry.index_map().size_local
    return cells.of(ends).reshape(-1, 2)[first[owned]].T
