"""A function on triangles, in the plane, on the surface of a solid or on a slice, on rank 0."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem, geometry, mesh

from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices
from dolfinx_signorini.meshes.elements import (
    control_points,
    facet_pieces,
    subtriangles,
    values_at_control_points,
)
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, box, facet_cells, owned_cells

LATTICE = 150  # points across a slice: a picture of the usual size shows no more


@dataclass(frozen=True)
class Triangles:
    """A function that is linear on triangles.

    A solved problem gives one, on rank 0:

        drawn = gather_triangles(problem.u)
        if drawn is not None:
            print(drawn.values.max())

    Attributes:
        points: Coordinates of the vertices, shape (points, dimension).
        values: The values at the vertices, or a row of values at each.
        triangles: Indices of points, shape (triangles, 3), or (lines, 2) of facets in the plane.
    """

    points: Array
    values: Array
    triangles: Indices


def gather_triangles(u: fem.Function) -> Triangles | None:
    """Return a function on a plane mesh, or on the boundary of a solid; None on all ranks but 0.

    Args:
        u: The function, in continuous elements of any degree; the call is collective.
    """
    space = u.function_space
    return gather_rows(space, values_at_control_points(space, u.x.array))


def gather_rows(
    space: fem.FunctionSpace, rows: Array, facets: LocalIndices | None = None
) -> Triangles | None:
    """Return values at the places of dofs, as `gather_triangles` does with those of a function.

    Args:
        space: A scalar space of continuous elements of any degree; the call is collective.
        rows: One value for each dof of this rank, or one row of values.
        facets: Owned facets to take in place of the cells of a plane mesh, which are drawn as
            lines, or of the whole boundary of a solid.
    """
    if space.mesh.topology.dim == 2 and facets is None:
        corners = cell_pieces(space, owned_cells(space.mesh))
    else:
        facets = boundary_facets(space.mesh) if facets is None else facets
        corners, _ = facet_pieces(space, facet_cells(space.mesh, facets))
    used = np.unique(corners)
    found = gathered(space, used, rows[used], corners)
    return None if found is None else Triangles(*found)


def cell_pieces(space: fem.FunctionSpace, cells: LocalIndices) -> LocalIndices:
    """Return the dofs of pieces of cells: triangles between neighbouring dofs, in space the cells.

    Args:
        space: A scalar space of continuous elements of any degree.
        cells: The cells.
    """
    element = space.element.basix_element
    if space.mesh.topology.dim == 2:
        corners = subtriangles(element.cell_type, element.degree)
    else:
        corners = np.concatenate(element.entity_dofs[0])[None]
    return space.dofmap.list[cells][:, corners].reshape(-1, corners.shape[1])


class Slice:
    """A lattice of points on a slice through a solid, on which functions are gathered:

        through = Slice(problem.space.mesh, axis=2, height=0.5)
        drawn = through.gather(problem.u)

    The cells around the points are looked for once.

    Args:
        domain: The mesh of the solid; the call is collective.
        axis: The axis at right angles to the slice: 0, 1 or 2.
        height: The coordinate of the slice on this axis.
    """

    def __init__(self, domain: mesh.Mesh, axis: int, height: float):
        self._comm = domain.comm
        low, high = box(domain.comm, domain.geometry.x)
        self._others = [i for i in range(3) if i != axis]
        along = [np.linspace(low[i], high[i], LATTICE) for i in self._others]
        self._points = np.full((LATTICE**2, 3), height)
        lattice = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1)
        self._points[:, self._others] = lattice.reshape(-1, 2)
        tree = geometry.bb_tree(domain, domain.topology.dim)
        near = geometry.compute_collisions_points(tree, self._points)
        inside = geometry.compute_colliding_cells(domain, near, self._points)
        self._known = np.flatnonzero(np.diff(inside.offsets))
        self._cells = inside.array[inside.offsets[self._known]]

    def gather(self, u: fem.Function) -> Triangles | None:
        """Return a function on the slice; None on all ranks but 0.

        Args:
            u: The function, in continuous elements of any degree; the call is collective.

        Returns:
            The function, whose points have the two other coordinates. Triangles that are not wholly
            inside of the solid are left out.
        """
        values: Array = np.full(len(self._points), np.nan)
        if len(self._known):
            found = u.eval(self._points[self._known], self._cells)
            values[self._known] = found.reshape(len(self._known), -1)[:, 0]
        parts = self._comm.gather(values, root=0)
        if parts is None:
            return None
        values = np.fmax.reduce(parts)  # not a number where no rank knows the point
        corner = np.arange(LATTICE**2).reshape(LATTICE, LATTICE)
        a, b, c, d = (
            part.ravel()
            for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:])
        )
        triangles = np.concatenate((np.stack((a, b, c), axis=1), np.stack((a, c, d), axis=1)))
        triangles = triangles[np.isfinite(values[triangles]).all(axis=1)]
        used, numbers = np.unique(triangles, return_inverse=True)
        return Triangles(self._points[used][:, self._others], values[used], numbers.reshape(-1, 3))


def gathered(
    space: fem.FunctionSpace,
    dofs: LocalIndices,
    values: Array,
    pieces: LocalIndices,
    *more: npt.NDArray[Any],
) -> tuple[npt.NDArray[Any], ...] | None:
    """Return the points of all ranks and the pieces between them on rank 0, None on the others.

    Args:
        space: The space of the dofs; the call is collective.
        dofs: Dofs of this rank, those of its pieces among them; their places are the points.
        values: What is known of these dofs, one row for each.
        pieces: The dofs of each piece of this rank, one row for each.
        more: What else is known of these pieces.

    Returns:
        The coordinates of the points, their values, the pieces as indices of points, and the rest.
    """
    domain, number = space.mesh, space.dofmap.index_map.local_to_global
    places = control_points(space)[dofs][:, : domain.geometry.dim]
    named = number(pieces.ravel()).reshape(pieces.shape)
    parts = domain.comm.gather((number(dofs), places, values, named, *more), root=0)
    if parts is None:
        return None
    numbers, points, values, named, *rest = map(np.concatenate, zip(*parts, strict=True))
    numbers, first = np.unique(numbers, return_index=True)
    return points[first], values[first], np.searchsorted(numbers, named), *rest
