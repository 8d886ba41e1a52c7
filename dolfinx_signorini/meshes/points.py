"""Coordinates and discrete functions at any points of cells and facets.

A compiled expression of DOLFINx has its points built in. Here the points are data, the same ones
for all cells or other ones for each cell: quadrature rules, lattices and searches on any kind of
cell tabulate what they need.
"""

import functools
import itertools
from collections.abc import Sequence
from typing import Any

import basix
import basix.ufl
import numpy as np
import numpy.typing as npt
from dolfinx import fem, mesh

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.tolerances import SOLVED, UNIT
from dolfinx_signorini.meshes.jacobians import inverses, spanned
from dolfinx_signorini.meshes.sided_meshes import cell_edges, facet_vertices


class Points:
    """Points of cells or facets, with the map from the reference cell to each of the cells:

        points = Points(domain, cells, lattice)
        x, y = points.x

    Args:
        domain: The mesh.
        places: Cells, shape (n,), or (cell, local facet) pairs, shape (n, 2).
        at: The points in the reference cell or facet: of shape (m, d), the same in every place, or
            of shape (n, m, d).

    Attributes:
        cells: The cell of each place, shape (n,).
    """

    def __init__(self, domain: mesh.Mesh, places: LocalIndices, at: Array):
        self.domain, self.places, self.at = domain, places, at
        self.cells, self._reference, self._axes = places, at, np.eye(domain.topology.dim)[None]
        if places.ndim == 2:
            origins, axes = _reference_facets(domain)
            self.cells, self._axes = places[:, 0], axes[places[:, 1]]
            self._reference = origins[places[:, 1], None] + at @ self._axes
        self._element = domain.ufl_domain().ufl_coordinate_element().sub_elements[0].basix_element
        nodes = np.take(domain.geometry.dofmap, self.cells, axis=0)
        x = np.asarray(domain.geometry.x, dtype=np.float64)
        self._nodes = [x[:, i][nodes] for i in range(domain.geometry.dim)]

    def of(self, rows: npt.NDArray[np.integer[Any]]) -> "Points":
        """Return the points of some of the places, which are given by their rows."""
        at = self.at if self.at.ndim == 2 else self.at[rows]
        return Points(self.domain, self.places[rows], at)

    @functools.cached_property
    def x(self) -> list[Array]:
        """The coordinates: for each direction of space an array of shape (n, m).

        Rounding moves no point out of the box around its straight-sided cell: a formula such as
        atan2(y, x) may jump at y = 0.
        """
        (table,) = _tabulated(self._element, 0, self._reference)
        places = [_at_points(table, nodes) for nodes in self._nodes]
        if self._element.degree > 1:
            return places
        return [
            np.clip(x, corners.min(axis=0)[:, None], corners.max(axis=0)[:, None])
            for x, corners in zip(places, (nodes.T.copy() for nodes in self._nodes), strict=True)
        ]

    @property
    def inside(self) -> list[Array]:
        """The coordinates, moved by `SOLVED` of the way to the middle of each cell."""
        middles = (nodes.mean(axis=1)[:, None] for nodes in self._nodes)
        return [x + SOLVED * (middle - x) for x, middle in zip(self.x, middles, strict=True)]

    @property
    def at_ends(self) -> bool:
        """Whether some points are on the boundary of a cell, in places that are cells."""
        at, simplices = self._reference, self._nodes[0].shape[1] == self._reference.shape[-1] + 1
        last = at.sum(axis=-1) if simplices else at
        near = (at < SOLVED).any() or (last > 1.0 - SOLVED).any()
        return bool(self.places.ndim == 1 and near)

    @functools.cached_property
    def jacobian(self) -> Array:
        """dx_i / dX_t: shape (n, m, gdim, tdim), or (n, 1, gdim, tdim) where cells are affine."""
        affine = self._nodes[0].shape[1] == self._reference.shape[-1] + 1
        tables = _tabulated(self._element, 1, self._reference[..., : 1 if affine else None, :])[1:]
        columns = [[_at_points(table, nodes) for table in tables] for nodes in self._nodes]
        return np.moveaxis(np.array(columns), (0, 1), (2, 3))

    @property
    def tangents(self) -> Array:
        """The derivatives along the axes of the reference cell or facet."""
        if self.places.ndim == 1:
            return self.jacobian
        return np.asarray(self.jacobian @ np.swapaxes(self._axes, 1, 2)[:, None])

    @property
    def normals(self) -> list[Array]:
        """The outward unit normals of facets: for each direction an array of shape (n, m).

        Raises:
            InputError: The places are cells.
        """
        if self.places.ndim == 1:
            raise InputError("must not depend on a normal in cells", "u")
        cell = basix.CellType[self.domain.topology.cell_name()]
        outward = np.asarray(basix.cell.facet_outward_normals(cell))[self.places[:, 1]]
        vectors = np.einsum("nt,nqti->inq", outward, inverses(self.jacobian))
        shape = len(self.places), self._reference.shape[-2]
        units = vectors / np.linalg.norm(vectors, axis=0)
        return [np.broadcast_to(component, shape) for component in units]

    @property
    def scale(self) -> Array:
        """The ratio of sizes, of the cell or facet and the reference one: (n, m) or (n, 1)."""
        return spanned(self.tangents)

    def values(self, function: fem.Function) -> list[Array]:
        """Return the values of each component of a Lagrange function, each of shape (n, m)."""
        (table,) = _tabulated(basix_element(function), 0, self._reference)
        return [_at_points(table, nodal) for nodal in self._nodal(function)]

    def shares(self, space: fem.FunctionSpace) -> tuple[LocalIndices, Array]:
        """Return the dofs of a scalar Lagrange space and their shares in the value at one point.

        Returns:
            Both of shape (n, dofs of a cell), where each place has one point.
        """
        (table,) = _tabulated(space.element.basix_element, 0, self._reference)
        return np.take(space.dofmap.list, self.cells, axis=0), table[:, 0]

    def gradients(self, function: fem.Function) -> list[list[Array]]:
        """Return for each component its derivatives in each direction, each of shape (n, m)."""
        element = basix_element(function)
        affine = self.jacobian.shape[1] == 1
        if affine and element.embedded_superdegree == 1:  # the same at all points of a cell
            at, repeats = self._reference[..., :1, :], self._reference.shape[-2]
        else:
            at, repeats = self._reference, 1
        tables = _tabulated(element, 1, at)[1:]
        inverse, result = inverses(self.jacobian), []
        for nodal in self._nodal(function):
            slopes = [_at_points(table, nodal) for table in tables]
            gradient = [slopes[0] * inverse[:, :, 0, i] for i in range(inverse.shape[3])]
            for t, slope in enumerate(slopes[1:], start=1):
                for i, component in enumerate(gradient):
                    component += slope * inverse[:, :, t, i]
            result.append([np.repeat(component, repeats, axis=1) for component in gradient])
        return result

    def tangential(self, vector: Sequence[Array]) -> list[Array]:
        """Return the part of a vector, components of shape (n, m), along the places."""
        if self.places.ndim == 1 or not vector:
            return list(vector)
        stacked = np.stack(list(vector), axis=-1)[..., None]
        part = self.tangents @ (np.linalg.pinv(self.tangents) @ stacked)
        return [part[:, :, i, 0] for i in range(part.shape[2])]

    def _nodal(self, function: fem.Function) -> list[Array]:
        """For each component the values of the dofs of every cell, shape (n, dofs)."""
        dofmap = function.function_space.dofmap
        dofs = np.take(dofmap.list, self.cells, axis=0)  # faster than an index
        return [function.x.array[dofmap.bs * dofs + i] for i in range(dofmap.bs)]


