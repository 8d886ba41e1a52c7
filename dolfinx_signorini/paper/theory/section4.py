"""Sections 4, 6 and 7 against their measurements: orders of u - u_h in all norms."""

import functools
import math
from collections.abc import Iterable

from dolfinx_signorini.paper.theory.checks import (
    TOLERANCE,
    Check,
    Row,
    Rows,
    bound_check,
    entry,
    fine,
    number,
    order_check,
    order_table,
    orders,
    table,
)
from dolfinx_signorini.paper.theory.experiments import (
    ROUGH_EXPONENTS,
    critical_norm,
    placed_name,
    rough_name,
)
from dolfinx_signorini.paper.theory.placement import PLACES, relative_errors
from dolfinx_signorini.paper.theory.proven import (
    ProvenOrder,
    allowed_order,
    proven_order,
)

LOWER = tuple(p for p in ROUGH_EXPONENTS if p < 4.0)
UPPER = tuple(p for p in ROUGH_EXPONENTS if p > 4.0)
PAPER_NORMS = ("W1_2.6", "W1_4", "W1_inf", "Linf", "H1_2_boundary_spectral")
PLACED_NORMS = ("L4", "L16", "Linf", "W1_4", "W1_16", "W1_inf", "H1_2_boundary_spectral")
FINE = 101  # cells per side: from here on the parts near and far are apart


def corollary_norms(p: float) -> tuple[str, ...]:
    """Return the norms of Corollaries 4.1 (p < 4) and 4.2 (p > 4)."""
    below = ("L2", "L4", "L16") if p < 4.0 else ()
    return (critical_norm(p), "W1_inf", *below, "Linf", "H1_2_boundary_spectral")


def corollary_4_1(rows: Rows) -> list[Check]:
    """Orders for u in W^{2,p}, 2 < p < 4."""
    return [check for p in LOWER for check in _corollary(rows, p)]


def corollary_4_2(rows: Rows) -> list[Check]:
    """Orders for u = u_s + u_r, p > 4."""
    return [check for p in UPPER for check in _corollary(rows, p)]


def _corollary(rows: Rows, p: float) -> Iterable[Check]:
    for norm in corollary_norms(p):
        allowed = allowed_order(p, norm)
        yield order_check(
            f"u - u_h in {norm}, p = {p:g}",
            rows[rough_name(p)],
            entry("errors", norm),
            proven_order(p, norm),
            f"the regularity ends at one point only, which allows {allowed:.3g}",
        )


def corollary_4_1_tables(rows: Rows) -> list[tuple[str, str]]:
    """Errors and orders for each p below 4."""
    return [_corollary_table(rows, p) for p in LOWER]


def corollary_4_2_tables(rows: Rows) -> list[tuple[str, str]]:
    """Errors and orders for each p above 4."""
    return [_corollary_table(rows, p) for p in UPPER]


def _corollary_table(rows: Rows, p: float) -> tuple[str, str]:
    values = {norm: entry("errors", norm) for norm in corollary_norms(p)}
    return f"u - u_h, p = {p:g}", order_table(rows[rough_name(p)], values)


def theorem_4_3(rows: Rows) -> list[Check]:
    """The optimal orders of the paper's solution."""
    better = "two parts: the part near the detachment point has the proven order, the other one 2"
    return [
        order_check(
            f"u - u_h in {norm}",
            fine(rows["paper"], FINE),
            entry("errors", norm),
            proven_order(math.inf, norm),
            better,
        )
        for norm in PAPER_NORMS
    ]


def theorem_4_3_tables(rows: Rows) -> list[tuple[str, str]]:
    """Errors and orders of the paper's solution."""
    values = {norm: entry("errors", norm) for norm in PAPER_NORMS}
    return [("u - u_h, the paper's solution", order_table(fine(rows["paper"]), values))]


