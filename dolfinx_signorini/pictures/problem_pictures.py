"""The pictures of a solved problem: the contact boundary, and the solution in plane or space."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from dolfinx import fem, mesh
from matplotlib.collections import LineCollection
from mpl_toolkits.mplot3d import Axes3D

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.kinds import check, choice
from dolfinx_signorini.meshes.sided_meshes import facet_nodes, owned_facets
from dolfinx_signorini.pictures.contact_boundary import (
    ContactBoundary,
    Solved,
    gather_contact_boundary,
)
from dolfinx_signorini.pictures.contact_pictures import draw_contact, draw_faces
from dolfinx_signorini.pictures.palette import COLOUR_MAP, CONTACT, IN_CONTACT
from dolfinx_signorini.pictures.picture import Picture, add_triangles
from dolfinx_signorini.pictures.triangles import Triangles, gather_triangles

PICTURES = {"contact": "contact pressure", "solution": "solution $u$"}
TITLE = 180  # characters of a title that are drawn


def draw_problem(
    problem: Solved,
    what: str,
    sides: Mapping[str, LocalIndices] | None,
) -> Picture | None:
    """Return a picture of a solved problem on rank 0, and None on the others.

    Args:
        problem: The problem; the call is collective.
        what: "contact" for gap and pressure, "solution" for u with the facets in contact.
        sides: Facets by the name of their side.

    Raises:
        InputError: There is no such picture, the problem is one on a line, or the sides have other
            facets than those of the mesh.
    """
    if problem.u.function_space.mesh.geometry.dim == 1:
        raise InputError("pictures are known in the plane and in space", "problem")
    check(what=(what, choice(*PICTURES)))
    boundary = gather_contact_boundary(problem, sides)
    if what == "contact":
        return None if boundary is None else draw_contact(boundary)
    name = "contact boundary"
    return draw_solution(problem.u, boundary, {name: problem.contact}, {name: CONTACT})


def draw_solution(
    u: fem.Function,
    boundary: ContactBoundary | None,
    parts: Mapping[str, LocalIndices],
    styles: Mapping[str, Mapping[str, Any]],
    points: Sequence[Sequence[float]] = (),
    title: str = "",
) -> Picture | None:
    """Return a picture of a solution with the facets in contact on rank 0, and None on the others.

    Args:
        u: The solution; the call is collective.
        boundary: The contact boundary, on rank 0.
        parts: Facets by the name of a part of the boundary; in the plane they are drawn.
        styles: How matplotlib draws these parts, by name.
        points: Detachment points to mark.
        title: The title of the picture.
    """
    domain, drawn = u.function_space.mesh, gather_triangles(u)
    if domain.topology.dim == 3:
        if drawn is None or boundary is None:
            return None
        return draw_solid(drawn, boundary.points[boundary.pieces], title)
    edges = gather_facets(domain, parts)
    if drawn is None or edges is None or boundary is None:
        return None
    edges["in contact"] = boundary.points[boundary.pieces[boundary.in_contact]]
    styles = {**styles, "in contact": IN_CONTACT}
    figure, axes = draw_plane(drawn, PICTURES["solution"], edges, styles, title)
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
    figure.legend_below()
    return figure


def gather_facets(domain: mesh.Mesh, parts: Mapping[str, LocalIndices]) -> dict[str, Array] | None:
    """Return the ends of the facets of each part, shape (facets, 2, 2), on rank 0, else None."""
    domain.topology.create_entities(domain.topology.dim - 1)
    ends = {
        name: domain.geometry.x[facet_nodes(domain, owned_facets(domain, part))][:, :, :2]
        for name, part in parts.items()
    }
    found = domain.comm.gather(ends, root=0)
    if found is None:
        return None
    return {name: np.concatenate([part[name] for part in found]) for name in parts}


def fitting_height(width: float, height: float) -> float:
    """Return the inches of a figure's height for a plane region of a width and a height.

    Title, labels and legend need about 1.4 inches.
    """
    return float(np.clip(1.4 + 6.0 * height / width, 3.0, 7.4))


def draw_plane(
    field: Triangles,
    label: str,
    parts: Mapping[str, Array],
    styles: Mapping[str, Mapping[str, Any]],
    title: str,
) -> tuple[Picture, Any]:
    """Return a picture of a function with parts of the boundary, and its axes.

    Args:
        field: The function.
        label: What the function is.
        parts: The ends of the facets of each part.
        styles, title: See `draw_solution`.
    """
    height = fitting_height(*np.ptp(field.points, axis=0))
    figure = Picture(figsize=(7.6, height), layout="compressed")  # axes of a fixed shape
    axes: Any = figure.add_subplot()
    drawn = add_triangles(axes, field.points, field.triangles, field.values, cmap=COLOUR_MAP)
    beside = axes.inset_axes([1.03, 0.0, 0.035, 1.0])  # as high as the domain
    figure.colorbar(drawn, cax=beside, label=label)
    for name, edges in parts.items():
        if len(edges):
            axes.add_collection(LineCollection(list(edges), label=name, zorder=3, **styles[name]))
    axes.set(xlabel="$x$", ylabel="$y$", aspect="equal")
    shown = textwrap.fill(textwrap.shorten(title, TITLE, placeholder=" ..."), TITLE // 3)
    axes.set_title(shown, parse_math=False)
    axes.margins(0.04)
    return figure, axes


def draw_solid(
    surface: Triangles, seen: Array, title: str = "", label: str = PICTURES["solution"]
) -> Picture:
    """Return a picture of a function on a solid's boundary, from where some triangles are seen."""
    figure = Picture(figsize=(7.6, 5.4))
    axes = cast(Axes3D, figure.add_subplot(projection="3d"))
    values = surface.values[surface.triangles].mean(axis=1)
    faces = draw_faces(axes, surface.points[surface.triangles], values)
    faces.set(edgecolor=(0.0, 0.0, 0.0, 0.15), linewidth=0.3)
    view = view_of(surface, seen)
    azimuth = np.degrees(np.arctan2(view[1], view[0])) + 10.0
    axes.view_init(elev=30.0 * view[2], azim=azimuth)
    figure.colorbar(faces, ax=axes, label=label, shrink=0.7, pad=0.1)
    axes.set_title(title, parse_math=False)
    return figure


def view_of(surface: Triangles, seen: Array) -> Array:
    """Return the direction from a solid to the eye, -1 or 1 along each axis.

    Args:
        surface: The boundary of the solid.
        seen: Corners of the triangles to look at, shape (triangles, 3, 3).
    """
    view = np.ones(3)
    if len(seen):
        low, high = surface.points.min(axis=0), surface.points.max(axis=0)
        view[seen.mean(axis=(0, 1)) < low + 0.4 * (high - low)] = -1.0
    return view
