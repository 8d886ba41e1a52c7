"""The picture of contact in the domain: the solution or the pressure, with the free boundary."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from dolfinx import fem
from matplotlib.lines import Line2D
from matplotlib.tri import Triangulation

from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.pictures.palette import COLOUR_MAP, COLOURS
from dolfinx_signorini.pictures.picture import Picture, add_triangles
from dolfinx_signorini.pictures.triangles import gather_triangles

PICTURES = {"contact": "contact pressure", "solution": "solution $u$"}
LINES = {1.0: ("contact below", COLOURS[1]), -1.0: ("contact above", COLOURS[2])}


def draw_region(f: fem.Function, what: str, active: Mapping[float, LocalIndices]) -> Picture | None:
    """Return a picture of contact in the domain on rank 0, and None on the others; collective.

    The free boundary, where contact ends, is drawn half-way between dofs in contact and others.

    Args:
        f: The solution or the pressure, in the plane.
        what: The label of the function, see `PICTURES`.
        active: The dofs in contact by the sign of their obstacle.

    Raises:
        InputError: There is no such picture, or the problem is none in the plane.
    """
    space = f.function_space
    if what not in PICTURES:
        raise InputError(f"must be one of {', '.join(PICTURES)}, not {what!r}", "what")
    if (space.mesh.topology.dim, space.mesh.geometry.dim) != (2, 2):
        raise InputError("contact in the domain is drawn in the plane only", "problem")
    field, regions = gather_triangles(f), []
    for sign, dofs in active.items():
        marks = fem.Function(space)
        marks.x.array[dofs] = 1.0
        marks.x.scatter_forward()
        regions.append((LINES[sign], gather_triangles(marks)))
    if field is None:
        return None
    width, height = np.ptp(field.points, axis=0)
    figure = Picture(figsize=(7.6, float(np.clip(1.4 + 6.0 * height / width, 3.0, 7.4))))
    axes: Any = figure.add_subplot()
    drawn = add_triangles(axes, field.points, field.triangles, field.values, cmap=COLOUR_MAP)
    figure.colorbar(drawn, ax=axes, label=PICTURES[what], fraction=0.06, pad=0.03)
    lines = []
    for (name, colour), region in regions:
        if region is None or not 0.0 < region.values.mean() < 1.0:
            continue
        mesh = Triangulation(region.points[:, 0], region.points[:, 1], region.triangles)
        axes.tricontour(mesh, region.values, levels=[0.5], colors=[colour], linewidths=2.0)
        lines.append(Line2D([], [], color=colour, linewidth=2.0, label=f"end of {name}"))
    axes.set(xlabel="$x$", ylabel="$y$", aspect="equal")
    if lines:
        figure.legend(handles=lines, loc="outside lower center", ncols=2, frameon=False)
    return figure
