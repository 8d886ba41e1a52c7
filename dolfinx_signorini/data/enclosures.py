"""Enclosures of formulas: intervals that contain all values of a formula on a box or a simplex.

The natural enclosure puts the enclosures of the operations together. Where an argument appears more
than once, the natural enclosure is too wide by a multiple of the width of the box. The mean value
form f(c) + f'(X) (x - c), with the derivatives enclosed on the box, is too wide by a multiple of
the square of the width only. On a simplex its largest value is at a vertex.

Source: Moore, Kearfott and Cloud, Introduction to Interval Analysis (2009), Chapters 5 and 6.
"""

from collections.abc import Callable
from functools import reduce

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.data.formulas import COMPARISONS, Formula, Node, PerNode, nodes
from dolfinx_signorini.data.interfaces.pieces import MOST_PIECES, divided
from dolfinx_signorini.data.intervals import (
    ONE,
    OPERATIONS,
    add,
    choose,
    cosine,
    cut,
    divide,
    line_where,
    multiply,
    negative,
    outward,
    power,
    reciprocal,
    sine,
    subtract,
)

LIMITS = {"sqrt": (0.0, np.inf), "log": (0.0, np.inf), "asin": (-1.0, 1.0), "acos": (-1.0, 1.0)}
ROUNDING = 1e-12  # of an argument that is beyond such a limit
DIVISIONS = 6  # of simplices in search for a sign

# A value and, where asked for, its derivatives: shapes (2, 1, boxes) and (2, dimension, boxes).
Pair = tuple[Array, Array | None]

# The derivative of each function of one argument a with the value v.
DERIVATIVES: dict[str, Callable[[Array, Array], Array]] = {
    "sqrt": lambda a, v: divide(0.5 * ONE, v),
    "exp": lambda a, v: v,
    "sin": lambda a, v: cosine(a),
    "cos": lambda a, v: negative(sine(a)),
    "tan": lambda a, v: add(ONE, power(v, 2.0)),
    "asin": lambda a, v: _of_arcsine(a),
    "acos": lambda a, v: negative(_of_arcsine(a)),
    "atan": lambda a, v: reciprocal(add(ONE, power(a, 2.0))),
    "sinh": lambda a, v: OPERATIONS["cosh"](a),
    "cosh": lambda a, v: OPERATIONS["sinh"](a),
    "tanh": lambda a, v: subtract(ONE, power(v, 2.0)),
    "log": lambda a, v: reciprocal(a),
    "abs": lambda a, v: np.sign(a),
    "sign": lambda a, v: line_where((a[0] <= 0.0) & (a[1] >= 0.0), 0.0 * v),
    "negative": lambda a, v: -ONE,
}


def enclosed_on_boxes(formula: Formula, low: Array, high: Array) -> Array:
    """Return the natural enclosures of a formula on boxes.

    Args:
        formula: The formula.
        low, high: The least and the largest coordinates of each box, shape (boxes, dimension).

    Returns:
        The lower and the upper ends, shape (2, boxes).
    """
    value, _ = _enclosed(formula, low, high, False)
    return np.broadcast_to(value[:, 0], (2, len(low)))


def enclosed_on_simplices(formula: Formula, corners: Array) -> Array:
    """Return enclosures of a formula on simplices: natural ones cut down by mean value forms.

    Args:
        formula: The formula.
        corners: The vertices of the simplices, which may be segments, triangles or tetrahedra in
            any space, shape (simplices, vertices, dimension).

    Returns:
        The lower and the upper ends, shape (2, simplices).
    """
    value, mean = _both(formula, corners)
    mean = np.stack((mean[0].min(axis=0), mean[1].max(axis=0)))
    both = np.stack((np.maximum(value[0, 0], mean[0]), np.minimum(value[1, 0], mean[1])))
    return np.broadcast_to(both, (2, len(corners)))


def enclosed_linearly(formula: Formula, corners: Array) -> Array:
    """Return the values at vertices of linear functions below and above a formula on simplices.

    Args:
        formula, corners: See `enclosed_on_simplices`.

    Returns:
        Shape (2, vertices, simplices).
    """
    return _both(formula, corners)[1]


