"""Measured rows compared: the Pareto front, and the cheapest configuration for an error."""

from collections.abc import Mapping, Sequence
from typing import Any

from dolfinx_signorini.tables import text_table
from dolfinx_signorini.tradeoff.kinds import UNIFORM_P1, Kind
from dolfinx_signorini.tradeoff.runs import Configuration

Row = Mapping[str, Any]


def kind_of(row: Row) -> Kind:
    """Return the kind of mesh and elements of a row."""
    return Kind(row["graded"], row["degree"])


def describe(row: Row) -> str:
    """Return the configuration of a row in words."""
    return str(Configuration(kind_of(row), row["n"]))


def is_baseline(row: Row) -> bool:
    """Return whether a row is of the paper's kind: uniform meshes, P1, the cascade."""
    return kind_of(row) == UNIFORM_P1 and row["method"] == "cascade"


def pareto_front(rows: Sequence[Row], norm: str, cost: str = "total") -> list[Row]:
    """Return the rows that no other row beats in both error and cost, cheapest first.

    Args:
        rows: Rows of the main grid.
        norm: The norm of the error.
        cost: The entry of a row that is its cost, "total" for seconds or "unknowns".
    """
    front: list[Row] = []
    for row in sorted(rows, key=lambda row: (row[cost], row["errors"][norm])):
        if not front or row["errors"][norm] < front[-1]["errors"][norm]:
            front.append(row)
    return front


def cheapest(rows: Sequence[Row], norm: str, target: float) -> Row | None:
    """Return the row that reaches an error in the fewest seconds, or None.

    Args:
        rows: Rows of the main grid.
        norm: The norm of the error.
        target: The largest error allowed, in the unit of the norm.
    """
    enough = [row for row in rows if row["errors"][norm] <= target]
    return min(enough, key=lambda row: row["total"]) if enough else None


def targets(rows: Sequence[Row], norm: str) -> list[float]:
    """Return errors to compare rows at, decreasing: powers of ten, and the best of uniform P1.

    Args:
        rows: Rows of the main grid.
        norm: The norm of the error.
    """
    errors = [row["errors"][norm] for row in rows]
    powers = [10.0**k for k in range(3, -13, -1) if min(errors) <= 10.0**k <= max(errors)]
    baseline = [row["errors"][norm] for row in rows if is_baseline(row)]
    return sorted({*powers, *([min(baseline)] if baseline else [])}, reverse=True)


def target_table(rows: Sequence[Row], norm: str) -> str:
    """Return a table of the cheapest configuration for each error, beside uniform P1.

    Args:
        rows: Rows of the main grid.
        norm: The norm of the error.
    """
    baseline = [row for row in rows if is_baseline(row)]
    best = min((row["errors"][norm] for row in baseline), default=float("nan"))
    lines = []
    for target in targets(rows, norm):
        row, base = cheapest(rows, norm, target), cheapest(baseline, norm, target)
        if row is None:
            continue
        against = ("uniform P1 does not get there", "", "")
        if base is not None:
            ratio = f"{base['total'] / row['total']:.1f}"
            against = (describe(base), f"{base['total']:.3g}", ratio)
        mark = "*" if target == best else ""
        own = (describe(row), str(row["unknowns"]), f"{row['total']:.3g}")
        lines.append((f"{target:.3e}{mark}", *own, *against))
    columns = ("at most", "the cheapest", "unknowns", "seconds", "against", "seconds", "times")
    return text_table(columns, lines, f"for an error in {norm} of at most ...")
