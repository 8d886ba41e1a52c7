"""Discs in the plane of complex numbers, which contain all values of operations on discs.

Every disc has a real centre. Operations bound the differences from the centre by the series of
their absolute values.

Source: Moore, Kearfott and Cloud, Introduction to Interval Analysis (2009), Chapter 9.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.data.arithmetic import Number


@dataclass(frozen=True, eq=False)
class Disc(Number):
    """Discs, whose operators are those of numbers:

        square = Disc(np.array(1.0), np.array(0.5)) ** 2.0

    Attributes:
        centre: The centres.
        radius: The radii; infinite where nothing is known.
    """

    kind = "disc"
    centre: Array
    radius: Array

    @property
    def size(self) -> Array:
        """The largest absolute value."""
        return np.asarray(np.abs(self.centre) + self.radius)

    def like(self, value: float) -> "Disc":
        """Return a float as a disc."""
        return Disc(np.array(value), np.array(0.0))

    def __neg__(self) -> "Disc":
        return Disc(-self.centre, self.radius)

    def __add__(self, other: "Disc") -> "Disc":
        return Disc(self.centre + other.centre, self.radius + other.radius)

    def __mul__(self, other: "Disc") -> "Disc":
        radius = np.abs(self.centre) * other.radius + self.radius * other.size
        return Disc(self.centre * other.centre, radius)

    def reciprocal(self) -> "Disc":
        """Return 1 over the disc."""
        distance = np.abs(self.centre) - self.radius
        radius = self.radius / (np.abs(self.centre) * distance)
        return Disc(np.asarray(1.0 / self.centre), radius).where(distance > 0.0)

    def __pow__(self, exponent: float) -> "Disc":
        centre = self.centre**exponent
        if exponent % 1.0:
            grown = (1.0 - self.radius / self.centre) ** -abs(exponent) - 1.0
            return Disc(centre, np.abs(centre) * grown).where(self.centre > self.radius)
        if exponent < 0.0:
            return (self**-exponent).reciprocal()
        return Disc(centre, self.size**exponent - np.abs(self.centre) ** exponent)

    def where(self, analytic: Mask) -> "Disc":
        """Return a disc about which nothing is known but where a function is analytic."""
        return Disc(self.centre, np.where(analytic, self.radius, np.inf))


def root(a: Disc) -> Disc:
    """Enclose the square root."""
    centre = np.sqrt(a.centre)
    radius = a.radius / (centre + np.sqrt(a.centre - a.radius))
    return Disc(centre, radius).where(a.centre > a.radius)


def exponential(a: Disc) -> Disc:
    """Enclose exp a."""
    return Disc(np.exp(a.centre), np.exp(a.centre) * np.expm1(a.radius))


def logarithm(a: Disc) -> Disc:
    """Enclose log a."""
    radius = -np.log1p(-a.radius / a.centre)
    return Disc(np.log(a.centre), radius).where(a.centre > a.radius)


def wave(
    function: Callable[[Array], Array], slope: Callable[[Array], Array]
) -> Callable[[Disc], Disc]:
    """Return what encloses f(c + w) = f(c) cos w + f'(c) sin w, or the same with cosh and sinh.

    The derivative of f is given up to its sign.
    """

    def enclosure(a: Disc) -> Disc:
        centre, other = function(a.centre), np.abs(slope(a.centre))
        radius = np.abs(centre) * (np.cosh(a.radius) - 1.0) + other * np.sinh(a.radius)
        return Disc(centre, radius)

    return enclosure


SINE, COSINE = wave(np.sin, np.cos), wave(np.cos, np.sin)
SINH, COSH = wave(np.sinh, np.cosh), wave(np.cosh, np.sinh)
