"""The checks of Section 5: the dual problems, and the parts of the error by their signs."""

import math
from collections.abc import Sequence

from dolfinx_signorini.studies.paper.theory.checks import (
    ROUNDING,
    Check,
    Order,
    Row,
    Rows,
    Within,
    entry,
)
from dolfinx_signorini.studies.paper.theory.contact_sets import ContactSet, condition_a_h
from dolfinx_signorini.studies.paper.theory.dual import EPSILONS, TOO_HIGH

CORNERS = (0.0, 1.0, 2.0, 3.0)  # arc length on the boundary of the unit square
FINE = 25  # cells per side: from here on (A_h) holds
GROWTH = 1.5 - 2.0 / TOO_HIGH  # of the W^{2,q} seminorm of r^{1/2}
DUALS = ("dual", "dual two")
CHAINS = {"plus": "(20)", "minus": "(26)"}
SIGNS = {"plus": "+", "minus": "-"}


def contact_set(row: Row) -> ContactSet:
    """Return the discrete contact set of a row."""
    found = row["contact_set"]
    intervals = tuple((a, b) for a, b in found["intervals"])
    return ContactSet(found["length"], intervals, tuple(found["detachments"]))


def detachment_error(row: Row) -> float:
    """Return the distance of the point of Section 7 from the nearest detachment point found."""
    return min(abs(s - 0.5) for s in row["contact_set"]["detachments"])


def violations(rows: Sequence[Row]) -> int:
    """Return in how many ways contact sets violate (A_h)."""
    return len(condition_a_h([contact_set(row) for row in rows], CORNERS).violations)


class Family(Check):
    """A check of all rows of an experiment together: the number of violations of (A_h)."""

    def figures(self, rows: Rows) -> list[tuple[int, float]]:
        """Return the number of violations, for the finest mesh."""
        (name,) = self.experiments
        chosen = [row for row in rows[name] if row["n"] >= self.first]
        return [(chosen[-1]["n"], float(violations(chosen)))]


def _worst(part: str, key: str, over: str) -> Check:
    """A quotient of entries for each epsilon, the largest one."""

    def value(row: Row) -> float:
        item = row[part]
        if isinstance(item[over], dict):
            above = item[key] if isinstance(item[key], dict) else {}
            return max(above.get(e, item[key]) / item[over][e] for e in item[over])
        return float(item[key] / item[over])

    names = {
        "interpolation": "(z - I_h(z), w)_H1 over its Hölder bound",
        "holder": "Hölder bound over that with W^{1,s} between W^{1,4} and W^{1,inf}",
    }
    what = f"{names[key]}, {len(EPSILONS)} eps"
    return Check(what, "<= 1", DUALS, value, Within(0.01, 1.0))


def _lemma(part: str, numbers: tuple[str, str]) -> tuple[Check, ...]:
    stable, regular = numbers
    constants = tuple(
        check
        for e in EPSILONS
        for check in (
            Check(
                f"eps = {e:g}",
                "<= C",
                ("dual",),
                entry(part, name, f"{e:g}"),
                Order(0.0, 0.0, 0.08),  # r^{1/2} is hardly in W^{2,q}: the constant settles slowly
                column=column,
            )
            for name, column in (
                ("stability", f"{stable}, H^1 norm of z over the load"),
                ("regularity", f"{regular}, discrete W^{{2,q}} seminorm of z over the load"),
            )
        )
    )
    return (
        Check(
            "largest value of z over its size",
            "<= 0",
            DUALS,
            entry(part, "largest"),
            Within(-math.inf, 1e-6),
        ),
        Check(
            "largest size of z on the contact cells over its whole",
            "0",
            DUALS,
            entry(part, "contact"),
            Within(0.0, 1e-6),
        ),
        *constants,
    )


def _proposition(part: str) -> tuple[Check, ...]:
    what = f"(u - u_h)^{SIGNS[part]} in L^4"
    orders = tuple(
        Check(f"{what}, {name}", "2 - eps", (name,), entry("signed", part), Order(2.0, 2.0), 49)
        for name in ("paper", "two", "three", "weak", "corner")
    )
    return (
        *orders,
        Check(
            f"{CHAINS[part]}: right-hand side less left-hand side, over the left",
            ">= 0",
            DUALS,
            entry(part, "slack"),
            Within(-ROUNDING, math.inf),
        ),
        Check(
            "(I_h(z), w)_H1 over the left-hand side",
            "<= 0",
            DUALS,
            lambda row: row[part]["sign"] / row[part]["error"],
            Within(-0.5, ROUNDING),
        ),
        _worst(part, "interpolation", "holder"),
        _worst(part, "holder", "holder_split"),
        Check(
            "the function tested with, on the contact cells",
            ">= 0",
            DUALS,
            entry(part, "admissible"),
            Within(-ROUNDING, math.inf),
        ),
        Check(
            "(z - I_h(z), w)_H1, which decides",
            "2 - eps",
            ("dual",),
            entry(part, "interpolation"),
            Order(2.0, 2.0, 0.1),
        ),
    )


CHECKS: dict[str, tuple[Check, ...]] = {
    "5.2": _lemma("plus", ("(18)", "(19)")),
    "5.3": tuple(
        Check(
            f"discrete W^{{2,{TOO_HIGH:g}}} seminorm of z over the load, part {SIGNS[part]}",
            f"grows, order {-GROWTH:g}",
            ("dual",),
            entry(part, "regularity", "none"),
            Order(-GROWTH, -0.5 * GROWTH),
        )
        for part in SIGNS
    ),
    "5.4": _proposition("plus"),
    "5.5": (
        *(
            Family(f"violations of (A_h), {name}", "0", (name,), entry("n"), Within(0, 0), FINE)
            for name in ("paper", "corner")
        ),
        *(
            Family(
                f"violations of (A_h), {name}",
                "an assumption",
                (name,),
                entry("n"),
                Within(1, math.inf),
                FINE,
            )
            for name in ("two", "three")
        ),
        Family(
            "violations of (A_h), paper with N = 15",
            "small h only",
            ("paper",),
            entry("n"),
            Within(1, math.inf),
        ),
        Check(
            "error of the detachment point, paper",
            "none",
            ("paper",),
            detachment_error,
            Order(1.0, 1.1),
            101,
        ),
    ),
    "5.6": _lemma("minus", ("(22)", "(23)")),
    "5.7": _proposition("minus"),
}
