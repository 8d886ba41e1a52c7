"""The pictures of a solved problem: the contact boundary, and the solution."""

from collections.abc import Mapping, Sequence
from typing import Any

from dolfinx import fem

from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.pictures.contact_boundary import (
    ContactBoundary,
    Solved,
    gather_contact_boundary,
)
from dolfinx_signorini.pictures.contact_pictures import draw_contact
from dolfinx_signorini.pictures.palette import CONTACT, IN_CONTACT
from dolfinx_signorini.pictures.picture import Picture
from dolfinx_signorini.pictures.plane_field import draw_plane_field, gather_facets
from dolfinx_signorini.pictures.solid_pictures import draw_solid
from dolfinx_signorini.pictures.triangles import gather_triangles

PICTURES = ("contact", "solution")


def draw_problem(
    problem: Solved,
    what: str,
    sides: Mapping[str, LocalIndices] | None,
    parts: Mapping[str, LocalIndices] | None = None,
    styles: Mapping[str, Mapping[str, Any]] | None = None,
    title: str = "",
) -> Picture | None:
    """Return a picture of a solved problem on rank 0, and None on the others.

    Args:
        problem: The problem; the call is collective.
        what: "contact" for gap and pressure, "solution" for u with the facets in contact.
        sides: Facets by the name of their side.
        parts, styles, title: See `draw_solution`; the contact boundary by default.

    Raises:
        InputError: There is no such picture, or the problem is one on a line.
    """
    if problem.u.function_space.mesh.geometry.dim == 1:
        raise InputError("pictures are known in the plane and in space", "problem")
    if what not in PICTURES:
        raise InputError(f"must be one of {', '.join(PICTURES)}, not {what!r}", "what")
    boundary = gather_contact_boundary(problem, sides)
    if what == "contact":
        return None if boundary is None else draw_contact(boundary)
    if parts is None or styles is None:
        parts, styles = {"contact boundary": problem.contact}, {"contact boundary": CONTACT}
    return draw_solution(problem.u, boundary, parts, styles, title=title)


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
        return None if drawn is None else draw_solid(drawn, boundary, title)
    edges = gather_facets(domain, parts)
    if drawn is None or edges is None or boundary is None:
        return None
    edges["in contact"] = boundary.points[boundary.pieces[boundary.in_contact]]
    return draw_plane_field(drawn, edges, {**styles, "in contact": IN_CONTACT}, points, title)
