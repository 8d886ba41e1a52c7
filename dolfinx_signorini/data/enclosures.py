"""Enclosures of formulas: intervals that contain all values of a formula on a box or a simplex.

The natural enclosure puts the enclosures of the operations together. Where an argument appears more
than once, the natural enclosure is too wide by a multiple of the width of the box. The mean value
form f(c) + f'(X) (x - c), with the derivatives enclosed on the box, is too wide by a multiple of
the square of the width only. On a simplex its largest value is at a vertex.

Source: Moore, Kearfott and Cloud, Introduction to Interval Analysis (2009), Chapters 5 and 6.
"""

from functools import reduce
from operator import add

import numpy as np
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.ranks import anywhere
from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.data.formulas import Formula, Node, PerNode, Values, nodes
from dolfinx_signorini.data.interfaces.pieces import MOST_PIECES, Numbers, subdivide
from dolfinx_signorini.data.intervals import Interval, outward
from dolfinx_signorini.data.operations import COMPARISONS


def enclosed_on_boxes(formula: Formula, low: Array, high: Array) -> Array:
    """Return the natural enclosures of a formula on boxes: lower and upper ends, shape (2, boxes).

    Args:
        formula: The formula.
        low, high: The least and the largest coordinates of each box, shape (boxes, dimension).
    """
    return np.broadcast_to(_values(formula, low, high).ends[:, 0], (2, len(low)))


def enclosed_everywhere(root: Node) -> Interval:
    """Return an enclosure of all values of a tree, one interval."""
    places = [node.value for node in nodes(root) if node.op == "coordinate"]
    line = np.full((1, 1 + int(max(places, default=0.0))), np.inf)
    return _values(Formula("", root), -line, line)


def enclosed_on_simplices(formula: Formula, corners: Array) -> Array:
    """Return enclosures of a formula on simplices: natural ones cut down by mean value forms.

    Args:
        formula: The formula.
        corners: The vertices of the simplices, which may be segments, triangles or tetrahedra in
            any space, shape (simplices, vertices, dimension).

    Returns:
        The lower and the upper ends, shape (2, simplices).
    """
    if formula.constant is not None:
        return np.full((2, len(corners)), formula.constant)
    return enclosed_both_ways(formula, corners)[0]


def enclosed_both_ways(formula: Formula, corners: Array) -> tuple[Array, Array]:
    """Return enclosures of a formula on simplices, and linear functions below and above it.

    Returns:
        The enclosures, see `enclosed_on_simplices`, and the values of the linear functions at the
        vertices, shape (2, vertices, simplices).
    """
    centres = np.clip(corners.mean(axis=1), corners.min(axis=1), corners.max(axis=1))
    value, slopes = _values_and_slopes(formula, corners)
    middle = _values(formula, centres, centres)
    with np.errstate(all="ignore"):
        means = [middle + _change(slopes, v - centres) for v in np.moveaxis(corners, 1, 0)]
    linear = np.stack(
        [np.broadcast_to(mean.ends[:, 0], (2, len(corners))) for mean in means], axis=1
    )
    low = np.maximum(value.low[0], linear[0].min(axis=0))
    high = np.minimum(value.high[0], linear[1].max(axis=0))
    return np.broadcast_to(np.stack((low, high)), (2, len(corners))), linear


def _change(slopes: Interval, way: Array) -> Interval:
    """What functions with some slopes change by, along ways, shape (boxes, dimension)."""
    terms = slopes * outward(way.T, way.T, 0.0)
    return reduce(add, (Interval(terms.ends[:, k : k + 1]) for k in range(way.shape[1])))


def nowhere_negative(comm: MPI.Comm, formula: Formula, corners: Array, tiny: float) -> bool:
    """Return whether a formula is known to have no value below 0 on the simplices of all ranks.

    Args:
        comm: The communicator; the call is collective.
        formula, corners: See `enclosed_on_simplices`; the simplices of this rank.
        tiny: Negative values of this size are none.
    """

    def look(pieces: Array, owners: Numbers, level: int) -> tuple[Mask, list[Mask]]:
        open_ = enclosed_on_simplices(formula, pieces)[0] < -tiny
        return open_, [open_]

    levels = subdivide(corners, np.arange(len(corners)), look, comm, MOST_PIECES)
    return not anywhere(comm, any([bool(left.any()) for *_, (left,) in levels]))


