"""The proven bound of the energy error of a scene."""

from dataclasses import replace
from typing import Any

import ufl

from dolfinx_signorini.base.ranks import anywhere
from dolfinx_signorini.bounds.energy_bound import EnergyBound, energy_bound
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.data.smoothness import load_is_a_function
from dolfinx_signorini.meshes.sided_meshes import cell_corners
from dolfinx_signorini.scenes.files.condition import BoundaryCondition, Setting
from dolfinx_signorini.scenes.files.conditions import Dirichlet, Neumann
from dolfinx_signorini.scenes.posing import (
    PosedScene,
    coefficients,
    diffusion,
    facets_by_kind,
    load_and_flux,
)

MADE = "the bound is that of the problem with the obstacle that was made at the nodes"
KINKED = "whether the flux of the manufactured solution is continuous is known at points only"


def bound_of_scene(posed: PosedScene) -> EnergyBound:
    """Return the bound of the energy error of a scene whose problem has been solved.

    Args:
        posed: The scene on a mesh; the call is collective.

    Raises:
        InputError: The problem has not been solved, its data make no sense, or there is no such
            bound, see `Scene.refuse`.
    """
    scene, problem = posed.scene, posed.problem
    scene.refuse(["bound"], option=True)
    bound, notes = energy_bound(problem, energy_terms(posed)), []
    if scene.manufactured and scene.solution is not None:
        corners, entries = cell_corners(posed.sided.mesh), scene.diffusion_entries
        kinked = not load_is_a_function(scene.solution, entries, corners)
        notes += [KINKED] * anywhere(problem.comm, kinked)
    if scene.contact is not None and scene.contact.value is None:
        notes.append(MADE)
    return replace(bound, sampled=bound.sampled or bool(notes), notes=(*bound.notes, *notes))


def energy_terms(posed: PosedScene) -> EnergyTerms:
    """Return the strong form of a scene on a mesh; collective."""
    scene, sided = posed.scene, posed.sided
    setting = Setting(sided, posed.problem.space, posed.exact)
    conditions = [(condition, sided.facets(condition.sides)) for condition in scene.conditions]
    given = [(_flux(condition, setting), facets) for condition, facets in conditions]
    solution = scene.solution if scene.manufactured else None
    if solution is not None:
        current = ufl.as_vector([w.ufl(setting.x) for w in load_and_flux(scene)[1]])
        free = facets_by_kind(posed.parts)[Neumann.acts_like]
        given.append((ufl.dot(current, ufl.FacetNormal(sided.mesh)), free))
    factors = [(condition.coefficient(setting), facets) for condition, facets in conditions]
    return EnergyTerms(
        diffusion=diffusion(scene, lambda entry: entry.ufl(setting.x)),
        reaction=setting.data(scene.reaction),
        load=setting.data(coefficients(scene).load),
        neumann=[(flux, facets) for flux, facets in given if flux is not None],
        robin=[(k, facets) for k, facets in factors if k is not None],
        dirichlet=[
            (setting.data(c.value or solution), on)
            for c, on in conditions
            if isinstance(c, Dirichlet)
        ],
    )


def _flux(condition: BoundaryCondition, setting: Setting) -> Any:
    """What a condition tells of the flux: a formula as it is, where it has one."""
    known = isinstance(condition, Neumann) and condition.value is not None
    return setting.data(condition.value) if known else condition.load(setting)
