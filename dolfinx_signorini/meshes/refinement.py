"""Refined meshes: their sides, their parent cells, and functions carried between the two meshes.

A refined mesh is shared by the ranks like its parent mesh, cell by cell, so that whatever belongs
to a cell of the parent mesh is found on the rank of the child cells.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from dolfinx import fem, mesh

from dolfinx_signorini.base import compat
from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.kinds import check, simplices
from dolfinx_signorini.base.ranks import summed
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.meshes.elements import (
    coefficients_of,
    component_arrays,
    control_points,
    points_on_cells,
    tested_at_places,
)
from dolfinx_signorini.meshes.parents import Parent, remember_parent
from dolfinx_signorini.meshes.points import Points, points_at
from dolfinx_signorini.meshes.polynomials import depths
from dolfinx_signorini.meshes.sided_meshes import (
    SidedMesh,
    boundary_facets,
    entity_nodes,
    facet_cells,
)


@dataclass(frozen=True)
class Refinement:
    """A refined mesh:

        refinement = refined(sided, cells=np.array([3, 7], dtype=np.int32))
        print(refinement.sided.mesh, refinement.parents)

    Attributes:
        sided: The refined mesh with its sides.
        parents: For each owned cell of the refined mesh the cell of the parent mesh around the
            cell.
    """

    sided: SidedMesh
    parents: LocalIndices


def refined(
    sided: SidedMesh,
    cells: LocalIndices | None = None,
    at: tuple[LocalIndices, Array] | None = None,
    halved: LocalIndices | None = None,
) -> Refinement:
    """Refine a mesh of triangles or tetrahedra; the call is collective.

    The edges of the cells are bisected, and further edges where the mesh would not conform. The
    refined mesh remembers its parent mesh: multigrid goes back to it, see `parent_mesh`.

    Args:
        sided: The mesh with its sides.
        cells: Owned cells all of whose edges are bisected; None for all cells.
        at: Further owned cells of which only the edges at one vertex are bisected, and these
            vertices, shape (cells, 3): so few cells grade a mesh towards a point.
        halved: Further owned cells of which only the longest edge is bisected.

    Raises:
        InputError: The cells are no triangles or tetrahedra with straight sides.

    Source: Plaza and Carey, Local refinement of simplicial grids based on the skeleton, Appl.
    Numer. Math. 32 (2000) 195-218.
    """
    domain = sided.mesh
    # DOLFINx writes beyond the end of its arrays where cells have more nodes than vertices.
    check(sided=(domain, simplices(2, 3, straight=True)))
    topology, tdim = domain.topology, domain.topology.dim
    topology.create_entities(1)
    edges = None
    if cells is not None:
        topology.create_connectivity(tdim, 1)
        topology.create_connectivity(1, tdim)
        edges = mesh.compute_incident_entities(topology, cells, tdim, 1)
        if at is not None:
            edges = np.union1d(edges, _edges_at(domain, *at)).astype(np.int32)
        if halved is not None:
            edges = np.union1d(edges, _longest_edges(domain, halved)).astype(np.int32)
    topology.create_connectivity(tdim, tdim - 1)
    fine, parents, facets = compat.refine(domain, edges)
    remember_parent(fine, Parent(sided, parents))
    regions = {
        name: np.flatnonzero(np.isin(parents, inside)).astype(np.int32)
        for name, inside in sided.regions.items()
    }
    return Refinement(SidedMesh(fine, _sides(sided, fine, parents, facets), regions), parents)


def _edges_at(domain: mesh.Mesh, cells: LocalIndices, points: Array) -> LocalIndices:
    """Return the edges of cells with an end at a point.

    Args:
        domain: The mesh, with its connectivities from cells to edges and back.
        cells: The cells.
        points: A vertex of each cell, shape (cells, 3); of the vertices the nearest one is taken.
    """
    edges, ends = _edges(domain, cells)
    distance = np.abs(ends - points[:, None, None]).max(axis=3).min(axis=2)
    return np.asarray(edges[distance == distance.min(axis=1, keepdims=True, initial=np.inf)])


def _longest_edges(domain: mesh.Mesh, cells: LocalIndices) -> LocalIndices:
    """Return the longest edges of cells; all of them where some are of one length.

    Args:
        domain: The mesh, with its connectivities from cells to edges and back.
        cells: The cells.
    """
    edges, ends = _edges(domain, cells)
    length = np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=2)
    longest = length.max(axis=1, keepdims=True, initial=0.0)
    return np.asarray(edges[length > (1.0 - SOLVED) * longest])


def _edges(domain: mesh.Mesh, cells: LocalIndices) -> tuple[LocalIndices, Array]:
    """Return the edges of cells and the ends of these edges.

    Args:
        domain: The mesh, with its connectivities from cells to edges and back.
        cells: The cells.

    Returns:
        The edges, shape (cells, edges), and coordinates, shape (cells, edges, 2, 3).
    """
    topology, tdim = domain.topology, domain.topology.dim
    topology.create_connectivity(1, 0)
    topology.create_connectivity(0, tdim)
    count = tdim * (tdim + 1) // 2
    edges: LocalIndices = topology.connectivity(tdim, 1).array.reshape(-1, count)[cells]
    ends = entity_nodes(domain, 1, edges.ravel()).reshape(len(cells), count, 2)
    return edges, np.asarray(domain.geometry.x[ends])


def _sides(
    sided: SidedMesh, fine: mesh.Mesh, parents: LocalIndices, parent_facets: npt.NDArray[np.int8]
) -> Mapping[str, LocalIndices]:
    """Return the owned facets of a refined mesh on the sides of its parent mesh."""
    domain = sided.mesh
    tdim = domain.topology.dim
    if not sided.sides:  # nobody needs the facets of a mesh that is on the way to another
        return {}
    facets = boundary_facets(fine)
    cells, local = facet_cells(fine, facets).T
    coarse = domain.topology.connectivity(tdim, tdim - 1).array.reshape(-1, tdim + 1)
    ancestors = coarse[parents[cells], parent_facets[cells, local]]
    return {name: facets[np.isin(ancestors, on)] for name, on in sided.sides.items()}


class Interpolation:
    """Interpolates functions of one space in another one, whose nodes have known places:

        restrict = Interpolation(fine, points, coarse, dofs)
        restrict(u)

    Args:
        source: The Lagrange space of the functions.
        points: A point of a cell of its mesh for each of the dofs.
        target: The space of the interpolations.
        dofs: Dofs of this rank, among them all that the rank owns.
    """

    def __init__(
        self,
        source: fem.FunctionSpace,
        points: Points,
        target: fem.FunctionSpace,
        dofs: LocalIndices,
    ):
        self._source, self._target, self._dofs = source, target, dofs
        self._sources, self._shares = points.shares(source)

    def __call__(self, u: fem.Function) -> fem.Function:
        """Return the interpolation of a function; the call is collective."""
        result = fem.Function(self._target)
        for part, values in zip(component_arrays(result), component_arrays(u), strict=True):
            part[self._dofs] = np.einsum("pn,pn->p", self._shares, values[self._sources])
        result.x.scatter_forward()
        for part in component_arrays(result):
            part[:] = coefficients_of(self._target, part)
        return result

    def transposed(self, tested: fem.Function) -> fem.Function:
        """Return a functional of the interpolations of the basis functions of the source.

        Args:
            tested: The functional of the basis functions of the target, as coefficients; the call
                is collective.
        """
        result, dofs = fem.Function(self._source), self._source.dofmap.index_map
        owned = self._dofs < self._target.dofmap.index_map.size_local
        for part, values in zip(component_arrays(result), component_arrays(tested), strict=True):
            at_places = owned * tested_at_places(self._target, values)[self._dofs]
            part[:] = summed(dofs, self._sources, self._shares * at_places[:, None])
        return result


class Transfer:
    """Carries functions between a mesh and its refinement.

    For example, the interpolation of a fine function on the coarse mesh, as a fine function:

        transfer = Transfer(coarse_space, fine_space, refinement.parents)
        transfer.prolong(transfer.restrict(u))

    Args:
        coarse: A Lagrange space on the parent mesh.
        fine: A Lagrange space of the same degree, or of a higher one, on the refined mesh.
        parents: The parent cells of the owned cells.

    Attributes:
        prolong: Returns a function of the coarse space as a function of the fine space.
        restrict: Returns the interpolation of a function of the fine space in the coarse space.
    """

    def __init__(self, coarse: fem.FunctionSpace, fine: fem.FunctionSpace, parents: LocalIndices):
        self.coarse, self.fine = coarse, fine
        dofs = fine.dofmap.list[: len(parents)]
        # One of the cells of each dof serves.
        wanted, first = first_places(dofs.ravel())
        cells = parents[first // dofs.shape[1]]
        x = control_points(fine)[wanted, None, : fine.mesh.topology.dim]
        self.prolong = Interpolation(coarse, points_at(coarse.mesh, cells, x), fine, wanted)
        self.restrict = self._restriction(parents)

    def _restriction(self, parents: LocalIndices) -> Interpolation:
        """Find for each coarse dof a fine cell with its node."""
        dim, dofs = self.fine.mesh.topology.dim, self.coarse.dofmap.list[parents]
        nodes = control_points(self.coarse)[dofs, :dim]
        cells = np.arange(len(parents), dtype=np.int32)
        points = points_at(self.fine.mesh, cells, nodes).at
        # The nearest one of the child cells: rounding takes nodes out of cells that are small
        # beside their coordinates, and fitted vertices may leave a node outside of all.
        outside, flat = -depths(points).ravel(), dofs.ravel()
        least = np.full(int(flat.max(initial=-1)) + 1, np.inf)
        np.minimum.at(least, flat, outside)
        nearest = np.flatnonzero(outside == least[flat])
        wanted, first = first_places(flat[nearest])
        child, node = np.divmod(nearest[first].astype(np.int32), dofs.shape[1])
        places = Points(self.fine.mesh, child, points[child, node][:, None])
        return Interpolation(self.fine, places, self.coarse, wanted)


def with_nodes_moved(u: fem.Function, move: Callable[[], object]) -> fem.Function:
    """Move nodes of the mesh of a function, and return the function of the places before.

    The values of the function itself go with the nodes. What goes out of a cell is continued.

    Args:
        u: The function, in a Lagrange space on straight-sided cells.
        move: Moves nodes of the mesh.
    """
    space, geometry = u.function_space, u.function_space.mesh.geometry
    before, result = geometry.x.copy(), u.copy()
    move()
    after = geometry.x.copy()
    moved = (after != before).any(axis=1)[geometry.dofmap].any(axis=1)
    cells = np.flatnonzero(moved).astype(np.int32)
    places = points_on_cells(space, cells)[..., : geometry.dim]
    geometry.x[:] = before  # the places after, in the cells before
    values = points_at(space.mesh, cells, places).values(u)
    geometry.x[:] = after
    for part, component in zip(component_arrays(result), values, strict=True):
        part[space.dofmap.list[cells]] = component
        part[:] = coefficients_of(space, part, cells)
    result.x.scatter_forward()
    return result


def prolong_on_cells(
    pairs: Sequence[tuple[fem.Function, fem.Function]], parents: LocalIndices, cells: LocalIndices
) -> None:
    """Interpolate functions on the parent mesh in a space on the refined mesh, on some cells only.

    Args:
        pairs: Source and target functions; all sources have one space, and so have all targets.
        parents: The parent cells of the owned cells of the refined mesh.
        cells: Owned cells of the refined mesh; the dofs of others are left as they are.
    """
    coarse, fine = (f.function_space for f in pairs[0])
    dofs, around, dim = fine.dofmap.list[cells], parents[cells], fine.mesh.topology.dim
    x = points_on_cells(fine, cells)[..., :dim]
    points = points_at(coarse.mesh, around, x)
    for old, new in pairs:
        new.x.array[dofs] = points.values(old)[0]
        new.x.array[:] = coefficients_of(fine, new.x.array, cells)


def first_places(dofs: LocalIndices) -> tuple[LocalIndices, LocalIndices]:
    """Return the different entries of an array in order, and for each the first place of it."""
    first = np.full(int(dofs.max(initial=-1)) + 1, -1, dtype=np.int32)
    first[dofs[::-1]] = np.arange(len(dofs) - 1, -1, -1, dtype=np.int32)
    found = np.flatnonzero(first >= 0).astype(np.int32)
    return found, first[found]