@np.errstate(all="ignore")
def undefined(formula: Formula, corners: Array) -> Mask:
    """Return whether a part of a formula may have no value somewhere in simplices."""
    boxes = Enclosures(corners.min(axis=1), corners.max(axis=1))
    return np.broadcast_to(boxes.undefined(formula.root).ravel(), len(corners))


def enclosed_slopes(formula: Formula, corners: Array) -> Array:
    """Return enclosures of the derivatives of a formula from one end of a segment to the other.

    The segments have the shape (segments, 2, dimension), the enclosures (2, segments).
    """
    _, slopes = _values_and_slopes(formula, corners)
    with np.errstate(all="ignore"):
        total = _change(slopes, corners[:, 1] - corners[:, 0])
    return np.broadcast_to(total.ends[:, 0], (2, len(corners)))


def enclosed_gradients(formula: Formula, corners: Array) -> Array:
    """Return enclosures of the partial derivatives, shape (2, simplices, dimension).

    See `enclosed_on_simplices`.
    """
    _, slopes = _values_and_slopes(formula, corners)
    shape = 2, len(corners), corners.shape[2]
    return np.broadcast_to(slopes.ends.transpose(0, 2, 1), shape)


@np.errstate(all="ignore")
def _values(formula: Formula, low: Array, high: Array) -> Interval:
    return Enclosures(low, high)(formula.root)


@np.errstate(all="ignore")
def _values_and_slopes(formula: Formula, corners: Array) -> tuple[Interval, Interval]:
    values = Enclosures(corners.min(axis=1), corners.max(axis=1))
    return values(formula.root), _Slopes(values)(formula.root)


class Enclosures(Values[Interval]):
    """Enclosures of the nodes of formulas on boxes, shape (2, 1, boxes).

    Args:
        low, high: The least and the largest coordinates, shape (boxes, dimension).
    """

    def __init__(self, low: Array, high: Array):
        ends = np.stack((low.T, high.T))
        coordinates = [Interval(ends[:, k : k + 1]) for k in range(ends.shape[1])]
        super().__init__("interval", coordinates, coordinates[0].like)

    def find(self, node: Node) -> Interval:
        result = super().find(node)
        if node.op in COMPARISONS:  # of no value is false
            unknown = self.undefined(node)
            return Interval(np.where(unknown, [[[0.0]], [[1.0]]], result.ends))
        return result

    def undefined(self, root: Node) -> Mask:
        """Return whether a part of a formula may have no value at some points, shape (1, boxes)."""
        result = np.zeros(1, dtype=bool)
        for node in nodes(root):
            low, high = node.limits
            if np.isfinite(low):
                least, most = self(node.args[0]).ends
                tiny = ROUNDING * np.maximum(np.abs(least), np.abs(most))
                tiny = np.where(np.isfinite(tiny), tiny, 0.0)
                result = result | (least < low - tiny) | (most > high + tiny)
        return result


class _Slopes(PerNode[Interval]):
    """Enclosures of the derivatives of nodes with certain values, shape (2, dimension, boxes)."""

    def __init__(self, values: Enclosures):
        super().__init__()
        self.values = values

    def find(self, node: Node) -> Interval:
        if not node.args:
            axes = np.arange(len(self.values.coordinates))[:, None]
            unit = np.where((node.op == "coordinate") & (axes == node.value), 1.0, 0.0)
            return Interval(np.stack((unit, unit)))
        value, operands = self.values(node), [self.values(a) for a in node.operands]
        # Next to a pole the derivative has a sign that the differences across the pole do not have.
        broken = ~np.isfinite(value.ends).all(axis=0) | node.operation.jumps(*operands)
        slopes = map(self, node.operands)
        slope = node.operation.slope(value, *operands, *node.exponents, *slopes)
        return slope.line_where(broken)
