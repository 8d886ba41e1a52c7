"""What checks read: figures of one row, and figures of all rows of some experiments together."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from dolfinx_signorini.norms.orders import DETACHMENT_EXPONENT
from dolfinx_signorini.studies.paper.solution import AMPLITUDE, DETACHMENT
from dolfinx_signorini.studies.paper.theory.checks import Row, Value, entry
from dolfinx_signorini.studies.paper.theory.contact_sets import ContactSet, condition_a_h
from dolfinx_signorini.studies.paper.theory.measures import TRACE
from dolfinx_signorini.studies.paper.theory.proven import supercloseness_order

TABLE_1 = {"L4": {101: 5.8745e-4, 1001: 6.0007e-6}, "W1_4": {101: 1.3044e-1, 1001: 1.3395e-2}}
PLACED = ("L4", "L16", "Linf", "W1_4", "W1_16", "W1_inf", TRACE)


def value_of(texts: Mapping[str, Any]) -> Value:
    """Return what a check or a curve of the data files reads from a row.

    Args:
        texts: The entries of the check, see the first lines of `data/statements.toml`.
    """
    name, *arguments = texts["of"].split()
    own, less, by = FUNCTIONS.get(name), texts.get("less", 0.0), texts.get("by")

    def read(row: Row) -> float | None:
        value = entry(name)(row) if own is None else own(row, *arguments)
        divisor = 1.0 if by is None else entry(by)(row)
        if value is None or divisor is None:
            return None
        value -= entry(less)(row) if isinstance(less, str) else less
        value *= row["n"] ** texts.get("power", 0) / divisor
        return abs(value) if texts.get("size") else float(value)

    return read


def contact_set(row: Row) -> ContactSet:
    """Return the discrete contact set of a row."""
    found = row["contact_set"]
    intervals = tuple((a, b) for a, b in found["intervals"])
    return ContactSet(found["length"], intervals, tuple(found["detachments"]))


def detachment_error(row: Row) -> float:
    """Return the distance of the point of Section 7 from the nearest detachment point found."""
    return min(abs(s - DETACHMENT[0]) for s in row["contact_set"]["detachments"])


def first_contact(row: Row) -> float:
    """Return the distance of the point of Section 7 from the nearest end of the contact set."""
    return min(abs(s - DETACHMENT[0]) for s in contact_set(row).boundary)


def outside(row: Row) -> float:
    """Return how far w_h lies below R_h(u) - u or above R_h(u)."""
    return float(max(row["one_sided"]["below"], row["one_sided"]["above"]))


def outer_width(row: Row) -> float:
    """Return how far the outer enclosure reaches beyond the contact set, in (e / b)^{2/3}."""
    found = row["enclosure"]
    width = DETACHMENT[0] - found["outer"]
    return float(width / (found["value"] / AMPLITUDE) ** (1.0 / DETACHMENT_EXPONENT))


def sharpness(row: Row, p: str) -> float:
    """Return the supercloseness over h^{3/2 - 1/p} / log2(1/h)."""
    n, order = row["n"], supercloseness_order(float(p)).value
    return float(row["supercloseness"] * n**order * math.log2(n))


def both_parts(row: Row, norm: str) -> float:
    """Return the part near the point and the one away, in the 16th power, over the whole."""
    parts, whole = row["parts"], row["by_paper_rule"][norm]
    return float(sum((parts[k][norm] / whole) ** 16 for k in ("near", "far")))


def over_table_1(row: Row, norm: str) -> float | None:
    """Return an error over that in the paper's Table 1; None for meshes that are not listed."""
    known = TABLE_1[norm].get(row["n"])
    return None if known is None else float(row["by_paper_rule"][norm] / known)


def worst(row: Row, part: str, key: str, over: str) -> float:
    """Return the largest quotient of two entries of a dual problem over all epsilon."""
    item = row[part]
    above = item[key] if isinstance(item[key], dict) else dict.fromkeys(item[over], item[key])
    return float(max(above[e] / item[over][e] for e in item[over]))


def violations(families: Sequence[Sequence[Row]]) -> int:
    """Return in how many ways the contact sets of one family of meshes violate (A_h)."""
    (rows,) = families
    sets = [contact_set(row) for row in rows]
    corners = np.arange(0.0, sets[0].length)  # of the unit square, by arc length
    return len(condition_a_h(sets, corners.tolist()).violations)


def middle(families: Sequence[Sequence[Row]]) -> float:
    """Return the error with the point at a half of an edge over the largest at other places.

    Args:
        families: The rows of the places 0, 1/4, 1/2, 3/4 of an edge.

    Returns:
        The quotient in the norm where it is largest, on the finest meshes.
    """
    zero, quarter, half, last = (rows[-1]["errors"] for rows in families)
    return max(half[norm] / max(e[norm] for e in (zero, quarter, last)) for norm in PLACED)


FUNCTIONS: Mapping[str, Callable[..., float | None]] = {
    function.__name__: function
    for function in (
        detachment_error,
        first_contact,
        outside,
        outer_width,
        sharpness,
        both_parts,
        over_table_1,
        worst,
    )
}
TOGETHER: Mapping[str, Callable[[Sequence[Sequence[Row]]], float]] = {
    function.__name__: function for function in (violations, middle)
}
