"""A check: what is measured, mesh by mesh, and the rule that says whether the measurement holds.

A rule is a function from figures to a verdict and can say no: every rule has at least one limit
that a wrong input crosses: `test_wrong_input.py` feeds every check such an input.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from dolfinx_signorini.base.records import Row
from dolfinx_signorini.norms.orders import eoc

ROUNDING = 1e-9  # of an inequality; linear systems are solved to 1e-11

Rows = Mapping[str, Sequence[Row]]
Value = Callable[[Any], Any]
Figures = Sequence[tuple[int, float]]  # cells per side and value, mesh by mesh


class Verdict(NamedTuple):
    """What a rule says.

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
    tolerance: float = 0.05

    def judge(self, figures: Figures) -> Verdict:
        """Return the verdict on figures by increasing number of cells."""
        order = last_order(figures)
        holds = self.low - self.tolerance <= order <= self.high + self.tolerance
        return Verdict(f"order {order + 0.0:.3f}", holds)


@dataclass(frozen=True)
class Within:
    """All figures lie between two limits.

    assert not Within(high=1.0).judge([(50, 0.9), (100, 1.1)]).holds
    """

    low: float = -math.inf
    high: float = math.inf

    def judge(self, figures: Figures) -> Verdict:
        """Return the verdict on figures by increasing number of cells."""
        values = [value for _, value in figures]
        holds = all(self.low <= value <= self.high for value in values)
        return Verdict(_from_to(min(values), max(values)), holds)


@dataclass(frozen=True)
class Slope:
    """The figures grow like a known constant times ln N, to a relative tolerance.

    assert Slope(2.0).judge([(50, 1.0), (100, 1.0 + 2.0 * math.log(2.0))]).holds
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
    """The figures tend to a known limit: the last one is off by a relative tolerance at most.

    assert Limit(10.0, 0.01).judge([(50, 10.2), (100, 10.05)]).holds
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
    """The figures settle at a positive number: the last two agree to a relative tolerance.

    assert Settles(0.01).judge([(50, 3.00), (100, 3.01)]).holds
    """

    tolerance: float

    def judge(self, figures: Figures) -> Verdict:
        """Return the verdict on figures by increasing number of cells."""
        (_, a), (_, b) = figures[-2:]
        return Verdict(_from_to(a, b), b > 0.0 and abs(b - a) <= self.tolerance * b)


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
        together: Whether `value` reads the rows of all experiments at once, a list for each.
    """

    what: str
    proven: str
    experiments: tuple[str, ...]
    value: Value
    rule: Rule
    first: int = 0
    column: str = ""
    together: bool = False

    @property
    def name(self) -> str:
        """What is measured, in full."""
        return f"{self.column}, {self.what}" if self.column else self.what

    def figures(self, rows: Rows) -> list[tuple[int, float]]:
        """Return what is measured, mesh by mesh; what is of all meshes has the finest one's N."""
        families = [fine(rows[name], self.first) for name in self.experiments]
        if self.together:
            return [(families[0][-1]["n"], float(self.value(families)))]
        found = [(row["n"], self.value(row)) for family in families for row in family]
        return [(n, float(value)) for n, value in found if value is not None]

    def verdict(self, rows: Rows) -> Verdict:
        """Return the verdict on the measurement."""
        return self.rule.judge(self.figures(rows))


def value_of(texts: Mapping[str, Any]) -> Value:
    """Return what a check or a curve of the data files reads from a row.

    Args:
        texts: The entries of the check, see the first lines of `data/statements.toml`.
    """

    def read(row: Row) -> float | None:
        value, less = entry(texts["of"])(row), texts.get("less", 0.0)
        divisor = entry(texts["by"])(row) if "by" in texts else 1.0
        if value is None or divisor is None:
            return None
        value -= entry(less)(row) if isinstance(less, str) else less
        value *= row["n"] ** texts.get("power", 0) / divisor
        value *= math.log2(row["n"]) ** texts.get("logarithms", 0)
        value = value ** texts.get("to", 1)
        return abs(value) if texts.get("size") else float(value)

    return read


def entry(path: str) -> Value:
    """Return the function that reads an entry of a row, by the keys on the way, joined by "/"."""

    def read(row: Row) -> Any:
        item: Any = row
        for key in path.split("/"):
            item = item[int(key) if isinstance(item, list | tuple) else key]
        return item

    return read


def fine(rows: Sequence[Row], first: int) -> list[Row]:
    """Return the rows of meshes with at least `first` cells per side."""
    return [row for row in rows if row["n"] >= first]


def last_order(figures: Figures) -> float:
    """Return the order of convergence between the two finest meshes; NaN where a figure is 0."""
    (n, a), (m, b) = figures[-2:]
    return eoc([1.0 / n, 1.0 / m], [a, b])[0] if min(a, b) > 0.0 else math.nan


def number(value: float) -> str:
    """Return a figure as text; rounding, which is different on every machine, as a bound."""
    if abs(value) <= ROUNDING:
        return "0" if value == 0.0 else f"< {ROUNDING:.0e}"
    if float(value).is_integer() and abs(value) < 1e6:
        return f"{value:.0f}"
    return f"{value:.2e}" if not 0.01 <= abs(value) < 1000.0 else f"{value:#.4g}"


def _from_to(first: float, last: float) -> str:
    return " to ".join(dict.fromkeys([number(first), number(last)]))
