"""Known solutions of Signorini problems on the unit square, with chosen regularity."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem, mesh

from dolfinx_signorini.manufactured import ManufacturedSolution
from dolfinx_signorini.paper.solution import DETACHMENT, SUPPORT_RADIUS, christof_haubner


@dataclass(frozen=True)
class Scene:
    """A Signorini problem with a known solution.

    Attributes:
        exact: The solution on a mesh.
        singular: Where its gradient is not smooth.
        contact: The relative interior of its contact set: open intervals of the arc length along
            the boundary, counterclockwise from (0, 0).
    """

    exact: Callable[[mesh.Mesh], ManufacturedSolution]
    singular: tuple[tuple[float, float], ...]
    contact: tuple[tuple[float, float], ...]


def paper_scene() -> Scene:
    """Return the paper's solution (28): r^{3/2} at the detachment point, smooth elsewhere."""
    return Scene(
        exact=christof_haubner,
        singular=(DETACHMENT,),
        contact=((0.5, 4.0 + 0.5 - SUPPORT_RADIUS),),
    )


def smooth_scene() -> Scene:
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

    return Scene(exact, (), ())


def rough_scene(p: float) -> Scene:
    """Return a solution whose regularity ends at a chosen exponent.

    With w the paper's solution and b = 2 - 2/p, so that second derivatives of r^b and the load with
    them are in L^q for q < p and not for q >= p, it is

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
    paper = paper_scene()
    return Scene(
        exact=lambda domain: _times_power(christof_haubner(domain), 0.5 - 2.0 / p, p > 4.0),
        singular=paper.singular,
        contact=paper.contact,
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
    return ManufacturedSolution(
        mesh=w.mesh,
        u=factor * w.u,
        grad=tuple(factor * w.grad[i] + slope * x[i] * w.u for i in range(2)),
        load=factor * w.load - 2.0 * slope * derivative - g * slope * w.u,
        support=w.support,
    )
