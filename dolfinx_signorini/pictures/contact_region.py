"""The picture of contact in the domain: the solution or the pressure, with the free boundary."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from dolfinx import fem
from matplotlib.lines import Line2D
from matplotlib.tri import Triangulation

from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.kinds import check, choice, known_by
from dolfinx_signorini.base.ranks import function_with
from dolfinx_signorini.meshes.sided_meshes import box
from dolfinx_signorini.pictures.contact_boundary import Solved
from dolfinx_signorini.pictures.palette import COLOURS
from dolfinx_signorini.pictures.picture import Picture
from dolfinx_signorini.pictures.problem_pictures import PICTURES, draw_plane, gather_facets
from dolfinx_signorini.pictures.triangles import Slice, Triangles, gather_triangles

LINES = {1.0: ("lower", COLOURS[1]), -1.0: ("upper", COLOURS[2])}

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


class InDomain(Solved, Protocol):
    """The part of a solved `ObstacleProblem` that this module needs."""

    @property
    def obstacles(self) -> Sequence[Any]:
        """The obstacles; the `sign` of each is 1 for a lower obstacle and -1 for an upper one."""

    @property
    def active_sides(self) -> Sequence[LocalIndices]:
        """For each of the obstacles the owned dofs in contact."""


def draw_region(
    problem: InDomain,
    what: str,
    parts: Mapping[str, LocalIndices] | None = None,
    styles: Mapping[str, Mapping[str, Any]] | None = None,
    title: str = "",
    plane: Plane | None = None,
) -> Picture | None:
    """Return a picture of contact in the domain on rank 0, and None on the others; collective.

    The free boundary, where contact ends, is drawn half-way between dofs in contact and others.

    Args:
        problem: The problem, in the plane or in space.
        what: "solution" for u, "contact" for the pressure.
        parts, styles, title: See `draw_solution`; no part by default.
        plane: In space the slice to draw: an axis, "x", "y" or "z", and the coordinate on this
            axis; by default the slice through the middle of the solid at right angles to z.

    Raises:
        InputError: There is no such picture, the mesh is a line or a surface in space, or the
            slice misses the solid.
    """
    space = problem.u.function_space
    check(what=(what, choice(*PICTURES)))
    gathered, names, height = _view(space, plane)
    field, regions = gathered(problem.pressure if what == "contact" else problem.u), []
    empty = space.mesh.comm.bcast(field is not None and not len(field.triangles), root=0)
    if empty:
        raise InputError("misses the solid", "plane")
    for obstacle, dofs in zip(problem.obstacles, problem.active_sides, strict=True):
        regions.append((LINES[obstacle.sign], gathered(function_with(space, dofs, 1.0))))
    edges = gather_facets(space.mesh, parts or {})
    if field is None or edges is None:
        return None
    figure, axes = draw_plane(field, PICTURES[what], edges, styles or {}, title or height)
    axes.set(xlabel=f"${names[0]}$", ylabel=f"${names[1]}$")
    lines = axes.get_legend_handles_labels()[0]
    for (name, colour), region in regions:
        if region is None or not 0.0 < region.values.mean() < 1.0:
            continue
        mesh = Triangulation(region.points[:, 0], region.points[:, 1], region.triangles)
        axes.tricontour(mesh, region.values, levels=[0.5], colors=[colour], linewidths=2.0)
        label = f"end of contact with the {name} obstacle"
        lines.append(Line2D([], [], color=colour, linewidth=2.0, label=label))
    if lines:
        figure.legend_below(lines)
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
    others, title = "xyz".replace(plane[0], ""), f"{plane[0]} = {height:.4g}"
    return Slice(domain, axis, height).gather, others, title
