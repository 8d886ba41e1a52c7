"""Known solutions of Signorini problems on the unit square, with chosen regularity."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import ufl
from dolfinx import fem, mesh

from dolfinx_signorini.norms.manufactured import ManufacturedSolution, manufacture
from dolfinx_signorini.studies.paper.solution import DETACHMENT, SUPPORT_RADIUS, christof_haubner
from dolfinx_signorini.studies.paper.theory.pieces import (
    Piece,
    bumps,
    composed,
    levels_of_bumps,
)

PLACES = (0.0, 0.25, 0.5, 0.75)  # of a boundary edge: on its first node ... in the middle ...


@dataclass(frozen=True)
class Example:
    """A Signorini problem with a known solution on any mesh of the unit square:

        exact = paper_example().exact(friedrichs_keller(comm, 25))

    Attributes:
        exact: The solution on a mesh.
        singular: Where the gradient of the solution is not smooth.
        contact: The relative interior of the contact set: open intervals of the arc length along
            the boundary, counterclockwise from (0, 0).
    """

    exact: Callable[[mesh.Mesh], ManufacturedSolution]
    singular: tuple[tuple[float, float], ...]
    contact: tuple[tuple[float, float], ...]


def paper_example(point: tuple[float, float] = DETACHMENT) -> Example:
    """Return the paper's solution (28): like r^{3/2} at the detachment point, smooth elsewhere.

    Args:
        point: The detachment point, on the bottom edge.
    """
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

    def exact(domain: mesh.Mesh) -> ManufacturedSolution:
        x = ufl.SpatialCoordinate(domain)
        u = 2.0 + ufl.cos(math.pi * x[0]) * ufl.cos(2.0 * math.pi * x[1])
        return manufacture(domain, u, reaction=1.0)

    return Example(exact, singular=(), contact=())


def kinked_example() -> Example:
    """Return |x_1 + 0.3 x_2 - 0.7| with no meaning for contact: in W^{1,inf}, not in H^2."""

    def exact(domain: mesh.Mesh) -> ManufacturedSolution:
        x = ufl.SpatialCoordinate(domain)
        return manufacture(domain, abs(x[0] + 0.3 * x[1] - 0.7), reaction=1.0)

    return Example(exact, singular=(), contact=())


RIGHT, LEFT, UP, DOWN = (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)
COMPOSED = {
    "two": (Piece((0.25, 0.0), RIGHT, UP, 0.2), Piece((0.75, 0.0), LEFT, UP, 0.2)),
    "three": (
        Piece((0.25, 0.0), RIGHT, UP, 0.2),
        Piece((0.75, 0.0), LEFT, UP, 0.2),
        Piece((0.5, 1.0), RIGHT, DOWN, 0.4),
    ),
    "weak": (Piece(DETACHMENT, RIGHT, UP, SUPPORT_RADIUS, exponent=3.5),),
    "corner": (
        Piece(DETACHMENT, RIGHT, UP, SUPPORT_RADIUS),
        Piece((1.0, 0.5), DOWN, LEFT, SUPPORT_RADIUS),
        Piece((1.0, 0.0), LEFT, UP, 0.5, exponent=2.0),
    ),
}
CONTACT = {
    "two": ((0.25, 0.75), (0.95, 4.05)),
    "three": ((0.25, 0.75), (0.95, 2.5), (2.9, 4.05)),
    "weak": ((0.5, 4.05),),
    "corner": ((0.5, 1.5), (1.95, 4.05)),
}


def composed_example(name: str) -> Example:
    """Return a solution with two or three points, a weak point, or contact across a corner.

    Args:
        name: One of `COMPOSED`.
    """
    pieces = COMPOSED[name]
    points = tuple(piece.point for piece in pieces if piece.exponent == 1.5)
    return Example(partial(composed, pieces=pieces), points, CONTACT[name])


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
    return Example(partial(bumps, levels=levels), points, contact)


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
        exact=lambda domain: _times_power(christof_haubner(domain), 0.5 - 2.0 / p, p > 4.0),
    )


def _times_power(w: ManufacturedSolution, power: float, plus_one: bool) -> ManufacturedSolution:
    """r^power w, or (1 + r^power) w; the power is no part of the generated code."""
    g = fem.Constant(w.mesh, np.float64(power))
    x = ufl.SpatialCoordinate(w.mesh) - ufl.as_vector(DETACHMENT)
    # No quadrature point is the detachment point; negative powers stay finite there all the same.
    r = ufl.max_value(ufl.sqrt(ufl.dot(x, x)), 1e-30)
    factor = r**g + (1.0 if plus_one else 0.0)
    slope = g * r ** (g - 2.0)  # the gradient of the factor is slope * x, its Laplacian g * slope
    derivative = sum(w.grad[i] * x[i] for i in range(2))
    return replace(
        w,
        u=factor * w.u,
        grad=tuple(factor * w.grad[i] + slope * x[i] * w.u for i in range(2)),
        load=factor * w.load - 2.0 * slope * derivative - g * slope * w.u,
    )
