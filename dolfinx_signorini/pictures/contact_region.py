"""The picture of contact in the domain: the solution or the pressure, with the free boundary."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from dolfinx import fem
from matplotlib.lines import Line2D
from matplotlib.tri import Triangulation

from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.pictures.palette import COLOURS
from dolfinx_signorini.pictures.picture import Picture
from dolfinx_signorini.pictures.problem_pictures import draw_plane, gather_facets
from dolfinx_signorini.pictures.triangles import gather_triangles

PICTURES = {"contact": "contact pressure", "solution": "solution $u$"}
LINES = {1.0: ("contact below", COLOURS[1]), -1.0: ("contact above", COLOURS[2])}


class Signed(Protocol):
    """An obstacle, as far as its picture needs it."""

    @property
    def sign(self) -> float:
        """1 for a lower obstacle, and -1 for an upper one."""


class Solved(Protocol):
    """The part of a solved `ObstacleProblem` that this module needs."""

    u: fem.Function

    @property
    def pressure(self) -> fem.Function:
        """The density of the contact pressure."""

    @property
    def obstacles(self) -> Sequence[Signed]:
        """The obstacles."""

    @property
    def active_sides(self) -> Sequence[LocalIndices]:
        """For each of the obstacles the owned dofs in contact."""


def draw_region(
    problem: Solved,
    what: str,
    parts: Mapping[str, LocalIndices] | None = None,
    styles: Mapping[str, Mapping[str, Any]] | None = None,
    title: str = "",
) -> Picture | None:
    """Return a picture of contact in the domain on rank 0, and None on the others; collective.

    The free boundary, where contact ends, is drawn half-way between dofs in contact and others.

    Args:
        problem: The problem, in the plane.
        what: "solution" for u, "contact" for the pressure.
        parts, styles, title: See `draw_solution`; no part by default.

    Raises:
        InputError: There is no such picture, or the problem is none in the plane.
    """
    space = problem.u.function_space
    if what not in PICTURES:
        raise InputError(f"must be one of {', '.join(PICTURES)}, not {what!r}", "what")
    if (space.mesh.topology.dim, space.mesh.geometry.dim) != (2, 2):
        raise InputError("contact in the domain is drawn in the plane only", "problem")
    field, regions = gather_triangles(problem.pressure if what == "contact" else problem.u), []
    for obstacle, dofs in zip(problem.obstacles, problem.active_sides, strict=True):
        marks = fem.Function(space)
        marks.x.array[dofs] = 1.0
        marks.x.scatter_forward()
        regions.append((LINES[obstacle.sign], gather_triangles(marks)))
    edges = gather_facets(space.mesh, parts or {})
    if field is None or edges is None:
        return None
    figure, axes = draw_plane(field, PICTURES[what], edges, styles or {}, title)
    lines = axes.get_legend_handles_labels()[0]
    for (name, colour), region in regions:
        if region is None or not 0.0 < region.values.mean() < 1.0:
            continue
        mesh = Triangulation(region.points[:, 0], region.points[:, 1], region.triangles)
        axes.tricontour(mesh, region.values, levels=[0.5], colors=[colour], linewidths=2.0)
        lines.append(Line2D([], [], color=colour, linewidth=2.0, label=f"end of {name}"))
    if lines:
        figure.legend(handles=lines, loc="outside lower center", ncols=4, frameon=False)
    return figure
