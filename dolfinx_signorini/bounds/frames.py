"""Cells with their vertices in an order along one direction, and functions at points of cells.

Cells that are translated copies of each other have their vertices in the same order, whatever the
numbers of the vertices are. So they share what depends on their shape.
"""

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from dolfinx import la, mesh
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices, Mask, union
from dolfinx_signorini.base.ranks import summed
from dolfinx_signorini.data.interfaces.pieces import widths
from dolfinx_signorini.meshes.jacobians import determinants, inverses
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.polynomials import barycentric, polynomials
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, owned_cells

DIRECTION = np.sqrt((1.0, 0.5, 0.3))  # along which no two vertices of a cell of a lattice are level


@dataclass(frozen=True)
class Frames:
    """The owned cells of a mesh of triangles or tetrahedra.

    Vertex j and facet j of a frame are vertex and facet `order[:, j]` of the cell in the mesh:

        frames = cell_frames(domain)
        facets = np.take_along_axis(facets_of_cells, frames.order, axis=1)

    Attributes:
        cells: The numbers of the cells in the mesh.
        order: The local vertices along a direction of space, the same one for all cells, shape
            (cells, d + 1).
        corners: The coordinates of the vertices in this order, shape (cells, d + 1, d).
        vertices, facets: The global numbers of vertices and facets, shape (cells, d + 1).
        local_facets: The numbers of the facets on this rank.
        places: Where the middles of the cells are along the direction.
        domain: The mesh.
    """

    cells: Indices
    order: Indices
    corners: Array
    vertices: Indices
    facets: Indices
    local_facets: Indices
    places: Array
    domain: mesh.Mesh

    @property
    def dimension(self) -> int:
        """The dimension d of the cells."""
        return self.corners.shape[2]

    def some(self, rows: Indices | slice) -> "Frames":
        """Return some of the frames, by the rows of the arrays."""
        names = [field.name for field in fields(self) if field.name != "domain"]
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    @functools.cached_property
    def jacobians(self) -> Array:
        """The derivatives of the maps from the reference simplex, shape (cells, d, d)."""
        return np.asarray((self.corners[:, 1:] - self.corners[:, :1]).transpose(0, 2, 1))

    @functools.cached_property
    def inverses(self) -> Array:
        """The inverse matrices of the Jacobians."""
        return inverses(self.jacobians)

    @functools.cached_property
    def volumes(self) -> Array:
        """The sizes of the cells."""
        return 1.0 / math.factorial(self.dimension) * np.abs(determinants(self.jacobians))

    @functools.cached_property
    def diameters(self) -> Array:
        """The lengths of the longest edges."""
        return widths(self.corners)

    @functools.cached_property
    def outer(self) -> Mask:
        """Whether facets are on the boundary, shape (cells, d + 1); collective."""
        index_map = self.domain.topology.index_map(self.dimension - 1)
        return np.asarray(summed(index_map, boundary_facets(self.domain))[self.local_facets] > 0.0)

    @functools.cached_property
    def gradients(self) -> Array:
        """The gradients of the barycentric coordinates, shape (cells, d + 1, d)."""
        return np.concatenate((-self.inverses.sum(axis=1, keepdims=True), self.inverses), axis=1)

    @functools.cached_property
    def facet_sizes(self) -> Array:
        """The sizes of the facets, shape (cells, d + 1)."""
        lengths = np.linalg.norm(self.gradients, axis=2)
        return self.dimension * self.volumes[:, None] * lengths

    def points(self, reference: Array) -> Points:
        """Return points of the cells, from those of the reference cell of the mesh."""
        return Points(self.domain, self.cells.astype(np.int32), reference)

    @functools.cached_property
    def _groups(self) -> list[tuple[Indices, Indices]]:
        """The cells whose vertices have one order, with this order."""
        code = self.order @ (self.order.shape[1] ** np.arange(self.order.shape[1]))
        groups = (np.flatnonzero(code == value) for value in np.flatnonzero(np.bincount(code)))
        return [(cells, self.order[cells[0]]) for cells in groups]

    def groups(self, points: Array) -> Iterator[tuple[Indices, Array]]:
        """Yield the cells whose vertices have one order, with points in the order of the frames.

        Args:
            points: Points of the reference cell of the mesh.
        """
        for cells, order in self._groups:
            yield cells, barycentric(points)[:, order][:, 1:]

    def moments(self, values: Array, points: Array, weights: Array, degree: int) -> Array:
        """Return the means of functions times polynomials, see `polynomials`.

        Args:
            values: The functions at points of the cells of the mesh, shape (cells, points, ...), or
                (cells, 1, ...) for functions that are constant in each cell.
            points, weights: The rule on the reference cell.
            degree: The degree of the polynomials.

        Returns:
            The means, shape (cells, ..., polynomials).
        """
        count = math.comb(degree + self.dimension, degree)
        result = np.zeros((len(values), *values.shape[2:], count))
        for cells, own in self.groups(points):
            table = polynomials(self.dimension, degree, own) * weights
            if values.shape[1] == 1:
                table = table.sum(axis=1, keepdims=True)
            result[cells] = np.tensordot(values[cells], table, (1, 1))
        return result


