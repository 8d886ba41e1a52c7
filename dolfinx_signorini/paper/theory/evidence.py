"""A statement against its measurement: checks, and the tables that the checks are read from."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dolfinx_signorini.orders import eoc
from dolfinx_signorini.paper.theory.proven import ProvenOrder
from dolfinx_signorini.tables import markdown_table

TOLERANCE = 0.05  # how far a measured order may lie below the proven one
ROUNDING = 1e-9  # relative: an inequality may be violated by so much; 1e-11 is the solvers' part
FIRST = 25  # cells per side: coarser meshes do not show an order

Row = Mapping[str, Any]
Rows = Mapping[str, Sequence[Row]]
Value = Callable[[Row], Any]
Tables = list[tuple[str, str]]  # title and text


@dataclass(frozen=True)
class Check:
    """One figure beside what is proven:

        Check("boundary nodes of none of the three cases", "0", "0 of 100", holds=True)

    Attributes:
        what: What is measured.
        proven: What is proven, in words.
        measured: The figure, in words.
        holds: Whether they agree.
        reason: Why the figure is better than what is proven, where the figure is better.
    """

    what: str
    proven: str
    measured: str
    holds: bool
    reason: str = ""


def entry(*keys: str | int) -> Value:
    """Return the function that reads an entry of a row, by the keys on the way to the entry."""

    def read(row: Row) -> Any:
        item: Any = row
        for key in keys:
            item = item[key]
        return item

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


def bound_check(what: str, proven: str, value: float, figure: str = "") -> Check:
    """Check an inequality, up to rounding.

    Args:
        what: What is bounded, relative to its size.
        proven: The bound: "<= 0", ">= 0" or "<= 1"; "0" for what is never negative.
        value: The measured value.
        figure: The value in words, where the number alone does not do.
    """
    relation, _, limit = proven.rpartition(" ")
    excess = float(limit) - value if relation == ">=" else value - float(limit)
    text = number(value) if float(limit) == 0.0 else f"{value:.4f}"
    return Check(what, proven, figure or text, excess <= ROUNDING)


def orders(rows: Sequence[Row], value: Value) -> list[float]:
    """Return the experimental orders of convergence between successive rows.

    Args:
        rows: Rows by increasing N.
        value: What to read from a row.
    """
    return eoc([1.0 / row["n"] for row in rows], [value(row) for row in rows])


def order_text(rows: Sequence[Row], value: Value) -> str:
    """Return the order between the two finest meshes, and which meshes they are, as text.

    Args:
        rows: Rows by increasing N, at least two.
        value: What to read from a row.
    """
    return f"{orders(rows, value)[-1]:.3f} (N = {rows[-2]['n']} to {rows[-1]['n']})"


def fine(rows: Sequence[Row], first: int = FIRST) -> list[Row]:
    """Return the rows of meshes that are fine enough to show an order.

    Args:
        rows: Rows by increasing N.
        first: The smallest number of cells per side that is fine enough.
    """
    return [row for row in rows if row["n"] >= first]


def number(value: float) -> str:
    """Return a figure as text; rounding, which is different on every machine, as a bound."""
    if abs(value) <= ROUNDING:
        return "0" if value == 0.0 else f"< {ROUNDING:.0e}"
    return f"{value:.3e}" if not 0.01 <= abs(value) < 1000.0 else f"{value:#.4g}"


def row_table(rows: Sequence[Row], values: Mapping[str, Value]) -> str:
    """Return values of rows by N, in Markdown.

    Args:
        rows: Rows by increasing N.
        values: What to read from a row, by the name of the column.
    """
    return order_table(rows, {}, values)


def order_table(
    rows: Sequence[Row], values: Mapping[str, Value], plain: Mapping[str, Value] | None = None
) -> str:
    """Return values with their orders of convergence by N, in Markdown.

    Args:
        rows: Rows by increasing N.
        values: What to read from a row, by the name of the column.
        plain: Further columns, without orders.
    """
    head, columns = ["N"], [[str(row["n"]) for row in rows]]
    for name, value in values.items():
        head += [name, "order"]
        columns.append([number(value(row)) for row in rows])
        columns.append(["", *(f"{order:.3f}" for order in orders(rows, value))])
    for name, value in (plain or {}).items():
        head.append(name)
        columns.append([_text(value(row)) for row in rows])
    return markdown_table(head, list(zip(*columns, strict=True)))


def _text(value: Any) -> str:
    return number(value) if isinstance(value, float) else str(value)
