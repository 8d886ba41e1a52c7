"""The pictures of a solved scene: the solution, the contact boundary, the way to an accuracy."""

from collections.abc import Sequence

from dolfinx_signorini.accuracy.pictures import draw_adaptive
from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.kinds import check, choice
from dolfinx_signorini.pictures.contact_boundary import (
    ContactBoundary,
    gather_contact_boundary,
    gather_contact_region,
)
from dolfinx_signorini.pictures.contact_pictures import draw_contact
from dolfinx_signorini.pictures.contact_region import draw_region
from dolfinx_signorini.pictures.deformed import draw_deformed
from dolfinx_signorini.pictures.picture import Picture
from dolfinx_signorini.pictures.problem_pictures import PICTURES, draw_solution
from dolfinx_signorini.problem.contact import ContactProblem
from dolfinx_signorini.scenes.files.toml_table import ALL
from dolfinx_signorini.scenes.solving import SceneResult


def scene_boundaries(result: SceneResult) -> list[ContactBoundary | None]:
    """Return where the obstacles of a scene are on rank 0, None on the others; collective.

    These are the cells with an obstacle, or the contact boundary with the names of its sides; of a
    scene with obstacles in the domain and on the boundary first the former, then the latter.
    """
    sides = _sides(result)
    return [
        gather_contact_region(zone)
        if zone.in_domain
        else gather_contact_boundary(zone.along_direction, sides)
        for zone in result.posed.problem.zones
    ]


def draw_scene(
    result: SceneResult,
    boundaries: Sequence[ContactBoundary | None],
    points: Sequence[Sequence[float]] = (),
) -> dict[str, Picture]:
    """Return the pictures of a solved scene by name; none on all ranks but 0.

    Args:
        result: The solved scene; the call is collective.
        boundaries: Where its obstacles are, see `scene_boundaries`.
        points: The detachment points of the scene, to be marked.
    """
    problem = result.posed.problem
    solid = problem.in_domain and result.posed.scene.domain.dimension == 3
    drawn = ("solution",) if solid else ("solution", "contact")
    figures = {what: _drawn(result, what, boundaries[0], points) for what in drawn}
    for beside in boundaries[1:]:
        figures["contact_boundary"] = None if beside is None else draw_contact(beside)
    figures["accuracy"] = None if result.found is None else draw_adaptive(result.found)
    return {name: figure for name, figure in figures.items() if figure is not None}


def draw_result(result: SceneResult, what: str) -> Picture | None:
    """Return one picture of a solved scene on rank 0, and None on the others.

    Args:
        result: The solved scene; the call is collective.
        what: "solution", or "contact" for gap and pressure.

    Raises:
        InputError: There is no such picture.
    """
    check(what=(what, choice(*PICTURES)))
    return _drawn(result, what, scene_boundaries(result)[0])


def _drawn(
    result: SceneResult,
    what: str,
    boundary: ContactBoundary | None,
    points: Sequence[Sequence[float]] = (),
) -> Picture | None:
    problem, scene, kinds = result.posed.problem, result.posed.scene, result.posed.parts
    parts = {kind.name: facets for kind, facets in kinds.items()}
    styles = {kind.name: kind.style for kind in kinds}
    if problem.in_domain and (what == "contact" or scene.domain.dimension == 2):
        return draw_region(problem.zones[0], what, parts, styles, scene.title)
    if what == "contact":
        return None if boundary is None else draw_contact(boundary)
    if scene.elasticity is None:
        return draw_solution(result.u, boundary, parts, styles, points, scene.title)
    assert isinstance(problem, ContactProblem)
    _, stress = scene.elasticity.stresses(problem.u)
    label = "von Mises stress"
    return draw_deformed(problem.u, problem.along_direction, stress, label, title=scene.title)


def _sides(result: SceneResult) -> dict[str, LocalIndices]:
    """The contact facets by the names of the sides that a scene names."""
    sides, contact = result.posed.sided.sides, result.posed.scene.contact
    names = () if contact is None else contact.sides
    if names == ALL:  # a name wins over a number for the same facets
        names = tuple(sorted(sides, key=lambda name: not name.isdecimal()))
    return {name: sides[name] for name in names}
