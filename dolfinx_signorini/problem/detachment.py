"""Detachment points: where contact really ends, found from a discrete solution.

The discrete contact set tells a detachment point to the length of an edge. The gap tells more: at
the distance s behind the point the gap is c s^{3/2} (1 + c_1 s + ...), whose power 2/3 is smooth.
From dofs at some distance, where the discrete gap is accurate, the zero of this power is
extrapolated.

Source: Christof and Haubner, Section 2.2, for the singularity; K. L. Johnson, Contact mechanics,
Cambridge (1985), Section 5.1, for the same of elastic bodies without friction.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from scipy.spatial import cKDTree

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.base.kinds import check
from dolfinx_signorini.base.tolerances import HALVINGS, ROUNDING
from dolfinx_signorini.meshes.elements import control_points, facet_pieces, values_at_control_points
from dolfinx_signorini.norms.orders import DETACHMENT_EXPONENT
from dolfinx_signorini.pictures.contact_boundary import Touching
from dolfinx_signorini.problem.contact import ContactProblem
from dolfinx_signorini.problem.contact_zones import ContactZone
from dolfinx_signorini.problem.signorini import SignoriniProblem, one_sided

# Of the largest gap and pressure, a tenth of the domain away from a point where contact ends;
# nearer to the point, at the distance s, the gap is like s^{3/2}, and the pressure like s^{1/2}.
SIGNIFICANT, AWAY = 0.02, 0.1
NEAR = 0.05  # of the size of the domain; at least 4 facets
# From so far at the most the gap is extrapolated: of the size of the domain, and in edges.
WINDOW, EDGES = 0.125, 16.0
# The degrees of the polynomials that extrapolate, the middle one believed, and how many times their
# difference the position may be off. On 542 ends of contact with h from 1/12 to 1/100, elements of
# degree 1 to 3, the position is right to 0.04 edges in the median (with degrees 1 to 3: to 0.23),
# and 9 times farther off than this says, by 0.07 edges at most where something was extrapolated.
DEGREES, SAFETY = (2, 3, 4), 4.0
ALIKE = 2  # digits of strengths and lengths: what differs by less has the order of the places


@dataclass(frozen=True)
class DetachmentPoint:
    """A point where the contact set of a discrete solution ends.

    Attributes:
        position: Where the gap, extrapolated from the free side, is zero; without enough dofs for
            that the middle of the edge between a dof in contact and one that is not.
        uncertainty: How far off the position may be: some times what extrapolations differ by, at
            most the distance of two dofs. Without an extrapolation this distance, and from degree
            3 on the length of a facet, whose dofs tell only together where contact ends.
        strength: The gap on one side and the pressure on the other, the smaller of the two,
            relative to the largest on the contact boundary of its part of the mesh; the gap, to the
            range of u there if that is smaller.
    """

    position: tuple[float, ...]
    uncertainty: float
    strength: float


def detachment_points(
    problem: SignoriniProblem | ContactProblem | ContactZone,
) -> list[DetachmentPoint]:
    """Find the points where contact really ends, the strongest first.

    Points that are about as strong as each other come in the order of their coordinates.

    Where gap and pressure vanish together, the discrete contact set begins and ends anywhere, by
    rounding. What counts is an end with a gap on one side and a pressure on the other.

    Args:
        problem: A problem in the plane that has been solved: for a scalar, or for an elastic body,
            whose gap has the same power; or the contact boundary of an `ObstacleProblem`.

    Returns:
        The same points on all ranks.

    Raises:
        InputError: The problem is not in the plane, or has not been solved.
    """
    check(problem=(problem, _with_one_obstacle))
    comm = problem.space.mesh.comm
    plane = problem.space.mesh.topology.dim == 2
    require(comm, plane, "must be one in the plane", "problem")
    degree = problem.space.element.basix_element.degree
    points = [p for table in _boundary_tables(problem) for p in _points_of(degree, *table)]
    return sorted(points, key=_rank)


def _points_of(
    degree: int, edges: Array, gap: Array, density: Array, values: Array, moved: float
) -> list[DetachmentPoint]:
    """The points of a connected part of the mesh, by its table, see `_boundary_tables`."""
    largest = min(float(gap.max(initial=0.0)), moved), float(density.max(initial=0.0))
    if min(largest) <= 0.0:
        return []
    ends = np.flatnonzero((gap[:, 0] > 0.0) != (gap[:, 1] > 0.0))
    middles = edges[ends].mean(axis=1)
    lengths = np.hypot(*(edges[ends, 1] - edges[ends, 0]).T)
    nodes = edges.reshape(-1, 2)
    tree = cKDTree(nodes)
    size = float(np.ptp(nodes, axis=0).max())
    reach = np.maximum(4.0 * lengths, NEAR * size)
    found = []
    for end, middle, length, radius in zip(ends, middles, lengths, reach, strict=True):
        around = tree.query_ball_point(middle, radius)
        shares = [
            float(field.ravel()[around].max()) / scale
            for field, scale in zip((gap, density), largest, strict=True)
        ]
        strength, near = min(*shares, 1.0), min(radius / (AWAY * size), 1.0)
        if min(shares[0] / near**DETACHMENT_EXPONENT, shares[1] / near**0.5) >= SIGNIFICANT:
            point = DetachmentPoint(tuple(map(float, middle)), float(length), strength)
            found.append((point, radius, end))
    # Of ends close to each other only the one with the shortest edge is kept.
    kept: list[tuple[DetachmentPoint, float, Any]] = []
    for candidate in sorted(found, key=lambda f: (_rounded(f[0].uncertainty), *_rank(f[0]))):
        place = candidate[0].position
        if all(np.linalg.norm(np.subtract(place, p.position)) > r for p, r, _ in kept):
            kept.append(candidate)
    points = []
    for point, _, end in sorted(kept, key=lambda f: _rank(f[0])):
        inside, outside = edges[end] if gap[end, 0] <= 0.0 else edges[end, ::-1]
        placed = _extrapolated(point, inside, outside, nodes, values.ravel())
        if degree > 2 and placed.uncertainty == point.uncertainty:
            placed = replace(placed, uncertainty=degree * point.uncertainty)
        points.append(placed)
    return points


def _rank(point: DetachmentPoint) -> tuple[float, tuple[float, ...]]:
    """What the middles of edges are sorted by: no rounding, and so no number of ranks, shows."""
    return -round(point.strength, ALIKE), point.position


def _rounded(length: float) -> float:
    return float(f"{length:.{ALIKE}e}")


def _extrapolated(
    point: DetachmentPoint, inside: Array, outside: Array, nodes: Array, gap: Array
) -> DetachmentPoint:
    """Return a point moved to the zero of the gap on the straight line behind the point.

    Args:
        point: The middle of an edge.
        inside, outside: The ends of the edge, in contact and not.
        nodes: All contact dofs, shape (dofs, 2).
        gap: The gap at these dofs.
    """
    size = float(np.ptp(nodes, axis=0).max())
    length = point.uncertainty
    tangent = (outside - inside) / length
    offset = nodes - point.position
    across = np.abs(offset[:, 0] * tangent[1] - offset[:, 1] * tangent[0])
    rounding = ROUNDING * size * max(1.0, float(np.abs(nodes).max()) / length)  # of the tangent
    along = np.where(across <= rounding, offset @ tangent, -1.0)
    s, first = np.unique(along, return_index=True)
    # On the edge next to the end the gap is of the size of its error.
    behind = (s > length) & (s <= max(WINDOW * size, EDGES * length))
    s, root = s[behind], np.cbrt(np.maximum(gap[first[behind]], 0.0)) ** 2
    count = len(s) if (root > 0.0).all() else int(np.argmin(root > 0.0))  # up to the next contact
    best, shift = length, 0.0
    while count >= 2 * len(DEGREES):
        zeros = [_zero(s[:count], root[:count], degree) for degree in DEGREES]
        spread = max(zeros) - min(zeros)
        if SAFETY * spread < best and max(map(abs, zeros)) <= length:
            best, shift = SAFETY * spread, zeros[len(DEGREES) // 2]
        count = int(np.searchsorted(s, 0.5 * s[count - 1], side="right"))
    position = point.position + shift * tangent
    uncertainty = max(best, ROUNDING * size)
    return DetachmentPoint(tuple(map(float, position)), uncertainty, point.strength)


def _zero(s: Array, values: Array, degree: int) -> float:
    """The zero next to 0 of a polynomial fit of what is about proportional to s; inf for none.

    Newton's method: eigenvalues of a companion matrix are spoilt by a small leading coefficient.
    """
    fit = Polynomial.fit(s, values, degree, w=np.sqrt(s))
    slope, zero = fit.deriv(), 0.0
    for _ in range(HALVINGS):
        rise = float(slope(zero))
        step = float(fit(zero)) / rise if rise != 0.0 else np.inf
        if not abs(step) <= s[-1]:
            return np.inf
        zero -= step
        if abs(step) <= ROUNDING * s[-1]:
            return zero
    return np.inf


def _with_one_obstacle(value: Any) -> str:
    """The kind of what has detachment points."""
    if isinstance(value, ContactZone):
        one = len(value.obstacles) == 1 and not value.in_domain
        return "" if one else "must be the contact boundary of a problem"
    return "" if isinstance(value, ContactProblem) else one_sided(value)


def _boundary_tables(
    problem: SignoriniProblem | ContactProblem | ContactZone,
) -> list[tuple[Array, Array, Array, Array, float]]:
    """All edges between neighbouring contact dofs, with gap and pressure density at both ends.

    Returns:
        The same on all ranks, for each connected part of the mesh: ends, shape (edges, 2, 2); then
        of shape (edges, 2) the gaps and the densities of the dofs, and the values of the gap at
        their places; and the range of u. Sides bend away from an obstacle by much more than that.
    """
    left, density, told = problem.gap, problem.pressure, Touching(problem.along_direction)
    space, gap, pressure = left.function_space, left.x.array, density.x.array
    values = values_at_control_points(space, gap)
    edges, _ = facet_pieces(space, problem.owned_entities)
    x, first = control_points(space)[:, :2], edges[:, 0]
    columns = gap[edges], pressure[edges], values[edges], told.ranges[first], told.parts[first]
    table = np.column_stack([x[edges].reshape(-1, 4), *columns])
    table = np.concatenate(space.mesh.comm.allgather(table))
    parts = [table[table[:, 11] == number] for number in np.unique(table[:, 11])]
    return [
        (t[:, :4].reshape(-1, 2, 2), t[:, 4:6], t[:, 6:8], t[:, 8:10], float(t[0, 10]))
        for t in parts
    ]
