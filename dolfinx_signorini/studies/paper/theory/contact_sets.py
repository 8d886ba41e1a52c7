"""Contact sets of u_h on the closed boundary curve, and the paper's condition (A_h) on them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx import fem

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.studies.paper.theory.curve import BoundaryCurve
from dolfinx_signorini.studies.paper.theory.discretisation import Discretisation


@dataclass(frozen=True)
class ContactSet:
    """Closed, disjoint intervals of the arc length of a closed curve:

        half = ContactSet(4.0, ((0.0, 2.0),), (0.0, 2.0))
        assert half.boundary == (0.0, 2.0)

    Attributes:
        length: Length of the curve.
        intervals: (start, end) with 0 <= start < length and start <= end < start + length; an end
            beyond the length wraps around; the whole curve is (0, length).
        detachments: The estimated position of each point of the relative boundary, in the order
            start, end of the intervals.
    """

    length: float
    intervals: tuple[tuple[float, float], ...]
    detachments: tuple[float, ...]

    @property
    def boundary(self) -> tuple[float, ...]:
        """The relative boundary: start and end of each interval; a singleton's point once."""
        if self.intervals == ((0.0, self.length),):
            return ()
        points = (p for a, b in self.intervals for p in ((a, b) if b > a else (a,)))
        return tuple(p % self.length for p in points)

    @property
    def singletons(self) -> tuple[float, ...]:
        """The connected components that are single points."""
        return tuple(a for a, b in self.intervals if a == b)


def discrete_contact_set(discretisation: Discretisation) -> ContactSet:
    """Return {u_h = 0} on the boundary: the edges with both nodes in contact, and single nodes.

    Each detachment point is placed between the last node in contact and the first free one, where
    the linear interpolant of gap - pressure changes its sign. The pressure is the force on a node
    divided by the diagonal entry of A, so that both have one unit.
    """
    curve, system = discretisation.curve, discretisation.system
    gap = curve.values(discretisation.u_h)
    x, pressure = system.vector_of(discretisation.u_h), fem.Function(system.space)
    pressure.x.array[system.contact_dofs] = system.multiplier(x) / system.contact_diagonal
    x.destroy()
    return contact_set_of_nodes(curve, gap, curve.values(pressure))


def contact_set_of_nodes(curve: BoundaryCurve, gap: Array, pressure: Array) -> ContactSet:
    """Return the contact set of gaps and pressures, in the unit of the gap, at nodes of a curve."""
    active, n = gap <= 0.0, len(gap)
    if active.all():
        return ContactSet(curve.length, ((0.0, curve.length),), ())
    starts = np.flatnonzero(active & ~np.roll(active, 1))
    intervals, detachments = [], []
    for start in starts:
        count = int(np.argmin(np.roll(active, -start)))
        last = (start + count - 1) % n
        a, b = curve.s[start], curve.s[last]
        intervals.append((float(a), float(b if b >= a else b + curve.length)))
        detachments.append(_sign_change(curve, gap, pressure, int(start), -1))
        if count > 1:
            detachments.append(_sign_change(curve, gap, pressure, int(last), 1))
    return ContactSet(curve.length, tuple(intervals), tuple(detachments))


def _sign_change(curve: BoundaryCurve, gap: Array, pressure: Array, node: int, step: int) -> float:
    """Where gap - pressure vanishes between a node in contact and its free neighbour."""
    n = len(gap)
    width = curve.widths[node if step > 0 else (node - 1) % n]
    free, pressed = gap[(node + step) % n], max(pressure[node], 0.0)
    return float((curve.s[node] + step * width * pressed / (pressed + free)) % curve.length)


@dataclass(frozen=True)
class Verdict:
    """What the check of condition (A_h) found.

    Attributes:
        violations: What is violated, in words; empty where the condition holds.
        points: The points d_i.
        radii: The radii delta_i.
    """

    violations: tuple[str, ...]
    points: tuple[float, ...] = ()
    radii: tuple[float, ...] = ()

    @property
    def holds(self) -> bool:
        """Whether the condition holds."""
        return not self.violations


def condition_a_h(levels: Sequence[ContactSet], corners: Sequence[float]) -> Verdict:
    """Check condition (A_h) over a family of discrete contact sets.

    Args:
        levels: The contact sets of the family, all of them with "sufficiently small" h.
        corners: Arc length of the corners.

    Returns:
        The points d_i in the middle between the extreme positions of the i-th boundary point, and
        radii delta_i that reach half-way from there to the nearest other position or corner.

    Raises:
        InputError: There is no level.

    Source: Definition 5.5.
    """
    if not levels:
        raise InputError("at least one contact set is needed", "levels")
    length = levels[0].length
    violations = [
        f"level {k}: the component at s = {s:.6g} is a single point"
        for k, c in enumerate(levels)
        for s in c.singletons
    ]
    counts = [len(c.boundary) for c in levels]
    if len(set(counts)) > 1:
        found = ", ".join(map(str, counts))
        return Verdict((*violations, f"the number of boundary points changes: {found}"))
    if counts[0] == 0:
        return Verdict(tuple(violations))
    tracks = _matched([np.sort(c.boundary) for c in levels], length)
    low, high = tracks.min(axis=0), tracks.max(axis=0)
    points, radii = 0.5 * (low + high), []
    before = low - np.append(high[-1] - length, high[:-1])
    after = np.append(low[1:], low[0] + length) - high
    for a, b, point, *rooms in zip(low, high, points, before, after, strict=True):
        room = min([*rooms, *(_distance(a, b, corner, length) for corner in corners)])
        if room <= 0.0:
            where = f"s = {point % length:.6g}"
            violations.append(f"the ball about {where} cannot avoid its neighbour or a corner")
        radii.append(float(0.5 * (b - a) + 0.4 * max(room, 0.0)))
    return Verdict(tuple(violations), tuple(float(p % length) for p in points), tuple(radii))


def _matched(boundaries: list[Array], length: float) -> Array:
    """Boundary points of all levels, one row each, shifted cyclically to follow the last level."""
    reference = boundaries[-1]
    rows = []
    for points in boundaries:
        shifts = []
        for k in range(len(points)):
            row = np.roll(points, -k)
            row = row + length * np.round((reference - row) / length)
            shifts.append((float(np.abs(row - reference).max()), row))
        rows.append(min(shifts, key=lambda shift: shift[0])[1])
    return np.array(rows)


def _distance(low: float, high: float, point: float, length: float) -> float:
    """Distance of a point on the closed curve from an interval, 0 inside of the interval."""
    images = point + length * np.arange(-1.0, 2.0)
    return float(np.maximum(np.maximum(low - images, images - high), 0.0).min())
