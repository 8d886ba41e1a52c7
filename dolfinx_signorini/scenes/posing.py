"""The discrete problem of a scene, with the forms and data that the scene mentions."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.constantvalue import Zero
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.errors import InputError, require
from dolfinx_signorini.data.coefficients import Coefficients
from dolfinx_signorini.data.derivatives import load_and_current
from dolfinx_signorini.data.formulas import Formula
from dolfinx_signorini.data.interfaces.jumps import integrable
from dolfinx_signorini.data.interfaces.rules import CellMeasure, facet_rule, measure_for
from dolfinx_signorini.data.interfaces.singular_sets import jumps
from dolfinx_signorini.meshes.elements import bernstein_space
from dolfinx_signorini.meshes.sided_meshes import (
    SidedMesh,
    boundary_facets,
    facet_cells,
    owned_facets,
)
from dolfinx_signorini.norms.manufactured import (
    ManufacturedSolution,
    contact_violations,
    manufacture,
)
from dolfinx_signorini.problem.assembly import restricted
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.scenes.files.condition import BoundaryCondition, Setting
from dolfinx_signorini.scenes.files.conditions import CONDITIONS, Contact, Neumann
from dolfinx_signorini.scenes.files.scene import Scene

Terms = dict[str, tuple[Expr, CellMeasure]]
FacetTerms = list[tuple[str, Expr, LocalIndices]]


@dataclass(frozen=True)
class PosedScene:
    """A scene on one mesh: the problem with the exact solution, and their parts.

    The forms are those of u, for lower and for upper obstacles:

        posed = pose(scene, comm)
        u = posed.problem.solve()
        v = ufl.TestFunction(posed.problem.space)
        load = sum(integrand * v * measure for integrand, measure in posed.sources.values())

    Attributes:
        problem: The discrete problem.
        exact: The exact solution, or None where it is not known.
        scene: The scene.
        sided: The mesh with its sides.
        parts: See `boundary_parts`.
        a, L: The forms of the problem.
        sources: The load and the fluxes by name: an integrand, and the measure of the part of the
            domain or of its boundary that the integral is over.
        reactions: The same for c, where a has an integral of c u v.
    """

    problem: BoundConstrainedProblem
    exact: ManufacturedSolution | None
    scene: Scene
    sided: SidedMesh
    parts: dict[type[BoundaryCondition], LocalIndices]
    a: ufl.Form
    L: ufl.Form
    sources: Terms
    reactions: Terms


def pose(scene: Scene, comm: MPI.Comm, sided: SidedMesh | None = None) -> PosedScene:
    """Make the mesh of a scene and assemble its problem.

    Args:
        scene: The scene.
        comm: The communicator that shares the mesh.
        sided: A mesh of the scene's domain to take in place of the scene's own.

    Raises:
        InputError: The problem has no or more than one solution, or some data make no sense.
    """
    sided = scene.domain.make(comm) if sided is None else sided
    parts = boundary_parts(scene, sided)
    if scene.manufactured:
        failing = violations(scene, sided)
        if failing:
            raise InputError("; ".join(failing), "solution")
    shape = () if scene.components == 1 else (scene.components,)
    space = bernstein_space(sided.mesh, scene.degree, shape)
    setting = Setting(sided, space, _exact_solution(scene, sided))
    both = zip(_cell_terms(scene, setting), _facet_terms(scene, setting, parts), strict=True)
    sources, reactions = (on_cells | on_facets for on_cells, on_facets in both)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    if scene.elasticity is None:
        a = _diffusion_form(scene, setting, u, v)
    else:
        a = scene.elasticity.form(setting, u, v)
    for c, measure in reactions.values():
        a += c * u * v * measure
    loads = [ufl.dot(integrand, v) * measure for integrand, measure in sources.values()]
    L = sum(loads[1:], loads[0]) if loads else _zero_form(v)
    conditions = [condition.dirichlet(setting) for condition in scene.conditions]
    given = setting, a, L, [bc for bc in conditions if bc is not None]
    if scene.obstacle is not None:
        boundary = {} if scene.contact is None else scene.contact.arguments(setting)
        problem = scene.obstacle.problem(*given, boundary)
    else:
        assert scene.contact is not None
        problem = scene.contact.problem(*given)
    return PosedScene(problem, setting.exact, scene, sided, parts, a, L, sources, reactions)


def violations(scene: Scene, sided: SidedMesh) -> list[str]:
    """Return the contact conditions that the exact solution of a scene violates; collective."""
    exact, contact, found = _exact_solution(scene, sided), scene.contact, []
    if scene.solution is not None and scene.obstacle is not None:
        found += scene.obstacle.violations(scene.solution, sided)
    if exact is not None and contact is not None:
        x = ufl.SpatialCoordinate(sided.mesh)
        obstacle = None if contact.value is None else contact.value.ufl(x)
        facets, upper = sided.facets(contact.sides), contact.bound == "upper"
        found += contact_violations(sided.mesh, facets, exact.u, exact.flux, obstacle, upper)
    return [str(violation) for violation in found]


def boundary_parts(scene: Scene, sided: SidedMesh) -> dict[type[BoundaryCondition], LocalIndices]:
    """Return the owned boundary facets of each kind of condition; all others are Neumann facets.

    Args:
        scene: The scene.
        sided: A mesh of the domain of the scene; the call is collective.

    Raises:
        InputError: A facet belongs to conditions of two kinds, or no facet to the contact boundary.
    """
    boundary, comm = boundary_facets(sided.mesh), sided.mesh.comm
    parts, rest = {}, boundary
    for kind in CONDITIONS:
        sides = [c.sides for c in scene.conditions if isinstance(c, kind)]
        facets = [sided.facets(names) for names in sides] or [np.empty(0, dtype=np.int32)]
        parts[kind] = np.intersect1d(np.concatenate(facets), boundary).astype(np.int32)
        once = bool(np.isin(parts[kind], rest).all())
        require(comm, once, "some facet belongs to more than one part", kind.key)
        rest = np.setdiff1d(rest, parts[kind]).astype(np.int32)
    if scene.contact is not None:
        found = comm.allreduce(len(parts[Contact])) > 0
        require(comm, found, f"there is no facet {scene.contact.on_sides()}", "contact")
    return parts | {Neumann: np.union1d(parts[Neumann], rest)}


def facets_by_kind(parts: dict[type[BoundaryCondition], LocalIndices]) -> dict[str, LocalIndices]:
    """Return the facets of `boundary_parts` by what the kinds of condition act like."""
    names = dict.fromkeys(kind.acts_like for kind in parts)
    return {n: np.concatenate([f for c, f in parts.items() if c.acts_like == n]) for n in names}


def _exact_solution(scene: Scene, sided: SidedMesh) -> ManufacturedSolution | None:
    if scene.solution is None:
        return None
    x = ufl.SpatialCoordinate(sided.mesh)
    reaction = None if scene.reaction is None else scene.reaction.ufl(x)
    K = diffusion(scene, lambda entry: entry.ufl(x))
    return manufacture(sided.mesh, scene.solution.ufl(x), K, reaction)


def diffusion(scene: Scene, value: Callable[[Formula], Expr]) -> Expr | None:
    """Return the diffusion of a scene, made of expressions of its entries; None for 1."""
    rows = [[value(entry) for entry in row] for row in scene.diffusion]
    if len(rows) <= 1:
        return rows[0][0] if rows else None
    return ufl.as_matrix(rows)


def _diffusion_form(scene: Scene, setting: Setting, u: Expr, v: Expr) -> ufl.Form:
    degree = 2 * (scene.degree - 1)
    k = diffusion(scene, lambda entry: integrable(entry, setting.sided.mesh, degree))
    entries = scene.diffusion_entries
    dx = measure_for(setting.sided.mesh, entries, degree, scene.degree)
    current = ufl.grad(u) if k is None else k * ufl.grad(u)
    return ufl.inner(current, ufl.grad(v)) * dx


def _cell_terms(scene: Scene, setting: Setting) -> tuple[Terms, Terms]:
    """Return the load and the reaction of the equation as sources and reactions."""
    domain, degree = setting.sided.mesh, scene.degree
    if scene.elasticity is not None:
        force = scene.elasticity.load(setting)
        return {} if force is None else {"body force": force}, {}
    sources: Terms = {}
    reactions: Terms = {}
    formula = coefficients(scene).load
    if formula is not None and formula.constant != 0.0:
        load = integrable(formula, domain, degree, poles_too=not scene.manufactured)
        sources["load"] = load, measure_for(domain, [formula], degree, degree)
    if scene.reaction is not None and scene.reaction.constant != 0.0:
        c = integrable(scene.reaction, domain, 2 * degree)  # of u v
        reactions["reaction"] = c, measure_for(domain, [scene.reaction], 2 * degree, degree)
    return sources, reactions


def coefficients(scene: Scene) -> Coefficients:
    """Return the coefficients of a scene, and the load, given or made for the solution."""
    load = load_and_flux(scene)[0] if scene.manufactured else scene.load
    return Coefficients(load, scene.reaction, scene.diffusion)


def load_and_flux(scene: Scene) -> tuple[Formula, list[Formula]]:
    """Return the load of a manufactured solution u, and the components of A grad u."""
    assert scene.solution is not None
    dim = scene.domain.dimension
    return load_and_current(scene.solution, scene.diffusion, scene.reaction, dim)


def _exact_flux(scene: Scene, setting: Setting, facets: LocalIndices) -> Expr:
    """The flux A grad u . n of a manufactured solution u on boundary facets."""
    assert setting.exact is not None
    flux, normal = setting.exact.flux, ufl.FacetNormal(setting.sided.mesh)
    current = load_and_flux(scene)[1]
    if not any(map(jumps, current)):
        return flux
    parts = [setting.on_facets(w, facets) for w in current]
    return sum((w * normal[k] for k, w in enumerate(parts[1:], 1)), parts[0] * normal[0])


def _facet_terms(
    scene: Scene, setting: Setting, parts: dict[type[BoundaryCondition], LocalIndices]
) -> tuple[Terms, Terms]:
    """Return what the conditions of a scene add to its sources and reactions."""
    sided = setting.sided
    loads: FacetTerms = []
    coefficients: FacetTerms = []
    if scene.manufactured and setting.exact is not None:
        free = facets_by_kind(parts)[Neumann.acts_like]
        if sided.mesh.comm.allreduce(len(free)):
            loads.append((Neumann.force_name, _exact_flux(scene, setting, free), free))
    for condition in scene.conditions:
        facets = sided.facets(condition.sides)
        load, c = condition.load(setting), condition.coefficient(setting)
        if load is not None:
            loads.append((condition.force_name, load, facets))
        if c is not None:
            coefficients.append((condition.force_name, c, facets))
    ds = _facet_measure(sided, [facets for _, _, facets in (*loads, *coefficients)])
    return _numbered(loads, ds, 0), _numbered(coefficients, ds, len(loads))


def _numbered(terms: FacetTerms, ds: ufl.Measure, first: int) -> Terms:
    """Return terms on the parts of a measure, from the first part on; equal names are numbered."""
    names = [name for name, _, _ in terms]
    result: Terms = {}
    for k, (name, integrand, _) in enumerate(terms):
        if names.count(name) > 1:
            name = f"{name} {names[: k + 1].count(name)}"
        if not isinstance(integrand, Zero):
            result[name] = (integrand, ds(first + k))
    return result


def _facet_measure(sided: SidedMesh, parts: Sequence[LocalIndices]) -> ufl.Measure:
    """Return a measure on parts of the boundary that are numbered from 0."""
    domain = sided.mesh
    owned = (owned_facets(domain, facets) for facets in parts)
    pairs = [(k, facet_cells(domain, facets).flatten()) for k, facets in enumerate(owned)]
    metadata = facet_rule(domain).metadata
    return ufl.Measure("ds", domain, subdomain_data=pairs, metadata=metadata)


def _zero_form(v: Expr) -> ufl.Form:
    """Return a load that integrates over no cell at all."""
    domain = v.ufl_function_space().mesh
    zero = fem.Constant(domain, np.zeros(v.ufl_shape))
    return restricted(ufl.inner(zero, v) * ufl.dx(domain), domain, np.empty(0, dtype=np.int32))
