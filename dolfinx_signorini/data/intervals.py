"""Interval arithmetic: enclosures of all values that operations have on intervals.

Ends are rounded outwards. An operation takes the values of all arguments for which the operation is
defined; without any such argument the result is the whole line. Intervals of different shapes are
broadcast.

Source: IEEE Standard 1788-2015 for interval arithmetic, set-based flavour.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.tolerances import ROUNDING, UNIT
from dolfinx_signorini.data.arithmetic import Number

SUBNORMAL = float(np.finfo(np.float64).smallest_subnormal)


@dataclass(frozen=True, eq=False)
class Interval(Number):
    """Intervals, whose operators are those of numbers:

        square = Interval(np.array([[-1.0], [2.0]])) ** 2.0

    Attributes:
        ends: The lower and the upper ends, shape (2, ...).
    """

    kind = "interval"
    ends: Array

    @property
    def low(self) -> Array:
        """The lower ends."""
        return np.asarray(self.ends[0])

    @property
    def high(self) -> Array:
        """The upper ends."""
        return np.asarray(self.ends[1])

    def like(self, value: float) -> "Interval":
        """Return a float as an interval."""
        return Interval(np.full((2, *[1] * (self.ends.ndim - 1)), value))

    def __neg__(self) -> "Interval":
        return Interval(-self.ends[::-1])

    def __add__(self, other: "Interval") -> "Interval":
        return outward(self.low + other.low, self.high + other.high, 0.0)

    def __mul__(self, other: "Interval") -> "Interval":
        products = self.ends[:, None] * other.ends
        unknown = np.isnan(products)
        if unknown.any():  # values of intervals are finite: 0 times an infinite end is 0
            products[unknown] = 0.0
        return outward(products.min(axis=(0, 1)), products.max(axis=(0, 1)))

    def __rtruediv__(self, value: float) -> "Interval":
        inverse = self.reciprocal()
        return inverse if value == 1.0 else value * inverse

    def reciprocal(self) -> "Interval":
        """Return 1 over the interval."""
        low, high = self.ends
        zero = self.contains(0.0)
        downwards = zero & ((low < 0.0) | (high == 0.0))
        upwards = zero & ((high > 0.0) | (low == 0.0))
        least = np.where(downwards, -np.inf, 1.0 / high)
        return outward(least, np.where(upwards, np.inf, 1.0 / low))

    def __abs__(self) -> "Interval":
        least, most = np.sort(np.abs(self.ends), axis=0)
        return Interval(np.stack((np.where(self.contains(0.0), 0.0, least), most)))

    def __pow__(self, exponent: float) -> "Interval":
        if exponent < 0.0:
            return (self**-exponent).reciprocal()
        if exponent % 2.0 == 0.0:
            return Interval(np.maximum(outward(*abs(self).ends ** exponent).ends, 0.0))
        if exponent % 1.0 == 0.0:
            return outward(*self.ends**exponent)
        return outward(*np.maximum(self.ends, 0.0) ** exponent).line_where(self.high < 0.0)

    def __lt__(self, other: "Interval") -> "Interval":
        return _truth(self.high < other.low, self.low < other.high)

    def __le__(self, other: "Interval") -> "Interval":
        return _truth(self.high <= other.low, self.low <= other.high)

    def __gt__(self, other: "Interval") -> "Interval":
        return other < self

    def __ge__(self, other: "Interval") -> "Interval":
        return other <= self

    def contains(self, value: float) -> Mask:
        """Return whether a value is in the intervals."""
        return (self.low <= value) & (self.high >= value)

    def line_where(self, condition: Mask) -> "Interval":
        """Return the whole line where a condition holds, and the interval elsewhere."""
        low = np.where(condition, -np.inf, self.low)
        return Interval(np.stack((low, np.where(condition, np.inf, self.high))))


def outward(low: Array, high: Array, least: float = SUBNORMAL) -> Interval:
    """Return an interval whose ends are rounded outwards; ends that are no numbers become infinite.

    Args:
        low, high: The ends as computed.
        least: The absolute error of an end; 0 for sums, which do not underflow.
    """
    ends: Array = np.empty((2, *np.broadcast_shapes(low.shape, high.shape)))
    ends[0], ends[1] = low, high
    margin = np.abs(ends)
    margin *= UNIT
    margin += least
    ends[0] -= margin[0]
    ends[1] += margin[1]
    unknown = np.isnan(ends)
    if unknown.any():
        ends[0, unknown[0]], ends[1, unknown[1]] = -np.inf, np.inf
    return Interval(ends)


def increasing(
    function: Callable[[Array], Array], low: float = -math.inf, high: float = math.inf
) -> Callable[[Interval], Interval]:
    """Return the interval form of a function that is increasing between two ends of its domain."""

    def enclosure(a: Interval) -> Interval:
        outside = (a.high < low) | (a.low > high)
        return outward(*function(np.clip(a.ends, low, high))).line_where(outside)

    return enclosure


def tangent(a: Interval) -> Interval:
    """Enclose tan a."""
    return outward(*np.tan(a.ends)).line_where(_meets(a, 0.5 * math.pi, math.pi))


def cut(y: Interval, x: Interval) -> Mask:
    """Whether the angle of (x, y) jumps by 2 pi inside of the intervals, or from -0.0 to 0.0."""
    return np.signbit(y.low) & (y.high >= 0.0) & (x.low < 0.0)


def angle(y: Interval, x: Interval) -> Interval:
    """Enclose atan2(y, x)."""
    corners = np.stack(np.broadcast_arrays(*(np.arctan2(q, p) for q in y.ends for p in x.ends)))
    result = outward(corners.min(axis=0), corners.max(axis=0))
    around = cut(y, x)
    end = np.nextafter(math.pi, 4.0)
    low = np.where(around, -end, result.low)
    return Interval(np.stack((low, np.where(around, end, result.high))))


def length(a: Interval, b: Interval) -> Interval:
    """Enclose the length of the vector (a, b)."""
    return Interval(np.maximum(outward(*np.hypot(abs(a).ends, abs(b).ends)).ends, 0.0))


def choose(condition: Interval, a: Interval, b: Interval) -> Interval:
    """Enclose a where a condition, which encloses 1 or 0, holds, and b elsewhere."""
    both = np.stack((np.minimum(a.low, b.low), np.maximum(a.high, b.high)))
    known = np.where(condition.high == 0.0, b.ends, both)
    return Interval(np.where(condition.low == 1.0, a.ends, known))


def _truth(surely: Mask, possibly: Mask) -> Interval:
    return Interval(np.stack((surely, possibly)).astype(np.float64))


def wave(function: Callable[[Array], Array], top: float) -> Callable[[Interval], Interval]:
    """Return the interval form of a function that goes from 1, first at a place, to -1 and back."""

    def enclosure(a: Interval) -> Interval:
        ends = function(a.ends)
        result = outward(ends.min(axis=0), ends.max(axis=0))
        bottom = _meets(a, top + math.pi, 2.0 * math.pi)
        low = np.where(bottom, -1.0, np.maximum(result.low, -1.0))
        high = np.where(_meets(a, top, 2.0 * math.pi), 1.0, np.minimum(result.high, 1.0))
        return Interval(np.stack((low, high)))

    return enclosure


def _meets(a: Interval, first: float, period: float) -> Mask:
    """Whether one of equidistant places may lie in an interval."""
    slack = ROUNDING * (1.0 + np.abs(a.ends).max(axis=0))
    before = np.floor((a.high + slack - first) / period)
    return ~(before < np.ceil((a.low - slack - first) / period))
