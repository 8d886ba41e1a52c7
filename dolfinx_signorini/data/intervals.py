"""Interval arithmetic: enclosures of all values that operations have on intervals.

An interval is an array of shape (2, ...) with the lower and the upper ends; intervals of different
shapes are broadcast. Ends are rounded outwards. An operation takes the values of all arguments for
which the operation is defined; without any such argument the result is the whole line.

Source: IEEE Standard 1788-2015 for interval arithmetic, set-based flavour.
"""

import math
from collections.abc import Callable

import numpy as np

from dolfinx_signorini.base.arrays import Array, Mask

Operation = Callable[..., Array]

RELATIVE = 2e-15  # rounding errors of one operation, which are at most 4 units in the last place
SMALLEST = 5e-324
SLACK = 1e-12  # of the places of the extrema of sine and cosine
ONE: Array = np.ones((2, 1, 1))


def outward(low: Array, high: Array, least: float = SMALLEST) -> Array:
    """Return an interval whose ends are rounded outwards; ends that are no numbers become infinite.

    Args:
        low, high: The ends as computed.
        least: The absolute error of an end; 0 for sums, which do not underflow.
    """
    ends: Array = np.stack(np.broadcast_arrays(low, high))
    margin = np.abs(ends)
    margin *= RELATIVE
    margin += least
    ends[0] -= margin[0]
    ends[1] += margin[1]
    unknown = np.isnan(ends)
    if unknown.any():
        ends[0, unknown[0]], ends[1, unknown[1]] = -np.inf, np.inf
    return ends


def line_where(condition: Mask, a: Array) -> Array:
    """Return the whole line where a condition holds, and an interval elsewhere.

    Args:
        condition: The condition.
        a: The interval.
    """
    return np.stack((np.where(condition, -np.inf, a[0]), np.where(condition, np.inf, a[1])))


def hull(a: Array, b: Array) -> Array:
    """Return the smallest interval around two others."""
    return np.stack((np.minimum(a[0], b[0]), np.maximum(a[1], b[1])))


def add(a: Array, b: Array) -> Array:
    """Enclose a + b."""
    return outward(a[0] + b[0], a[1] + b[1], 0.0)


def negative(a: Array) -> Array:
    """Enclose -a."""
    return -a[::-1]


def subtract(a: Array, b: Array) -> Array:
    """Enclose a - b."""
    return outward(a[0] - b[1], a[1] - b[0], 0.0)


def multiply(a: Array, b: Array) -> Array:
    """Enclose a b; 0 times an infinite end is 0, because values of intervals are finite."""
    products = [p * q for p in a for q in b]
    for product in products:
        product[np.isnan(product)] = 0.0
    low = np.minimum(np.minimum(products[0], products[1]), np.minimum(products[2], products[3]))
    high = np.maximum(np.maximum(products[0], products[1]), np.maximum(products[2], products[3]))
    return outward(low, high)


def reciprocal(a: Array) -> Array:
    """Enclose 1/a."""
    low, high = a
    zero = (low <= 0.0) & (high >= 0.0)
    downwards, upwards = zero & ((low < 0.0) | (high == 0.0)), zero & ((high > 0.0) | (low == 0.0))
    return outward(np.where(downwards, -np.inf, 1.0 / high), np.where(upwards, np.inf, 1.0 / low))


def divide(a: Array, b: Array) -> Array:
    """Enclose a/b."""
    return multiply(a, reciprocal(b))


def size(a: Array) -> Array:
    """Enclose |a|."""
    low = np.where((a[0] <= 0.0) & (a[1] >= 0.0), 0.0, np.minimum(np.abs(a[0]), np.abs(a[1])))
    return np.stack((low, np.maximum(np.abs(a[0]), np.abs(a[1]))))


def power(a: Array, exponent: float) -> Array:
    """Enclose the power of an interval with a fixed exponent."""
    if exponent < 0.0:
        return reciprocal(power(a, -exponent))
    if exponent % 2.0 == 0.0:
        return np.maximum(outward(*size(a) ** exponent), 0.0)
    if exponent % 1.0 == 0.0:
        return outward(*a**exponent)
    return line_where(a[1] < 0.0, outward(*np.maximum(a, 0.0) ** exponent))


def sine(a: Array) -> Array:
    """Enclose sin a."""
    return _wave(np.sin, a, 0.5 * math.pi)


