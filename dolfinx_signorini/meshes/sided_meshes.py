"""Meshes: their creation, and which of their cells and facets a computation touches.

The creation of meshes and of a `SidedMesh`, `boundary_facets`, `box` and `longest_side` are
collective; all other functions are local to the rank that calls them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import reduce
from itertools import combinations
from typing import Any

import basix
import numpy as np
import numpy.typing as npt
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini.base import compat
from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices, Mask, union
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.base.kinds import (
    COMMUNICATOR,
    MESH,
    TEXT,
    Kind,
    check,
    gmsh_model,
    indices,
    integer,
)
from dolfinx_signorini.base.ranks import gathered
from dolfinx_signorini.meshes.jacobians import determinants, spanned


@dataclass(frozen=True)
class SidedMesh:
    """A mesh with the facets of its sides and, where they have names, the cells of its regions.

    The making of one is collective.

    Attributes:
        mesh: The mesh.
        sides: For each side the facets on it that this rank knows.
        regions: For each region the cells in it that this rank owns.

    Raises:
        InputError: An attribute is of another kind, on some rank.
    """

    mesh: mesh.Mesh
    sides: Mapping[str, LocalIndices]
    regions: Mapping[str, LocalIndices] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check(mesh=(self.mesh, MESH))
        for name, given, kind, count in (
            ("sides", self.sides, "facet", facet_count(self.mesh)),
            ("regions", self.regions, "owned cell", len(owned_cells(self.mesh))),
        ):
            message = _named(kind, count)(given)
            require(self.mesh.comm, not message, message, name)

    def facets(self, names: tuple[str, ...]) -> LocalIndices:
        """Return the facets of some sides; "all" stands for the whole boundary."""
        if names == ("all",):
            return boundary_facets(self.mesh)
        return union(self.sides[name] for name in names)

    def cells(self, names: tuple[str, ...]) -> LocalIndices:
        """Return the owned cells of some regions; "all" stands for all of them."""
        if names == ("all",):
            return owned_cells(self.mesh)
        return union(self.regions[name] for name in names)

    def combinations(self, facets: LocalIndices) -> tuple[Mask, Indices]:
        """Return which combinations of sides there are, and which of them each facet is on.

        Args:
            facets: Facets of this rank; the call is collective.

        Returns:
            The combinations, the same on all ranks, shape (combinations, sides), and for each of
            the facets the number of its combination.
        """
        return _combinations(self.mesh.comm, self.sides, facets)

    def combinations_of_regions(self) -> tuple[Mask, Indices]:
        """Return the same as `combinations`, of regions and all owned cells; collective."""
        return _combinations(self.mesh.comm, self.regions, owned_cells(self.mesh))


def _combinations(
    comm: MPI.Comm, parts: Mapping[str, LocalIndices], entities: LocalIndices
) -> tuple[Mask, Indices]:
    marks = np.array([np.isin(entities, part) for part in parts.values()], dtype=bool)
    marks = marks.reshape(len(parts), len(entities)).T
    own = comm.allgather(np.unique(marks, axis=0))
    found = np.unique(np.concatenate(own), axis=0)
    both = np.concatenate((found, marks))
    numbers = np.unique(both, axis=0, return_inverse=True)[1].ravel()
    return found, numbers[len(found) :]


def gmsh_mesh(model: Any, comm: MPI.Comm, dimension: int) -> tuple[mesh.Mesh, mesh.MeshTags]:
    """Return the mesh of a gmsh model, with the physical groups of its boundary as facet tags.

    The call is the same for all versions of DOLFINx; `dolfinx.io.gmshio` has other names and
    results from 0.10 on.

    Args:
        model: `gmsh.model`, with a mesh on rank 0.
        comm: The communicator that shares the mesh; the call is collective.
        dimension: The dimension of space, 2 or 3.

    Raises:
        InputError: An argument is of another kind.
    """
    check(
        model=(model, gmsh_model),
        comm=(comm, COMMUNICATOR),
        dimension=(dimension, integer(2, 3)),
    )
    return compat.gmsh_mesh(model, comm, dimension)[:2]


def _named(what: str, count: int) -> Kind:
    """Return the kind of mappings from names to facets or cells, of which a mesh has so many."""

    def kind(parts: Any) -> str:
        if not isinstance(parts, Mapping):
            return f"must be a mapping from names to {what}s, not {type(parts).__name__}"
        for name, entities in parts.items():
            message = TEXT(name) or indices(entities, f"{what}s")
            if message:
                return f"{name!r}: {message}"
            if len(entities) and not 0 <= np.min(entities) <= np.max(entities) < count:
                return f"{name!r}: has an index that is no {what} of this mesh"
        return ""

    return kind


def is_straight(domain: mesh.Mesh) -> bool:
    """Return whether a mesh consists of straight-sided triangles of a plane, or of tetrahedra."""
    simplices = domain.topology.cell_name() in ("triangle", "tetrahedron")
    flat = domain.geometry.dim == domain.topology.dim
    return simplices and flat and domain.geometry.cmap.degree == 1


def facet_count(domain: mesh.Mesh) -> int:
    """Return how many facets this rank knows."""
    dimension = domain.topology.dim - 1
    domain.topology.create_entities(dimension)
    index_map = domain.topology.index_map(dimension)
    return int(index_map.size_local + index_map.num_ghosts)


def owned_cells(domain: mesh.Mesh) -> LocalIndices:
    """Return the indices of the cells that this rank owns."""
    return np.arange(domain.topology.index_map(domain.topology.dim).size_local, dtype=np.int32)


def cell_corners(domain: mesh.Mesh, cells: LocalIndices | None = None) -> Array:
    """Return the nodes of cells, of all owned ones by default: (cells, nodes, coordinates)."""
    x = np.asarray(domain.geometry.x[:, : domain.geometry.dim], dtype=np.float64)
    return np.asarray(x[domain.geometry.dofmap[owned_cells(domain) if cells is None else cells]])


def gathered_cells(domain: mesh.Mesh) -> tuple[Indices, Array]:
    """Return the cells and the nodes of a mesh on rank 0, and none on other ranks; collective.

    Returns:
        The global numbers of the nodes of each cell, shape (cells, nodes), and the coordinates of
        all nodes, shape (nodes, dimension).
    """
    geometry, index_map = domain.geometry, domain.geometry.index_map()
    cells = geometry.dofmap[owned_cells(domain)]
    numbers = index_map.local_to_global(cells.ravel()).reshape(cells.shape)
    x = np.asarray(geometry.x[: index_map.size_local, : geometry.dim], dtype=np.float64)
    every, points = gathered(domain.comm, numbers, x) or (numbers[:0], x[:0])
    return every, points


def cell_edges(domain: mesh.Mesh, cells: LocalIndices) -> Array:
    """Return the edges of cells from their first vertex, shape (cells, coordinates, edges).

    The edges are the derivatives of the map from the reference cell.

    Args:
        domain: A mesh of straight-sided triangles or tetrahedra that fill the space.
        cells: Cells of this rank.
    """
    nodes = np.take(domain.geometry.dofmap, cells, axis=0)  # faster than an index
    x: Array = np.asarray(np.take(domain.geometry.x, nodes, axis=0), dtype=np.float64)
    x = x[:, :, : domain.topology.dim]
    return np.asarray((x[:, 1:] - x[:, :1]).transpose(0, 2, 1))


def cells_near_ball(domain: mesh.Mesh, centre: tuple[float, ...], radius: float) -> LocalIndices:
    """Return the owned cells that meet a ball, and possibly some next to it.

    Args:
        domain: The mesh; its cells are straight-sided.
        centre: Coordinates of the centre, as many as the mesh has space dimensions.
        radius: Radius of the ball.
    """
    vertices = domain.geometry.dofmap[: len(owned_cells(domain))].T
    x = [np.ascontiguousarray(line) for line in domain.geometry.x.T[: len(centre)]]
    # A cell whose vertices are all farther away than radius + diameter cannot meet the ball.
    diameter = 0.0
    for a, b in combinations(vertices, 2):
        edges = reduce(np.add, (np.square(y[a] - y[b]) for y in x))
        diameter = max(diameter, math.sqrt(np.max(edges, initial=0.0)))
    distances = reduce(np.add, (np.square(y - c) for y, c in zip(x, centre, strict=True)))
    near = distances <= (radius + diameter) ** 2
    return np.flatnonzero(np.any([near[v] for v in vertices], axis=0)).astype(np.int32)


def clockwise(domain: mesh.Mesh, cells: LocalIndices) -> Mask:
    """Tell which cells number their vertices clockwise; always none but for plane triangles.

    Args:
        domain: The mesh.
        cells: Cells of this rank.
    """
    if domain.topology.cell_name() != "triangle" or domain.geometry.dim != 2:
        return np.zeros(len(cells), dtype=bool)
    return np.asarray(determinants(cell_edges(domain, cells)[..., :2]) < 0.0)


def boundary_facets(domain: mesh.Mesh) -> LocalIndices:
    """Return the facets on the boundary of the domain that this rank owns; collective.

    Raises:
        InputError: The domain is no mesh.
    """
    check(domain=(domain, MESH))
    tdim = domain.topology.dim
    domain.topology.create_connectivity(tdim - 1, tdim)
    return mesh.exterior_facet_indices(domain.topology)


SAMPLE = 2_000  # cells that tell about many


def sampled(count: int, step: int) -> LocalIndices:
    """Return one index at random of each `step` successive ones, the same in every call.

    On structured meshes cells at equal distances are all alike.

    Args:
        count: The number of all indices.
        step: The number of indices that one of them stands for.
    """
    first = np.arange(0, count, step)
    chosen = first + np.random.default_rng(0).integers(step, size=len(first))
    return chosen[chosen < count].astype(np.int32)


def owned_facets(domain: mesh.Mesh, facets: LocalIndices) -> LocalIndices:
    """Return those of some facets of this rank that the rank owns."""
    return facets[facets < domain.topology.index_map(domain.topology.dim - 1).size_local]


def facet_cells(domain: mesh.Mesh, facets: LocalIndices) -> LocalIndices:
    """Return boundary facets as (cell, local facet) pairs, shape (facets, 2).

    Args:
        domain: The mesh.
        facets: Boundary facets of this rank.
    """
    tdim = domain.topology.dim
    domain.topology.create_connectivity(tdim - 1, tdim)
    domain.topology.create_connectivity(tdim, tdim - 1)
    return compat.exterior_facet_pairs(domain.topology, facets).reshape(-1, 2)


def box(comm: MPI.Comm, points: npt.NDArray[np.floating]) -> Array:
    """Return the lowest and the highest coordinates of the points of all ranks; collective.

    Args:
        comm: The communicator.
        points: The points of this rank, shape (points, dimension); some rank has one.

    Returns:
        Shape (2, dimension).
    """
    ends = [(-points).max(axis=0, initial=-np.inf), points.max(axis=0, initial=-np.inf)]
    lowest, highest = np.max(comm.allgather(ends), axis=0)
    return np.array([-lowest, highest])


def longest_side(domain: mesh.Mesh) -> float:
    """Return the longest side of the box around a mesh; the call is collective."""
    return float(np.ptp(box(domain.comm, domain.geometry.x), axis=0).max())


def facet_vertices(domain: mesh.Mesh) -> LocalIndices:
    """Return the vertices of each facet by their places in the cell, shape (facets, vertices)."""
    cell = basix.CellType[domain.topology.cell_name()]
    return np.array(basix.topology(cell)[domain.topology.dim - 1], dtype=np.int32)


def facet_nodes(domain: mesh.Mesh, facets: LocalIndices) -> LocalIndices:
    """Return the geometry nodes of boundary facets, shape (facets, vertices); none for none.

    Args:
        domain: The mesh.
        facets: Boundary facets of this rank.
    """
    pairs = facet_cells(domain, facets)
    return np.asarray(domain.geometry.dofmap[pairs[:, :1], facet_vertices(domain)[pairs[:, 1]]])


def entity_nodes(domain: mesh.Mesh, dim: int, entities: LocalIndices) -> LocalIndices:
    """Return the nodes of straight-sided simplices of a mesh, shape (entities, dim + 1).

    DOLFINx divides by zero where a rank has no entity.

    Args:
        domain: A mesh that has the connectivities of these entities.
        dim: The dimension of the entities.
        entities: Edges or facets.
    """
    if len(entities) == 0:
        return np.empty((0, dim + 1), dtype=np.int32)
    return mesh.entities_to_geometry(domain, dim, entities).reshape(-1, dim + 1)


def facet_scale(domain: mesh.Mesh, facets: LocalIndices) -> Array:
    """Return the ratio of each facet's size to that of the reference facet.

    Args:
        domain: A mesh of straight-sided triangles or tetrahedra.
        facets: (cell, local facet) pairs, shape (facets, 2).
    """
    vertices = facet_vertices(domain)[facets[:, 1]]
    x = domain.geometry.x[domain.geometry.dofmap[facets[:, :1], vertices]]
    return math.factorial(domain.topology.dim - 1) * simplex_sizes(x)


def simplex_sizes(corners: npt.NDArray[np.floating]) -> Array:
    """Return the lengths, areas or volumes of segments, triangles or tetrahedra in any space.

    Args:
        corners: The vertices, shape (simplices, vertices, coordinates).
    """
    edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    return np.asarray(spanned(edges) / math.factorial(edges.shape[2]), dtype=np.float64)


def cells_with_dofs(space: fem.FunctionSpace, marked: Mask) -> LocalIndices:
    """Return the cells of this rank, ghosts included, that have one of some dofs.

    Args:
        space: A function space.
        marked: Whether a dof is one of them, for the owned dofs and the ghosts of this rank.
    """
    found = np.zeros(len(space.dofmap.list), dtype=bool)
    for dofs in space.dofmap.list.T:
        found |= marked[dofs]
    return np.flatnonzero(found).astype(np.int32)


def covering_cells(space: fem.FunctionSpace, marked: Mask, cells: LocalIndices) -> LocalIndices:
    """Return few cells of this rank that together have all of some dofs.

    In two rounds cells with many dofs that no neighbour claims come first; of each dof that is left
    then, a cell is taken.

    Args:
        space: A function space.
        marked: Whether a dof is one of them, for the owned dofs and the ghosts of this rank.
        cells: All cells that have one of them, see `cells_with_dofs`.
    """
    left, chosen = marked.copy(), []
    cells = np.random.default_rng(0).permutation(cells)
    for last in (False, False, True):
        wanted = left[space.dofmap.list[cells]]
        order = np.argsort(-wanted.sum(axis=1), kind="stable")
        cells, wanted = cells[order], wanted[order]
        dofs = space.dofmap.list[cells]
        rows = np.broadcast_to(np.arange(len(cells))[:, None], dofs.shape)
        first = np.full(len(left), len(cells))
        first[dofs[wanted][::-1]] = rows[wanted][::-1]  # the first row of each dof comes last
        if not last:
            wins = wanted.any(axis=1) & (~wanted | (first[dofs] == rows)).all(axis=1)
            chosen.append(cells[wins])
            left[dofs[wins]] = False
    chosen.append(cells[np.unique(first[left])])
    return np.sort(np.concatenate(chosen))
