"""Solutions of Signorini's problem with small supports, from which others are put together.

In local coordinates X along the boundary into the contact set and Y into the domain, z = X + iY,

    u = -A psi(r) Im z^k,    k = 3/2 or 7/2,

meets Signorini's conditions on a straight boundary: u = 0 and du/dn > 0 where X > 0, du/dn = 0 and
u > 0 where X < 0. With k = 2 and X, Y the distances from the sides of a corner, u = 0 and
du/dn > 0 on both sides. psi is the polynomial of the paper, 1 at r = 0 and 0 from the radius on.
Sums meet the conditions where no piece is in contact with a free part of another one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import ufl
from dolfinx import mesh

from dolfinx_signorini.norms.manufactured import ManufacturedSolution
from dolfinx_signorini.studies.paper.solution import SUPPORT_RADIUS, local_piece

Point = tuple[float, float]


@dataclass(frozen=True)
class Piece:
    """One piece of a solution:

        strong = Piece((0.25, 0.0), tangent=(1.0, 0.0), inward=(0.0, 1.0), radius=0.2)

    Attributes:
        point: The detachment point, or the corner.
        tangent: The direction into the contact set.
        inward: The direction into the domain.
        radius: Where the piece ends.
        exponent: k: 1.5 for a strong point, 3.5 for a weak one, 2 for a corner.
        amplitude: A.
    """

    point: Point
    tangent: Point
    inward: Point
    radius: float
    exponent: float = 1.5
    amplitude: float = 10.0


def composed(domain: mesh.Mesh, pieces: Sequence[Piece]) -> ManufacturedSolution:
    """Return the sum of pieces as a solution of -div(grad u) + u = f.

    Args:
        domain: The mesh.
        pieces: The pieces.
    """
    u, load, gradient = ufl.as_ufl(0.0), ufl.as_ufl(0.0), [ufl.as_ufl(0.0)] * 2
    for piece in pieces:
        x = ufl.SpatialCoordinate(domain) - ufl.as_vector(list(piece.point))
        frame = [list(piece.tangent), list(piece.inward)]
        X, Y = (ufl.dot(x, ufl.as_vector(axis)) for axis in frame)
        value, slope, laplacian = local_piece(X, Y, piece.radius, piece.exponent)
        u += piece.amplitude * value
        load += piece.amplitude * (value - laplacian)
        for i in range(2):
            part = frame[0][i] * slope[0] + frame[1][i] * slope[1]
            gradient[i] += piece.amplitude * part
    points = tuple(piece.point for piece in pieces if piece.exponent == 1.5)
    return ManufacturedSolution(domain, u, (gradient[0], gradient[1]), load, singular=points)


@dataclass(frozen=True)
class Level:
    """Equal bumps side by side on the bottom side.

    Attributes:
        start: Where the first bump begins.
        count: How many bumps.
        width: The width of a bump.
        amplitude: The amplitude of a bump in its own coordinates.
    """

    start: float
    count: int
    width: float
    amplitude: float

    @property
    def points(self) -> tuple[Point, ...]:
        """The detachment points: the middle of each bump."""
        return tuple((self.start + (m + 0.5) * self.width, 0.0) for m in range(self.count))


def levels_of_bumps(p: float, first: int, last: int) -> tuple[Level, ...]:
    """Return levels k of bumps of width 2^-k and height 2^{-k(2 - 1/p)} on pieces like 1/k^2.

    The sum of infinitely many levels is in W^{2,p}, and violates condition (A).

    Args:
        p: The exponent.
        first, last: The levels.
    """
    start, levels = 0.05, []
    for k in range(first, last + 1):
        width, count = 0.5**k, max(1, math.floor(2.0 * 2**k / k**2))
        levels.append(Level(start, count, width, 10.0 * 2.0 ** ((first - k) * (2.0 - 1.0 / p))))
        start += count * width
    return tuple(levels)


def bumps(domain: mesh.Mesh, levels: Sequence[Level]) -> ManufacturedSolution:
    """Return levels of bumps as a solution of -div(grad u) + u = f.

    Args:
        domain: The mesh.
        levels: The levels, one beside the other from left to right.
    """
    x = ufl.SpatialCoordinate(domain)
    scale, start, amplitude = (ufl.as_ufl(v) for v in (1.0, 0.0, 0.0))
    for level in reversed(levels):
        inside = ufl.lt(x[0], level.start + level.count * level.width)
        scale = ufl.conditional(inside, 1.0 / level.width, scale)
        start = ufl.conditional(inside, level.start, start)
        amplitude = ufl.conditional(inside, level.amplitude, amplitude)
    amplitude = ufl.conditional(ufl.lt(x[0], levels[0].start), 0.0, amplitude)
    # The distance from the middle of the bump: the position less its integer part less 1/2.
    X = -ufl.atan(1.0 / ufl.tan(math.pi * (x[0] - start) * scale)) / math.pi
    value, slope, laplacian = local_piece(X, x[1] * scale, SUPPORT_RADIUS)
    return ManufacturedSolution(
        domain,
        amplitude * value,
        (amplitude * scale * slope[0], amplitude * scale * slope[1]),
        amplitude * (value - scale * scale * laplacian),
    )
