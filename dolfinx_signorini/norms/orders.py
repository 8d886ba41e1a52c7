"""Orders of convergence: measured, by regression, and as approximation and theorems allow.

At a detachment point a solution is like r^{3/2} sin(3/2 theta), whatever the data, and near a
corner like another power of the distance r. Lagrange elements of degree k on uniform meshes
approximate r^a, in a norm of s derivatives in L^p of d dimensions, with the order

    min(k + 1 - s, a - s + d/p):

on a cell at distance r the error is like h^{k+1-s} r^{a-k-1}, and on the cells next to the point
like h^{a-s}. Where cells become smaller towards the point, the order is that of a smooth function.

Sources: Christof and Haubner, Section 2.2, for the singularity; Babuska, Kellogg and Pitkaranta,
Numer. Math. 33 (1979) 447-471, for graded meshes.
"""

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.norms.names import Norm, parse_norm

Numbers = TypeVar("Numbers", float, Array)  # one number, or an array of them

DETACHMENT_EXPONENT = 1.5  # a, of the solution at a detachment point inside a straight side
FREE_BOUNDARY_EXPONENT = 2.0  # of the distance to the end of contact in the domain
KINK_EXPONENT = 1.0  # of the distance to a kink, of an obstacle in the domain
SMOOTH = math.inf  # in place of a, for a smooth function and for meshes that are graded as it takes
LISTED = ("L2", "L4", "Linf", "H1", "W1_4", "W1_inf")  # norms whose orders are told of a scene


def eoc(widths: Sequence[float], errors: Sequence[float]) -> list[float]:
    """Return the experimental order of convergence between each width and the one before.

    Args:
        widths: Mesh widths h, at least one.
        errors: One error per width, positive.

    Returns:
        One order less than there are widths.

    Source: Christof and Haubner, equation (30).
    """
    return (np.diff(np.log(errors)) / np.diff(np.log(widths))).tolist()


def regression(widths: Sequence[float], errors: Sequence[float]) -> float:
    """Return the order of the least-squares line through (log h, log error).

    Args:
        widths: Mesh widths h, at least two.
        errors: One error per width, positive.

    Source: Christof and Haubner, row "regr." of Table 2.
    """
    return float(np.polyfit(np.log(widths), np.log(errors), 1)[0])


def approximation_order(
    norm: str, degree: int = 1, exponent: float = DETACHMENT_EXPONENT, dimension: int = 2
) -> float:
    """Return the order in h up to which elements approximate r^exponent in a norm.

    Args:
        norm: Name of a norm, see `names.parse_norm`.
        degree: Polynomial degree of the elements.
        exponent: The exponent of r; `SMOOTH` for a mesh that is graded as the norm asks for.
        dimension: See `is_finite`; 1 for the distance to the end of contact in the domain.

    Raises:
        InputError: The norm is unknown.
    """
    parsed = parse_norm(norm)
    return min(_smooth(parsed, degree), singular_order(parsed, exponent, dimension))


def expected_order(
    norm: str, degree: int = 1, exponent: float = DETACHMENT_EXPONENT, dimension: int = 2
) -> float | None:
    """Return the order of a discrete solution on uniform meshes, up to any epsilon and logarithms.

    The order is that of approximation, but in L^p not above twice the exponent, by duality with
    a dual solution of the same exponent: degree 2 does not raise the order beyond 2 unless the
    detachment point is a vertex. For degree 1 and a detachment point the orders are those of the
    paper's theorems.

    Args:
        norm: Name of a norm, see `names.parse_norm`.
        degree: Polynomial degree of the elements.
        exponent: The solution is like r^exponent at its worst point.
        dimension: See `approximation_order`.

    Returns:
        The order, or None in L^p and W^{1,p} of the boundary, where nothing is known.

    Raises:
        InputError: The norm is unknown.

    Source: Christof and Haubner, Theorems 4.3 and 6.1; Table 2 for L^16 and W^{1,16}.
    """
    parsed = parse_norm(norm)
    order = approximation_order(norm, degree, exponent, dimension)
    if parsed.boundary:
        return order if parsed.derivatives == 0.5 else None
    return min(order, 2.0 * min(1.0, exponent)) if parsed.derivatives == 0.0 else max(order, 0.0)


def expected_orders(degree: int, exponent: float, dimension: int = 2) -> dict[str, float]:
    """Return the orders of a discrete solution on uniform meshes in the norms listed of a scene.

    Args:
        degree: Polynomial degree of the elements.
        exponent: The solution is like r^exponent at its worst point.
        dimension: See `approximation_order`.
    """
    orders = {norm: expected_order(norm, degree, exponent, dimension) for norm in LISTED}
    return {norm: order for norm, order in orders.items() if order is not None}


def is_finite(norm: str | Norm, exponent: float, dimension: int = 2) -> bool:
    """Tell whether a norm of r^exponent is finite, and with it the norm of an error.

    The p-th power of s derivatives is like r^{(a - s) p}, whose integral is finite if and only if
    (a - s) p + d > 0, d the dimension; for p = inf the largest value is finite if a >= s. Where the
    expected order is negative the norm is infinite, whatever a quadrature rule or a finite number
    of samples says.

    Args:
        norm: The norm or its name, see `names.parse_norm`. The interpolation estimate
            H1_2_boundary is as finite as H1_boundary, the norm H1_2_boundary_spectral itself more
            often.
        exponent: The exponent a of r at the worst point.
        dimension: The dimension of the space in which r is the distance to a point: 2 in the plane
            and for the distance to an edge in space, 3 for the distance to a corner in space.

    Raises:
        InputError: The norm is unknown.
    """
    parsed = parse_norm(norm) if isinstance(norm, str) else norm
    if parsed.derivatives == 0.5 and not parsed.spectral:
        parsed = Norm(1.0, 2.0, boundary=True)
    order = singular_order(parsed, exponent, dimension)
    return order > 0.0 or (math.isinf(parsed.p) and order == 0.0)


def grading_exponent(degree: int, norm: str = "W1_inf") -> float:
    """Return the largest exponent mu of a grading that keeps the full order in a norm.

    Cells of the size h (r / R)^{1 - mu} at the distance r < R of a detachment point, and of the
    size R (h / R)^{1/mu} next to the point, keep the order of a smooth function if

        mu <= (3/2 - s + d/p) / (k + 1 - s):

    the error is like h(r)^{k+1-s} r^{3/2-k-1} on a cell at distance r, and like h(0)^{3/2-s} in the
    cells at the point.
    The number of cells grows by a constant factor only. No norm on the domain asks for a stronger
    grading than W^{1,inf} does: mu = 1/(2k).

    Args:
        degree: Polynomial degree k of the elements.
        norm: Name of a norm, see `names.parse_norm`.

    Returns:
        mu, at most 1, which stands for no grading.
    """
    parsed = parse_norm(norm)
    return min(1.0, singular_order(parsed, DETACHMENT_EXPONENT) / _smooth(parsed, degree))


def _smooth(norm: Norm, degree: int) -> float:
    """The order in which elements approximate a smooth function."""
    return degree + 1.0 - norm.derivatives


def singular_order(norm: Norm, exponent: Numbers, dimension: int = 2) -> Numbers:
    """Return the order in which elements of a high degree approximate r^exponent."""
    return exponent - norm.derivatives + (dimension - norm.boundary) / norm.p
