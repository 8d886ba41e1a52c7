"""The discrete problem of a scene, with the forms and data that the scene mentions."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Any

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
from dolfinx_signorini.data.interfaces.piecewise_forms import BY_DATA
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

Forms = dict[str, ufl.Form]
FacetTerms = list[tuple[str, Expr, LocalIndices]]


@dataclass(frozen=True)
class PosedScene:
    """A scene on one mesh: the problem with the exact solution, and their parts.

    The forms are those of u, for lower and for upper obstacles, as they are integrated:

        posed = pose(scene, comm)
        u = posed.problem.solve()
        work = {name: ufl.action(form, u) for name, form in posed.sources.items()}

    Attributes:
        problem: The discrete problem.
        exact: The exact solution, or None where it is not known.
        scene: The scene.
        sided: The mesh with its sides.
        parts: See `boundary_parts`.
        sources: The load and the fluxes by name, the linear forms whose sum is L.
        reactions: The parts of a that have the coefficients c of u v, by name, with the integrals
            of derivatives over the same cells: of constants these are 0.
    """

    problem: BoundConstrainedProblem
    exact: ManufacturedSolution | None
    scene: Scene
    sided: SidedMesh
    parts: dict[type[BoundaryCondition], LocalIndices]
    sources: Forms
    reactions: Forms

    @property
    def a(self) -> ufl.Form:
        """The bilinear form."""
        return self.problem.assembled_forms[0]

    @property
    def L(self) -> ufl.Form:
        """The linear form."""
        return self.problem.assembled_forms[1]


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
    both = zip(_on_cells(scene, setting), _on_facets(scene, setting, parts), strict=True)
    sources, reactions = (on_cells | on_facets for on_cells, on_facets in both)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    if scene.elasticity is None:
        K = diffusion(scene, setting.x)
        current = ufl.grad(u) if K is None else K * ufl.grad(u)
        stiffness = ufl.inner(current, ufl.grad(v)) * setting.dx
    else:
        stiffness = scene.elasticity.form(setting, u, v)
    a = sum(reactions.values(), stiffness)
    L = reduce(add, sources.values()) if sources else _zero_form(v)
    conditions = [condition.dirichlet(setting) for condition in scene.conditions]
    given = setting, a, L, [bc for bc in conditions if bc is not None]
    if scene.obstacle is not None:
        boundary = {} if scene.contact is None else scene.contact.arguments(setting)
        problem = scene.obstacle.problem(*given, boundary)
    else:
        assert scene.contact is not None
        problem = scene.contact.problem(*given)
    a, L = problem.assembled_forms
    loads = {name: _part(L, form) for name, form in sources.items()}
    terms = {name: _part(a, form) for name, form in reactions.items()}
    return PosedScene(problem, setting.exact, scene, sided, parts, loads, terms)


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
    return manufacture(sided.mesh, scene.solution.ufl(x), diffusion(scene, x), reaction)


def diffusion(scene: Scene, x: Expr) -> Expr | None:
    """Return the diffusion of a scene, an expression of the coordinates x; None for 1."""
    rows = [[entry.ufl(x) for entry in row] for row in scene.diffusion]
    if len(rows) <= 1:
        return rows[0][0] if rows else None
    return ufl.as_matrix(rows)


def _on_cells(scene: Scene, setting: Setting) -> tuple[Forms, Forms]:
    """Return the load and the reaction of the equation as sources and reactions."""
    u, v = ufl.TrialFunction(setting.space), ufl.TestFunction(setting.space)
    if scene.elasticity is not None:
        force = scene.elasticity.load(setting)
        return {} if force is None else {"body force": ufl.dot(force, v) * setting.dx}, {}
    sources, reactions = Forms(), Forms()
    load = coefficients(scene).load
    if load is not None and load.constant != 0.0:
        sources["load"] = load.ufl(setting.x) * v * setting.dx
    if scene.reaction is not None and scene.reaction.constant != 0.0:
        reactions["reaction"] = scene.reaction.ufl(setting.x) * u * v * setting.dx
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


def _on_facets(
    scene: Scene, setting: Setting, parts: dict[type[BoundaryCondition], LocalIndices]
) -> tuple[Forms, Forms]:
    """Return what the conditions of a scene add to its sources and reactions."""
    sided = setting.sided
    loads: FacetTerms = []
    coefficients: FacetTerms = []
    if scene.manufactured and setting.exact is not None:
        free = facets_by_kind(parts)[Neumann.acts_like]
        if sided.mesh.comm.allreduce(len(free)):
            current = ufl.as_vector([w.ufl(setting.x) for w in load_and_flux(scene)[1]])
            flux = ufl.dot(current, ufl.FacetNormal(sided.mesh))
            loads.append((Neumann.force_name, flux, free))
    for condition in scene.conditions:
        facets = sided.facets(condition.sides)
        load, c = condition.load(setting), condition.coefficient(setting)
        if load is not None:
            loads.append((condition.force_name, load, facets))
        if c is not None:
            coefficients.append((condition.force_name, c, facets))
    ds = _facet_measure(sided, [facets for _, _, facets in (*loads, *coefficients)])
    u, v = ufl.TrialFunction(setting.space), ufl.TestFunction(setting.space)
    fluxes = [(name, ufl.dot(load, v)) for name, load, _ in loads]
    springs = [(name, c * u * v) for name, c, _ in coefficients]
    return _numbered(fluxes, ds, 0), _numbered(springs, ds, len(loads))


def _numbered(terms: Sequence[tuple[str, Expr]], ds: ufl.Measure, first: int) -> Forms:
    """Return integrals over the parts of a measure from the first on; equal names are numbered."""
    names, result = [name for name, _ in terms], Forms()
    for k, (name, integrand) in enumerate(terms):
        if names.count(name) > 1:
            name = f"{name} {names[: k + 1].count(name)}"
        if not isinstance(integrand, Zero):
            result[name] = integrand * ds(first + k)
    return result


def _facet_measure(sided: SidedMesh, parts: Sequence[LocalIndices]) -> ufl.Measure:
    """Return a measure on parts of the boundary that are numbered from 0."""
    domain = sided.mesh
    owned = (owned_facets(domain, facets) for facets in parts)
    pairs = [(k, facet_cells(domain, facets).flatten()) for k, facets in enumerate(owned)]
    return ufl.Measure("ds", domain, subdomain_data=pairs, metadata=BY_DATA)


def _part(whole: ufl.Form, part: ufl.Form) -> ufl.Form:
    """Return the integrals of a form over all cells, or over the facets that a part is over."""

    def place(integral: ufl.Integral) -> tuple[str, Any]:
        kind = integral.integral_type()  # the rules of cells may have numbers
        return kind, None if kind == "cell" else integral.subdomain_id()

    places = set(map(place, part.integrals()))
    return ufl.Form([integral for integral in whole.integrals() if place(integral) in places])


def _zero_form(v: Expr) -> ufl.Form:
    """Return a load that integrates over no cell at all."""
    domain = v.ufl_function_space().mesh
    zero = fem.Constant(domain, np.zeros(v.ufl_shape))
    return restricted(ufl.inner(zero, v) * ufl.dx(domain), domain, np.empty(0, dtype=np.int32))
