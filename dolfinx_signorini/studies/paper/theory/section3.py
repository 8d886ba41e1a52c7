"""The checks of Section 3: the Ritz projection, one-sided approximation, supercloseness."""

import math

from dolfinx_signorini.studies.paper.theory.checks import ROUNDING, Check, Order, Row, Within, entry
from dolfinx_signorini.studies.paper.theory.families import ROUGH_EXPONENTS, rough_name
from dolfinx_signorini.studies.paper.theory.measures import TRACE
from dolfinx_signorini.studies.paper.theory.proven import supercloseness_order

ROUGH = {rough_name(p): p for p in ROUGH_EXPONENTS}
STRONG = ("paper", "two", "three", "corner")
SCENES = (*STRONG, "weak", *ROUGH)
FINE = 49


def ratio(row: Row) -> float | None:
    """Return both sides of (9): the left one over the infimum."""
    return None if row["infimum"] is None else float(row["supercloseness"] / row["infimum"])


def printed(row: Row) -> float | None:
    """Return both sides of (9) as printed: with R_h(u) - u on the left."""
    return None if row["infimum"] is None else float(row["ritz"]["H1"] / row["infimum"])


def _projection() -> tuple[Check, ...]:
    checks = []
    for example, p in (("smooth", 2), ("smooth", 4), ("paper", 3)):
        gradient = "H1" if p == 2 else f"W1_{p}"
        for norm, column, proven, low, high in (
            (f"L{p}", "L^p", "2", 2.0, 2.0),
            (gradient, "W^{1,p}", "1", 1.0, 1.0),
            (f"L{p}_boundary", "L^p(∂Ω)", f"{2.0 - 1.0 / p:.4g}", 2.0 - 1.0 / p, 2.0),
            (TRACE, "H^{1/2}(∂Ω)", "3/2 - eps", 1.5, 1.55),
        ):
            what, value, rule = f"{example}, p = {p}", entry("ritz", norm), Order(low, high)
            checks.append(Check(what, proven, (example,), value, rule, FINE, column))
    return tuple(checks)


def _superclose(what: str, *keys: str) -> list[Check]:
    """The orders of rough solutions: at least the proven one, at most that of approximation."""
    checks = []
    for name, p in ROUGH.items():
        proven = supercloseness_order(p)
        text = f"{proven.value:.3g} - eps"  # in W^{2,q} for q < p only
        rule = Order(proven.value, 2.0)  # away from the point the order is 2
        checks.append(Check(f"{what}, p = {p:g}", text, (name,), entry(*keys), rule, FINE))
    return checks


CHECKS: dict[str, tuple[Check, ...]] = {
    "3.2": _projection(),
    "stability": tuple(
        Check(
            f"norm of R_h(v) in W^{{1,{p}}} over that of v, a kink across the cells",
            "<= C",
            ("kinked",),
            entry("stability", f"W1_{p}"),
            Within(0.5, 2.5),
        )
        for p in ("2", "16", "inf")
    ),
    "3.3": (
        Check(
            "smallest <du/dn, v_h - R_h(u)> over all v_h >= R_h(u) - u",
            ">= 0",
            ("paper",),
            entry("obstacle", "minimum"),
            Within(-ROUNDING, ROUNDING),
        ),
        Check(
            "(R_h(u), .)_H1 - (f, .) - <du/dn, .> over R_h(u) - u_h, in H^1",
            "0",
            ("paper",),
            entry("obstacle", "identity"),
            Within(0.0, 0.03),
        ),
        Check(
            "the same minimum with the constraint at the nodes only",
            "not covered",
            ("paper",),
            entry("obstacle", "minimum_nodes"),
            Within(-math.inf, -1e-10),
        ),
    ),
    "3.4": (
        Check(
            "left-hand side over the infimum, all solutions",
            "<= 1",
            SCENES,
            ratio,
            Within(0.05, 1.0),
        ),
        Check(
            "norm squared of R_h(u) - u_h over (R_h(u) - u_h, w_h)_H1",
            "<= 1",
            SCENES,
            entry("one_sided", "tested"),
            Within(0.05, 1.0 + ROUNDING),
        ),
        Check(
            "R_h(u) - u, as printed, over the infimum, paper",
            "not <= 1",
            ("paper",),
            printed,
            Within(low=1.5),
        ),
    ),
    "3.5": (
        Check(
            "w_h below R_h(u) - u or above R_h(u)",
            "0",
            SCENES,
            lambda row: max(row["one_sided"]["below"], row["one_sided"]["above"]),
            Within(0.0, 0.0),
        ),
        Check(
            "nodes of none of the three cases of Fig. 1",
            "0",
            SCENES,
            entry("one_sided", "cases", 3),
            Within(0.0, 0.0),
        ),
        Check(
            "largest w_h - R_h(u) + u at a node (13), paper",
            "3/2 - eps",
            ("paper",),
            entry("one_sided", "distance"),
            Order(1.5, 1.5, 0.01),
            FINE,
        ),
        Check(
            "w_h in H^1, paper",
            "3/2 - eps",
            ("paper",),
            entry("one_sided", "norm"),
            Order(1.5, 1.5),
            FINE,
        ),
        *_superclose("w_h in H^1", "one_sided", "norm"),
    ),
    "3.6": (
        Check(
            "R_h(u) - u_h in H^1 near the detachment point, paper",
            "3/2 - eps",
            ("paper",),
            entry("supercloseness_parts", "near"),
            Order(1.5, 1.58),
            101,
        ),
        *(
            Check(
                f"R_h(u) - u_h in H^1, {name}",
                "3/2 - eps",
                (name,),
                entry("supercloseness"),
                Order(1.5, 2.0),
                FINE,
            )
            for name in (*STRONG, "weak")
        ),
        *_superclose("R_h(u) - u_h in H^1", "supercloseness"),
    ),
}
