"""A statement against its measurement: checks, and the tables they are read from."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dolfinx_signorini.orders import eoc
from dolfinx_signorini.paper.theory.proven import ProvenOrder

TOLERANCE = 0.05  # how far a measured order may lie below the proven one
ROUNDING = 1e-9  # relative: an inequality may be violated by so much; 1e-11 is the solvers' part
FIRST = 25  # cells per side: coarser meshes do not show an order

Row = Mapping[str, Any]
Rows = Mapping[str, Sequence[Row]]
Value = Callable[[Row], float]


@dataclass(frozen=True)
class Check:
    """One figure beside what is proven.

    Attributes:
        what: What is measured.
        proven: What is proven, in words.
        measured: The figure, in words.
        holds: Whether they agree.
        reason: Why the figure is better than what is proven, where it is.
    """

    what: str
    proven: str
    measured: str
    holds: bool
    reason: str = ""


def entry(*keys: str) -> Value:
    """Return the function that reads an entry of a row."""

    def read(row: Row) -> float:
        item: Any = row
        for key in keys:
            item = item[key]
        return float(item)

    return read


def order_check(
    what: str, rows: Sequence[Row], value: Value, proven: ProvenOrder, reason: str = ""
) -> Check:
    """Compare the order between the two finest meshes with the proven one.

    Args:
        what: What converges.
        rows: Rows by increasing N, at least two.
        value: What to read from a row.
        proven: The proven order.
        reason: Why the order may be better.
    """
    order = orders(rows, value)[-1]
    return Check(
        what,
        f"order {proven}",
        order_text(rows, value),
        order >= proven.value - TOLERANCE,
        reason if order > proven.value + TOLERANCE else "",
    )


def order_text(rows: Sequence[Row], value: Value) -> str:
    """Return the order between the two finest meshes, and which they are."""
    return f"{orders(rows, value)[-1]:.3f} (N = {rows[-2]['n']} to {rows[-1]['n']})"


def bound_check(what: str, proven: str, excess: float, figure: str) -> Check:
    """Check an inequality by how far it is violated, relative to its size."""
    return Check(what, proven, figure, excess <= ROUNDING)


def orders(rows: Sequence[Row], value: Value) -> list[float]:
    """Return the experimental orders of convergence between successive rows."""
    return eoc([1.0 / row["n"] for row in rows], [value(row) for row in rows])


def fine(rows: Sequence[Row], first: int = FIRST) -> list[Row]:
    """Return the rows on meshes that are fine enough to show an order."""
    return [row for row in rows if row["n"] >= first]


def number(value: float) -> str:
    """Return a figure as text; rounding, which is different on every machine, as a bound."""
    if abs(value) <= ROUNDING:
        return "0" if value == 0.0 else f"< {ROUNDING:.0e}"
    return f"{value:.3e}" if not 0.01 <= abs(value) < 1000.0 else f"{value:#.4g}"


def table(columns: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown, aligned so that it reads well on a terminal, too."""
    cells = [list(columns), *(list(line) for line in lines)]
    widths = [max(len(line[i]) for line in cells) for i in range(len(columns))]
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    body = [cells[0], rule, *cells[1:]]
    return "".join(
        "| "
        + " | ".join(
            text.ljust(width) if i == 0 else text.rjust(width)
            for i, (text, width) in enumerate(zip(line, widths, strict=True))
        )
        + " |\n"
        for line in body
    )


def order_table(
    rows: Sequence[Row], values: Mapping[str, Value], plain: Mapping[str, Value] | None = None
) -> str:
    """Return values with their orders by N, in Markdown.

    Args:
        rows: Rows by increasing N.
        values: What to read from a row, by the name of the column.
        plain: Further columns, without orders.
    """
    columns = ["N"]
    for name in values:
        columns += [name, "order"]
    lines = [[str(row["n"])] for row in rows]
    for value in values.values():
        for line, row, order in zip(lines, rows, [math.nan, *orders(rows, value)], strict=True):
            line += [number(value(row)), "" if math.isnan(order) else f"{order:.3f}"]
    for name, value in (plain or {}).items():
        columns.append(name)
        for line, row in zip(lines, rows, strict=True):
            line.append(number(value(row)))
    return table(columns, lines)
