"""Formulas of complex coordinates: discs around all values, and what polynomials miss of a formula.

Let x be in a cell with the centre x0, and f(x0 + s (x - x0)) be analytic for complex |s| <= R, with
values that are at most M away from f(x0). Then the Taylor polynomial of degree n at x0 misses at
most M R^-n / (R - 1) of f in the cell, and f itself is at most M / R away from f(x0): by Cauchy's
and Schwarz's inequalities. One enclosure by discs in the plane of complex numbers bounds all
derivatives at once. Every disc has a real centre, the value at x0. Operations bound the differences
from the centre by the series of their absolute values.

Where a formula chooses (where, min, max, abs, sign) and the choice is the same all over the cell,
the chosen part is continued analytically. A choice is taken to be the same where that holds in the
cell without its outermost part of relative width `EDGE`: jumps along sides of cells are none.

Source: Moore, Kearfott and Cloud, Introduction to Interval Analysis (2009), Chapter 9; Ahlfors,
Complex Analysis (1979), Sections 4.2 and 4.3.
"""

from collections.abc import Callable
from functools import reduce

import numpy as np

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.data.formulas import Formula, Node, PerNode
from dolfinx_signorini.data.interfaces.roughness import chosen, factors, switch

Disc = tuple[Array, Array]  # centres and radii; a radius is infinite where nothing is known

EDGE = 1e-9


def discs(formula: Formula, corners: Array, reach: float) -> Disc:
    """Return discs around the values of a formula at complex points around simplices.

    Args:
        formula: The formula.
        corners: The vertices of the simplices, shape (simplices, vertices, dimension).
        reach: R, the size of the complex neighbourhoods as a multiple of the simplices.

    Returns:
        The centres and the radii, shape (simplices,); infinite radii where a formula is not
        analytic, or not found to be so.
    """
    low, high = corners.min(axis=1).T, corners.max(axis=1).T
    discs = _Discs(0.5 * (low + high), 0.5 * (high - low), reach)
    with np.errstate(all="ignore"):
        centres, radii = discs(formula.root)
        both = np.broadcast_arrays(centres, radii, np.empty(len(corners)))
        unknown = ~(np.isfinite(both[0]) & np.isfinite(both[1]))
    return np.where(unknown, 0.0, both[0]), np.where(unknown, np.inf, both[1])


class _Discs(PerNode[Disc]):
    """Discs around the values of the nodes of a formula.

    Args:
        centres, widths: Of boxes around the simplices, shape (dimension, simplices).
        reach: See `discs`.
    """

    def __init__(self, centres: Array, widths: Array, reach: float):
        super().__init__()
        self.centres, self.radii, self.reach = centres, reach * widths, reach

    def find(self, node: Node) -> Disc:
        if node.op == "number":
            return np.array(node.value), np.array(0.0)
        if node.op == "coordinate":
            return self.centres[int(node.value)], self.radii[int(node.value)]
        if (margin := switch(node)) is not None:
            return self._choice(margin, self(chosen(node, True)), self(chosen(node, False)))
        parts = [self(argument) for argument in node.args]
        if node.op == "^":
            return power(parts[0], node.args[1].value)
        if node.op == "atan2":
            return self._angle(*parts)
        return OPERATIONS[node.op](*parts)

    def _choice(self, margin: Node, a: Disc, b: Disc) -> Disc:
        """a where the margin is positive in the whole simplex, b where negative.

        An analytic product without a zero of its factors has one sign, that at the centre.
        """
        centre, radius = self(margin)
        clear = self._nonzero((centre, radius))
        if len(parts := factors(margin)) > 1:
            known = reduce(np.logical_and, map(self._nonzero, map(self, parts)))
            clear = clear | (known & np.isfinite(radius))
        yes, no = clear & (centre > 0.0), clear & (centre < 0.0)
        return np.where(yes, a[0], b[0]), np.where(yes, a[1], np.where(no, b[1], np.inf))

    def _nonzero(self, a: Disc) -> Mask:
        """Whether a function has no zero in the whole simplex."""
        return np.asarray(np.abs(a[0]) > (1.0 - EDGE) / self.reach * a[1])

    def _angle(self, y: Disc, x: Disc) -> Disc:
        """atan2(y, x), whose derivatives are x/q and -y/q with q = x^2 + y^2."""
        inverse = reciprocal(add(power(x, 2.0), power(y, 2.0)))
        change = size(multiply(x, inverse)) * y[1] + size(multiply(y, inverse)) * x[1]
        inner = (1.0 - EDGE) / self.reach
        clear = (y[0] - inner * y[1] > 0.0) | (y[0] + inner * y[1] < 0.0)
        clear |= x[0] - inner * x[1] > 0.0
        return np.arctan2(y[0], x[0]), np.where(clear, change, np.inf)


