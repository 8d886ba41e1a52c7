"""From a scene to its discrete problem: the forms, boundary parts and data that it mentions."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import default_scalar_type, fem
from mpi4py import MPI
from ufl.constantvalue import Zero
from ufl.core.expr import Expr

from dolfinx_signorini import compat
from dolfinx_signorini.accuracy.family import Posed
from dolfinx_signorini.errors import InputError, require
from dolfinx_signorini.manufactured import (
    ManufacturedSolution,
    contact_violations,
    manufacture,
    matching_obstacle,
)
from dolfinx_signorini.meshes import SidedMesh, boundary_facets, facet_cells
from dolfinx_signorini.problem import SignoriniProblem
from dolfinx_signorini.quadrature import CELL_RULE, FACET_RULE, QuadratureRule
from dolfinx_signorini.scenes.expressions import Expression, any_variable
from dolfinx_signorini.scenes.scene import Scene

Indices = npt.NDArray[np.int32]


@dataclass(frozen=True)
class PosedScene(Posed):
    """A scene on one mesh: problem, exact solution and sign, see `Posed`, and what they are from.

    Attributes:
        scene: The scene.
        sided: The mesh with its sides.
        obstacle: The obstacle of the discrete problem.
        sources: Load and fluxes by name: what is integrated, and over which part of the domain or
            of its boundary.
    """

    scene: Scene
    sided: SidedMesh
    obstacle: "float | Expr | fem.Function"
    sources: dict[str, tuple[Expr, ufl.Measure]]

    def solution(self, solved: fem.Function) -> fem.Function:
        """Return u from what the problem was solved for."""
        u = fem.Function(solved.function_space, name="u")
        u.x.array[:] = self.sign * solved.x.array
        return u


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
    x = ufl.SpatialCoordinate(sided.mesh)
    kinds = facets_by_kind(scene, sided)
    require(
        comm,
        comm.allreduce(len(kinds["contact"])) > 0,
        f"contact: there is no facet on {', '.join(scene.contact.sides)}",
    )
    known = _known_solution(scene, sided, x)
    space = fem.functionspace(sided.mesh, ("Lagrange", scene.degree))
    sources = _sources(scene, sided, kinds["Neumann"], x, known)
    v = ufl.TestFunction(space)
    terms = [scene.sign * integrand * v * measure for integrand, measure in sources.values()]
    contact = sided.facets(scene.contact.sides)
    obstacle = _obstacle(scene, space, contact, x, known)
    problem = SignoriniProblem(
        _bilinear_form(scene, space, x),
        sum(terms[1:], terms[0]) if terms else _zero_form(space),
        contact=contact,
        obstacle=obstacle,
        bcs=_dirichlet_conditions(scene, sided, space, x, known),
    )
    return PosedScene(
        scene=scene,
        sided=sided,
        problem=problem,
        exact=known,
        sign=scene.sign,
        obstacle=obstacle,
        sources=sources,
    )


def violations(scene: Scene, sided: SidedMesh) -> list[str]:
    """Return the contact conditions that the exact solution of a scene does not satisfy."""
    if scene.solution is None:
        return []
    x = ufl.SpatialCoordinate(sided.mesh)
    known = _manufacture(scene, sided, x)
    obstacle = scene.contact.obstacle
    found = contact_violations(
        sided.mesh,
        sided.facets(scene.contact.sides),
        known.u,
        known.flux,
        None if obstacle is None else obstacle.ufl(x),
        scene.contact.upper,
    )
    return [str(violation) for violation in found]


def facets_by_kind(scene: Scene, sided: SidedMesh) -> dict[str, Indices]:
    """Return the owned boundary facets of each kind of condition; the call is collective.

    Raises:
        InputError: A facet belongs to the contact boundary and has Dirichlet data or a flux, too.
    """
    boundary = boundary_facets(sided.mesh)
    names = {
        "contact": scene.contact.sides,
        "Dirichlet": sum((part.sides for part in scene.dirichlet), ()),
        "flux": sum((part.sides for part in scene.neumann), ()),
    }
    facets = {
        kind: np.intersect1d(sided.facets(sides), boundary).astype(np.int32)
        for kind, sides in names.items()
    }
    taken = np.concatenate(list(facets.values()))
    once = len(np.unique(taken)) == len(taken)
    require(sided.mesh.comm, once, "sides: some facet belongs to more than one part")
    taken = np.concatenate((facets["contact"], facets["Dirichlet"]))
    return {
        "contact": facets["contact"],
        "Dirichlet": facets["Dirichlet"],
        "Neumann": np.setdiff1d(boundary, taken).astype(np.int32),
    }


def interpolate_near(space: fem.FunctionSpace, formula: Expr, dofs: Indices) -> fem.Function:
    """Return a function with a formula's values at some dofs; others may be left at 0."""
    function = fem.Function(space)
    cells = np.flatnonzero(np.isin(space.dofmap.list, dofs).any(axis=1)).astype(np.int32)
    points = compat.interpolation_points(space.element)
    function.interpolate(fem.Expression(formula, points, comm=space.mesh.comm), cells0=cells)
    return function


def _known_solution(scene: Scene, sided: SidedMesh, x: Expr) -> ManufacturedSolution | None:
    if scene.solution is None:
        return None
    if scene.manufactured:
        failing = violations(scene, sided)
        if failing:
            raise InputError("solution: " + "; ".join(failing))
    return _manufacture(scene, sided, x)