def cell_frames(domain: mesh.Mesh) -> Frames:
    """Return the frames of the owned cells of a mesh."""
    topology, d = domain.topology, domain.topology.dim
    for dimension in (0, d - 1):
        topology.create_connectivity(d, dimension)
    cells = owned_cells(domain)
    vertices, local_facets = (
        topology.connectivity(d, dimension).array.reshape(-1, d + 1) for dimension in (0, d - 1)
    )
    x: Array = np.asarray(domain.geometry.x, dtype=np.float64)
    corners = x[domain.geometry.dofmap, :d]
    along = la.vector(topology.index_map(0))
    along.array[vertices] = corners @ DIRECTION[:d]
    along.scatter_forward()  # all ranks have the numbers of the owner
    places, corners = along.array[vertices[: len(cells)]], corners[: len(cells)]
    numbers = _global(topology.index_map(0), vertices[: len(cells)])
    order = np.lexsort((numbers, places), axis=1)
    facets = np.take_along_axis(local_facets[: len(cells)], order, axis=1)
    return Frames(
        np.asarray(cells, dtype=np.int64),
        order,
        np.take_along_axis(corners, order[:, :, None], axis=1),
        np.take_along_axis(numbers, order, axis=1),
        _global(topology.index_map(d - 1), facets),
        facets.astype(np.int64),
        places.mean(axis=1),
        domain,
    )


def cells_around(comm: MPI.Comm, vertices: Indices, marked: Mask) -> Mask:
    """Return which cells have a vertex that some cell marks.

    Args:
        comm: The communicator; the call is collective.
        vertices: The global numbers of the vertices of the cells of this rank.
        marked: Which of these are marked, shape (cells, d + 1), or (cells, 1) for whole cells.
    """
    ends = np.concatenate(
        comm.allgather(np.unique(vertices[np.broadcast_to(marked, vertices.shape)]))
    )
    return np.asarray(np.isin(vertices, ends).any(axis=1))


def on_frames(frames: Frames, parts: Sequence[LocalIndices]) -> Mask:
    """Return whether facets of cells are on the boundary and in one of several lists; collective.

    Args:
        frames: The cells.
        parts: Facets that some rank knows, which need not have the cell of the facet.
    """
    index_map = frames.domain.topology.index_map(frames.dimension - 1)
    return frames.outer & (summed(index_map, union(parts))[frames.local_facets] > 0.0)


def _global(index_map: object, local: LocalIndices) -> Indices:
    numbers = index_map.local_to_global(local.ravel().astype(np.int32))  # type: ignore[attr-defined]
    return np.asarray(numbers, dtype=np.int64).reshape(local.shape)
