"""The orders of convergence that the paper proves.

What is known of a solution u is an exponent p. Below 4, u is in W^{2,p}. Above 4, u = u_s + u_r as
in Theorem 2.3, with u_r in W^{2,p}; infinity stands for every finite p.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import basix
import numpy as np
from scipy.special import zeta

from dolfinx_signorini.meshes.quadrature import QuadratureRule
from dolfinx_signorini.norms.names import Norm, parse_norm
from dolfinx_signorini.norms.orders import (
    DETACHMENT_EXPONENT,
    SMOOTH,
    approximation_order,
    expected_order,
)

TRACE = "H1_2_boundary_spectral"


@dataclass(frozen=True)
class ProvenOrder:
    """An order of convergence, whose text is the order:

        assert str(ProvenOrder(1.5, True)) == "1.5 - eps"

    Attributes:
        value: The order; reached up to an arbitrarily small loss where `open` is set.
        open: Whether "minus epsilon" belongs to the order.
    """

    value: float
    open: bool

    def __str__(self) -> str:
        return f"{self.value:.4g}" + (" - eps" if self.open else "")


def printed(norm: str) -> str:
    """Return how the document prints a norm of the domain, or that of the trace."""
    if norm == TRACE:
        return "H^{1/2} of the boundary"
    known = parse_norm(norm)
    return f"W^{{1,{known.p:g}}}" if known.derivatives else f"L^{known.p:g}"


def power_exponents(p: float) -> tuple[float, ...]:
    """Return the b of a solution like the sum of r^b at one point, with the regularity p.

    With b = 2 - 2/p second derivatives like r^{b-2} are in L^q for q < p only. Above 4 the solution
    has a part like r^{3/2} as well, and nothing else for infinity.
    """
    if math.isinf(p):
        return (DETACHMENT_EXPONENT,)
    b = 2.0 - 2.0 / p
    return (b,) if p < 4.0 else (DETACHMENT_EXPONENT, b)


def critical_exponent(p: float) -> float:
    """Return the q of W^{1,q} up to which Corollaries 4.1 and 4.2 prove the order 1."""
    return 2.0 / (0.5 + (2.0 if p > 4.0 else 1.0) / p)


def allowed_order(p: float, norm: str) -> float:
    """Return the order that a solution allows whose regularity ends at one point only.

    This order explains where measured orders are better than the proven ones, which hold for
    every function of the same regularity.
    """
    return approximation_order(norm, exponent=min(power_exponents(p)))


def smooth_order(norm: str) -> float:
    """Return the order of a smooth solution: the most that linear elements can reach."""
    # The H^{1/2} error has parts of orders 3/2 and 2.
    return 1.6 if norm == TRACE else approximation_order(norm, exponent=SMOOTH)


def supercloseness_order(p: float) -> ProvenOrder:
    """Return the order of ||R_h(u) - u_h||_H1, which is also that of ||w_h||_H1 in Lemma 3.5.

    Raises:
        ValueError: p is not between 2 and 4, nor above 4.

    Source: Theorem 3.6.
    """
    return _best(p, _supercloseness)


def proven_order(p: float, norm: str, contact_sets: bool = False) -> ProvenOrder:
    """Return the best order of ||u - u_h|| in a norm that follows from the paper's statements.

    W^{1,q} and L^q with a q that the statements do not name follow from the named ones by
    inverse estimates, for q above, and by Hoelder's inequality, for q below, as in the last row of
    the paper's Table 2. A solution with p > 4 is in W^{2,4-eps} as well, and for p < 8 some orders
    are better that way.

    Args:
        p: The exponent of the solution.
        norm: Name of a norm on the domain, or H1_2_boundary, see `names.parse_norm`.
        contact_sets: Whether conditions (A) and (A_h) hold and the load is bounded.

    Raises:
        ValueError: The norm is unknown or nothing is proven for it, or p is out of range.

    Source: Corollaries 4.1 and 4.2, Theorems 4.3 and 6.1.
    """
    wanted, duality = parse_norm(norm), expected_order(norm)
    if duality is None:
        raise ValueError(f"norm {norm!r}: nothing is proven for it on the boundary")
    best = _best(p, lambda q, above: _corollary(q, above, wanted))
    if wanted.derivatives == 0.0 and contact_sets and math.isinf(p):
        return ProvenOrder(duality, True)  # Theorem 6.1
    return best


def _best(p: float, order: Callable[[float, bool], ProvenOrder]) -> ProvenOrder:
    """The better of the order for p and, above 4, that of W^{2,4-eps}."""
    if not (2.0 < p < 4.0 or p > 4.0):
        raise ValueError(f"p: the statements hold for 2 < p < 4 and for p > 4, not for {p}")
    if p < 4.0:
        return order(p, False)
    return max(order(p, True), order(4.0, True), key=lambda found: (found.value, not found.open))


def _supercloseness(p: float, above: bool) -> ProvenOrder:
    return ProvenOrder(1.5 - (2.0 if p > 4.0 else 1.0) / p, above)


def _corollary(p: float, above: bool, norm: Norm) -> ProvenOrder:
    base = _supercloseness(p, above)
    if norm.derivatives == 1.0:
        # Order 1 up to an exponent, here excluded for p = 4 as the limit of p < 4; above that
        # exponent supercloseness less the inverse estimate from H^1.
        critical = critical_exponent(p)
        if norm.p < critical or (norm.p == critical and p != 4.0):
            return ProvenOrder(1.0, p > 4.0)
        return ProvenOrder(base.value - 1.0 + 2.0 / norm.p, above)
    # |ln h|^{1/2} in L^inf is less than any power of h.
    logarithm = norm.derivatives == 0.0 and math.isinf(norm.p)
    return ProvenOrder(base.value, above or logarithm)


def interpolation_constant() -> float:
    """Return B of ||grad(u - I_h(u))||_L4^4 = h^4 (A + B ln(1/h) + ...) for u like r^{3/2}.

    On the Friedrichs-Keller triangulation the interpolation error of a quadratic function is known
    on both kinds of triangles; its Hessian at the angle theta is that of -r^{3/2} sin(3/2 theta),
    times r^{1/2}. R_h(u) is closer to I_h(u) than both are to u, so that u_h has the same constant.
    """
    theta = (np.arange(2000) + 0.5) * math.pi / 2000
    a, b = 0.75 * np.sin(0.5 * theta), -0.75 * np.cos(0.5 * theta)  # u_xx = -u_yy and u_xy
    points, weights = QuadratureRule("Gauss-Jacobi", 4).points(basix.CellType.triangle)
    x, y = points.sum(axis=1), points[:, 1]  # in the triangle (0, 0), (1, 0), (1, 1)
    first = np.outer(a, x - 0.5) + np.outer(b, y)
    second = np.outer(b, x - 1.0) - np.outer(a, y - 0.5)
    total = 2.0 * (first**4 + second**4) @ weights
    return float(total.mean() * math.pi)


CONSTANTS: Mapping[str, float] = {
    "B": interpolation_constant(),
    "10^4 B": 1e4 * interpolation_constant(),
    # sum over n of |n| |c_n|^2 of the interpolation error of s^{3/2} on edges
    "trace": 9.0 / 16.0 * float(zeta(3.0)) / (4.0 * math.pi**3),
}
