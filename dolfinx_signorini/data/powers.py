"""Points in the plane around which a datum is like a power of the distance, such as r^1.5 cos(t).

Around a point at which two affine parts a and b of a formula vanish, the formula is the sum of a
smooth function and of one that is like r^s, where r is the distance from the point. The exponent s
follows from the operations, as the order of a zero does. A logarithm or an angle has s = 0. On a
side of a domain in the plane, a jump has s = 0 and a kink s = 1.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.tolerances import HALF_OF_THE_DIGITS, SOLVED
from dolfinx_signorini.data.derivatives import Derivative
from dolfinx_signorini.data.formulas import Formula, Node, PerNode, evaluated, nodes, squares
from dolfinx_signorini.data.interfaces.facet_jumps import PARTS
from dolfinx_signorini.data.interfaces.interface import Interface, interfaces
from dolfinx_signorini.meshes.jacobians import inverses
from dolfinx_signorini.meshes.polynomials import depths


class SingularPoint(NamedTuple):
    """A point around which a function is like a power of the distance:

        around = SingularPoint((0.5, 0.0), 1.5).is_vertex_of(cell_corners(domain))

    Attributes:
        place: The point.
        exponent: The exponent.
    """

    place: tuple[float, ...]
    exponent: float

    def is_vertex_of(self, corners: Array) -> Mask:
        """Return whether the point is a vertex of triangles.

        Args:
            corners: The vertices of the triangles, shape (triangles, 3, 2).
        """
        away = np.linalg.norm(corners - np.array(self.place), axis=2)
        return np.asarray(away.min(axis=1) < HALF_OF_THE_DIGITS * away.max(axis=1))


class Powers(NamedTuple):
    """The powers of r in a formula: of all, and of what is not smooth; infinite for nothing."""

    all: float
    rough: float


def singular_points(formula: Formula, corners: Array) -> Iterator[SingularPoint]:
    """Yield the points at which a formula is like a power of the distance.

    Jumps and kinks count on segments, where they are points.

    Args:
        formula: The formula.
        corners: The vertices of the segments or triangles of this rank that may have such points,
            shape (parts, vertices, 2).
    """
    zeros = [(x, pair) for pair in pairs(formula.root) for x in _zeros(pair, corners)]
    size = np.ptp(corners.reshape(-1, 2), axis=0).max() if zeros else 0.0
    while zeros:
        place = zeros[0][0]
        here = [np.abs(x - place).max() <= HALF_OF_THE_DIGITS * size for x, _ in zeros]
        met = {frozenset(pair) for near, (_, pair) in zip(here, zeros, strict=True) if near}
        zeros = [zero for near, zero in zip(here, zeros, strict=True) if not near]
        exponent = _Powers(met)(formula.root).rough
        if np.isfinite(exponent):
            yield SingularPoint(tuple(map(float, place)), exponent)
    if corners.shape[1] == 2:
        for interface in interfaces(formula):
            yield from _crossings(formula, interface, corners)


def _crossings(formula: Formula, interface: Interface, segments: Array) -> Iterator[SingularPoint]:
    """Yield the points at which a formula jumps or has a kink inside of segments."""
    lattice = np.linspace(0.0, 1.0, PARTS + 1)[:, None, None]
    x = segments[:, 0] + lattice * (segments[:, 1] - segments[:, 0])
    signs = np.sign(interface.values(x))
    part, segment = np.nonzero(signs[:-1] * signs[1:] < 0.0)
    start, end = x[part, segment], x[part + 1, segment]
    places = start + interface.zeros(start, end)[:, None] * (end - start)
    along = segments[segment, 1] - segments[segment, 0]
    jumps = np.abs(interface.jump(formula.root, places))
    slopes = [interface.jump(Derivative(k)(formula.root), places) for k in range(along.shape[1])]
    kinks = np.abs(np.einsum("kp,pk->p", slopes, along))
    values = np.abs(evaluated(formula.root, x))
    size = SOLVED * values[np.isfinite(values)].max(initial=0.0)
    exponents = np.where(jumps > size, 0.0, np.where(kinks > size, 1.0, np.inf))
    for k in np.flatnonzero(np.isfinite(exponents)):
        yield SingularPoint(tuple(places[k].tolist()), float(exponents[k]))


def pairs(root: Node) -> list[tuple[Node, Node]]:
    """Return the arguments of distances and angles in a formula, in either order but once.

    A distance may be a root of a sum of two squares, too.
    """
    found: dict[frozenset[Node], tuple[Node, ...]] = {}
    for node in nodes(root):
        both: Sequence[Node] = ()
        if node.op in ("hypot", "atan2"):
            both = node.args
        elif node.op in ("^", "sqrt", "log", "/"):
            both = squares(node.args[-1 if node.op == "/" else 0])
        found.setdefault(frozenset(both), tuple(both))
    return [(pair[0], pair[1]) for both, pair in found.items() if len(pair) == len(both) == 2]


class _Powers(PerNode[Powers]):
    """The powers of the nodes of a formula around a point where some pairs of them vanish."""

    def __init__(self, pairs: set[frozenset[Node]]):
        super().__init__()
        self.pairs = pairs

    def find(self, node: Node) -> Powers:
        if any(node in pair for pair in self.pairs):
            return Powers(1.0, np.inf)
        if node.op in ("number", "coordinate"):
            return Powers(np.inf if node.is_number(0.0) else 0.0, np.inf)
        if node.op == "hypot" and frozenset(node.args) in self.pairs:
            return Powers(1.0, 1.0)
        if node.op == "atan2" and frozenset(node.args) in self.pairs:
            return Powers(0.0, 0.0)
        if frozenset(squares(node)) in self.pairs:
            return Powers(2.0, np.inf)
        parts = [self(a) for a in node.operands]
        first, last = parts[0], parts[-1]
        exponents = {"sqrt": 0.5, "abs": 1.0}
        if node.op in ("*", "/"):
            if node.op == "/":
                last = _power(last, -1.0)
            rough = min(first.all + last.rough, first.rough + last.all)
            return Powers(first.all + last.all, rough)
        if node.op == "^" or node.op in exponents:
            n = node.exponents[0] if node.op == "^" else exponents[node.op]
            if n > 0.0 and n % 2.0 == 0.0 and node.args[0].op == "hypot":
                return Powers(n * first.all, np.inf)
            return _power(first, n, whole=node.op == "^")
        if node.op == "log" and first.all > 0.0:
            return Powers(0.0, 0.0)
        least = Powers(*(min(each) for each in zip(*parts, strict=True)))
        alike = node.op in ("+", "-", "negative") or _vanishes_at_zero(node)
        return least if alike else Powers(0.0, least.rough)


def _vanishes_at_zero(node: Node) -> bool:
    """Whether an operation is 0 for the operand 0, as a sine is."""
    known, (low, high) = node.operation, node.limits
    return known.arguments == 1 and low < 0.0 < high and bool(known.value(0.0) == 0.0)


def _power(base: Powers, n: float, whole: bool = True) -> Powers:
    """The powers of base^n; of |base|^n where n does not stand for a product."""
    if whole and n > 0.0 and n % 1.0 == 0.0:
        return Powers(n * base.all, base.rough + (n - 1.0) * base.all)
    if base.all == 0.0:
        return base
    return Powers(n * base.all, n * base.all)


def _zeros(pair: tuple[Node, Node], corners: Array) -> Array:
    """The points of segments or triangles at which a pair of affine nodes vanishes."""

    def values(x: Array) -> Array:
        return np.stack([evaluated(node, x) for node in pair], axis=-1)

    first, sides = corners[:, 0], np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    with np.errstate(all="ignore"):  # where the pair does not change
        at_corners = values(corners)
        slopes = np.swapaxes(at_corners[:, 1:] - at_corners[:, :1], 1, 2)
        shares = -np.einsum("pij,pj->pi", inverses(slopes), at_corners[:, 0])
        inside = depths(shares) >= -HALF_OF_THE_DIGITS
        points = (first + np.einsum("pij,pj->pi", sides, shares))[inside]
        small = HALF_OF_THE_DIGITS * np.abs(at_corners[inside]).max(axis=(1, 2))
        return np.asarray(points[np.abs(values(points)).max(axis=1) <= small])
