"""The picture of contact in the domain: the solution or the pressure, with the free boundary."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from dolfinx import fem
from matplotlib.lines import Line2D
from matplotlib.tri import Triangulation

from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.kinds import check, known_by
from dolfinx_signorini.meshes.sided_meshes import box
from dolfinx_signorini.pictures.palette import COLOUR_MAP, COLOURS
from dolfinx_signorini.pictures.picture import Picture, add_triangles
from dolfinx_signorini.pictures.triangles import Triangles, gather_slice, gather_triangles

PICTURES = {"contact": "contact pressure", "solution": "solution $u$"}
LINES = {1.0: ("contact below", COLOURS[1]), -1.0: ("contact above", COLOURS[2])}


Plane = tuple[str, float]
PLANE = known_by(
    'a pair of an axis and a number, such as ("z", 0.5)',
    lambda value: (
        isinstance(value, tuple)
        and len(value) == 2
        and value[0] in ("x", "y", "z")
        and isinstance(value[1], int | float)
        and math.isfinite(value[1])
    ),
)


def draw_region(
    f: fem.Function, what: str, active: Mapping[float, LocalIndices], plane: Plane | None = None
) -> Picture | None:
    """Return a picture of contact in the domain on rank 0, and None on the others; collective.

    The free boundary, where contact ends, is drawn half-way between dofs in contact and others.

    Args:
        f: The solution or the pressure, in the plane or in space.
        what: The label of the function, see `PICTURES`.
        active: The dofs in contact by the sign of their obstacle.
        plane: In space the slice to draw: an axis, "x", "y" or "z", and the coordinate on this
            axis; by default the slice through the middle of the solid at right angles to z.

    Raises:
        InputError: There is no such picture, the mesh is a line or a surface in space, or the
            slice misses the solid.
    """
    space = f.function_space
    if what not in PICTURES:
        raise InputError(f"must be one of {', '.join(PICTURES)}, not {what!r}", "what")
    gathered, names, title = _view(space, plane)
    field, regions = gathered(f), []
    for sign, dofs in active.items():
        marks = fem.Function(space)
        marks.x.array[dofs] = 1.0
        marks.x.scatter_forward()
        regions.append((LINES[sign], gathered(marks)))
    empty = space.mesh.comm.bcast(field is not None and not len(field.triangles), root=0)
    if empty:
        raise InputError("misses the solid", "plane")
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
    axes.set(xlabel=f"${names[0]}$", ylabel=f"${names[1]}$", aspect="equal", title=title)
    if lines:
        figure.legend(handles=lines, loc="outside lower center", ncols=2, frameon=False)
    return figure


def _view(
    space: fem.FunctionSpace, plane: Plane | None
) -> tuple[Callable[[fem.Function], Triangles | None], str, str]:
    """Return what gathers a function on the plane mesh or on a slice, the axes' names, a title."""
    domain = space.mesh
    dims = domain.topology.dim, domain.geometry.dim
    if dims == (2, 2):
        if plane is not None:
            raise InputError("is for problems in space", "plane")
        return gather_triangles, "xy", ""
    if dims != (3, 3):
        raise InputError("contact in the domain is drawn in the plane and in space", "problem")
    if plane is None:
        plane = "z", float(box(domain.comm, domain.geometry.x)[:, 2].mean())
    check(plane=(plane, PLANE))
    axis, height = "xyz".index(plane[0]), float(plane[1])
    others, title = "xyz".replace(plane[0], ""), f"${plane[0]} = {height:.4g}$"
    return lambda f: gather_slice(f, axis, height), others, title
