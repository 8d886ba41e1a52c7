"""The checks of Sections 4, 6 and 7: the errors of u_h in all norms."""

import math
from collections.abc import Sequence

from dolfinx_signorini.studies.paper.theory.checks import (
    TRACE_CONSTANT,
    Check,
    Limit,
    Order,
    Row,
    Rows,
    Slope,
    Within,
    entry,
    interpolation_constant,
    over,
)
from dolfinx_signorini.studies.paper.theory.examples import COMPOSED, PLACES
from dolfinx_signorini.studies.paper.theory.families import (
    POWER_EXPONENTS,
    SHARP_EXPONENT,
    placed_name,
    power_name,
)
from dolfinx_signorini.studies.paper.theory.measures import TRACE
from dolfinx_signorini.studies.paper.theory.proven import allowed_order, proven_order

LOWER = tuple(p for p in POWER_EXPONENTS if p < 4.0)
UPPER = tuple(p for p in POWER_EXPONENTS if 4.0 < p < math.inf)
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
SHARP = ("W1_inf", "Linf")  # norms in which one solution is as bad as the theorem allows
FINE = 49
TRANSITION = {"L16": (1.625, 2.0), "W1_16": (0.625, 1.0)}  # near the point and away from there
TABLE_1 = {"L4": (5.8745e-4, 6.0007e-6), "W1_4": (1.3044e-1, 1.3395e-2)}  # N = 101 and 1001
PLACED = ("L4", "L16", "Linf", "W1_4", "W1_16", "W1_inf", TRACE)


def best_order(norm: str) -> float:
    """Return the order of a smooth solution: the most that linear elements can reach."""
    # The H^{1/2} error has parts of orders 3/2 and 2.
    return 1.6 if norm == TRACE else (1.0 if norm.startswith("W") else 2.0)


def _powers(exponents: Sequence[float]) -> tuple[Check, ...]:
    """Problem (3) with a pure power: not below the proven order, and the order of approximation."""
    checks = []
    for p in exponents:
        proven, value = "1" if p < 4.0 else "1 - eps", entry("critical")
        column = f"W^{{1,4p/(p+{2 if p < 4.0 else 4})}}"
        rule, experiments = Order(1.0, 1.0), (power_name(p),)
        checks.append(Check(f"p = {p:g}", proven, experiments, value, rule, FINE, column))
        for norm in (*MAIN, "L4"):
            order, value = proven_order(p, norm), entry("errors", norm)
            allowed = allowed_order(p, norm)
            above = 0.06 if p > 4.0 and norm not in ("L4", TRACE) else 0.0
            text = f"{order.value:.3g} - eps"  # in W^{2,q} for q < p only
            rule = Order(max(order.value, allowed), max(order.value, allowed) + above)
            column = NAMES[norm]
            checks.append(Check(f"p = {p:g}", text, experiments, value, rule, FINE, column))
    return tuple(checks)


def _theorem(experiment: str, norms: Sequence[str], first: int = FINE) -> tuple[Check, ...]:
    """Errors of a solution with strong points: sharp in sup norms, at best smooth in the others."""
    checks = []
    for norm in norms:
        proven = proven_order(math.inf, norm)
        high = best_order(norm)
        if norm in SHARP and experiment == "paper":
            high = proven.value + (0.02 if norm == "Linf" else 0.0)
        rule, value, column = Order(proven.value, high), entry("errors", norm), NAMES[norm]
        checks.append(Check(experiment, str(proven), (experiment,), value, rule, first, column))
    return tuple(checks)


def _logarithms() -> tuple[Check, ...]:
    """W^{1,4} and H^{1/2} against the best possible constants."""
    B = interpolation_constant()
    four, half = over(entry("errors", "W1_4"), 1.0, to=4.0), over(entry("errors", TRACE), 1.5, to=2)
    return (
        Check(
            "(W^{1,4} error / h)^4 grows with ln N, problem (3)",
            f"B = {B:.4f}",
            (power_name(math.inf),),
            four,
            Slope(B, 0.01),
        ),
        Check(
            "(W^{1,4} error / h)^4 grows with ln N, paper",
            f"10^4 B = {1e4 * B:.0f}",
            ("paper",),
            four,
            Slope(1e4 * B, 0.25),
        ),
        Check(
            "(H^{1/2} error / h^{3/2})^2 grows with ln N, problem (3)",
            f"{TRACE_CONSTANT:.5f}",
            (power_name(math.inf),),
            half,
            Slope(TRACE_CONSTANT, 0.15),
        ),
    )


def share(row: Row, norm: str) -> float:
    """Return the part near the point and the one away, in the 16th power, over the whole.

    Args:
        row: A row with the errors and their parts.
        norm: The norm.
    """
    parts = row["parts"]
    return float(sum((parts[k][norm] / row["errors"][norm]) ** 16 for k in ("near", "far")))


def _placement() -> tuple[Check, ...]:
    norms = ("W1_4", "W1_inf", "Linf", TRACE, "L4")
    proven = {norm: proven_order(math.inf, norm, contact_sets=True) for norm in norms}
    return tuple(
        Check(
            f"point at {place:g} of an edge",
            str(order),
            (placed_name(place),),
            entry("errors", norm),
            Order(order.value, best_order(norm)),
            column=NAMES[norm],
        )
        for place in PLACES
        for norm, order in proven.items()
    )


