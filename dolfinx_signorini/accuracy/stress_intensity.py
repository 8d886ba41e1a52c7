"""The factors of the singularities at a detachment point, by dual singular functions.

In polar coordinates about the end of a contact set on a straight boundary, the contact at
theta = 0, the gap of -div(K grad u) + c u = f is

    w = a r^{1/2} sin(theta/2) - b r^{3/2} sin(3/2 theta) + smoother terms.

Where contact really ends, a = 0 and b > 0: the gap opens like b r^{3/2}, and the contact pressure
grows like 3/2 K b r^{1/2}. With a radial cut-off function eta, Green's formula gives both factors:

    k pi c = integral of w div(grad F) + F (f - c u)/K,    F = eta r^{-k} sin(k theta),

k = 1/2 with the factor c = a, and k = 3/2 with c = -b. No derivative of u enters, so that the
factors of a discrete solution are as accurate as its values.

Sources: Grisvard, Singularities in Boundary Value Problems (1992), Section 2.4, for the dual
functions; Christof and Haubner, Theorem 2.3, for a = 0.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from scipy.integrate import quad
from ufl.core.expr import Expr

from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.base.kinds import check, coordinates, optional, positive
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.base.tolerances import HALF_OF_THE_DIGITS, ROUNDING, SOLVED, TINY
from dolfinx_signorini.bounds.strong_form import EnergyTerms, strong_form
from dolfinx_signorini.meshes.elements import facet_dofs
from dolfinx_signorini.meshes.quadrature import CELL_RULE, FACET_RULE
from dolfinx_signorini.meshes.sided_meshes import (
    boundary_facets,
    cell_corners,
    cells_near_ball,
)
from dolfinx_signorini.norms.boundary_edges import BoundaryEdges
from dolfinx_signorini.problem.detachment import DetachmentPoint
from dolfinx_signorini.problem.signorini import SignoriniProblem, one_sided

PLATEAU, REACH = 0.25, 0.95  # of the radius: where the cut-off function is 1, and where it ends
SLACK = 2.0  # edges about the point in which contact may end


@dataclass(frozen=True)
class StressIntensity:
    """The factors of the gap at a detachment point.

    The factors tell how fast the gap opens, and how far off the point is:

        found = stress_intensity(problem, point)
        print(found.three_halves, found.corrected)

    Attributes:
        point: The point about which the gap is expanded.
        half: a, the factor of r^{1/2}: zero up to the error of the point and of the solution.
        three_halves: b, the factor of r^{3/2}: positive where contact really ends.
        radius: The radius in which the solution was used.
        tangent: The unit vector along the boundary into the contact set.
    """

    point: tuple[float, float]
    half: float
    three_halves: float
    radius: float
    tangent: tuple[float, float]

    @property
    def corrected(self) -> tuple[float, float]:
        """The point at which the factor of r^{1/2} vanishes, to first order.

        Moving the point by d along the tangent changes a by -3/2 b d.
        """
        shift = self.half / (1.5 * self.three_halves)
        x, y = (p + shift * t for p, t in zip(self.point, self.tangent, strict=True))
        return x, y


@dataclass(frozen=True)
class _Boundary:
    """All boundary edges: ends (n, 2, 2), gap and obstacle there (n, 2), a point inside (n, 2)."""

    ends: Array
    gap: Array
    obstacle: Array
    inside: Array
    contact: Mask


def stress_intensity(
    problem: SignoriniProblem,
    point: DetachmentPoint | tuple[float, float],
    terms: EnergyTerms | None = None,
    radius: float | None = None,
) -> StressIntensity:
    """Return the factors of r^{1/2} and r^{3/2} at a detachment point of a solved problem.

    Within the radius the boundary must be straight, on one side in contact and on the other side
    free, with a constant diffusion, and an obstacle that is affine along the boundary.

    Args:
        problem: A problem on triangles that has been solved; the call is collective.
        point: The point, as `detachment_points` finds it.
        terms: The strong form, whose diffusion is a number; None to read it from the forms of the
            problem, see `strong_form`.
        radius: Where the cut-off function ends; by default as far as the conditions above allow.

    Raises:
        InputError: No contact ends near the point, or the radius is too large.
    """
    check(
        problem=(problem, one_sided),
        point=(getattr(point, "position", point), coordinates(2)),
        radius=(radius, optional(positive)),
    )
    domain, comm = problem.space.mesh, problem.comm
    plane = domain.topology.cell_name() == "triangle" and domain.geometry.dim == 2
    require(comm, plane, "triangles in the plane are needed", "mesh")
    terms = strong_form(problem, terms)
    scalar = terms.diffusion is None or isinstance(terms.diffusion, int | float)
    require(comm, scalar, "a number is needed", "terms.diffusion")
    position = point.position if isinstance(point, DetachmentPoint) else point
    p = np.array([float(c) for c in position])
    boundary = _boundary(problem)
    tangent, normal, largest = _frame(problem, boundary, p)
    fits = radius is None or 0.0 < radius <= largest
    require(comm, fits, f"must be positive and at most {largest:.6g}", "radius")
    outer = REACH * largest if radius is None else float(radius)
    level, slope = _affine_obstacle(problem, boundary, p, tangent, outer)
    u, x = problem.u, ufl.SpatialCoordinate(domain) - ufl.as_vector([float(c) for c in p])
    X, Y = (ufl.dot(x, ufl.as_vector([float(c) for c in v])) for v in (tangent, normal))
    gap = problem.sign * (u - level - slope * X)
    load = 0.0 if terms.load is None else terms.load
    reaction = 0.0 if terms.reaction is None else terms.reaction
    diffusion = 1.0 if terms.diffusion is None else float(terms.diffusion)  # type: ignore[arg-type]
    source = problem.sign * (load - reaction * u) / diffusion
    half, three = (_factor(problem, k, gap, source, (X, Y), p, outer) for k in (0.5, 1.5))
    return StressIntensity(
        (float(p[0]), float(p[1])), half, -three, outer, (float(tangent[0]), float(tangent[1]))
    )


def _boundary(problem: SignoriniProblem) -> _Boundary:
    """Gather the boundary edges on all ranks."""
    edges = BoundaryEdges(problem.space.mesh)
    dofs = facet_dofs(problem.space, edges.facets)[:, :2]
    gap = problem.gap.x.array[dofs]
    obstacle = problem.u.x.array[dofs] - problem.sign * gap
    inside = cell_corners(edges.domain, edges.facets[:, 0]).mean(axis=1)
    contact = np.isin(boundary_facets(edges.domain), problem.contact)
    return _Boundary(edges.x, *map(edges.gathered, (gap, obstacle, inside, contact)))


def _frame(problem: SignoriniProblem, boundary: _Boundary, p: Array) -> tuple[Array, Array, float]:
    """The tangent into the contact set, the normal into the domain, and the largest radius."""
    comm, ends = problem.comm, boundary.ends
    distances = _distances(ends, p)
    nearest = int(np.argmin(distances))
    size = float(np.ptp(ends.reshape(-1, 2), axis=0).max())
    on = bool(distances[nearest] <= SOLVED * size and boundary.contact[nearest])
    require(comm, on, f"{tuple(map(float, p))} is not on the contact boundary", "point")
    edge = ends[nearest, 1] - ends[nearest, 0]
    length = float(np.hypot(*edge))
    t = edge / length
    offsets = ends - p
    s, across = offsets @ t, offsets @ np.array([-t[1], t[0]])
    straight = boundary.contact & (np.abs(across) <= SOLVED * size).all(axis=1)
    beside = straight[:, None] & (np.abs(np.abs(s) / length - SLACK - 1.0) <= 1.0)
    held = [boundary.gap[beside & (side * s > 0.0)] == 0.0 for side in (1.0, -1.0)]
    ends_here = all(map(len, held)) and (
        (held[0].all() and not held[1].any()) or (held[1].all() and not held[0].any())
    )
    require(comm, bool(ends_here), "no contact ends here", "point")
    if held[1].all():
        t, s = -t, -s
    expected = np.where(s > 0.0, boundary.gap == 0.0, boundary.gap > 0.0)
    good = straight & (expected | (np.abs(s) <= SLACK * length)).all(axis=1)
    largest = float(distances[~good].min(initial=np.inf))
    n = np.array([-t[1], t[0]])
    n = n if (boundary.inside[nearest] - p) @ n > 0.0 else -n
    return t, n, largest


def _distances(ends: Array, p: Array) -> Array:
    """The distances of edges from a point."""
    start, edge = ends[:, 0], ends[:, 1] - ends[:, 0]
    along = np.clip(((p - start) * edge).sum(axis=1) / (edge**2).sum(axis=1), 0.0, 1.0)
    return np.asarray(np.hypot(*(start + along[:, None] * edge - p).T))


def _affine_obstacle(
    problem: SignoriniProblem, boundary: _Boundary, p: Array, tangent: Array, radius: float
) -> tuple[float, float]:
    """The obstacle at the point, and its slope along the boundary."""
    used = boundary.contact & (_distances(boundary.ends, p) < radius)
    s, g = ((boundary.ends[used] - p) @ tangent).ravel(), boundary.obstacle[used].ravel()
    slope, level = np.polyfit(s, g, 1)
    scale = highest(problem.comm, np.abs(problem.u.x.array))
    defect = float(np.abs(level + slope * s - g).max())
    affine = defect <= HALF_OF_THE_DIGITS * max(scale, TINY)
    require(problem.comm, affine, "is not affine along the boundary at the point", "obstacle")
    return float(level), float(slope)


def _factor(
    problem: SignoriniProblem,
    k: float,
    gap: Expr,
    source: Expr,
    frame: tuple[Expr, Expr],
    p: Array,
    outer: float,
) -> float:
    """The factor of r^k sin(k theta)."""
    inner = PLATEAU * outer
    (X, Y), r = frame, ufl.sqrt(frame[0] * frame[0] + frame[1] * frame[1])
    large = ufl.sqrt(0.5 * (r + abs(X)))
    small = 0.5 * Y / large
    c, s = (ufl.conditional(ufl.lt(X, 0.0), *pair) for pair in ((small, large), (large, small)))
    dual = s / r if k == 0.5 else s * (3.0 * c * c - s * s) / (r * r * r)
    t = ufl.max_value(ufl.min_value((r - inner) / (outer - inner), 1.0), 0.0)
    eta = _cut_off(t)
    slope = -30.0 * t * t * (1.0 - t) * (1.0 - t) / (outer - inner)
    bend = -60.0 * t * (1.0 - 3.0 * t + 2.0 * t * t) / (outer - inner) ** 2
    cells, near = _cells(problem, p, outer, inner)
    mean = _mean(problem, source, near)
    # The mean of the source is integrated exactly: r^{-3/2} asks too much of a rule.
    weights = dual * (bend + (1.0 - 2.0 * k) * slope / r) * gap + eta * dual * (source - mean)
    parts = [(1, np.setdiff1d(cells, near)), (2, near)]
    dx = ufl.Measure("dx", problem.space.mesh, subdomain_data=parts)
    # On cells next to the point the rule for the root of the distance on facets.
    rules = (CELL_RULE, FACET_RULE)
    form = sum(weights * dx(k, metadata=rule.metadata) for k, rule in enumerate(rules, 1))
    return float(compiled.integral(form) + mean * _whole(k, inner, outer)) / (k * math.pi)


def _cells(
    problem: SignoriniProblem, p: Array, outer: float, inner: float
) -> tuple[LocalIndices, LocalIndices]:
    """The owned cells in the ball, and those of them next to the point."""
    domain, centre = problem.space.mesh, (float(p[0]), float(p[1]))
    closest = cells_near_ball(domain, centre, ROUNDING * outer)
    sizes = domain.h(2, closest)
    size = highest(problem.comm, sizes)
    near = cells_near_ball(domain, centre, min(2.0 * size, inner))
    cells = np.union1d(cells_near_ball(domain, centre, outer), near)
    return cells.astype(np.int32), near


def _mean(problem: SignoriniProblem, source: Expr, cells: LocalIndices) -> fem.Constant:
    """The mean of the source over cells of all ranks."""
    domain = problem.space.mesh
    dx = ufl.Measure("dx", domain, subdomain_data=[(1, cells)], metadata=CELL_RULE.metadata)
    one = fem.Constant(domain, np.float64(1.0))
    total, area = (compiled.integral(v * dx(1)) for v in (source, one))
    return fem.Constant(domain, np.float64(total / area))


def _whole(k: float, inner: float, outer: float) -> float:
    """The integral of eta r^{-k} sin(k theta) over the half-plane."""

    def beyond(r: float) -> float:
        return float(_cut_off((r - inner) / (outer - inner)) * r ** (1.0 - k))

    return float(inner ** (2.0 - k) / (2.0 - k) + quad(beyond, inner, outer)[0]) / k


def _cut_off(t: Any) -> Any:
    """The polynomial from 1 at t = 0 to 0 at t = 1 with two derivatives that vanish at both."""
    return 1.0 - t * t * t * (10.0 - 15.0 * t + 6.0 * t * t)