def size(a: Disc) -> Array:
    """Return the largest absolute value in a disc."""
    return np.asarray(np.abs(a[0]) + a[1])


def add(a: Disc, b: Disc) -> Disc:
    """Enclose a + b."""
    return a[0] + b[0], a[1] + b[1]


def subtract(a: Disc, b: Disc) -> Disc:
    """Enclose a - b."""
    return a[0] - b[0], a[1] + b[1]


def negative(a: Disc) -> Disc:
    """Enclose -a."""
    return -a[0], a[1]


def multiply(a: Disc, b: Disc) -> Disc:
    """Enclose a b."""
    return a[0] * b[0], np.abs(a[0]) * b[1] + a[1] * size(b)


def reciprocal(a: Disc) -> Disc:
    """Enclose 1/a."""
    distance = np.abs(a[0]) - a[1]
    return _where(distance > 0.0, np.asarray(1.0 / a[0]), a[1] / (np.abs(a[0]) * distance))


def power(a: Disc, exponent: float) -> Disc:
    """Enclose the power of a disc with a fixed exponent."""
    if exponent % 1.0:
        grown = (1.0 - a[1] / a[0]) ** -abs(exponent) - 1.0
        return _where(a[0] > a[1], a[0] ** exponent, np.abs(a[0] ** exponent) * grown)
    if exponent < 0.0:
        return reciprocal(power(a, -exponent))
    return a[0] ** exponent, size(a) ** exponent - np.abs(a[0]) ** exponent


def _root(a: Disc) -> Disc:
    return _where(a[0] > a[1], np.sqrt(a[0]), a[1] / (np.sqrt(a[0]) + np.sqrt(a[0] - a[1])))


def _by_derivative(function: Callable[[Array], Array], a: Disc, slope: Disc) -> Disc:
    return function(a[0]), a[1] * size(slope)


def _where(analytic: Mask, centres: Array, radii: Array) -> Disc:
    return centres, np.where(analytic, radii, np.inf)


def _sum(function: Callable[[Array], Array], even: Array, odd: Array, a: Disc) -> Disc:
    """Enclose f(c + w) = f(c) cos w + f'(c) sin w, or the same with cosh and sinh.

    Args:
        function: f.
        even, odd: |f| and |f'| at the centres.
        a: The disc.
    """
    return function(a[0]), even * (np.cosh(a[1]) - 1.0) + odd * np.sinh(a[1])


def _sine(a: Disc) -> Disc:
    return _sum(np.sin, np.abs(np.sin(a[0])), np.abs(np.cos(a[0])), a)


def _cosine(a: Disc) -> Disc:
    return _sum(np.cos, np.abs(np.cos(a[0])), np.abs(np.sin(a[0])), a)


def _sinh(a: Disc) -> Disc:
    return _sum(np.sinh, np.abs(np.sinh(a[0])), np.cosh(a[0]), a)


def _cosh(a: Disc) -> Disc:
    return _sum(np.cosh, np.cosh(a[0]), np.abs(np.sinh(a[0])), a)


def _of_arcsine(a: Disc) -> Disc:
    square = power(a, 2.0)
    return reciprocal(_root((1.0 - square[0], square[1])))


def _of_arctangent(a: Disc) -> Disc:
    square = power(a, 2.0)
    return reciprocal((1.0 + square[0], square[1]))


OPERATIONS: dict[str, Callable[..., Disc]] = {
    "sqrt": _root,
    "exp": lambda a: (np.exp(a[0]), np.exp(a[0]) * np.expm1(a[1])),
    "log": lambda a: _where(a[0] > a[1], np.log(a[0]), -np.log1p(-a[1] / a[0])),
    "sin": _sine,
    "cos": _cosine,
    "tan": lambda a: multiply(_sine(a), reciprocal(_cosine(a))),
    "sinh": _sinh,
    "cosh": _cosh,
    "tanh": lambda a: multiply(_sinh(a), reciprocal(_cosh(a))),
    "asin": lambda a: _by_derivative(np.arcsin, a, _of_arcsine(a)),
    "acos": lambda a: _by_derivative(np.arccos, a, _of_arcsine(a)),
    "atan": lambda a: _by_derivative(np.arctan, a, _of_arctangent(a)),
    "hypot": lambda a, b: _root(add(power(a, 2.0), power(b, 2.0))),
    "negative": negative,
    "+": add,
    "-": subtract,
    "*": multiply,
    "/": lambda a, b: multiply(a, reciprocal(b)),
}