def points_at(domain: mesh.Mesh, cells: LocalIndices, x: Array) -> Points:
    """Return points from their coordinates.

    Args:
        domain: A mesh of straight-sided triangles or tetrahedra that fill the space.
        cells: The cells of the points.
        x: The coordinates of the points of each cell, shape (cells, points, coordinates).
    """
    maps, dim = inverses(cell_edges(domain, cells)), domain.topology.dim
    offsets = x - domain.geometry.x[domain.geometry.dofmap[cells, :1], :dim]
    at = np.zeros(offsets.shape)
    for i, j in itertools.product(range(dim), repeat=2):
        at[:, :, i] += maps[:, i, j, None] * offsets[:, :, j]
    return Points(domain, cells, at)


def basix_element(function: fem.Function, subject: str = "") -> Any:
    """Return the scalar element of a function.

    Args:
        function: The function.
        subject: The subject of the error; the function's name by default.

    Raises:
        InputError: The element is not a Lagrange element or one like it.
    """
    space = function.function_space
    try:
        element = space.element.basix_element
    except RuntimeError:
        element = None
    plain = element is not None and element.map_type == basix.MapType.identity
    if not plain or space.element.needs_dof_transformations:
        message = "known for functions in Lagrange spaces, not in others"
        raise InputError(message, subject or function.name)
    return element


def _reference_facets(domain: mesh.Mesh) -> tuple[Array, Array]:
    """The first vertex of each facet of the reference cell, and the vectors along its axes."""
    cell = basix.CellType[domain.topology.cell_name()]
    corners = np.asarray(basix.geometry(cell))[facet_vertices(domain)]
    return corners[:, 0], corners[:, 1 : domain.topology.dim] - corners[:, :1]


def _tabulated(element: Any, derivatives: int, reference: Array) -> list[Array]:
    """The values of the basis (then each first derivative) at points: (m, dofs) or (n, m, dofs).

    What differs from 0 or 1 by rounding is 0 or 1, so that a node has its own coordinates.
    """
    flat = np.ascontiguousarray(reference.reshape(-1, reference.shape[-1]))
    some = flat if len(flat) else np.zeros((1, flat.shape[1]))  # Basix takes no empty array
    tables = element.tabulate(derivatives, some)[:, : len(flat), :, 0]
    whole = np.rint(tables)
    tables = np.where(np.abs(tables - whole) < UNIT, whole, tables)
    return [table.reshape(*reference.shape[:-1], tables.shape[2]) for table in tables]


def _at_points(table: Array, nodal: Array) -> Array:
    """Values at points, shape (n, m), from a table and the values of dofs, shape (n, dofs)."""
    if table.ndim == 2:
        return np.asarray(nodal @ table.T)
    return np.asarray((table @ nodal[:, :, None])[:, :, 0])
