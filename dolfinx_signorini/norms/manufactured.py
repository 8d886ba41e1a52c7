"""Manufactured solutions: from a chosen u to the data of a Signorini problem that u solves.

Any smooth u solves -div(K grad u) + c u = f with f, Dirichlet data and fluxes computed from u. On
the contact boundary more is needed: with the obstacle g and the flux q = K grad u . n,

    u >= g,    q >= 0,    q > 0 only where u = g

(for an upper obstacle the signs turn). Where an obstacle with these properties exists,
`matching_obstacle` makes one; otherwise `contact_violations` says which condition fails where.
"""

from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import default_scalar_type, fem, mesh
from mpi4py import MPI
from ufl.core.expr import Expr
from ufl.domain import extract_unique_domain

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.base.kinds import MESH, check, on_mesh, optional
from dolfinx_signorini.base.ranks import highest, marked
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.data.formula_values import values_at
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.polynomials import equispaced
from dolfinx_signorini.meshes.sided_meshes import (
    SAMPLE,
    cells_with_dofs,
    facet_cells,
    facet_vertices,
    owned_cells,
    owned_facets,
    sampled,
)
from dolfinx_signorini.norms.references import Reference, interpolant

INTERVALS = 4  # along an edge of a facet between sample points; its ends are where kinks are


@dataclass(frozen=True)
class ManufacturedSolution(Reference):
    """A known solution of a Signorini problem on one mesh, with its load.

    The solution is a reference for errors, and its load goes into the problem:

        exact = manufacture(domain, u, reaction=1.0)
        problem = SignoriniProblem(a, exact.load * v * ufl.dx, contact=facets)
        error_norms(problem.solve(), exact, ["L4"])

    Attributes:
        load: The right-hand side f = -div(K grad u) + c u, which vanishes outside of the support,
            too.
        flux: K grad u . n, to be used on boundary facets; None where no flux was asked for.

    Raises:
        InputError: An attribute is of another kind.
    """

    load: Expr
    flux: Expr | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        on_facets = optional(on_mesh(self.mesh, normals=True))
        check(load=(self.load, on_mesh(self.mesh)), flux=(self.flux, on_facets))


@dataclass(frozen=True)
class Violation:
    """A contact condition that a chosen solution does not satisfy.

    Violations print themselves in words:

        for violation in contact_violations(domain, facets, u, flux, obstacle):
            print(violation)

    Attributes:
        condition: The condition, in words.
        value: By how much the condition fails at the worst point.
        point: Coordinates of the worst point.
    """

    condition: str
    value: float
    point: tuple[float, ...]

    def __str__(self) -> str:
        where = ", ".join(f"{c:.6g}" for c in self.point)
        return f"{self.condition} fails at ({where}) by {self.value:.3g}"


def manufacture(
    domain: mesh.Mesh,
    u: Expr,
    diffusion: Expr | float | None = None,
    reaction: Expr | float | None = None,
) -> ManufacturedSolution:
    """Return a chosen solution with its gradient, its load and its flux.

    Args:
        domain: The mesh whose coordinates u uses.
        u: The solution.
        diffusion: K, a scalar or a tensor; None for 1.
        reaction: c; None for none.

    Raises:
        InputError: An argument is of another kind, or lives on another mesh.
    """
    check(domain=(domain, MESH))
    check(
        u=(u, on_mesh(domain)),
        diffusion=(diffusion, optional(on_mesh(domain, tensor=True))),
        reaction=(reaction, optional(on_mesh(domain))),
    )
    if not isinstance(u, Expr) or extract_unique_domain(u) is None:
        # A number, whose gradient UFL does not know.
        u = fem.Constant(domain, default_scalar_type(float(u)))
    gradient = ufl.grad(u)
    current = gradient if diffusion is None else diffusion * gradient
    load = -ufl.div(current)
    if reaction is not None:
        load += reaction * u
    components = tuple(gradient[i] for i in range(domain.geometry.dim))
    flux = ufl.dot(current, ufl.FacetNormal(domain))
    return ManufacturedSolution(domain, u, components, load, flux)


def contact_violations(
    domain: mesh.Mesh,
    facets: LocalIndices,
    u: Expr,
    flux: Expr,
    obstacle: Expr | float | None,
    upper: bool = False,
) -> list[Violation]:
    """Return the contact conditions that fail, each where it fails worst; the call is collective.

    Args:
        domain: The mesh.
        facets: The contact facets.
        u: The solution.
        flux: The flux K grad u . n of the solution.
        obstacle: The obstacle g; None for an obstacle that `matching_obstacle` is going to make.
        upper: Whether u <= g is asked for, in place of u >= g.
    """
    sign = -1.0 if upper else 1.0
    g = u if obstacle is None else obstacle
    x = ufl.SpatialCoordinate(domain)
    values, sizes = _on_facets(domain, facets, [u, flux, u - g, *x])
    gap, pressure, height = sign * values[:, 2], sign * values[:, 1], values[:, 0]
    here, push = (
        highest(domain.comm, np.abs(v)) for v in (np.maximum(abs(height), abs(gap)), pressure)
    )
    pressed = np.minimum(np.maximum(gap, 0.0) * push, np.maximum(pressure, 0.0) * here)
    size, force = max(sizes[0], sizes[2]), sizes[1]
    order, sense = ("u <= g", "flux <= 0") if upper else ("u >= g", "flux >= 0")
    tests = [
        (f"{sense} (the boundary may push and not pull)", -pressure, SOLVED * force),
        (f"{order} (no penetration)", -gap, SOLVED * size),
        ("flux = 0 where u does not touch g", pressed, SOLVED * size * force),
    ]
    found = []
    for condition, defect, tolerance in tests[: 1 if obstacle is None else 3]:
        worst = worst_violation(domain.comm, condition, defect, values[:, 3:])
        if worst.value > tolerance:
            found.append(worst)
    return found


