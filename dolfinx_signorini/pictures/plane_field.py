"""A plane solution with parts of the boundary, gathered on rank 0 and drawn."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from matplotlib.collections import LineCollection

from dolfinx_signorini.base.arrays import Array, Indices
from dolfinx_signorini.meshes.elements import control_points, subtriangles, values_at_control_points
from dolfinx_signorini.meshes.sided_meshes import facet_nodes
from dolfinx_signorini.pictures.palette import COLOUR_MAP
from dolfinx_signorini.pictures.picture import Picture, add_triangles

TITLE = 180  # characters of a title that are drawn


@dataclass(frozen=True)
class PlaneField:
    """A function on a plane domain, with parts of the boundary.

    A solved problem gives one, on rank 0:

        field = gather_plane_field(problem.u, {"contact": problem.contact})
        if field is not None:
            draw_plane_field(field, {"contact": {"color": "red"}}).savefig("solution.png")

    Attributes:
        points: Coordinates of the dofs, shape (points, 2).
        values: The values at the points.
        triangles: Indices of points, shape (triangles, 3).
        parts: The facets of each part of the boundary, shape (facets, 2 ends, 2).
    """

    points: Array
    values: Array
    triangles: Indices
    parts: dict[str, Array]


def gather_plane_field(
    u: fem.Function, parts: Mapping[str, npt.NDArray[np.int32]]
) -> PlaneField | None:
    """Return a function with parts of the boundary on rank 0, and None on the others.

    Args:
        u: The function, in continuous elements of any degree; the call is collective.
        parts: Boundary facets by the name of the part.
    """
    space = u.function_space
    domain, index_map = space.mesh, space.dofmap.index_map
    owned, facets = index_map.size_local, domain.topology.index_map(1).size_local
    cells = space.dofmap.list[: domain.topology.index_map(2).size_local]
    element = space.element.basix_element
    triangles = cells[:, subtriangles(element.cell_type, element.degree)].flatten()
    edges = {}
    for name, part in parts.items():
        edges[name] = domain.geometry.x[facet_nodes(domain, part[part < facets])]
    data = (
        control_points(space)[:owned, :2],
        values_at_control_points(space, u.x.array)[:owned],
        index_map.local_to_global(triangles).reshape(-1, 3),
        edges,
    )
    gathered = domain.comm.gather(data, root=0)
    if gathered is None:
        return None
    points, values, triangles = (np.concatenate([part[i] for part in gathered]) for i in range(3))
    joined = {name: np.concatenate([part[3][name] for part in gathered]) for name in parts}
    return PlaneField(points, values, triangles, {n: x[:, :, :2] for n, x in joined.items()})


def draw_plane_field(
    field: PlaneField,
    styles: Mapping[str, Mapping[str, Any]],
    points: Sequence[Sequence[float]] = (),
    title: str = "",
) -> Picture:
    """Return a picture of a function with the parts of the boundary.

    Args:
        field: The function.
        styles: How matplotlib draws the parts of the boundary, by name.
        points: Detachment points to mark.
        title: The title of the picture.
    """
    width, height = np.ptp(field.points, axis=0)
    # The height that the colour bar and the legend need is about 1.4 inches.
    size = (7.6, float(np.clip(1.4 + 6.0 * height / width, 3.0, 7.4)))
    figure = Picture(figsize=size, layout="constrained")
    axes: Any = figure.add_subplot()
    drawn = add_triangles(axes, field.points, field.triangles, field.values, cmap=COLOUR_MAP)
    figure.colorbar(drawn, ax=axes, label="solution $u$", fraction=0.06, pad=0.03)
    for name, edges in field.parts.items():
        if len(edges):
            axes.add_collection(LineCollection(list(edges), label=name, zorder=3, **styles[name]))
    if len(points):
        axes.plot(
            *np.transpose(points),
            linestyle="",
            marker="o",
            markersize=8,
            markerfacecolor="white",
            markeredgecolor="black",
            zorder=4,
            label="detachment point",
        )
    axes.set(xlabel="$x$", ylabel="$y$", aspect="equal")
    shown = textwrap.fill(textwrap.shorten(title, TITLE, placeholder=" ..."), TITLE // 3)
    axes.set_title(shown, parse_math=False)
    axes.margins(0.04)
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    return figure
