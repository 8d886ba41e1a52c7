"""Closed-form solutions of Signorini problems as UFL: the solution, its gradient and its load.

A manufactured solution is made for one mesh, because UFL expressions refer to the coordinates of
their mesh. Where the solution vanishes outside a ball, the ball is stored as its support, so that
load and errors evaluate the closed form on the cells that meet it and nowhere else.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, mesh
from ufl.core.expr import Expr

from dolfinx_signorini import compat
from dolfinx_signorini.meshes import cells_near_ball, owned_cells

DETACHMENT = (0.5, 0.0)
SUPPORT_RADIUS = 0.45
AMPLITUDE = 10.0


@dataclass(frozen=True)
class ManufacturedSolution:
    """A known solution u of a Signorini problem on one mesh.

    Attributes:
        mesh: The mesh whose coordinates the expressions use.
        u: The solution.
        grad: Its gradient, one component per space dimension.
        load: The right-hand side f = -div(grad u) + u.
        support: Centre and radius of a ball outside of which u and f vanish, or None.
    """

    mesh: mesh.Mesh
    u: Expr
    grad: tuple[Expr, ...]
    load: Expr
    support: tuple[tuple[float, ...], float] | None = None

    def support_cells(self) -> npt.NDArray[np.int32]:
        """Return the owned cells on which u may be non-zero (all of them without a support)."""
        if self.support is None:
            return owned_cells(self.mesh)
        return cells_near_ball(self.mesh, *self.support)


def christof_haubner(
    domain: mesh.Mesh,
    detachment: tuple[float, float] = DETACHMENT,
    radius: float = SUPPORT_RADIUS,
) -> ManufacturedSolution:
    r"""Return the paper's solution (28) on the unit square, with its gradient and load.

    With polar coordinates (r, theta) about the detachment point,

        u = -10 psi(r) r^{3/2} sin(3/2 theta),

    where psi is the polynomial of degree 9 with psi(0) = 1, psi(radius) = 0 and four vanishing
    derivatives at both ends, continued by 0. It solves -div(grad u) + u = f with u >= 0,
    du/dn >= 0 and u du/dn = 0 on the whole boundary, is positive on the bottom edge to the left
    of the detachment point and touches the obstacle 0 to the right of it.

    All expressions are free of trigonometric functions and of cancellation, and are finite at the
    detachment point: with C + iS = (x + iy)^{1/2}, r^{3/2} sin(3/2 theta) = S (3 C^2 - S^2).

    Args:
        domain: A mesh of the unit square.
        detachment: The detachment point on the bottom edge, at least `radius` from its ends.
        radius: Where psi ends.

    Source: Christof and Haubner, Section 7, equation (28).
    """
    x = ufl.SpatialCoordinate(domain)
    x0, x1 = x[0] - detachment[0], x[1] - detachment[1]
    # Scaled like hypot, so that the squares of tiny distances do not underflow.
    largest = ufl.max_value(abs(x0), abs(x1))
    scale = ufl.conditional(ufl.gt(largest, 0.0), largest, 1.0)
    r = scale * ufl.sqrt((x0 / scale) * (x0 / scale) + (x1 / scale) * (x1 / scale))
    # The larger of sqrt(r) cos(theta/2) and sqrt(r) sin(theta/2), then the other one by division.
    large = ufl.sqrt(0.5 * (r + abs(x0)))
    small = 0.5 * x1 / ufl.conditional(ufl.gt(large, 0.0), large, 1.0)
    left = ufl.lt(x0, 0.0)
    c = ufl.conditional(left, small, large)
    s = ufl.conditional(left, large, small)
    w = s * (3.0 * c * c - s * s)

    t = ufl.min_value(r / radius, 1.0)
    t3 = t * t * t
    q = 1.0 - t
    q3 = q * q * q
    psi = q3 * q * q * (1.0 + t * (5.0 + t * (15.0 + t * (35.0 + t * 70.0))))
    dpsi_over_r = -630.0 * t3 * q3 * q / radius**2
    laplacian = -2520.0 * t3 * q3 * (2.0 - 3.0 * t) / radius**2  # psi'' + 4 psi' / r

    return ManufacturedSolution(
        mesh=domain,
        u=-AMPLITUDE * psi * w,
        grad=(
            -AMPLITUDE * (1.5 * psi * s + w * dpsi_over_r * x0),
            -AMPLITUDE * (1.5 * psi * c + w * dpsi_over_r * x1),
        ),
        load=AMPLITUDE * w * (laplacian - psi),
        support=((float(detachment[0]), float(detachment[1])), float(radius)),
    )


def interpolated(exact: ManufacturedSolution, degree: int) -> ManufacturedSolution:
    """Return the solution interpolated into continuous Lagrange elements, in place of the exact u.

    Near the detachment point u is only r^{3/2}-smooth, so the interpolant differs from u by
    O(h^{3/2}) there whatever the degree: it serves where a closed form is not at hand.

    Args:
        exact: The solution to interpolate.
        degree: Polynomial degree, at least 1.
    """
    space = fem.functionspace(exact.mesh, ("Lagrange", degree))
    u = fem.Function(space)
    u.interpolate(fem.Expression(exact.u, compat.interpolation_points(space.element)))
    gradient = ufl.grad(u)
    return ManufacturedSolution(
        mesh=exact.mesh,
        u=u,
        grad=tuple(gradient[i] for i in range(exact.mesh.geometry.dim)),
        load=exact.load,
        support=exact.support,
    )
