"""The proven bound of the energy error of a scene."""

from dataclasses import replace

from dolfinx_signorini.bounds.energy_bound import EnergyBound, energy_bound
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.scenes.files.condition import Setting
from dolfinx_signorini.scenes.files.conditions import Dirichlet, Neumann
from dolfinx_signorini.scenes.posing import PosedScene, diffusion, facets_by_kind
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
        InputError: The problem has not been solved, its data make no sense, or there is no such
            bound, see `Scene.refuse`.
    """
    posed.scene.refuse(["bound"], option=True)
    contact, problem = posed.scene.contact, posed.problem
    known, terms = KnownData(posed), energy_terms(posed)
    tolerance = HIDDEN * known.size
    bound = energy_bound(problem, *known.enclosed(terms, tolerance))
    if known.hidden > 2.0 * HIDDEN * bound.flux > 0.0:
        bound = energy_bound(problem, *known.enclosed(terms, HIDDEN * bound.flux))
    if contact is not None and contact.value is None:
        return replace(bound, sampled=True, notes=(*bound.notes, MADE))
    return bound


def energy_terms(posed: PosedScene) -> EnergyTerms:
    """Return the strong form of a scene on a mesh, with its formulas as they are; collective."""
    scene, sided, exact = posed.scene, posed.sided, posed.exact
    setting = Setting(sided, posed.problem.space, exact)
    conditions = [(condition, sided.facets(condition.sides)) for condition in scene.conditions]
    given = [(condition.load(setting), facets) for condition, facets in conditions]
    coefficients = [(condition.coefficient(setting), facets) for condition, facets in conditions]
    terms = EnergyTerms(
        diffusion=diffusion(scene, lambda entry: entry.ufl(setting.x)),
        reaction=setting.data(scene.reaction),
        load=setting.data(scene.load),
        neumann=[(load, facets) for load, facets in given if load is not None],
        robin=[(k, facets) for k, facets in coefficients if k is not None],
        dirichlet=[(setting.data(c.value), on) for c, on in conditions if isinstance(c, Dirichlet)],
    )
    if not scene.manufactured or exact is None:
        return terms
    free = facets_by_kind(posed.parts)[Neumann.acts_like]
    return replace(
        terms,
        load=exact.load,
        neumann=[*terms.neumann, (exact.flux, free)],
        dirichlet=[(exact.u, facets) for _, facets in terms.dirichlet],
    )