class Middle(Check):
    """A check of all places together: the error in the middle over the largest at other places."""

    def figures(self, rows: Rows) -> list[tuple[int, float]]:
        """Return the quotient in the norm where it is largest, on the finest mesh."""
        last = {place: rows[placed_name(place)][-1] for place in PLACES}
        errors = {place: self.value(row) for place, row in last.items()}
        quotients = [
            errors[0.5][norm] / max(errors[place][norm] for place in PLACES if place != 0.5)
            for norm in PLACED
        ]
        return [(last[0.5]["n"], float(max(quotients)))]


def _table_1(row: Row, norm: str) -> float | None:
    known = dict(zip((101, 1001), TABLE_1[norm], strict=True))
    return row["errors"][norm] / known[row["n"]] if row["n"] in known else None


CHECKS: dict[str, tuple[Check, ...]] = {
    "4.1": (
        *_powers(LOWER),
        Check(
            "(16): u - I_h(u) in H^{1/2} of the boundary, paper",
            "3/2 - eps",
            ("paper",),
            entry("interpolation"),
            Order(1.5, 1.5),
            101,
        ),
    ),
    "4.2": _powers(UPPER),
    "4.3": (
        *_theorem("paper", MAIN, 101),
        *(check for name in COMPOSED for check in _theorem(name, MAIN)),
    ),
    "4.4.1": _logarithms(),
    "4.4.3": (
        Check(
            "largest over smallest diameter of cells and their circles",
            "<= C",
            ("unstructured", "obtuse"),
            entry("shape"),
            Within(1.0, 8.0),
        ),
        Check(
            "largest angle in degrees, obtuse",
            "any",
            ("obtuse",),
            entry("angle"),
            Within(100.0, 180.0),
        ),
        *(check for name in ("unstructured", "obtuse") for check in _theorem(name, MAIN)),
        Check(
            "u - u_h in W^{1,inf}, cells graded towards the point (not quasi-uniform)",
            "not covered",
            ("graded",),
            entry("errors", "W1_inf"),
            Order(0.9, 1.0),
        ),
        Check(
            "R_h(u) - u_h in H^1, bumps of all scales, p = 3, without (A)",
            f"{1.5 - 1.0 / SHARP_EXPONENT:.3g}",
            ("sharp",),
            entry("supercloseness"),
            Order(1.5 - 1.0 / SHARP_EXPONENT, 1.5),
            FINE,
        ),
    ),
    "6.1": tuple(
        Check(
            f"u - u_h in L^4, {name}",
            "2 - eps",
            (name,),
            entry("errors", "L4"),
            Order(2.0, 2.0),
            FINE,
        )
        for name in ("paper", "two", "three", "corner", "weak", "unstructured", "obtuse")
    ),
    "6.2.4": tuple(
        Check(
            f"(u - u_h)^- in L^4 without (A_h), {name}",
            "2 - eps under (A_h)",
            (name,),
            entry("signed", "minus"),
            Order(2.0, 2.0),
            FINE,
        )
        for name in ("two", "three")
    ),
    "6.2.6": (
        Check(
            "u - u_h in L^4, bumps of all scales, p = 3, without (A)",
            "none",
            ("sharp",),
            entry("errors", "L4"),
            Order(1.5 - 1.0 / SHARP_EXPONENT, 2.0),
            FINE,
        ),
        Check(
            "u - u_h in L^4, bumps of all scales, bounded load, without (A)",
            "none",
            ("sharp inf",),
            entry("errors", "L4"),
            Order(1.75, 2.0),  # still rising
            FINE,
        ),
    ),
    "7": (
        *_placement(),
        Middle(
            "error with the point in the middle over the worst other place, largest of 7 norms",
            "> 1 by the remark",
            tuple(map(placed_name, PLACES)),
            entry("errors"),
            Within(0.5, 1.0),
        ),
    ),
    "table1": tuple(
        Check(
            f"u - u_h in {NAMES[norm]} over Table 1, N = 101 and 1001",
            "1",
            ("paper",),
            lambda row, norm=norm: _table_1(row, norm),  # type: ignore[misc]
            Limit(1.0, 2e-4),
        )
        for norm in TABLE_1
    ),
    "table2": (
        *(
            Check(
                f"u - u_h in {NAMES[norm]}, within 8 cells of the point",
                f"{near} - eps",
                ("paper",),
                entry("parts", "near", norm),
                Order(near, near, 0.02),
                101,
            )
            for norm, (near, _) in TRANSITION.items()
        ),
        Check(
            "u - u_h in L^16, away from the point",
            "2 - eps",
            ("paper",),
            entry("parts", "far", "L16"),
            Order(2.0, 2.0, 0.02),
            101,
        ),
        *(
            Check(
                f"both parts together over the whole, {NAMES[norm]}",
                "1",
                ("paper",),
                lambda row, norm=norm: share(row, norm),  # type: ignore[misc]
                Within(1.0 - 1e-9, 1.0 + 1e-9),
                101,
            )
            for norm in TRANSITION
        ),
    ),
}
