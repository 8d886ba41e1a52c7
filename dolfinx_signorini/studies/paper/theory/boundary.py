"""The boundary of a plane domain as one closed curve, and contact sets on the curve.

A contact set is a union of edges of the curve and of single nodes. The paper's condition (A_h)
asks for a family of such sets that no component is a single node, and that the ends of components
stay apart from each other and from the corners.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.errors import InputError, require
from dolfinx_signorini.base.ranks import function_with
from dolfinx_signorini.base.tolerances import HALF_OF_THE_DIGITS, SOLVED
from dolfinx_signorini.meshes.elements import facet_dofs
from dolfinx_signorini.norms.boundary_edges import BoundaryEdges


class BoundaryCurve:
    """The nodes on the boundary, counterclockwise from the leftmost of the lowest nodes.

    Edge i joins node i to node i + 1, the last edge the last node to the first:

        curve = BoundaryCurve(space)
        values = curve.values(u_h)  # at arc length curve.s

    Args:
        space: A scalar space of continuous, piecewise linear functions on a plane mesh.

    Attributes:
        dofs: Global dof of each node, shape (n,).
        x: Coordinates of the nodes, shape (n, 2).
        s: Arc length of the nodes from the first, shape (n,).
        widths: The length of each edge.
        length: Length of the curve.

    Raises:
        InputError: The elements are not linear, or the boundary is not one closed curve.
    """

    def __init__(self, space: fem.FunctionSpace):
        degree, comm = space.element.basix_element.degree, space.mesh.comm
        require(comm, degree == 1, f"degree 1 is needed, not {degree}", "space")
        self.space, self.edges = space, BoundaryEdges(space.mesh)
        curves = self.edges.curves
        require(comm, len(curves) == 1, f"{len(curves)} closed curves, not one", "boundary")
        rows, reverse = curves[0].T
        x, y = self.edges.x[rows, reverse].T
        if (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() < 0.0:
            rows, reverse = rows[::-1], 1 - reverse[::-1]
            x, y = self.edges.x[rows, reverse].T
        first = int(np.lexsort((x, y))[0])
        self._rows, self._reverse = np.roll(rows, -first), np.roll(reverse, -first)
        self.x = self.edges.x[self._rows, self._reverse]
        index_map = space.dofmap.index_map
        ends = facet_dofs(space, self.edges.facets)[:, :2]
        dofs = index_map.local_to_global(ends.ravel()).reshape(ends.shape)
        self.dofs = self.edges.gathered(dofs)[self._rows, self._reverse]
        low, high = index_map.local_range
        self._owned = (self.dofs >= low) & (self.dofs < high)
        self._local = self.dofs[self._owned] - low
        self.widths = self.edges.lengths[self._rows]
        self.s = np.concatenate(([0.0], np.cumsum(self.widths)[:-1]))
        self.length = float(self.widths.sum())

    @property
    def corners(self) -> Array:
        """Arc length of the nodes at which the curve changes its direction."""
        edges = np.roll(self.x, -1, axis=0) - self.x
        before = np.roll(edges, 1, axis=0)
        turn = before[:, 0] * edges[:, 1] - before[:, 1] * edges[:, 0]
        return self.s[np.abs(turn) > HALF_OF_THE_DIGITS * (edges**2).sum(axis=1)]

    def values(self, function: fem.Function) -> Array:
        """Return the nodal values of a function of the space along the curve."""
        values = np.zeros(len(self.dofs))
        values[self._owned] = function.x.array[self._local]
        return np.asarray(self.space.mesh.comm.allreduce(values))

    def function(self, values: Array) -> fem.Function:
        """Return the function with given values along the curve and 0 at all other nodes."""
        return function_with(self.space, self._local, values[self._owned])

    def samples(self, expressions: list[Expr], points: Array) -> Array:
        """Evaluate expressions at points of every edge.

        Args:
            expressions: UFL expressions.
            points: Positions along an edge from 0 to 1, ascending and symmetric about 1/2.

        Returns:
            Shape (n, points, expressions), edges and points in the order of the curve.
        """
        values = self.edges.samples(expressions, points)[self._rows]
        reverse = self._reverse == 1
        values[reverse] = values[reverse, ::-1]
        return values

    def facets_between(self, edges: Mask) -> npt.NDArray[np.int32]:
        """Return the owned facets (local indices) of the marked edges."""
        domain, facets = self.space.mesh, self.edges.facets
        offset = sum(domain.comm.allgather(len(facets))[: domain.comm.rank])
        rows = self._rows[edges] - offset
        mine = facets[rows[(rows >= 0) & (rows < len(facets))]]
        connectivity = domain.topology.connectivity(2, 1)
        return np.array(sorted(connectivity.links(c)[k] for c, k in mine), dtype=np.int32)


def edges_that_meet(curve: BoundaryCurve, intervals: Sequence[tuple[float, float]]) -> Mask:
    """Return whether an edge meets open intervals (start, end) of the arc length (5.1)."""
    marked = np.zeros(len(curve.s), dtype=bool)
    tolerance = SOLVED * curve.widths
    for a, b in intervals:
        for turn in (-curve.length, 0.0, curve.length):
            start, end = curve.s + turn, curve.s + curve.widths + turn
            marked |= (end > a + tolerance) & (start < b - tolerance)
    return marked


def ends_of(edges: Mask) -> Mask:
    """Return whether a node is an end of a marked edge."""
    return edges | np.roll(edges, 1)


def runs(marked: Mask) -> list[tuple[int, int]]:
    """Return the first and the last member of each run along the curve; none where all are marked.

    Args:
        marked: Which nodes, or edges, are members.
    """
    starts = np.flatnonzero(marked & ~np.roll(marked, 1))
    counts = (int(np.argmin(np.roll(marked, -start))) for start in starts)
    return [
        (int(a), (int(a) + count - 1) % len(marked))
        for a, count in zip(starts, counts, strict=True)
    ]


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
        return tuple(p % self.length for pair in self.intervals for p in dict.fromkeys(pair))

    @property
    def singletons(self) -> tuple[float, ...]:
        """The connected components that are single points."""
        return tuple(a for a, b in self.intervals if a == b)


def contact_set_of_nodes(curve: BoundaryCurve, gap: Array, pressure: Array) -> ContactSet:
    """Return the contact set of gaps and pressures, in the unit of the gap, at nodes of a curve.

    No pressure is negative. Each detachment point is placed between the last node in contact and
    the first free one, where the linear interpolant of gap - pressure changes its sign.
    """
    if (gap <= 0.0).all():
        return ContactSet(curve.length, ((0.0, curve.length),), ())

    def change(node: int, step: int) -> float:
        """Where gap - pressure vanishes between a node in contact and its free neighbour."""
        width = curve.widths[node if step > 0 else node - 1]
        free, pressed = gap[(node + step) % len(gap)], pressure[node]
        return float((curve.s[node] + step * width * pressed / (pressed + free)) % curve.length)

    intervals, detachments = [], list[float]()
    for first, last in runs(gap <= 0.0):
        a, b = float(curve.s[first]), float(curve.s[last])
        intervals.append((a, b if b >= a else b + curve.length))
        detachments += [change(first, -1), *([change(last, 1)] if first != last else [])]
    return ContactSet(curve.length, tuple(intervals), tuple(detachments))


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
    images = np.add.outer(length * np.arange(-1.0, 2.0), np.asarray(corners)).ravel()
    for a, b, point, *rooms in zip(low, high, points, before, after, strict=True):
        away = np.maximum(np.maximum(a - images, images - b), 0.0)  # of the corners
        room = float(min(*rooms, away.min(initial=np.inf)))
        if room <= 0.0:
            where = f"s = {point % length:.6g}"
            violations.append(f"the ball about {where} cannot avoid its neighbour or a corner")
        radii.append(float(0.5 * (b - a) + 0.4 * max(room, 0.0)))
    return Verdict(tuple(violations), tuple(float(p % length) for p in points), tuple(radii))


def _matched(boundaries: list[Array], length: float) -> Array:
    """Boundary points of all levels, one row each, shifted cyclically to follow the last level."""
    reference = boundaries[-1]

    def followed(points: Array) -> Array:
        rows = np.array([np.roll(points, -k) for k in range(len(points))])
        rows += length * np.round((reference - rows) / length)
        return np.asarray(rows[np.abs(rows - reference).max(axis=1).argmin()])

    return np.array([followed(points) for points in boundaries])
