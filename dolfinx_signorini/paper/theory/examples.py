"""Known solutions of Signorini problems on the unit square, with chosen regularity."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import ufl
from dolfinx import fem, mesh

from dolfinx_signorini.manufactured import ManufacturedSolution
from dolfinx_signorini.paper.solution import DETACHMENT, SUPPORT_RADIUS, christof_haubner

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
        c, s = ufl.cos(math.pi * x[0]), ufl.sin(math.pi * x[0])
        c2, s2 = ufl.cos(2.0 * math.pi * x[1]), ufl.sin(2.0 * math.pi * x[1])
        return ManufacturedSolution(
            mesh=domain,
            u=2.0 + c * c2,
            grad=(-math.pi * s * c2, -2.0 * math.pi * c * s2),
            load=2.0 + (1.0 + 5.0 * math.pi**2) * c * c2,
        )

    return Example(exact, singular=(), contact=())


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
