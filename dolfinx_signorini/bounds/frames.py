"""Cells with their vertices in the order of global numbers, and functions at points of cells."""

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from dolfinx import mesh
from ufl import SpatialCoordinate, as_ufl, as_vector
from ufl.core.expr import Expr

from dolfinx_signorini.base import compat, compiled
from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices, Mask
from dolfinx_signorini.base.ranks import summed
from dolfinx_signorini.bounds.reference_flux import barycentric, polynomials
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.sided_meshes import owned_cells


@dataclass(frozen=True)
class Frames:
    """The owned cells of a mesh of triangles or tetrahedra.

    Vertex j and facet j of a frame are vertex and facet `order[:, j]` of the cell in the mesh:

        frames = cell_frames(domain)
        facets = np.take_along_axis(facets_of_cells, frames.order, axis=1)

    Attributes:
        cells: The numbers of the cells in the mesh.
        order: The local vertices by global number, shape (cells, d + 1).
        corners: The coordinates of the vertices in this order, shape (cells, d + 1, d).
        vertices, facets: The global numbers of vertices and facets, shape (cells, d + 1).
        local_facets: The numbers of the facets on this rank.
        domain: The mesh.
    """

    cells: Indices
    order: Indices
    corners: Array
    vertices: Indices
    facets: Indices
    local_facets: Indices
    domain: mesh.Mesh

    @property
    def dimension(self) -> int:
        """The dimension d of the cells."""
        return self.corners.shape[2]

    def some(self, rows: Indices) -> "Frames":
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
        return np.asarray(np.linalg.inv(self.jacobians), dtype=np.float64)

    @functools.cached_property
    def volumes(self) -> Array:
        """The sizes of the cells."""
        return 1.0 / math.factorial(self.dimension) * np.abs(np.linalg.det(self.jacobians))

    @functools.cached_property
    def diameters(self) -> Array:
        """The lengths of the longest edges."""
        edges = self.corners[:, :, None] - self.corners[:, None]
        return np.sqrt(np.square(edges).sum(axis=3).max(axis=(1, 2), initial=0.0))

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

    def groups(self) -> Iterator[tuple[Indices, Indices]]:
        """Yield the cells whose vertices have one order, with this order."""
        if not len(self.order):
            return
        code = self.order @ (self.order.shape[1] ** np.arange(self.order.shape[1]))
        for value in np.unique(code):
            cells = np.flatnonzero(code == value)
            yield cells, self.order[cells[0]]

    def moments(self, values: Array, points: Array, weights: Array, degree: int) -> Array:
        """Return the means of functions times polynomials of `reference_flux.polynomials`.

        Args:
            values: The functions at points of the cells of the mesh, shape (cells, points, ...).
            points, weights: The rule on the reference cell.
            degree: The degree of the polynomials.

        Returns:
            The means, shape (cells, ..., polynomials).
        """
        first = polynomials(self.dimension, degree, points)
        result = np.zeros((len(values), *values.shape[2:], len(first)))
        for cells, order in self.groups():
            own = polynomials(self.dimension, degree, barycentric(points)[:, order][:, 1:])
            result[cells] = np.tensordot(values[cells], own * weights, (1, 1))
        return result


def cell_frames(domain: mesh.Mesh) -> Frames:
    """Return the frames of the owned cells of a mesh."""
    topology, d = domain.topology, domain.topology.dim
    for dimension in (0, d - 1):
        topology.create_connectivity(d, dimension)
    cells = owned_cells(domain)
    vertices, local_facets = (
        topology.connectivity(d, dimension).array.reshape(-1, d + 1)[: len(cells)]
        for dimension in (0, d - 1)
    )
    numbers = _global(topology.index_map(0), vertices)
    order = np.argsort(numbers, axis=1)
    x: Array = np.asarray(domain.geometry.x, dtype=np.float64)
    corners = x[domain.geometry.dofmap[: len(cells)], :d]
    facets = np.take_along_axis(local_facets, order, axis=1)
    return Frames(
        np.asarray(cells, dtype=np.int64),
        order,
        np.take_along_axis(corners, order[:, :, None], axis=1),
        np.take_along_axis(numbers, order, axis=1),
        _global(topology.index_map(d - 1), facets),
        facets.astype(np.int64),
        domain,
    )


def on_frames(frames: Frames, parts: Sequence[LocalIndices]) -> Mask:
    """Return whether the facets of cells are in one of several lists of facets; collective.

    Args:
        frames: The cells.
        parts: Facets that some rank knows, which need not have the cell of the facet.
    """
    facets = np.concatenate([*parts, np.empty(0, dtype=np.int32)]).astype(np.int32)
    index_map = frames.domain.topology.index_map(frames.dimension - 1)
    return np.asarray(summed(index_map, facets)[frames.local_facets] > 0.0)


def values_at(
    domain: mesh.Mesh, data: Sequence[Expr | float], points: Array, entities: Indices
) -> Array:
    """Return data at points of cells or of facets.

    Args:
        domain: The mesh.
        data: Numbers and scalar UFL expressions.
        points: Points of the reference cell, or of the reference facet.
        entities: Cells, or (cell, local facet) pairs.

    Returns:
        The values, shape (entities, points, data).
    """
    result = np.zeros((len(entities), len(points), len(data)))
    rest = []
    for k, item in enumerate(data):
        if isinstance(item, int | float | np.number):
            result[:, :, k] = item
        else:
            rest.append(k)
    if rest:
        # The coordinate comes last: DOLFINx 0.11 refuses expressions that are the same everywhere.
        terms = [*(as_ufl(data[k]) for k in rest), SpatialCoordinate(domain)[0]]
        expression = compiled.expression(as_vector(terms), points, domain.comm)
        values = compat.evaluate(expression, domain, entities.astype(np.int32))
        result[:, :, rest] = values.reshape(len(entities), len(points), len(terms))[:, :, :-1]
    return result


def _global(index_map: object, local: LocalIndices) -> Indices:
    numbers = index_map.local_to_global(local.ravel().astype(np.int32))  # type: ignore[attr-defined]
    return np.asarray(numbers, dtype=np.int64).reshape(local.shape)
