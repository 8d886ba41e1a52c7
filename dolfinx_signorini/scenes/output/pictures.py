"""The pictures of a solved scene: the solution, the contact boundary, the way to an accuracy."""

from dolfinx_signorini.accuracy.pictures import draw_adaptive
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.pictures.contact_boundary import ContactBoundary, gather_contact_boundary
from dolfinx_signorini.pictures.contact_pictures import draw_contact
from dolfinx_signorini.pictures.picture import Picture
from dolfinx_signorini.pictures.problem_pictures import PICTURES, draw_solution
from dolfinx_signorini.scenes.files.toml_table import ALL
from dolfinx_signorini.scenes.posing import boundary_parts
from dolfinx_signorini.scenes.solving import SceneResult


def scene_boundary(result: SceneResult) -> ContactBoundary | None:
    """Return the contact boundary of a solved scene on rank 0, with the sides that the scene names.

    Args:
        result: The solved scene; the call is collective.
    """
    sided, names = result.posed.sided, result.posed.scene.contact.sides
    if names == ALL:  # a name wins over a number for the same facets
        names = tuple(sorted(sided.sides, key=lambda name: not name.isdecimal()))
    return gather_contact_boundary(
        result.posed.problem, {name: sided.sides[name] for name in names}
    )


def draw_scene(
    result: SceneResult,
    boundary: ContactBoundary | None,
    points: tuple[tuple[float, ...], ...] = (),
) -> dict[str, Picture]:
    """Return the pictures of a solved scene by name; none on all ranks but 0.

    Args:
        result: The solved scene; the call is collective.
        boundary: The contact boundary of the scene, on rank 0.
        points: The detachment points of the scene, to be marked.
    """
    figures: dict[str, Picture | None] = {
        "solution": _drawn(result, boundary, points),
        "contact": None if boundary is None else draw_contact(boundary),
        "accuracy": None if result.found is None else draw_adaptive(result.found),
    }
    return {name: figure for name, figure in figures.items() if figure is not None}


def _drawn(
    result: SceneResult,
    boundary: ContactBoundary | None,
    points: tuple[tuple[float, ...], ...] = (),
) -> Picture | None:
    """Return a picture of the solution with the parts of the boundary; None on all ranks but 0.

    Args:
        result: The solved scene; the call is collective.
        boundary: The contact boundary of the scene, on rank 0.
        points: The detachment points of the scene, to be marked.
    """
    posed = result.posed
    kinds = boundary_parts(posed.scene, posed.sided)
    parts = {kind.name: facets for kind, facets in kinds.items()}
    styles = {kind.name: kind.style for kind in kinds}
    return draw_solution(result.u, boundary, parts, styles, points, posed.scene.title)


def draw_result(result: SceneResult, what: str) -> Picture | None:
    """Return one picture of a solved scene on rank 0, and None on the others.

    Args:
        result: The solved scene; the call is collective.
        what: "solution", or "contact" for gap and pressure.

    Raises:
        InputError: There is no such picture.
    """
    if what not in PICTURES:
        raise InputError(f"must be one of {', '.join(PICTURES)}, not {what!r}", "what")
    boundary = scene_boundary(result)
    if what == "solution":
        return _drawn(result, boundary)
    return None if boundary is None else draw_contact(boundary)
