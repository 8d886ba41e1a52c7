"""Known solutions of Signorini problems on the unit square, with chosen regularity.

Most are the paper's solution, or sums of pieces like the paper's with small supports. In local
coordinates X along the boundary into the contact set and Y into the domain, z = X + iY,

    u = -A psi(r) Im z^k,    k = 3/2 or 7/2,

meets Signorini's conditions on a straight boundary: u = 0 and du/dn > 0 where X > 0, du/dn = 0 and
u > 0 where X < 0. With k = 2 and X, Y the distances from the sides of a corner, u = 0 and
du/dn > 0 on both sides. psi is the polynomial of the paper, 1 at r = 0 and 0 from the radius on.
Sums meet the conditions where no piece is in contact with a free part of another one.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import ufl
from dolfinx import fem, mesh
from ufl.core.expr import Expr

from dolfinx_signorini.norms.manufactured import ManufacturedSolution, manufacture
from dolfinx_signorini.norms.orders import DETACHMENT_EXPONENT
from dolfinx_signorini.studies.paper.solution import (
    AMPLITUDE,
    DETACHMENT,
    SUPPORT_RADIUS,
    christof_haubner,
    local_piece,
)
from dolfinx_signorini.studies.paper.theory.proven import power_exponents

Point = tuple[float, float]


@dataclass(frozen=True)
class Example:
    """A Signorini problem with a known solution on any mesh of the unit square:

        exact = paper_example().exact(friedrichs_keller(comm, 25))

    Attributes:
        exact: The solution on a mesh.
        singular: Where the gradient of the solution is not smooth. The solution names these points
            as well, unless they are many: sup norms look closely at each.
        contact: The relative interior of the contact set: open intervals of the arc length along
            the boundary, counterclockwise from (0, 0).
    """

    exact: Callable[[mesh.Mesh], ManufacturedSolution]
    singular: tuple[Point, ...] = ()
    contact: tuple[tuple[float, float], ...] = ()


def paper_example(point: Point = DETACHMENT) -> Example:
    """Return the paper's solution (28): like r^{3/2} at a point of the bottom, smooth elsewhere."""
    return Example(
        exact=partial(christof_haubner, detachment=point),
        singular=(point,),
        contact=((point[0], 4.0 + point[0] - SUPPORT_RADIUS),),
    )


def placed_example(place: float, n: int) -> Example:
    """Return the paper's solution with its detachment point at a place of a boundary edge.

    Args:
        place: Part of the edge that lies between its left node and the detachment point.
        n: Even number of cells per side, at least 20 so that the support stays in the square.

    Raises:
        ValueError: n is odd or too small, or the place is not between 0 and 1.
    """
    if n % 2 or n < 20 or not 0.0 <= place < 1.0:
        raise ValueError(f"no edge of {n} cells per side has the place {place} next to the middle")
    return paper_example((DETACHMENT[0] + place / n, 0.0))


def smooth_example() -> Example:
    """Return 2 + cos(pi x) cos(2 pi y): positive, with no flux, so that nothing is in contact."""
    return Example(
        lambda domain: _given(
            domain, lambda x, y: 2.0 + ufl.cos(math.pi * x) * ufl.cos(2.0 * math.pi * y)
        )
    )


def kinked_example() -> Example:
    """Return |x_1 + 0.3 x_2 - 0.7| with no meaning for contact: in W^{1,inf}, not in H^2."""
    return Example(lambda domain: _given(domain, lambda x, y: abs(x + 0.3 * y - 0.7)))


def rough_example(p: float) -> Example:
    """Return a solution whose regularity ends at a chosen exponent.

    With w the paper's solution and b = 2 - 2/p, so that second derivatives of r^b and the load with
    them are in L^q for q < p and not for q >= p, the solution is

        u = r^{b - 3/2} w         for p < 4: like r^b at the detachment point (Corollary 4.1)
        u = (1 + r^{b - 3/2}) w   for p > 4: u_s = w and a part like r^b (Corollary 4.2).

    The factor is positive and has no flux through the line of the bottom side, so u meets the
    conditions of Signorini where w does.

    Args:
        p: The exponent, between 2 and 4 or above 4.

    Raises:
        ValueError: p is neither.
    """
    if not (2.0 < p < 4.0 or 4.0 < p < math.inf):
        raise ValueError(f"p: must lie between 2 and 4 or above 4, not {p}")
    return replace(
        paper_example(),
        exact=lambda domain: times_powers(christof_haubner(domain), p),
    )


def times_powers(w: ManufacturedSolution, p: float) -> ManufacturedSolution:
    """Return a solution like r^{3/2} times powers of r: like r^b for all b of a regularity.

    Args:
        w: The solution; r is the distance from the paper's detachment point.
        p: The exponent, see `power_exponents`; the powers are no part of the generated code.
    """
    x = ufl.SpatialCoordinate(w.mesh) - ufl.as_vector(DETACHMENT)
    # No quadrature point is the detachment point; negative powers stay finite there all the same.
    r = ufl.max_value(ufl.sqrt(ufl.dot(x, x)), 1e-30)
    # The factor, whose gradient is slope * x, and its Laplacian.
    factor, slope, laplacian = ufl.as_ufl(0.0), ufl.as_ufl(0.0), ufl.as_ufl(0.0)
    for exponent in power_exponents(p):
        g = fem.Constant(w.mesh, np.float64(exponent - DETACHMENT_EXPONENT))
        factor += r**g
        slope += g * r ** (g - 2.0)
        laplacian += g * g * r ** (g - 2.0)
    derivative = sum(w.grad[i] * x[i] for i in range(2))
    return replace(
        w,
        u=factor * w.u,
        grad=tuple(factor * w.grad[i] + slope * x[i] * w.u for i in range(2)),
        load=factor * w.load - 2.0 * slope * derivative - laplacian * w.u,
    )