def worst_violation(comm: MPI.Comm, condition: str, defect: Array, points: Array) -> Violation:
    """Return by how much a condition fails at the worst of some points.

    Args:
        comm: The communicator; the call is collective.
        condition: The condition, in words.
        defect: By how much the condition fails at the points of this rank.
        points: The points, shape (points, dimension).
    """
    worst = int(np.argmax(defect)) if len(defect) else -1
    local = (float(defect[worst]), tuple(map(float, points[worst]))) if worst >= 0 else None
    value, point = max((v for v in comm.allgather(local) if v), default=(0.0, ()))
    return Violation(condition, value, point)


def matching_obstacle(
    space: fem.FunctionSpace, facets: LocalIndices, u: Expr, flux: Expr, upper: bool = False
) -> fem.Function:
    """Return an obstacle that u touches exactly where the flux of u is not zero.

    On the facets with a flux the obstacle is u, and elsewhere it is off u by the largest |u|.

    Args:
        space: The Lagrange space of the discrete problem.
        facets: The contact facets.
        u: The solution.
        flux: The flux K grad u . n of the solution.
        upper: Whether the obstacle is an upper one.
    """
    domain = space.mesh
    tdim = domain.topology.dim
    sign = -1.0 if upper else 1.0
    count = len(_facet_points(domain))
    values, (size, force) = _on_facets(domain, facets, [u, flux])
    pushed = (abs(values[:, 1]).reshape(-1, count) > SOLVED * force).any(axis=1)
    touching, contact = (
        marked(space, fem.locate_dofs_topological(space, tdim - 1, some))
        for some in (owned_facets(domain, facets)[pushed], facets)
    )
    g = interpolant(space, u, cells_with_dofs(space, contact))
    g.name, clear = "obstacle", ~touching
    g.x.array[clear] -= sign * (size if size > 0.0 else 1.0)
    return g


def _facet_points(domain: mesh.Mesh) -> Array:
    """Sample points of the reference facet."""
    return equispaced(domain.topology.dim - 1, INTERVALS)


def _on_facets(
    domain: mesh.Mesh, facets: LocalIndices, values: list[Expr]
) -> tuple[Array, list[float]]:
    """Values at the sample points of the owned facets, and how large the values are.

    Returns:
        The values, shape (facets x points, values), and for each of them the largest size there, or
        the mean size on facets in the domain, if that is larger: a flux of 1e-50 on all of the
        facets is none.
    """
    points, comm = _facet_points(domain), domain.comm
    formula = values_at(domain, values)

    def at_points(pairs: LocalIndices) -> Array:
        return np.stack(formula(Points(domain, pairs, points)), axis=2)

    found = at_points(facet_cells(domain, owned_facets(domain, facets)))
    # Where r = 0 the gradient of r^a comes out as 0/0; the flux is 0 there for a > 1.
    missing = ~np.isfinite(found).all(axis=2)
    require(
        comm,
        not (missing.mean(axis=1) > 0.5).any(),
        "its gradient has no finite value on a whole facet; write r^a sin(a theta), for example, "
        "with hypot and atan2, and not with roots that vanish on a side",
        "solution",
    )
    found = np.nan_to_num(found, nan=0.0, posinf=0.0, neginf=0.0).reshape(-1, len(values))
    cells = owned_cells(domain)
    cells = cells[sampled(len(cells), 1 + len(cells) // SAMPLE)]
    count = len(facet_vertices(domain))  # facets of a cell
    pairs = np.stack((np.repeat(cells, count), np.tile(np.arange(count), len(cells))), axis=1)
    inside = np.nan_to_num(np.abs(at_points(pairs.astype(np.int32))), nan=0.0, posinf=0.0)
    inside = inside.reshape(len(cells), count * len(points), len(values)).mean(axis=1)
    middle = np.full((1, domain.topology.dim), 1.0 / count)
    volumes = Points(domain, cells, middle).scale[:, 0]
    sums = comm.allreduce(np.array([*(volumes @ inside), volumes.sum()]))
    largest = np.max(comm.allgather(np.abs(found).max(axis=0, initial=0.0)), axis=0)
    return found, np.maximum(largest, sums[:-1] / sums[-1]).tolist()
