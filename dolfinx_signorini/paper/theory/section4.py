"""Sections 4, 6 and 7 against their measurements: orders of u - u_h in all norms."""

import math
from collections.abc import Mapping, Sequence
from functools import partial

from dolfinx_signorini.paper.theory.evidence import (
    ROUNDING,
    TOLERANCE,
    Check,
    Row,
    Rows,
    Tables,
    entry,
    fine,
    number,
    order_check,
    order_table,
    orders,
)
from dolfinx_signorini.paper.theory.examples import PLACES
from dolfinx_signorini.paper.theory.experiments import (
    ROUGH_EXPONENTS,
    critical_norm,
    placed_name,
    rough_name,
)
from dolfinx_signorini.paper.theory.proven import ProvenOrder, allowed_order, proven_order
from dolfinx_signorini.tables import markdown_table

LOWER = tuple(p for p in ROUGH_EXPONENTS if p < 4.0)
UPPER = tuple(p for p in ROUGH_EXPONENTS if p > 4.0)
PAPER_NORMS = ("W1_2.6", "W1_4", "W1_inf", "Linf", "H1_2_boundary_spectral")
PLACED_NORMS = ("L4", "L16", "Linf", "W1_4", "W1_16", "W1_inf", "H1_2_boundary_spectral")
TRANSITION = {"L16": (1.625, 2), "W1_16": (0.625, 1)}  # orders near the point and away from there
FINE = 101  # cells per side: from here on the parts near and far are apart


def corollary_norms(p: float) -> tuple[str, ...]:
    """Return the norms of Corollaries 4.1 (p < 4) and 4.2 (p > 4)."""
    below = ("L2", "L4", "L16") if p < 4.0 else ()
    return (critical_norm(p), "W1_inf", *below, "Linf", "H1_2_boundary_spectral")


def _corollary(exponents: Sequence[float], rows: Rows) -> list[Check]:
    """Compare the orders of the rough solutions with those of a corollary."""
    checks = []
    for p in exponents:
        for norm in corollary_norms(p):
            what, value = f"u - u_h in {norm}, p = {p:g}", entry("errors", norm)
            allowed = allowed_order(p, norm)
            reason = f"the regularity ends at one point only, which allows {allowed:.3g}"
            proven = proven_order(p, norm)
            checks.append(order_check(what, rows[rough_name(p)], value, proven, reason))
    return checks


def _corollary_tables(exponents: Sequence[float], rows: Rows) -> Tables:
    """Return tables of errors and orders for each exponent."""
    tables = []
    for p in exponents:
        values = {norm: entry("errors", norm) for norm in corollary_norms(p)}
        tables.append((f"u - u_h, p = {p:g}", order_table(rows[rough_name(p)], values)))
    return tables


corollary_4_1, corollary_4_1_tables = partial(_corollary, LOWER), partial(_corollary_tables, LOWER)
corollary_4_2, corollary_4_2_tables = partial(_corollary, UPPER), partial(_corollary_tables, UPPER)


def theorem_4_3(rows: Rows) -> list[Check]:
    """Compare the orders of the paper's solution with the optimal ones."""
    better = "two parts: the part near the detachment point has the proven order, the other one 2"
    family = fine(rows["paper"], FINE)
    return [
        order_check(
            f"u - u_h in {norm}",
            family,
            entry("errors", norm),
            proven_order(math.inf, norm),
            better,
        )
        for norm in PAPER_NORMS
    ]


def theorem_4_3_tables(rows: Rows) -> Tables:
    """Return a table of errors and orders of the paper's solution."""
    values = {norm: entry("errors", norm) for norm in PAPER_NORMS}
    return [("u - u_h, the paper's solution", order_table(fine(rows["paper"]), values))]