def theorem_6_1(rows: Rows) -> list[Check]:
    """All orders of the paper's solution."""
    proven = proven_order(math.inf, "L4", contact_sets=True)
    family = fine(rows["paper"], FINE)
    signed = [
        order_check(f"(u - u_h)^{sign} in L4", family, entry("signed", key), proven)
        for sign, key in (("+", "plus"), ("-", "minus"))
    ]
    return [*signed, *theorem_4_3(rows)]


def theorem_6_1_tables(rows: Rows) -> list[tuple[str, str]]:
    """The L^4 errors, with their two parts."""
    values = {
        "L4": entry("errors", "L4"),
        "(u - u_h)^+": entry("signed", "plus"),
        "(u - u_h)^-": entry("signed", "minus"),
    }
    return [("u - u_h in L4, the paper's solution", order_table(fine(rows["paper"]), values))]


def transition(rows: Rows) -> list[Check]:
    """The orders past p = 4, and what the two parts of the error contribute."""
    family = fine(rows["paper"], FINE)
    checks = [
        order_check(
            f"u - u_h in {norm}, {part}",
            family,
            entry("parts", part, norm),
            ProvenOrder(order, True, "Table 2"),
            reason,
        )
        for norm, part, order, reason in (
            ("L16", "near", 1.625, ""),
            ("W1_16", "near", 0.625, ""),
            ("L16", "far", 1.625, "order 2 of the smooth part of the solution"),
            ("W1_16", "far", 0.625, "order 1 of the smooth part of the solution"),
        )
    ]
    defect = max(abs(sum(_shares(norm, row)) - 1.0) for row in family for norm in ("L16", "W1_16"))
    whole = "near^16 + far^16 against the 16th power of the whole error"
    return [*checks, bound_check(whole, "equal", defect, f"equal to {number(defect)}")]


def _shares(norm: str, row: Row) -> tuple[float, float]:
    """The shares of the parts near and far in the 16th power of the error."""
    whole = row["errors"][norm]
    return (row["parts"]["near"][norm] / whole) ** 16, (row["parts"]["far"][norm] / whole) ** 16


def _share_near(norm: str, row: Row) -> float:
    return _shares(norm, row)[0]


def transition_tables(rows: Rows) -> list[tuple[str, str]]:
    """The whole error and its parts, with the share of the part near the point."""
    result = []
    family = fine(rows["paper"], FINE)
    for norm in ("L16", "W1_16"):
        values = {
            norm: entry("errors", norm),
            "near": entry("parts", "near", norm),
            "far": entry("parts", "far", norm),
        }
        shares = {"share of near": functools.partial(_share_near, norm)}
        text = order_table(family, values, shares)
        result.append((f"u - u_h in {norm} and its parts", text))
    return result


def placement(rows: Rows) -> list[Check]:
    """The orders hold wherever in its cell the detachment point lies."""
    checks = []
    for place in PLACES:
        family = rows[placed_name(place)]
        margins = {
            norm: orders(family, entry("errors", norm))[-1]
            - proven_order(math.inf, norm, contact_sets=True).value
            for norm in PLACED_NORMS
        }
        worst = min(margins, key=lambda norm: margins[norm])
        checks.append(
            Check(
                f"orders of u - u_h in {len(PLACED_NORMS)} norms, point at {place:g} of an edge",
                "those of Theorem 6.1",
                f"at the least {margins[worst]:+.3f} of them, in {worst}",
                margins[worst] >= -TOLERANCE,
            )
        )
    return checks


def placement_tables(rows: Rows) -> list[tuple[str, str]]:
    """Errors by place, relative to the point on a node; the worst place of each norm."""
    families = {place: rows[placed_name(place)] for place in PLACES}
    lines = []
    for norm in PLACED_NORMS:
        last = {place: found[-1] for place, found in relative_errors(families, norm).items()}
        worst = max(last, key=lambda place: last[place])
        lines.append([norm, *(f"{last[place]:.4f}" for place in PLACES), f"{worst:g}"])
    n = families[0.0][-1]["n"]
    columns = ("norm", *(f"at {place:g}" for place in PLACES), "worst")
    return [(f"Error over that with the point on a node, N = {n}", table(columns, lines))]
