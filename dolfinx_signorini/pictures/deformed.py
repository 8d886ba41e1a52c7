"""The deformed shape of an elastic body, with a stress in colours, and the obstacle."""

import math
from typing import Any, cast

import numpy as np
from dolfinx import fem
from matplotlib.collections import PolyCollection
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.data.node_values import (
    node_averages,
    values_in_cells,
    vectors_at_nodes,
)
from dolfinx_signorini.meshes.elements import determined, values_at_control_points
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, owned_facets
from dolfinx_signorini.pictures.contact_boundary import AlongDirection, Touching
from dolfinx_signorini.pictures.palette import IN_CONTACT
from dolfinx_signorini.pictures.picture import Picture
from dolfinx_signorini.pictures.problem_pictures import draw_plane, draw_solid, fitting_height
from dolfinx_signorini.pictures.triangles import Triangles, gather_rows

# Of the size of the body: a largest displacement below SEEN is drawn larger, as about DRAWN. Shapes
# of the gallery with less could not be told from those at rest, and with more looked torn. As much
# is left free around the body.
SEEN, DRAWN = 0.02, 0.06
AT_REST: dict[str, Any] = {"color": "0.6", "linewidth": 0.8}
OBSTACLE: dict[str, Any] = {"color": "black", "linewidth": 1.5}
SHADE = "0.85"  # grey, of what is behind the surface of the obstacle


def draw_deformed(
    u: fem.Function,
    contact: AlongDirection,
    stress: Expr | None,
    label: str,
    scale: float | None = None,
    title: str = "",
) -> Picture | None:
    """Return a picture of a deformed body on rank 0, and None on the others.

    Displacement and obstacle are drawn in one scale, so that a point in contact lies on the
    obstacle in any scale.

    Args:
        u: The displacement; the call is collective.
        contact: The contact along the direction of the obstacle.
        stress: What colours the body; None for the size of the displacement.
        label: What the colours mean.
        scale: How many times as large the displacement is drawn; chosen by default.
        title: The title of the picture.
    """
    space = contact.space
    moved = vectors_at_nodes(space, u)
    colours = np.linalg.norm(moved, axis=1)
    if stress is not None:
        colours = node_averages(space, values_in_cells(space, stress))[:, 0]
    body = gather_rows(space, np.column_stack((moved, colours)))
    boundary = _gather_boundary(space, contact, moved)
    sides = boundary_facets(space.mesh)
    outline = gather_rows(space, moved, sides) if space.mesh.topology.dim == 2 else None
    if body is None or boundary is None:
        return None
    displacement = body.values[:, :-1]
    size = float(np.ptp(body.points, axis=0).max())
    if scale is None:
        scale = scale_for(float(np.linalg.norm(displacement, axis=1).max()) / size)
    drawn = Triangles(
        body.points + scale * displacement, np.ascontiguousarray(body.values[:, -1]), body.triangles
    )
    told = "displacement to scale" if scale == 1.0 else f"displacement {scale:g} times as large"
    told += "" if outline is not None else "; grey: the obstacle"
    title = f"{title}\n{told}" if title else told
    if outline is None:
        return _draw_in_space(drawn, boundary, scale, label, title)
    return _draw_in_plane(drawn, outline, boundary, scale, label, title)


def scale_for(share: float) -> float:
    """Return how many times as large a displacement is drawn: 1, 2 or 5 times a power of ten.

    Args:
        share: The largest displacement, relative to the size of the body.
    """
    if share >= SEEN or share == 0.0 or not math.isfinite(share):
        return 1.0
    power = 10.0 ** math.floor(math.log10(DRAWN / share))
    return float(max((k * power for k in (2.0, 5.0) if k * power * share <= DRAWN), default=power))


def _gather_boundary(
    space: fem.FunctionSpace, contact: AlongDirection, moved: Array
) -> Triangles | None:
    """The contact boundary on rank 0, with what is known of each point in a row.

    That is the displacement, the direction to the obstacle, the distance of both at rest, and
    whether they touch.
    """
    touching = determined(space, Touching(contact).nodes)
    distance = values_at_control_points(space, contact.distance.x.array)
    directions = contact.directions.x.array.reshape(moved.shape)  # no coefficients, in any basis
    rows = np.column_stack((moved, directions, distance, touching))
    return gather_rows(space, rows, owned_facets(space.mesh, contact.contact))


def _surfaces(boundary: Triangles, scale: float) -> tuple[Array, Array, Array]:
    """The pieces of the obstacle, their vectors outwards, and the pieces of the body in contact."""
    points, pieces = boundary.points, boundary.triangles
    dim = points.shape[1]
    split = np.split(boundary.values, [dim, 2 * dim, 2 * dim + 1], axis=1)
    moved, directions, distance, touches = split
    touching = (touches[pieces, 0] > 0.0).all(axis=1)
    there = (points + scale * distance * directions)[pieces]
    return there, directions[pieces], (points + scale * moved)[pieces[touching]]


def _draw_in_plane(
    drawn: Triangles,
    outline: Triangles,
    boundary: Triangles,
    scale: float,
    label: str,
    title: str,
) -> Picture:
    obstacle, directions, touching = _surfaces(boundary, scale)
    rest, moved = outline.points[outline.triangles], outline.values[outline.triangles]
    parts = {"at rest": rest, "obstacle": obstacle, "in contact": touching}
    styles = {"at rest": AT_REST, "obstacle": OBSTACLE, "in contact": IN_CONTACT}
    figure, axes = draw_plane(drawn, label, parts, styles, "")
    axes.set_title(title, parse_math=False)
    shown = np.concatenate((rest.reshape(-1, 2), (rest + scale * moved).reshape(-1, 2)))
    low, high = shown.min(axis=0), shown.max(axis=0)
    margin = DRAWN * float((high - low).max())
    behind = obstacle + 2.0 * margin * directions
    shade = np.concatenate((obstacle, behind[:, ::-1]), axis=1)
    axes.add_collection(PolyCollection(list(shade), color=SHADE, zorder=0), autolim=False)
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    figure.set_figheight(fitting_height(*(high - low + 2.0 * margin)))
    figure.legend_below()
    return figure


def _draw_in_space(
    drawn: Triangles, boundary: Triangles, scale: float, label: str, title: str
) -> Picture:
    figure = draw_solid(drawn, boundary.points[boundary.triangles], title, label)
    axes = cast(Axes3D, figure.axes[0])
    obstacle, _, _ = _surfaces(boundary, scale)
    axes.add_collection3d(Poly3DCollection(list(obstacle), color=SHADE, alpha=0.3, linewidth=0.3))
    return figure
