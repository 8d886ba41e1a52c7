"""The checks of Section 2: regularity, condition (A), unique solvability."""

import math

from dolfinx_signorini.studies.paper.theory.checks import (
    Check,
    Limit,
    Order,
    Row,
    Settles,
    Within,
    entry,
)
from dolfinx_signorini.studies.paper.theory.families import power_name

ANY = math.inf
GROWTH = 0.5 - 2.0 / 16.0  # of the W^{2,16} seminorm of r^{3/2}


def half(row: Row) -> float:
    """Return the size of the factor of r^{1/2}."""
    return abs(float(row["factors"]["half"]))


CHECKS: dict[str, tuple[Check, ...]] = {
    "(3)": (
        Check(
            "u - u_h in W^{1,4}, -r^{3/2} sin(3/2 theta)",
            "1 - eps",
            (power_name(math.inf),),
            entry("errors", "W1_4"),
            Order(1.0, 1.0),
            51,
        ),
        Check(
            "u - u_h in L^inf, the same",
            "3/2 - eps",
            (power_name(math.inf),),
            entry("errors", "Linf"),
            Order(1.5, 1.5, 0.01),
            51,
        ),
        Check(
            "u - u_h in L^inf, -r^{1.2} sin(3/2 theta)",
            "1.1",
            (power_name(2.5),),
            entry("errors", "Linf"),
            Order(1.1, 1.2, 0.01),
            51,
        ),
    ),
    "2.1": (
        Check(
            "discrete H^2 seminorm of u_h, load with a pole, in L^2 and not in L^4",
            "bounded",
            ("pole",),
            entry("second", "2"),
            Order(0.0, 0.0),
        ),
        Check(
            "discrete W^{2,16} seminorm, the same",
            "none",
            ("pole",),
            entry("second", "16"),
            Order(-ANY, -0.25),
        ),
    ),
    "2.2": (
        Check(
            "length between the contact set of u from inside and from outside",
            "-> 0",
            ("paper",),
            entry("trace", "between"),
            Order(1.0, 1.0),
        ),
        Check(
            "components of its interior",
            "finite",
            ("paper",),
            entry("trace", "components"),
            Within(1.0, 1.0),
        ),
        Check(
            "components that the mesh sees, bumps of all scales",
            "infinite",
            ("sharp",),
            entry("trace", "components"),
            Order(-ANY, -0.4),
        ),
    ),
    "2.3": (
        Check(
            "1. factor of r^{1/2} at (1/2, 0), paper", "-> 0", ("paper",), half, Order(1.8, 2.5), 31
        ),
        Check(
            "1. factor of r^{1/2} times N at the point that is found, load without known solution",
            "bounded",
            ("unknown",),
            lambda row: half(row) * row["n"],
            Within(0.0, 5.0),
        ),
        Check(
            "1. discrete W^{2,3} seminorm of u_h, load without known solution",
            "bounded",
            ("unknown",),
            entry("second", "3"),
            Order(0.0, 0.0),
        ),
        Check(
            "2. factor of r^{3/2}, paper",
            "10",
            ("paper",),
            entry("factors", "three_halves"),
            Limit(10.0, 1e-3),
        ),
        Check(
            "2. factor of r^{3/2}, load without known solution",
            "settles, > 0",
            ("unknown",),
            entry("factors", "three_halves"),
            Settles(0.01),
        ),
    ),
    "2.4.1": (
        Check(
            "discrete W^{2,16} seminorm of u_h, paper",
            f"grows, order {-GROWTH:g}",
            ("paper",),
            entry("second", "16"),
            Order(-GROWTH, -0.7 * GROWTH),
            51,
        ),
        Check(
            "discrete W^{2,3} seminorm of u_h, paper",
            "bounded",
            ("paper",),
            entry("second", "3"),
            Order(0.0, 0.0),
            51,
        ),
    ),
    "2.4.3": (
        Check(
            "components of the contact set of u_h, problem (3) with f = 0",
            "finite",
            (power_name(math.inf),),
            entry("components"),
            Within(1.0, 1.0),
        ),
    ),
    "2.6": (
        Check(
            "distance of two solutions, by the cascade and by BNCG from far away",
            "0",
            ("unknown", "pole"),
            entry("uniqueness"),
            Within(0.0, 1e-6),
        ),
    ),
}
