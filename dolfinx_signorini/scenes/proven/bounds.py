"""The proven bound of the energy error of a scene."""

from dataclasses import replace

from dolfinx_signorini.bounds.energy_bound import EnergyBound, energy_bound
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.norms.manufactured import ManufacturedSolution
from dolfinx_signorini.scenes.files.conditions import Dirichlet, Neumann, Setting
from dolfinx_signorini.scenes.posing import PosedScene, boundary_parts, diffusion, facets_by_kind
from dolfinx_signorini.scenes.proven.known_data import KnownData

HIDDEN = 0.02  # of the flux part of a bound, or a guess of it
MADE = "the bound is that of the problem with the obstacle that was made at the nodes"


def bound_of_scene(posed: PosedScene) -> EnergyBound:
    """Return the bound of the energy error of a scene whose problem has been solved.

    Formulas are enclosed so well that what is hidden between the points of rules is at most a
    share of the flux part.

    Args:
        posed: The scene on a mesh; the call is collective.

    Raises:
        InputError: The problem has not been solved, or its data make no sense.
    """
    known, terms = KnownData(posed), energy_terms(posed)
    tolerance = HIDDEN * known.size
    bound = energy_bound(posed.problem, *known.enclosed(terms, tolerance))
    if known.hidden > 2.0 * HIDDEN * bound.flux > 0.0:
        bound = energy_bound(posed.problem, *known.enclosed(terms, HIDDEN * bound.flux))
    if posed.scene.contact.value is None:
        return replace(bound, sampled=True, notes=(*bound.notes, MADE))
    return bound


def energy_terms(posed: PosedScene) -> EnergyTerms:
    """Return the strong form of a scene, with its formulas as they are.

    Args:
        posed: The scene on a mesh; the call is collective.
    """
    scene, sided = posed.scene, posed.sided
    exact = posed.exact if isinstance(posed.exact, ManufacturedSolution) else None
    setting = Setting(sided, posed.problem.space, exact)
    manufactured = exact if scene.manufactured else None
    neumann, robin, dirichlet = [], [], []
    for condition in scene.conditions:
        facets = sided.facets(condition.sides)
        load, coefficient = condition.load(setting), condition.coefficient(setting)
        if load is not None:
            neumann.append((load, facets))
        if coefficient is not None:
            robin.append((coefficient, facets))
        if isinstance(condition, Dirichlet):
            value = None if condition.value is None else condition.value.ufl(setting.x)
            dirichlet.append((value if manufactured is None else manufactured.u, facets))
    if manufactured is not None:
        free = facets_by_kind(boundary_parts(scene, sided))[Neumann.acts_like]
        neumann.append((manufactured.flux, free))
    load = None if scene.load is None else scene.load.ufl(setting.x)
    return EnergyTerms(
        diffusion=diffusion(scene, lambda entry: entry.ufl(setting.x)),
        reaction=None if scene.reaction is None else scene.reaction.ufl(setting.x),
        load=load if manufactured is None else manufactured.load,
        neumann=neumann,
        robin=robin,
        dirichlet=dirichlet,
    )