def cosine(a: Array) -> Array:
    """Enclose cos a."""
    return _wave(np.cos, a, 0.0)


def tangent(a: Array) -> Array:
    """Enclose tan a."""
    return line_where(_meets(a, 0.5 * math.pi, math.pi), outward(*np.tan(a)))


def inside(function: Operation, low: float, high: float) -> Operation:
    """Return the interval form of an increasing function.

    Args:
        function: The function.
        low, high: Where the domain of the function begins and ends.
    """

    def enclosure(a: Array) -> Array:
        outside = (a[1] < low) | (a[0] > high)
        return line_where(outside, outward(*function(np.clip(a, low, high))))

    return enclosure


def cut(y: Array, x: Array) -> Mask:
    """Whether the angle of (x, y) jumps by 2 pi inside of the intervals, or from -0.0 to 0.0."""
    return np.signbit(y[0]) & (y[1] >= 0.0) & (x[0] < 0.0)


def angle(y: Array, x: Array) -> Array:
    """Enclose atan2(y, x)."""
    corners = np.stack(np.broadcast_arrays(*(np.arctan2(q, p) for q in y for p in x)))
    result = outward(corners.min(axis=0), corners.max(axis=0))
    around = cut(y, x)
    end = np.nextafter(math.pi, 4.0)
    return np.stack((np.where(around, -end, result[0]), np.where(around, end, result[1])))


def length(a: Array, b: Array) -> Array:
    """Enclose the length of the vector (a, b)."""
    return np.maximum(outward(*np.hypot(size(a), size(b))), 0.0)


def choose(condition: Array, a: Array, b: Array) -> Array:
    """Enclose a or b, as a condition says.

    Args:
        condition: Encloses 1 where the condition holds, and 0 where not.
        a, b: The intervals for a condition that holds, and for one that does not.
    """
    undecided = hull(a, b)
    return np.where(condition[0] == 1.0, a, np.where(condition[1] == 0.0, b, undecided))


def _truth(surely: Mask, possibly: Mask) -> Array:
    return np.stack((surely, possibly)).astype(np.float64)


def _wave(function: Operation, a: Array, top: float) -> Array:
    """Enclose a function that oscillates between 1, first at a place, and -1."""
    ends = function(a)
    low, high = outward(ends.min(axis=0), ends.max(axis=0))
    low = np.where(_meets(a, top + math.pi, 2.0 * math.pi), -1.0, np.maximum(low, -1.0))
    high = np.where(_meets(a, top, 2.0 * math.pi), 1.0, np.minimum(high, 1.0))
    return np.stack((low, high))


def _meets(a: Array, first: float, period: float) -> Mask:
    """Whether one of equidistant places may lie in an interval."""
    slack = SLACK * (1.0 + np.abs(a).max(axis=0))
    before = np.floor((a[1] + slack - first) / period)
    return ~(before < np.ceil((a[0] - slack - first) / period))


# The enclosures of all operations of formulas but powers, by their names.
OPERATIONS: dict[str, Operation] = {
    "sqrt": inside(np.sqrt, 0.0, math.inf),
    "exp": inside(np.exp, -math.inf, math.inf),
    "sin": sine,
    "cos": cosine,
    "tan": tangent,
    "asin": inside(np.arcsin, -1.0, 1.0),
    "acos": lambda a: negative(inside(lambda b: -np.arccos(b), -1.0, 1.0)(a)),
    "atan": inside(np.arctan, -math.inf, math.inf),
    "sinh": inside(np.sinh, -math.inf, math.inf),
    "cosh": lambda a: outward(*np.cosh(size(a))),
    "tanh": inside(np.tanh, -math.inf, math.inf),
    "log": lambda a: line_where(a[1] <= 0.0, outward(*np.log(np.maximum(a, 0.0)))),
    "abs": size,
    "sign": np.sign,
    "atan2": angle,
    "hypot": length,
    "min": np.minimum,
    "max": np.maximum,
    "where": choose,
    "negative": negative,
    "+": add,
    "-": subtract,
    "*": multiply,
    "/": divide,
    "<": lambda a, b: _truth(a[1] < b[0], a[0] < b[1]),
    "<=": lambda a, b: _truth(a[1] <= b[0], a[0] <= b[1]),
    ">": lambda a, b: _truth(a[0] > b[1], a[1] > b[0]),
    ">=": lambda a, b: _truth(a[0] >= b[1], a[1] >= b[0]),
}
