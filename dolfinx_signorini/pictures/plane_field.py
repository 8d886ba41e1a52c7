"""A plane solution with parts of the boundary, gathered on rank 0 and drawn."""

import textwrap
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from dolfinx import mesh
from matplotlib.collections import LineCollection

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.meshes.sided_meshes import facet_nodes
from dolfinx_signorini.pictures.palette import COLOUR_MAP
from dolfinx_signorini.pictures.picture import Picture, add_triangles
from dolfinx_signorini.pictures.triangles import Triangles

TITLE = 180  # characters of a title that are drawn


def gather_facets(domain: mesh.Mesh, parts: Mapping[str, LocalIndices]) -> dict[str, Array] | None:
    """Return the ends of facets, shape (facets, 2, 2), by part on rank 0, and None on the others.

    Args:
        domain: A plane mesh; the call is collective.
        parts: Boundary facets by the name of the part.
    """
    count = domain.topology.index_map(1).size_local
    ends = {
        name: domain.geometry.x[facet_nodes(domain, part[part < count])][:, :, :2]
        for name, part in parts.items()
    }
    found = domain.comm.gather(ends, root=0)
    if found is None:
        return None
    return {name: np.concatenate([part[name] for part in found]) for name in parts}


def draw_plane_field(
    field: Triangles,
    parts: Mapping[str, Array] = MappingProxyType({}),
    styles: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
    points: Sequence[Sequence[float]] = (),
    title: str = "",
) -> Picture:
    """Return a picture of a function with the parts of the boundary.

    Args:
        field: The function.
        parts: The ends of the facets of each part of the boundary, shape (facets, 2, 2).
        styles: How matplotlib draws the parts of the boundary, by name.
        points: Detachment points to mark.
        title: The title of the picture.
    """
    width, height = np.ptp(field.points, axis=0)
    # The height that the colour bar and the legend need is about 1.4 inches.
    size = (7.6, float(np.clip(1.4 + 6.0 * height / width, 3.0, 7.4)))
    figure = Picture(figsize=size)
    axes: Any = figure.add_subplot()
    drawn = add_triangles(axes, field.points, field.triangles, field.values, cmap=COLOUR_MAP)
    figure.colorbar(drawn, ax=axes, label="solution $u$", fraction=0.06, pad=0.03)
    for name, edges in parts.items():
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
