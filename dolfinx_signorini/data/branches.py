"""Branches of formulas: `where`, `min`, `max`, `abs` and `sign`, decided cell by cell.

Let m be the function whose sign a branch depends on, c a point of a simplex, and s intervals around
the derivatives of m. At each vertex v, m(c) + s.(v - c) lies between two numbers, and the linear
functions with these values at the vertices enclose m. Then m <= 0 is possible only where the lower
one is not positive. With the values l at the vertices that is a share of

    l_0^d / ((l_0 - l_1) ... (l_0 - l_d))       if l_0 < 0 <= l_1, ..., l_d,
    1 - l_d^d / ((l_d - l_0) ... (l_d - l_d-1)) if l_0, ..., l_d-1 < 0 < l_d,

of the simplex, and at most d D/M in any case with -D = min l <= 0 < M = max l, for the barycentric
coordinate of the vertex with M is at most D/M there. A mesh that is fitted to the line m = 0, up to
rounding, leaves shares like 1e-15, and next to a curve what the curve bulges.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.tolerances import SOLVED, UPWARDS
from dolfinx_signorini.data.enclosures import enclosed_both_ways, undefined
from dolfinx_signorini.data.formulas import Formula, Node, PerNode, evaluated
from dolfinx_signorini.data.interfaces.pieces import FINE, Numbers, subdivide
from dolfinx_signorini.data.interfaces.singular_sets import factors, margins

MOST_PATTERNS = 64  # of branches: in all simplices, and where all that there may be are tried


@dataclass(frozen=True)
class Decided:
    """Some simplices with formulas that choose nothing on them:

        for part in decided(formulas, corners):
            low, high = enclosed_on_simplices(part.formulas[0], corners[part.cells])

    Attributes:
        cells: The numbers of the simplices.
        formulas: The branches of the formulas, without switches.
        shares: Of each simplex, where the formulas may have other branches.
        others: Formulas that enclose all other values together: with all branches that some of the
            simplices may have, or with their own ones.
    """

    cells: Indices
    formulas: list[Formula]
    shares: Array
    others: list[list[Formula]]


def decided(formulas: Sequence[Formula], corners: Array, finest: int = FINE) -> list[Decided]:
    """Return branches of formulas, with the simplices on which they may stand for others.

    Args:
        formulas: The formulas.
        corners: The vertices of the simplices, shape (simplices, vertices, dimension).
        finest: Into how many pieces a simplex may be divided for its share, about.

    Returns:
        The formulas themselves, with shares 0, where there are too many branches.
    """
    known = dict.fromkeys(margins(*formulas))
    count, every = len(corners), np.arange(len(corners))
    found = [_sides(Formula("", margin), corners, finest) for margin in known]
    signs = np.array([sign for sign, _ in found]).reshape(len(found), count)
    patterns, which = np.unique(signs, axis=1, return_inverse=True)
    if not found or patterns.shape[1] > MOST_PATTERNS:
        return [Decided(every, list(formulas), np.zeros(count), [])]
    shares = np.minimum(np.sum([share for _, share in found], axis=0), 1.0)

    def made(pattern: Sequence[bool]) -> list[Formula]:
        chosen = _Chosen(dict(zip(known, pattern, strict=True)))
        return [Formula(f.text, chosen(f.root)) for f in formulas]

    parts = []
    for k, pattern in enumerate(patterns.T):
        cells = np.flatnonzero(which.ravel() == k)
        open_ = [bool((share[cells] > 0.0).any()) for _, share in found]
        both = zip(open_, pattern, strict=True)
        others = [list(formulas)]
        if 2 ** sum(open_) <= MOST_PATTERNS:
            choices = ((True, False) if free else (bool(sign),) for free, sign in both)
            others = [made(other) for other in product(*choices)]
        parts.append(Decided(cells, made(pattern.tolist()), shares[cells], others))
    return parts


def _sides(margin: Formula, corners: Array, finest: int) -> tuple[npt.NDArray[np.bool_], Array]:
    """Whether a function is positive in most of a simplex, and on what share it may be negative.

    A product changes its sign where one of its factors does, and nowhere else: factors tell more
    where they are simpler, (x - a) (b - x) for example next to the lines x = a and x = b.
    """
    positive, share = _sides_of_one(margin, corners, finest)
    parts = [Formula("", part) for part in factors(margin.root, signs=True)]
    if len(parts) < 2:
        return positive, share
    middle = corners.mean(axis=1)
    known = ~undefined(margin, corners)
    total = np.zeros(len(corners))
    for part in parts:
        above, shared = _sides_of_one(part, corners, finest)
        value = evaluated(part.root, middle)
        known &= np.where(above, value > 0.0, value < 0.0)
        total += shared
    value = evaluated(margin.root, middle)
    better = known & (value != 0.0) & (total < share)
    return np.where(better, value > 0.0, positive), np.where(better, total, share)


def _sides_of_one(
    margin: Formula, corners: Array, finest: int
) -> tuple[npt.NDArray[np.bool_], Array]:
    """The same, by what encloses the function itself."""

    def look(pieces: Array, owners: Numbers, level: int) -> tuple[Mask, list[Array]]:
        shares = _shares(margin, pieces)
        return shares.min(axis=0) > SOLVED, [shares]

    total = np.zeros((2, len(corners)))  # of places that may be negative, and positive
    parts = 2 ** (corners.shape[1] - 1)
    deepest = int(math.log(finest, parts))
    for _, owners, level, (shares,) in subdivide(
        corners, np.arange(len(corners)), look, deepest=deepest
    ):
        for side, share in zip(total, shares, strict=True):
            side += np.bincount(owners, share, len(corners)) / float(parts) ** level
    positive = total[0] <= total[1]
    return positive, np.minimum(np.where(positive, *total), 1.0)


def _shares(margin: Formula, corners: Array) -> Array:
    """Shares of simplices outside of which a function is positive, and negative."""
    (least, most), (low, high) = enclosed_both_ways(margin, corners)
    result, doubt = [], undefined(margin, corners)
    for ends, clear in ((low, least > 0.0), (-high, most < 0.0)):
        share = np.where(clear, 0.0, _not_positive(ends))
        result.append(np.where(doubt, 1.0, share))  # a comparison of no value is false
    return np.stack(result)


def _not_positive(ends: Array) -> Array:
    """Where linear functions are not positive, at most, by their values, shape (vertices, n)."""
    d, values = len(ends) - 1, np.sort(ends, axis=0)  # what is no number comes last
    depth, top, below = np.maximum(-values[0], 0.0), values[-1], (values < 0.0).sum(axis=0)
    with np.errstate(all="ignore"):
        tip = np.prod(depth / (depth + values[1:]), axis=0)
        rest = -np.expm1(-np.log1p(-values[:-1] / top).sum(axis=0))
        share = np.where(below == 1, tip, np.where(below == d, rest, d * depth / top))
        share = np.where((top > 0.0) & np.isfinite(depth), share, 1.0)
    return np.asarray(np.minimum(np.where(np.isnan(share), 1.0, share * UPWARDS), 1.0))


class _Chosen(PerNode[Node]):
    """The nodes of formulas whose branches are those of switches with known signs."""

    def __init__(self, positive: dict[Node, bool]):
        super().__init__()
        self.positive = positive

    def find(self, node: Node) -> Node:
        if node.switch is not None:
            return self(node.chosen(self.positive[node.switch]))
        return Node(node.op, tuple(map(self, node.args)), node.value)