def _manufacture(scene: Scene, sided: SidedMesh, x: Expr) -> ManufacturedSolution:
    assert scene.solution is not None
    reaction = None if scene.reaction is None else scene.reaction.ufl(x)
    return manufacture(sided.mesh, scene.solution.ufl(x), _diffusion(scene, x), reaction)


def _diffusion(scene: Scene, x: Expr) -> Expr | None:
    k = scene.diffusion
    if k is None or isinstance(k, Expression):
        return None if k is None else k.ufl(x)
    return ufl.as_matrix([[entry.ufl(x) for entry in row] for row in k])


def _bilinear_form(scene: Scene, space: fem.FunctionSpace, x: Expr) -> ufl.Form:
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    k = _diffusion(scene, x)
    entries: Sequence[Expression] = ()
    if scene.diffusion is not None:
        tensor = scene.diffusion
        entries = [tensor] if isinstance(tensor, Expression) else [e for row in tensor for e in row]
    degree = 2 * (scene.degree - 1)
    dx = _cells(CELL_RULE if any_variable(entries) else QuadratureRule("default", degree))
    current = ufl.grad(u) if k is None else k * ufl.grad(u)
    a = ufl.inner(current, ufl.grad(v)) * dx
    if scene.reaction is not None:
        variable = any_variable([scene.reaction])
        rule = CELL_RULE if variable else QuadratureRule("default", degree + 2)
        a += scene.reaction.ufl(x) * u * v * _cells(rule)
    return a


def _sources(
    scene: Scene, sided: SidedMesh, neumann: Indices, x: Expr, known: ManufacturedSolution | None
) -> dict[str, tuple[Expr, ufl.Measure]]:
    """Load and fluxes as (integrand, measure), by name."""
    sources: dict[str, tuple[Expr, ufl.Measure]] = {}
    dx = ufl.dx(sided.mesh, metadata=CELL_RULE.metadata)
    if scene.manufactured and known is not None:
        sources["load"] = (known.load, dx)
        facets = [neumann] if sided.mesh.comm.allreduce(len(neumann)) else []
        fluxes = [known.flux for _ in facets]
    else:
        if scene.load is not None:
            sources["load"] = (scene.load.ufl(x), dx)
        facets = [sided.facets(part.sides) for part in scene.neumann]
        fluxes = [part.value.ufl(x) for part in scene.neumann if part.value is not None]
    if fluxes:
        ds = _facet_measure(sided, facets)
        for k, flux in enumerate(fluxes):
            sources["flux" if len(fluxes) == 1 else f"flux {k + 1}"] = (flux, ds(k))
    return {name: source for name, source in sources.items() if not isinstance(source[0], Zero)}


def _obstacle(
    scene: Scene,
    space: fem.FunctionSpace,
    contact: Indices,
    x: Expr,
    known: ManufacturedSolution | None,
) -> float | Expr | fem.Function:
    given = scene.contact.obstacle
    if given is not None:
        return scene.sign * (given.ufl(x) if given.constant is None else given.constant)
    if known is None:
        raise InputError("contact: an obstacle is made for manufactured solutions only")
    g = matching_obstacle(space, contact, known.u, known.flux, scene.contact.upper)
    g.x.array[:] *= scene.sign
    return g


def _dirichlet_conditions(
    scene: Scene,
    sided: SidedMesh,
    space: fem.FunctionSpace,
    x: Expr,
    known: ManufacturedSolution | None,
) -> list[fem.DirichletBC]:
    tdim = sided.mesh.topology.dim
    conditions = []
    for part in scene.dirichlet:
        dofs = fem.locate_dofs_topological(space, tdim - 1, sided.facets(part.sides))
        if part.value is not None and part.value.constant is not None:
            value = default_scalar_type(scene.sign * part.value.constant)
            conditions.append(fem.dirichletbc(value, dofs, space))
            continue
        if part.value is not None:
            formula = part.value.ufl(x)
        elif known is not None:
            formula = known.u
        else:
            raise InputError("dirichlet: data follow from manufactured solutions only")
        data = interpolate_near(space, scene.sign * formula, dofs)
        conditions.append(fem.dirichletbc(data, dofs))
    return conditions


def _zero_form(space: fem.FunctionSpace) -> ufl.Form:
    """A load that integrates over no cell at all."""
    none = ufl.Measure(
        "dx",
        space.mesh,
        subdomain_data=[(1, np.empty(0, dtype=np.int32))],
        metadata=QuadratureRule("default", 0).metadata,
    )
    return fem.Constant(space.mesh, default_scalar_type(0.0)) * ufl.TestFunction(space) * none(1)


def _cells(rule: QuadratureRule) -> ufl.Measure:
    return ufl.dx(metadata=rule.metadata)


def _facet_measure(sided: SidedMesh, parts: Sequence[Indices]) -> ufl.Measure:
    """A measure on parts of the boundary that are numbered from 0."""
    domain = sided.mesh
    owned = domain.topology.index_map(domain.topology.dim - 1).size_local
    pairs = [
        (k, facet_cells(domain, facets[facets < owned]).flatten()) for k, facets in enumerate(parts)
    ]
    rule = FACET_RULE if domain.topology.dim == 2 else CELL_RULE
    return ufl.Measure("ds", domain, subdomain_data=pairs, metadata=rule.metadata)