@dataclass(frozen=True)
class Piece:
    """One piece of a solution:

        strong = Piece((0.25, 0.0), tangent=(1.0, 0.0), inward=(0.0, 1.0), radius=0.2)

    Attributes:
        point: The detachment point, or the corner.
        tangent, inward: The directions into the contact set and into the domain.
        radius: Where the piece ends.
        exponent: k: 1.5 for a strong point, 3.5 for a weak one, 2 for a corner.
    """

    point: Point
    tangent: Point
    inward: Point
    radius: float
    exponent: float = 1.5


RIGHT, LEFT, UP, DOWN = (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)
FIRST, SECOND = Piece((0.25, 0.0), RIGHT, UP, 0.2), Piece((0.75, 0.0), LEFT, UP, 0.2)
# By name the pieces and the contact set.
COMPOSED: Mapping[str, tuple[tuple[Piece, ...], tuple[tuple[float, float], ...]]] = {
    "two": ((FIRST, SECOND), ((0.25, 0.75), (0.95, 4.05))),
    "three": (
        (FIRST, SECOND, Piece((0.5, 1.0), RIGHT, DOWN, 0.4)),
        ((0.25, 0.75), (0.95, 2.5), (2.9, 4.05)),
    ),
    "weak": ((Piece(DETACHMENT, RIGHT, UP, SUPPORT_RADIUS, exponent=3.5),), ((0.5, 4.05),)),
    "corner": (
        (
            Piece(DETACHMENT, RIGHT, UP, SUPPORT_RADIUS),
            Piece((1.0, 0.5), DOWN, LEFT, SUPPORT_RADIUS),
            Piece((1.0, 0.0), LEFT, UP, 0.5, exponent=2.0),
        ),
        ((0.5, 1.5), (1.95, 4.05)),
    ),
}


def composed_example(name: str) -> Example:
    """Return a solution of `COMPOSED`: two or three points, a weak one, contact across a corner."""
    pieces, contact = COMPOSED[name]
    points = tuple(piece.point for piece in pieces if piece.exponent == 1.5)
    return Example(partial(_composed, pieces=pieces, points=points), points, contact)


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
    """
    start, levels = 0.05, []
    for k in range(first, last + 1):
        width, count = 0.5**k, max(1, math.floor(2.0 * 2**k / k**2))
        amplitude = AMPLITUDE * 2.0 ** ((first - k) * (2.0 - 1.0 / p))
        levels.append(Level(start, count, width, amplitude))
        start += count * width
    return tuple(levels)


def sharp_example(p: float, last: int = 10) -> Example:
    """Return bumps on ever smaller scales: in W^{2,p} and, with all levels, without (A).

    Args:
        p: The exponent.
        last: The finest level: bumps of the width 2^-last.
    """
    levels = levels_of_bumps(p, 3, last)
    points = tuple(point for level in levels for point in level.points)
    free = [(x - SUPPORT_RADIUS * level.width, x) for level in levels for x, _ in level.points]
    ends = [end for pair in free for end in pair]
    contact = tuple(zip(ends[1::2], [*ends[2::2], 4.0 + ends[0]], strict=True))
    return Example(partial(_bumps, levels=levels), points, contact)


# By name, as functions of the numbers behind the name.
EXAMPLES: Mapping[str, Callable[..., Example]] = {
    "paper": paper_example,
    "smooth": smooth_example,
    "kinked": kinked_example,
    "sharp": sharp_example,
    "rough": rough_example,
    "placed": placed_example,
    **{name: partial(composed_example, name) for name in COMPOSED},
}


def _given(domain: mesh.Mesh, u: Callable[[Expr, Expr], Expr]) -> ManufacturedSolution:
    x = ufl.SpatialCoordinate(domain)
    return manufacture(domain, u(x[0], x[1]), reaction=1.0)


def _composed(
    domain: mesh.Mesh, pieces: Sequence[Piece], points: tuple[Point, ...]
) -> ManufacturedSolution:
    """The sum of pieces as a solution of -div(grad u) + u = f."""
    u, load, gradient = ufl.as_ufl(0.0), ufl.as_ufl(0.0), [ufl.as_ufl(0.0)] * 2
    for piece in pieces:
        x = ufl.SpatialCoordinate(domain) - ufl.as_vector(list(piece.point))
        frame = [list(piece.tangent), list(piece.inward)]
        X, Y = (ufl.dot(x, ufl.as_vector(axis)) for axis in frame)
        value, slope, laplacian = local_piece(X, Y, piece.radius, piece.exponent)
        u += AMPLITUDE * value
        load += AMPLITUDE * (value - laplacian)
        for i in range(2):
            part = frame[0][i] * slope[0] + frame[1][i] * slope[1]
            gradient[i] += AMPLITUDE * part
    return ManufacturedSolution(domain, u, (gradient[0], gradient[1]), load, singular=points)


def _bumps(domain: mesh.Mesh, levels: Sequence[Level]) -> ManufacturedSolution:
    """Levels of bumps, from left to right, as a solution of -div(grad u) + u = f."""
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
