"""Checks whose orders follow from the theorems: one for each norm and each experiment."""

import math
from collections.abc import Callable, Mapping

from dolfinx_signorini.studies.paper.theory.checks import (
    TRACE_CONSTANT,
    Check,
    Order,
    Slope,
    entry,
    interpolation_constant,
    over,
)
from dolfinx_signorini.studies.paper.theory.measures import TRACE
from dolfinx_signorini.studies.paper.theory.proven import (
    allowed_order,
    proven_order,
    supercloseness_order,
)

NAMES = {
    "W1_2.6": "W^{1,2.6}",
    "W1_4": "W^{1,4}",
    "W1_16": "W^{1,16}",
    "W1_inf": "W^{1,inf}",
    "L4": "L^4",
    "L16": "L^16",
    "Linf": "L^inf",
    TRACE: "H^{1/2} of the boundary",
}
MAIN = ("W1_2.6", "W1_4", "W1_inf", "Linf", TRACE)
FINE = 49  # cells per side


def best_order(norm: str) -> float:
    """Return the order of a smooth solution: the most that linear elements can reach."""
    # The H^{1/2} error has parts of orders 3/2 and 2.
    return 1.6 if norm == TRACE else (1.0 if norm.startswith("W") else 2.0)


def supercloseness(exponent: str, what: str, of: str) -> list[Check]:
    """Return the check of a rough solution: at least the proven order, at most a smooth one's."""
    p = float(exponent)
    proven = supercloseness_order(p).value
    text, value = f"{proven:.3g} - eps", entry(of)  # in W^{2,q} for q < p only
    return [Check(what, text, (f"rough {p:g}",), value, Order(proven, 2.0), FINE)]


def powers(exponent: str) -> list[Check]:
    """Return problem (3) with a power: not below the proven order, and that of approximation."""
    p, low = float(exponent), float(exponent) < 4.0
    what, experiments = f"p = {p:g}", (f"power {p:g}",)
    column = f"W^{{1,4p/(p+{2 if low else 4})}}"
    text, rule = "1" if low else "1 - eps", Order(1.0, 1.0)
    checks = [Check(what, text, experiments, entry("critical"), rule, FINE, column)]
    for norm in (*MAIN, "L4"):
        proven, value = proven_order(p, norm).value, entry(f"errors/{norm}")
        order = max(proven, allowed_order(p, norm))
        rule = Order(order, order + (0.0 if low or norm in ("L4", TRACE) else 0.06))
        text = f"{proven:.3g} - eps"  # in W^{2,q} for q < p only
        checks.append(Check(what, text, experiments, value, rule, FINE, NAMES[norm]))
    return checks


def theorem(on: str, first: int = FINE) -> list[Check]:
    """Return errors of solutions with strong points: one is as bad in sup norms as can be."""
    checks = []
    for norm in MAIN:
        proven, high = proven_order(math.inf, norm), best_order(norm)
        if on == "paper" and norm in ("W1_inf", "Linf"):
            high = proven.value + (0.02 if norm == "Linf" else 0.0)
        rule, value = Order(proven.value, high), entry(f"errors/{norm}")
        checks.append(Check(on, str(proven), (on,), value, rule, first, NAMES[norm]))
    return checks


def placement(place: str) -> list[Check]:
    """Return errors with the detachment point at a place of an edge."""
    checks = []
    for norm in ("W1_4", "W1_inf", "Linf", TRACE, "L4"):
        proven = proven_order(math.inf, norm, contact_sets=True)
        rule, value = Order(proven.value, best_order(norm)), entry(f"errors/{norm}")
        what, on = f"point at {place} of an edge", (f"placed {place}",)
        checks.append(Check(what, str(proven), on, value, rule, column=NAMES[norm]))
    return checks


def logarithms() -> list[Check]:
    """Return W^{1,4} and H^{1/2} errors beside the best possible constants."""
    B, point = interpolation_constant(), "power inf"
    four = over(entry("errors/W1_4"), 1.0, to=4.0)
    half = over(entry(f"errors/{TRACE}"), 1.5, to=2.0)
    gradient, trace = "(W^{1,4} error / h)^4", "(H^{1/2} error / h^{3/2})^2"
    grows, short = "grows with ln N, problem (3)", f"{TRACE_CONSTANT:.5f}"
    paper = f"{gradient} grows with ln N, paper"
    return [
        Check(f"{gradient} {grows}", f"B = {B:.4f}", (point,), four, Slope(B, 0.01)),
        Check(paper, f"10^4 B = {1e4 * B:.0f}", ("paper",), four, Slope(1e4 * B, 0.25)),
        Check(f"{trace} {grows}", short, (point,), half, Slope(TRACE_CONSTANT, 0.15)),
    ]


TABLES: Mapping[str, Callable[..., list[Check]]] = {
    table.__name__: table for table in (supercloseness, powers, theorem, placement, logarithms)
}