def theorem_6_1(rows: Rows) -> list[Check]:
    """Compare all orders of the paper's solution with the proven ones."""
    proven = proven_order(math.inf, "L4", contact_sets=True)
    family = fine(rows["paper"], FINE)
    signed = [
        order_check(f"(u - u_h)^{sign} in L4", family, entry("signed", key), proven)
        for sign, key in (("+", "plus"), ("-", "minus"))
    ]
    return [*signed, *theorem_4_3(rows)]


def theorem_6_1_tables(rows: Rows) -> Tables:
    """Return a table of the L^4 errors, with their two parts."""
    values = {
        "L4": entry("errors", "L4"),
        "(u - u_h)^+": entry("signed", "plus"),
        "(u - u_h)^-": entry("signed", "minus"),
    }
    return [("u - u_h in L4, the paper's solution", order_table(fine(rows["paper"]), values))]


def transition(rows: Rows) -> list[Check]:
    """Compare the orders past p = 4 with the proven ones, and check that the parts add up."""
    family = fine(rows["paper"], FINE)
    checks = []
    for part in ("near", "far"):
        for norm, (near, far) in TRANSITION.items():
            reason = f"order {far} of the smooth part of the solution" if part == "far" else ""
            value, proven = entry("parts", part, norm), ProvenOrder(near, True, "Table 2")
            what = f"u - u_h in {norm}, {part}"
            checks.append(order_check(what, family, value, proven, reason))
    defect = max(
        abs(_share(row, "near", norm) + _share(row, "far", norm) - 1.0)
        for row in family
        for norm in TRANSITION
    )
    whole = "near^16 + far^16 against the 16th power of the whole error"
    return [*checks, Check(whole, "equal", f"equal to {number(defect)}", defect <= ROUNDING)]


def transition_tables(rows: Rows) -> Tables:
    """Return tables of the whole error and its parts, with the share of the part near the point."""
    return [
        (f"u - u_h in {norm} and its parts", _transition_table(fine(rows["paper"], FINE), norm))
        for norm in TRANSITION
    ]


def _transition_table(family: Sequence[Row], norm: str) -> str:
    values = {
        norm: entry("errors", norm),
        "near": entry("parts", "near", norm),
        "far": entry("parts", "far", norm),
    }
    return order_table(family, values, {"share of near": lambda row: _share(row, "near", norm)})


def _share(row: Row, part: str, norm: str) -> float:
    """The share of a part in the 16th power of the error."""
    return float((row["parts"][part][norm] / row["errors"][norm]) ** 16)


def relative_errors(rows: Mapping[float, Sequence[Row]], norm: str) -> dict[float, list[float]]:
    """Return the error of each place over that of the point on a node, mesh by mesh.

    Args:
        rows: Rows with "errors" by place, over the same meshes.
        norm: The norm.
    """
    on_node = [row["errors"][norm] for row in rows[0.0]]
    return {
        place: [row["errors"][norm] / error for row, error in zip(found, on_node, strict=True)]
        for place, found in rows.items()
    }


def placement(rows: Rows) -> list[Check]:
    """Check that the orders hold wherever in its cell the detachment point lies."""
    checks = []
    for place in PLACES:
        margins = {}
        for norm in PLACED_NORMS:
            order = orders(rows[placed_name(place)], entry("errors", norm))[-1]
            margins[norm] = order - proven_order(math.inf, norm, contact_sets=True).value
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


def placement_tables(rows: Rows) -> Tables:
    """Return a table of errors by place, relative to the point on a node, with the worst place."""
    families = {place: rows[placed_name(place)] for place in PLACES}
    lines = []
    for norm in PLACED_NORMS:
        last = {place: found[-1] for place, found in relative_errors(families, norm).items()}
        worst = max(last, key=lambda place: last[place])
        lines.append([norm, *(f"{last[place]:.4f}" for place in PLACES), f"{worst:g}"])
    n = families[0.0][-1]["n"]
    columns = ("norm", *(f"at {place:g}" for place in PLACES), "worst")
    title = f"Error over that with the point on a node, N = {n}"
    return [(title, markdown_table(columns, lines))]
