"""The checks beyond the paper: factors of singularities, a sharp scene, enclosures, the force."""

import math

from dolfinx_signorini.studies.paper.theory.checks import Check, Order, Row, Settles, Within, entry
from dolfinx_signorini.studies.paper.theory.families import SHARP_EXPONENT

STRENGTH = 10.0  # the factor of r^{3/2} of the paper's solution


def outer_width(row: Row) -> float:
    """Return how far the outer enclosure reaches beyond the contact set, in (e / b)^{2/3}."""
    found = row["enclosure"]
    return float((0.5 - found["outer"]) / (found["value"] / STRENGTH) ** (2.0 / 3.0))


def sharpness(row: Row) -> float:
    """Return the supercloseness over h^{3/2 - 1/p} / log2(1/h)."""
    n = row["n"]
    return float(row["supercloseness"] * n ** (1.5 - 1.0 / SHARP_EXPONENT) * math.log2(n))


CHECKS: dict[str, tuple[Check, ...]] = {
    "stress": (
        Check(
            "factor of r^{3/2} less 10, paper",
            "none",
            ("paper",),
            lambda row: abs(row["factors"]["three_halves"] - STRENGTH),
            Order(1.8, 3.0),
            31,
        ),
        Check(
            "detachment point corrected by the factors, less 1/2",
            "none",
            ("paper",),
            lambda row: abs(row["factors"]["corrected"] - 0.5),
            Order(1.8, 2.2),
            31,
        ),
        Check(
            "factor of r^{3/2}, load without known solution",
            "> 0",
            ("unknown",),
            entry("factors", "three_halves"),
            Within(1.0, 100.0),
        ),
    ),
    "sharp": (
        Check(
            "R_h(u) - u_h in H^1 over h^{3/2-1/p} / log2(1/h), p = 3",
            "<= C log2(1/h)",
            ("sharp",),
            sharpness,
            Settles(0.25),
            49,
        ),
    ),
    "enclosure": (
        Check(
            "outer end less 1/2",
            "<= 0",
            ("bounds",),
            lambda row: row["enclosure"]["outer"] - 0.5,
            Within(-0.5, 0.0),
        ),
        Check(
            "inner end less 1/2",
            ">= 0",
            ("bounds",),
            lambda row: row["enclosure"]["inner"] - 0.5,
            Within(0.0, 0.5),
        ),
        Check(
            "width of the outer part over (e/b)^{2/3}, e the sup error",
            "<= 2^{2/3}",
            ("bounds",),
            outer_width,
            Within(0.0, 2.0 ** (2.0 / 3.0)),
        ),
        Check(
            "width of the enclosure",
            "-> 0, order 1",
            ("bounds",),
            lambda row: row["enclosure"]["inner"] - row["enclosure"]["outer"],
            Order(1.0, 1.2),
        ),
    ),
    "force": (
        Check(
            "error of the force over its bound",
            "<= 1",
            ("bounds",),
            lambda row: row["force"]["error"] / row["force"]["bound"],
            Within(0.0, 1.0),
        ),
        Check(
            "energy error over its bound",
            "<= 1",
            ("bounds",),
            lambda row: row["energy"] / row["force"]["bound"],
            Within(0.5, 1.0),
        ),
        Check(
            "bound of the force", "order 1", ("bounds",), entry("force", "bound"), Order(1.0, 1.0)
        ),
        Check(
            "error of the force over its bound by a dual solution",
            "<= 1",
            ("bounds",),
            lambda row: row["force"]["error"] / row["force"]["dual"],
            Within(0.0, 1.0),
        ),
        Check(
            "bound of the force by a dual solution",
            "order 3/2",
            ("bounds",),
            entry("force", "dual"),
            Order(1.45, 1.7),
        ),
        Check(
            "error of the force itself",
            "none",
            ("bounds",),
            entry("force", "error"),
            Order(1.5, 2.5),
        ),
    ),
}
