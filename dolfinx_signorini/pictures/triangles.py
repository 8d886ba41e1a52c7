"""A function on triangles, in the plane or on the surface of a solid, on rank 0."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices
from dolfinx_signorini.meshes.elements import (
    control_points,
    facet_pieces,
    subtriangles,
    values_at_control_points,
)
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, facet_cells


@dataclass(frozen=True)
class Triangles:
    """A function that is linear on triangles.

    A solved problem gives one, on rank 0:

        drawn = gather_triangles(problem.u)
        if drawn is not None:
            print(drawn.values.max())

    Attributes:
        points: Coordinates of the vertices, shape (points, dimension).
        values: The values at the vertices.
        triangles: Indices of points, shape (triangles, 3).
    """

    points: Array
    values: Array
    triangles: Indices


def gather_triangles(u: fem.Function) -> Triangles | None:
    """Return a function on a plane mesh, or on the boundary of a solid; None on all ranks but 0.

    Args:
        u: The function, in continuous elements of any degree; the call is collective.
    """
    space, topology = u.function_space, u.function_space.mesh.topology
    dim = topology.dim
    if dim == 2:
        element = space.element.basix_element
        cells = space.dofmap.list[: topology.index_map(dim).size_local]
        corners = cells[:, subtriangles(element.cell_type, element.degree)].reshape(-1, 3)
    else:
        facets = boundary_facets(space.mesh)
        owned = facets[facets < topology.index_map(dim - 1).size_local]
        corners, _ = facet_pieces(space, facet_cells(space.mesh, owned))
    used = np.unique(corners)
    found = gathered(space, used, values_at_control_points(space, u.x.array)[used], corners)
    return None if found is None else Triangles(*found)


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
