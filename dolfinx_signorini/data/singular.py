"""Root mean squares of formulas next to singular points, such as r^(-1/2) around r = 0.

Let r = hypot(a, b) be a part of the formula that vanishes in a simplex. Each part of the formula is
written as r^n t with a number n and an interval for t: a and b have n = 1 and t in [-1, 1], so that
a/r and r^1.5 b/r^2 are enclosed, as no interval arithmetic can. The formula is at most M r^n then.

Let the derivatives of (a, b) in the simplex P differ by at most e from a matrix whose smaller
singular value is s + e, and L be the diameter of P in space, 1 in a plane. Then r < q on a part of
P of the size pi L (q/s)^2 at most. With q such that this is |P|, the mean of r^(2 n) over P is at
most q^(2 n) / (n + 1) for -1 < n < 0: the layer cake representation (Lieb and Loss, Analysis,
2001, Section 1.13).
"""

import math

import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.data.enclosures import enclosed_on_boxes
from dolfinx_signorini.data.formulas import Formula, Node, PerNode, squares
from dolfinx_signorini.data.interfaces.pieces import widths
from dolfinx_signorini.data.interfaces.singular_sets import NEAR_POLE
from dolfinx_signorini.data.intervals import Interval, outward
from dolfinx_signorini.data.matrices import least_stretch
from dolfinx_signorini.data.operations import applied
from dolfinx_signorini.data.powers import pairs
from dolfinx_signorini.meshes.sided_meshes import simplex_sizes

Scaled = tuple[float, Interval]  # n and t of r^n t

LOGARITHM = 0.125  # |log r| is at most a number times r to minus this power


def root_mean_squares(formula: Formula, corners: Array) -> Array:
    """Return bounds of the roots of the means of the square of a formula on simplices.

    Args:
        formula: The formula.
        corners: The vertices of the simplices, shape (simplices, vertices, dimension).

    Returns:
        The bounds; infinite where none is found.
    """
    result = np.full(len(corners), np.inf)
    low, high = corners.min(axis=1), corners.max(axis=1)
    for pair in pairs(formula.root):
        radius = enclosed_on_boxes(Formula("r", Node("hypot", pair)), low, high)
        near = np.flatnonzero((radius[0] <= NEAR_POLE * radius[1]) & np.isfinite(radius[1]))
        if not len(near):
            continue
        scaled = _ScaledNodes(np.stack((low[near].T, high[near].T)), pair, radius[1, near])
        with np.errstate(all="ignore"):
            n, t = scaled(formula.root)
            most = np.broadcast_to(abs(t).high, len(near))
            found = most * np.sqrt(_mean_power(pair, corners[near], 2.0 * n, radius[1, near]))
        result[near] = np.fmin(result[near], found)
    return result


def _mean_power(pair: tuple[Node, Node], corners: Array, n: float, most: Array) -> Array:
    """Bounds of the mean of r^n over simplices."""
    if n >= 0.0:
        return np.asarray(most**n)
    dimension = corners.shape[2]
    if n <= -2.0 or corners.shape[1] != dimension + 1:
        return np.full(len(corners), np.inf)
    length = 1.0 if dimension == 2 else widths(corners)
    share = np.sqrt(simplex_sizes(corners) / (math.pi * length))
    q = np.maximum(least_stretch(pair, corners), 0.0) * share
    return np.asarray(np.where(q > 0.0, q**n / (0.5 * n + 1.0), np.inf))


class _ScaledNodes(PerNode[Scaled]):
    """Enclosures of the nodes of a formula on boxes, as r^n t, with the largest r in each box."""

    def __init__(self, ends: Array, pair: tuple[Node, Node], most: Array):
        super().__init__()
        self.ends, self.pair, self.most = ends, frozenset(pair), most

    def find(self, node: Node) -> Scaled:
        if node in self.pair:
            return 1.0, Interval(np.array([[-1.0], [1.0]]))
        if node.op == "number":
            return 0.0, Interval(np.full((2, 1), node.value))
        if node.op == "coordinate":
            return 0.0, Interval(self.ends[:, int(node.value)])
        if node.op == "hypot" and self.pair == frozenset(node.args):
            return 1.0, Interval(np.ones((2, 1)))
        if self.pair == frozenset(squares(node)):
            return 2.0, Interval(np.ones((2, 1)))
        function = node.operation.of("interval")
        if node.op == "where":
            condition = node.args[0].operation.of("interval")
            n, branches = self._alike(*map(self, node.args[1:]))
            return n, function(condition(*self._alike(*map(self, node.args[0].args))[1]), *branches)
        parts = [self(a) for a in node.operands]
        (n, t), (m, s) = parts[0], parts[-1]
        if node.op in ("^", "sqrt"):
            return n * (node.exponents or (0.5,))[0], function(t, *node.exponents)
        if node.op in ("*", "/"):
            return (n + m if node.op == "*" else n - m), function(t, s)
        if node.op in ("+", "-", "min", "max", "negative", "abs"):
            n, values = self._alike(*parts)
            return n, function(*values)
        if node.op == "log" and n > 0.0:
            return self._logarithm(n, t)
        return 0.0, function(*(self._lowered(part, 0.0) for part in parts))

    def _alike(self, *parts: Scaled) -> tuple[float, list[Interval]]:
        n = min(n for n, _ in parts)
        return n, [self._lowered(part, n) for part in parts]

    def _lowered(self, part: Scaled, n: float) -> Interval:
        """The t of a part with a lower power of r."""
        power, t = part
        if power < n:  # not bounded
            return Interval(np.array([[-np.inf], [np.inf]]))
        return t if power == n else t * outward(0.0 * self.most, self.most ** (power - n))

    def _logarithm(self, n: float, t: Interval) -> Scaled:
        """log(r^n t) = n log r + log t; r^e |log r| is largest at r = e^(-1/e), or at the end."""
        e = LOGARITHM
        end = self.most**e * np.abs(np.log(self.most))
        top = np.where(self.most < math.exp(-1.0 / e), 0.0, 1.0 / (e * math.e))
        most = n * np.maximum(end, top)
        own = applied("log", t) * outward(0.0 * self.most, self.most**e)
        return -e, outward(own.low - most, own.high + most)
