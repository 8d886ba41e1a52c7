"""The orders of convergence that the paper proves, from the regularity of the solution."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from dolfinx_signorini.norms import Norm, parse_norm


@dataclass(frozen=True)
class Regularity:
    """What is known of a solution.

    Attributes:
        p: Exponent. Below 4: u is in W^{2,p}. Above 4: u = u_s + u_r as in Theorem 2.3, with
            u_r in W^{2,p}; infinity for every finite p.
        contact_sets: Whether conditions (A) and (A_h) hold and the load is bounded.
    """

    p: float
    contact_sets: bool = False


@dataclass(frozen=True)
class ProvenOrder:
    """An order of convergence.

    Attributes:
        value: The order; reached up to an arbitrarily small loss where `open` is set.
        open: Whether "minus epsilon" belongs to it.
        source: The statement of the paper.
    """

    value: float
    open: bool
    source: str

    def __str__(self) -> str:
        return f"{self.value:.4g}" + (" - eps" if self.open else "")


def supercloseness_order(p: float) -> ProvenOrder:
    """Return the order of ||R_h(u) - u_h||_H1, which is also that of ||w_h||_H1 in Lemma 3.5.

    Args:
        p: As in `Regularity`.

    Raises:
        ValueError: p is not between 2 and 4, nor above 4.

    Source: Theorem 3.6.
    """
    return _best(p, _supercloseness)


def proven_order(regularity: Regularity, norm: str) -> ProvenOrder:
    """Return the best order of ||u - u_h|| in a norm that follows from the paper's statements.

    W^{1,q} and L^q with a q that the statements do not name follow from those they name by
    inverse estimates, for q above, and by Hoelder's inequality, for q below, as in the last row of
    the paper's Table 2. A solution with p > 4 is in W^{2,4-eps} as well, and for p < 8 some orders
    are better that way.

    Args:
        regularity: What is known of u.
        norm: A name that `dolfinx_signorini.norms.parse_norm` knows, on the domain or
            H1_2_boundary.

    Raises:
        ValueError: The norm is unknown or nothing is proven for it, or p is out of range.

    Source: Corollaries 4.1 and 4.2, Theorems 4.3 and 6.1.
    """
    wanted = parse_norm(norm)
    if wanted.boundary and wanted.derivatives != 0.5:
        raise ValueError(f"norm {norm!r}: nothing is proven for it on the boundary")
    best = _best(regularity.p, lambda p, open_: _corollary(p, open_, wanted))
    duality = wanted.derivatives == 0 and regularity.contact_sets and math.isinf(regularity.p)
    if not duality:
        return best
    # 2 - eps in L^4; above, the inverse estimate takes 1/2 - 2/q of it.
    value = 2.0 if wanted.p <= 4.0 else 1.5 + 2.0 / wanted.p
    return ProvenOrder(value, True, "Theorem 6.1")


def singular_order(exponent: float, norm: str) -> float:
    """Return the order in which linear elements on uniform meshes resolve r^exponent at a point.

    It explains where measured orders are better than the proven ones, which hold for every
    function of the same regularity.

    Args:
        exponent: Between 1 and 2.
        norm: A name that `dolfinx_signorini.norms.parse_norm` knows.

    Source: the error of interpolation, h^exponent times a function of x/h.
    """
    wanted = parse_norm(norm)
    if wanted.derivatives == 0.5:
        return min(1.5, exponent)
    dimension = 1.0 if wanted.boundary else 2.0
    return min(2.0 - wanted.derivatives, exponent - wanted.derivatives + dimension / wanted.p)


def _best(p: float, order: Callable[[float, bool], ProvenOrder]) -> ProvenOrder:
    """The better of the order for p and, above 4, that of W^{2,4-eps}."""
    if not (2.0 < p < 4.0 or p > 4.0):
        raise ValueError(f"p: the statements hold for 2 < p < 4 and for p > 4, not for {p}")
    if p < 4.0:
        return order(p, False)
    return max(order(p, True), order(4.0, True), key=lambda found: (found.value, not found.open))


def _supercloseness(p: float, above: bool) -> ProvenOrder:
    return ProvenOrder(1.5 - (2.0 if p > 4.0 else 1.0) / p, above, "Theorem 3.6")


def _corollary(p: float, above: bool, norm: Norm) -> ProvenOrder:
    base = _supercloseness(p, above)
    source = "Theorem 4.3" if math.isinf(p) else f"Corollary 4.{2 if p > 4.0 else 1}"
    if norm.derivatives == 1.0:
        # Order 1 up to an exponent, here excluded for p = 4 as the limit of p < 4; above it
        # supercloseness less the inverse estimate from H^1.
        critical = 2.0 / (0.5 + (2.0 if p > 4.0 else 1.0) / p)
        if norm.p < critical or (norm.p == critical and p != 4.0):
            return ProvenOrder(1.0, p > 4.0, source)
        return ProvenOrder(base.value - 1.0 + 2.0 / norm.p, above, source)
    # |ln h|^{1/2} in L^inf is less than any power of h.
    logarithm = norm.derivatives == 0.0 and math.isinf(norm.p)
    return ProvenOrder(base.value, above or logarithm, source)
