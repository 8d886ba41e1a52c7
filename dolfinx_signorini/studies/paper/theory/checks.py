"""A check: what is measured, mesh by mesh, and the rule that says whether the measurement holds.

A rule is a function from figures to a verdict and can say no: every rule has at least one limit
that a wrong input crosses: `test_wrong_input.py` feeds every check such an input.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import basix
import numpy as np
from scipy.special import zeta

from dolfinx_signorini.meshes.quadrature import QuadratureRule
from dolfinx_signorini.norms.orders import eoc

TOLERANCE = 0.05  # of a measured order
ROUNDING = 1e-9  # of an inequality; linear systems are solved to 1e-11

Row = Mapping[str, Any]
Rows = Mapping[str, Sequence[Row]]
Value = Callable[[Any], Any]
Figures = Sequence[tuple[int, float]]  # cells per side and value, mesh by mesh


@dataclass(frozen=True)
class Verdict:
    """What a rule says:

        print(verdict.measured, "yes" if verdict.holds else "NO")

    Attributes:
        measured: The figure, in words.
        holds: Whether the measurement agrees with what is proven.
    """

    measured: str
    holds: bool


@dataclass(frozen=True)
class Order:
    """The order of convergence between the two finest meshes lies between two limits.

        assert Order(1.5, 1.5).judge([(50, 1.0), (100, 0.5**1.5)]).holds

    Attributes:
        low, high: The limits; a quantity that grows has a negative order.
        tolerance: How far beyond them the measured order may lie.
    """

    low: float
    high: float
    tolerance: float = TOLERANCE

    def judge(self, figures: Figures) -> Verdict:
        """Return the verdict on figures by increasing number of cells."""
        (n, a), (m, b) = figures[-2:]
        order = eoc([1.0 / n, 1.0 / m], [a, b])[0] if min(a, b) > 0.0 else math.nan
        holds = self.low - self.tolerance <= order <= self.high + self.tolerance
        return Verdict(f"order {order + 0.0:.3f}", holds)


@dataclass(frozen=True)
class Within:
    """All figures lie between two limits.

        assert not Within(high=1.0).judge([(50, 0.9), (100, 1.1)]).holds

    Attributes:
        low, high: The limits.
    """

    low: float = -math.inf
    high: float = math.inf

    def judge(self, figures: Figures) -> Verdict:
        """Return the verdict on figures by increasing number of cells."""
        values = [value for _, value in figures]
        holds = all(self.low <= value <= self.high for value in values)
        ends = dict.fromkeys([number(min(values)), number(max(values))])
        return Verdict(" to ".join(ends), holds)


@dataclass(frozen=True)
class Slope:
    """The figures grow like a constant times ln N, with a known constant.

        assert Slope(2.0).judge([(50, 1.0), (100, 1.0 + 2.0 * math.log(2.0))]).holds

    Attributes:
        constant: The constant.
        tolerance: How far off the measured one may be, relative to it.
    """

    constant: float
    tolerance: float = 0.1

    def judge(self, figures: Figures) -> Verdict:
        """Return the verdict on figures by increasing number of cells."""
        (n, a), (m, b) = figures[-2:]
        ratio = (b - a) / math.log(m / n) / self.constant
        return Verdict(f"{ratio:.3f} of it", abs(ratio - 1.0) <= self.tolerance)


@dataclass(frozen=True)
class Limit:
    """The figures tend to a known limit.

        assert Limit(10.0, 0.01).judge([(50, 10.2), (100, 10.05)]).holds

    Attributes:
        value: The limit.
        tolerance: How far off the last figure may be, relative to the limit.
    """

    value: float
    tolerance: float

    def judge(self, figures: Figures) -> Verdict:
        """Return the verdict on figures by increasing number of cells."""
        found = figures[-1][1]
        holds = abs(found - self.value) <= self.tolerance * abs(self.value)
        return Verdict(f"{found:.5g}", holds)


@dataclass(frozen=True)
class Settles:
    """The figures settle at a positive number: the two finest meshes nearly agree.

        assert Settles(0.01).judge([(50, 3.00), (100, 3.01)]).holds

    Attributes:
        tolerance: How far the last two figures may be apart, relative to the last one.
    """

    tolerance: float

    def judge(self, figures: Figures) -> Verdict:
        """Return the verdict on figures by increasing number of cells."""
        (_, a), (_, b) = figures[-2:]
        text = " to ".join(dict.fromkeys([number(a), number(b)]))
        return Verdict(text, b > 0.0 and abs(b - a) <= self.tolerance * b)


Rule = Order | Within | Slope | Limit | Settles
RULES: Mapping[str, Callable[..., Rule]] = {
    rule.__name__.lower(): rule for rule in (Order, Within, Slope, Limit, Settles)
}


@dataclass(frozen=True)
class Check:
    """A measurement and the rule that judges it.

    A check reads rows and knows nothing else of the experiments:

        check = Check("u - u_h in L4", "2 - eps", ("paper",), entry("errors/L4"), Order(2, 2))
        print(check.verdict(rows))

    Attributes:
        what: What is measured.
        proven: What is proven of it.
        experiments: The experiments whose rows are read.
        value: What to read from a row; None on meshes where nothing was measured.
        rule: The rule.
        first: Cells per side of the coarsest mesh that counts.
        column: Where checks fill a table of two entries: `what` is the row, this is the column.
    """

    what: str
    proven: str
    experiments: tuple[str, ...]
    value: Value
    rule: Rule
    first: int = 0
    column: str = ""

    @property
    def name(self) -> str:
        """What is measured, in full."""
        return f"{self.column}, {self.what}" if self.column else self.what

    def figures(self, rows: Rows) -> list[tuple[int, float]]:
        """Return what is measured, mesh by mesh."""
        found = [
            (row["n"], self.value(row))
            for name in self.experiments
            for row in rows[name]
            if row["n"] >= self.first
        ]
        return [(n, float(value)) for n, value in found if value is not None]

    def verdict(self, rows: Rows) -> Verdict:
        """Return the verdict on the measurement."""
        return self.rule.judge(self.figures(rows))


@dataclass(frozen=True)
class Together(Check):
    """A check of one figure of all rows: `value` reads a list of rows of each experiment."""

    def figures(self, rows: Rows) -> list[tuple[int, float]]:
        """Return the figure, for the finest mesh of the first experiment."""
        families = [fine(rows[name], self.first) for name in self.experiments]
        return [(families[0][-1]["n"], float(self.value(families)))]


def entry(path: str) -> Value:
    """Return the function that reads an entry of a row, by the keys on the way, joined by "/"."""

    def read(row: Row) -> Any:
        item: Any = row
        for key in path.split("/"):
            item = item[int(key) if isinstance(item, list | tuple) else key]
        return item

    return read


def over(value: Value, power: float, to: float = 1.0) -> Value:
    """Return the function that reads a normalised value: (value / h^a)^c.

    Args:
        value: What to read from a row.
        power: a, with h = 1/N.
        to: c.
    """

    def read(row: Row) -> float:
        return float((value(row) * row["n"] ** power) ** to)

    return read


def number(value: float) -> str:
    """Return a figure as text; rounding, which is different on every machine, as a bound."""
    if abs(value) <= ROUNDING:
        return "0" if value == 0.0 else f"< {ROUNDING:.0e}"
    if float(value).is_integer() and abs(value) < 1e6:
        return f"{value:.0f}"
    return f"{value:.2e}" if not 0.01 <= abs(value) < 1000.0 else f"{value:#.4g}"


def orders(rows: Sequence[Row], value: Value) -> list[float]:
    """Return the experimental orders of convergence between successive rows.

    Args:
        rows: Rows by increasing N.
        value: What to read from a row.
    """
    return eoc([1.0 / row["n"] for row in rows], [value(row) for row in rows])


def fine(rows: Sequence[Row], first: int) -> list[Row]:
    """Return the rows of meshes that are fine enough.

    Args:
        rows: Rows by increasing N.
        first: The smallest number of cells per side that is fine enough.
    """
    return [row for row in rows if row["n"] >= first]


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


# sum over n of |n| |c_n|^2 of the interpolation error of s^{3/2} on edges: (9/16) zeta(3)/(4 pi^3).
TRACE_CONSTANT = 9.0 / 16.0 * float(zeta(3.0)) / (4.0 * math.pi**3)
