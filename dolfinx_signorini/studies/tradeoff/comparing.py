"""Measured rows compared: the Pareto front, and the cheapest configuration for an error.

Functions of a norm, given by its name, take rows that are compared in this norm, see `compared`.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import fields

from dolfinx_signorini.base.records import Row
from dolfinx_signorini.norms.orders import (
    DETACHMENT_EXPONENT,
    SMOOTH,
    approximation_order,
    regression,
)
from dolfinx_signorini.studies.tradeoff.family import KINDS, UNIFORM_P1, Kind
from dolfinx_signorini.studies.tradeoff.runs import Configuration

Table = tuple[Sequence[str], Sequence[Sequence[str]]]

FEWEST = 4  # rows of which the slope is taken


def kind_of(row: Row) -> Kind:
    """Return the kind of mesh and elements of a row."""
    return Kind(row["mesh"], row["degree"])


def of_kind(rows: Iterable[Row], kind: Kind) -> list[Row]:
    """Return the rows of one kind of mesh and elements."""
    return [row for row in rows if kind_of(row) == kind]


def describe(row: Row) -> str:
    """Return the configuration of a row in words."""
    own = {field.name: row[field.name] for field in fields(Configuration) if field.name in row}
    return str(Configuration(kind_of(row), **own))


def compared(rows: Sequence[Row], norm: str) -> list[Row]:
    """Return the rows that are compared in a norm: no sweeps, no meshes adapted for other norms."""
    return [
        row
        for row in rows
        if row["purpose"] == "main"
        and row["norm"] in (None, norm)
        and not (row["accuracy"] and row["estimate"] > row["accuracy"])
    ]


def pareto_front(rows: Sequence[Row], norm: str, cost: str = "total") -> list[Row]:
    """Return the rows that no other row beats in both error and cost, cheapest first.

    The cost is an entry of a row: "total" for seconds, or "unknowns".
    """
    front: list[Row] = []
    for row in sorted(rows, key=lambda row: (row[cost], row["errors"][norm])):
        if not front or row["errors"][norm] < front[-1]["errors"][norm]:
            front.append(row)
    return front


def cheapest(rows: Sequence[Row], norm: str, target: float) -> Row | None:
    """Return the row that reaches an error in the fewest seconds, or None."""
    enough = [row for row in rows if row["errors"][norm] <= target]
    return min(enough, key=lambda row: row["total"]) if enough else None


def targets(rows: Sequence[Row], norm: str) -> list[float]:
    """Return errors to compare rows at, decreasing: powers of ten, and the best of uniform P1."""
    return sorted({*_powers(rows, norm), *_best(rows, norm)}, reverse=True)


def accuracies(rows: Sequence[Row], norm: str) -> list[float]:
    """Return the errors to ask the adaptive loop for, decreasing.

    The errors are the targets of other rows, where the error of uniform P1 is given two digits and
    made no larger, and the next power of ten, which no other row has reached.
    """
    smallest = math.ceil(math.log10(min(row["errors"][norm] for row in rows))) - 1
    rounded = [float(f"{0.95 * error:.1e}") for error in _best(rows, norm)]
    return sorted({*_powers(rows, norm), *rounded, float(f"1e{smallest}")}, reverse=True)


def _powers(rows: Sequence[Row], norm: str) -> list[float]:
    """The powers of ten between the largest error and the smallest."""
    errors = [row["errors"][norm] for row in rows]
    powers = [float(f"1e{k}") for k in range(3, -13, -1)]
    return [power for power in powers if min(errors) <= power <= max(errors)]


def _best(rows: Sequence[Row], norm: str) -> list[float]:
    """The smallest error of uniform P1, or nothing without uniform P1."""
    errors = [row["errors"][norm] for row in of_kind(rows, UNIFORM_P1)]
    return [min(errors)] if errors else []


def slope(rows: Sequence[Row], norm: str) -> float | None:
    """Return s for an error like unknowns^-s, by regression over the finer half of some rows.

    The rows are of one kind; at least four count, or all if fewer are known. s is the order in h
    over the dimension, and None for less than two numbers of unknowns.
    """
    rows = sorted(rows, key=lambda row: row["unknowns"])
    finer = rows[-max(FEWEST, (len(rows) + 1) // 2) :]
    unknowns = [row["unknowns"] for row in finer]
    if len(set(unknowns)) < 2:
        return None
    return -regression(unknowns, [row["errors"][norm] for row in finer])


def target_table(rows: Sequence[Row], norm: str) -> Table:
    """Return heads and lines of a table: the cheapest row for each error, beside uniform P1."""
    baseline = of_kind(rows, UNIFORM_P1)
    best = _best(rows, norm)
    lines = []
    for target in targets(rows, norm):
        row, base = cheapest(rows, norm, target), cheapest(baseline, norm, target)
        if row is None:
            continue
        against = ("uniform P1 does not get there", "", "")
        if base is not None:
            ratio = f"{base['total'] / row['total']:.1f}"
            against = (describe(base), f"{base['total']:.3g}", ratio)
        mark = "*" if target in best else ""
        own = (describe(row), str(row["unknowns"]), f"{row['total']:.3g}")
        lines.append((f"{target:.3e}{mark}", *own, *against))
    columns = ("at most", "the cheapest", "unknowns", "seconds", "against", "seconds", "times")
    return columns, lines


def order_table(rows: Sequence[Row], norms: Sequence[str]) -> Table:
    """Return heads and lines of a table: orders in h in the plane, measured and allowed."""
    lines = []
    for kind in KINDS:
        exponent = DETACHMENT_EXPONENT if kind.mesh == "uniform" else SMOOTH
        cells, most = [], 0
        for norm in norms:
            own = of_kind(compared(rows, norm), kind)
            most = max([most, *(row["unknowns"] for row in own)])
            order = slope(own, norm)
            measured = "-" if order is None else f"{2.0 * order:.2f}"
            cells.append(f"{measured} ({approximation_order(norm, kind.degree, exponent):g})")
        lines.append((str(kind), str(most), *cells))
    return ("mesh and elements", "unknowns, at most", *norms), lines


def rivals(rows: Sequence[Row], norms: Sequence[str]) -> list[Row]:
    """Return the finest uniform P1 row, and the cheapest rows that are as accurate in some norm."""
    baseline = of_kind(compared(rows, norms[0]), UNIFORM_P1)
    result = [max(baseline, key=lambda row: row["n"])]
    for norm in norms:
        row = cheapest(compared(rows, norm), norm, result[0]["errors"][norm])
        if row is not None and row not in result:
            result.append(row)
    return result