def _both(formula: Formula, corners: Array) -> tuple[Array, Array]:
    """Natural enclosures, and mean value forms at vertices."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    centres = np.clip(corners.mean(axis=1), low, high)
    value, slopes = _enclosed(formula, low, high, True)
    assert slopes is not None
    middle, _ = _enclosed(formula, centres, centres, False)
    with np.errstate(all="ignore"):
        means = []
        for vertex in np.moveaxis(corners, 1, 0):
            offset = (vertex - centres).T
            terms = multiply(slopes, outward(offset, offset, 0.0))
            change = reduce(add, (terms[:, k : k + 1] for k in range(len(offset))))
            means.append(np.broadcast_to(add(middle, change)[:, 0], (2, len(corners))))
    return value, np.stack(means, axis=1)


def nowhere_negative(comm: MPI.Comm, formula: Formula, corners: Array, tiny: float) -> bool:
    """Return whether a formula is known to have no value below 0 on the simplices of all ranks.

    Args:
        comm: The communicator; the call is collective.
        formula, corners: See `enclosed_on_simplices`; the simplices of this rank.
        tiny: Negative values of this size are none.
    """
    for _ in range(DIVISIONS + 1):
        open_ = enclosed_on_simplices(formula, corners)[0] < -tiny
        count = comm.allreduce(int(np.count_nonzero(open_)))
        if count == 0 or count > MOST_PIECES:
            return count == 0
        corners, _ = divided(corners[open_], np.flatnonzero(open_))
    return False


def undefined(formula: Formula, corners: Array) -> npt.NDArray[np.bool_]:
    """Return whether a part of a formula may have no value somewhere in simplices.

    Args:
        formula, corners: See `enclosed_on_simplices`.
    """
    with np.errstate(all="ignore"):
        boxes = Enclosures(corners.min(axis=1), corners.max(axis=1), False)
        found = boxes.undefined(formula.root)
    return np.broadcast_to(found.ravel(), len(corners))


def enclosed_slopes(formula: Formula, corners: Array) -> Array:
    """Return enclosures of the derivatives of a formula from one end of a segment to the other.

    Args:
        formula: The formula.
        corners: The ends of the segments, shape (segments, 2, dimension).

    Returns:
        The lower and the upper ends, shape (2, segments).
    """
    slopes = _slopes_on(formula, corners)
    way = (corners[:, 1] - corners[:, 0]).T
    with np.errstate(all="ignore"):
        terms = multiply(slopes, outward(way, way, 0.0))
        total = reduce(add, (terms[:, k : k + 1] for k in range(len(way))))
    return np.broadcast_to(total[:, 0], (2, len(corners)))


def enclosed_gradients(formula: Formula, corners: Array) -> Array:
    """Return enclosures of the partial derivatives of a formula on simplices.

    Args:
        formula, corners: See `enclosed_on_simplices`.

    Returns:
        The lower and the upper ends, shape (2, simplices, dimension).
    """
    slopes = _slopes_on(formula, corners).transpose(0, 2, 1)
    return np.broadcast_to(slopes, (2, len(corners), corners.shape[2]))


def _slopes_on(formula: Formula, corners: Array) -> Array:
    _, slopes = _enclosed(formula, corners.min(axis=1), corners.max(axis=1), True)
    assert slopes is not None
    return slopes


def _enclosed(formula: Formula, low: Array, high: Array, slopes: bool) -> Pair:
    with np.errstate(all="ignore"):
        return Enclosures(low, high, slopes)(formula.root)


class Enclosures(PerNode[Pair]):
    """Enclosures of the nodes of formulas on boxes.

    Args:
        low, high: The least and the largest coordinates, shape (boxes, dimension).
        slopes: Whether derivatives are enclosed, too.
    """

    def __init__(self, low: Array, high: Array, slopes: bool):
        super().__init__()
        self.ends, self.slopes = np.stack((low.T, high.T)), slopes

    def find(self, node: Node) -> Pair:
        if node.op == "number":
            return node.value * ONE, 0.0 * ONE if self.slopes else None
        if node.op == "coordinate":
            k = int(node.value)
            unit = np.eye(self.ends.shape[1])[None, :, k, None]
            return self.ends[:, k : k + 1], np.concatenate((unit, unit)) if self.slopes else None
        pairs = [self(a) for a in node.args]
        values = [value for value, _ in pairs]
        if node.op == "^":
            result = power(values[0], node.args[1].value)
        else:
            result = OPERATIONS[node.op](*values)
        if node.op in COMPARISONS:  # of no value is false
            result = np.where(self.undefined(node), [[[0.0]], [[1.0]]], result)
        slopes = [slope for _, slope in pairs if slope is not None]
        if not slopes:
            return result, None
        # Next to a pole the derivative has a sign that the differences across the pole do not have.
        pole = np.asarray(~np.isfinite(result).all(axis=0))
        return result, line_where(pole, _slopes(node, values, result, slopes))

    def undefined(self, root: Node) -> npt.NDArray[np.bool_]:
        """Return whether a part of a formula may have no value at some points, shape (1, boxes)."""
        result = np.zeros(1, dtype=bool)
        for node in nodes(root):
            low, high = LIMITS.get(node.op, (-np.inf, np.inf))
            if node.op == "^" and node.args[1].value % 1.0:
                low = 0.0
            if (low, high) != (-np.inf, np.inf):
                least, most = self(node.args[0])[0]
                tiny = ROUNDING * np.maximum(np.abs(least), np.abs(most))
                tiny = np.where(np.isfinite(tiny), tiny, 0.0)
                result = result | (least < low - tiny) | (most > high + tiny)
        return result


def _slopes(node: Node, values: list[Array], result: Array, slopes: list[Array]) -> Array:
    """Enclose the derivatives of an operation by the derivatives of its arguments."""
    a, b = values[0], values[-1]
    da, db = slopes[0], slopes[-1]
    if node.op in DERIVATIVES:
        return multiply(DERIVATIVES[node.op](a, result), da)
    if node.op == "^":
        exponent = node.args[1].value
        if exponent == 0.0:
            return 0.0 * ONE
        return multiply(multiply(exponent * ONE, power(a, exponent - 1.0)), da)
    if node.op == "+":
        return add(da, db)
    if node.op == "-":
        return subtract(da, db)
    if node.op == "*":
        return add(multiply(a, db), multiply(b, da))
    if node.op == "/":
        return divide(subtract(da, multiply(result, db)), b)
    if node.op == "hypot":
        shares = [np.clip(divide(c, result), -1.0, 1.0) for c in (a, b)]
        return add(multiply(shares[0], da), multiply(shares[1], db))
    if node.op == "atan2":
        turn = subtract(multiply(b, da), multiply(a, db))
        turn = divide(turn, power(OPERATIONS["hypot"](a, b), 2.0))
        return line_where(cut(a, b), turn)
    if node.op in ("min", "max"):
        below = OPERATIONS["<=" if node.op == "min" else ">="](a, b)
        return choose(below, da, db)
    if node.op == "where":
        decided = values[0][0] == values[0][1]
        return line_where(~decided, choose(values[0], slopes[1], slopes[2]))
    return 0.0 * ONE  # of a comparison, which only `where` uses


def _of_arcsine(a: Array) -> Array:
    return reciprocal(OPERATIONS["sqrt"](subtract(ONE, power(a, 2.0))))
