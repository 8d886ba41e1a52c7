"""Polynomials in place of formulas on simplices, with proven bounds of what the polynomials miss.

A formula is known at the points of a quadrature rule. What a rule cannot see is bounded on each
piece of a simplex: by `discs` where the formula is analytic, or else by an interval around all
values. Simplices are divided into pieces where these bounds are not small enough: near jumps, kinks
and singular points, and where the formula varies faster than the mesh.

Let t(n) bound what polynomials of degree n miss of f on a piece. By a rule with positive weights
that is exact for polynomials of degree q, the mean of f p over the piece, with a polynomial p of
degree n, is wrong by at most 2 t(q - n) max |p|, and the root of the mean of (f - p)^2 is wrong by
at most 2 t(q / 2). A projection on polynomials of degree n that has the norm L in the maximum norm
misses at most (1 + L) t(n) of f at every point.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import comb

import numpy as np
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, Mask, blocks
from dolfinx_signorini.base.tolerances import SOLVED, UPWARDS
from dolfinx_signorini.data.analytic import missed_by_discs
from dolfinx_signorini.data.branches import Decided, decided
from dolfinx_signorini.data.enclosures import enclosed_on_simplices
from dolfinx_signorini.data.formulas import Formula, Node, evaluated, nodes
from dolfinx_signorini.data.interfaces.interface import Interface
from dolfinx_signorini.data.interfaces.pieces import (
    FINE,
    MOST_PIECES,
    Numbers,
    corners_of_reference,
    divided,
    inside,
    relative_sizes,
    subdivide,
    with_reference,
)
from dolfinx_signorini.data.interfaces.singular_sets import factors, margins
from dolfinx_signorini.data.singular import root_mean_squares
from dolfinx_signorini.meshes.polynomials import largest, polynomials
from dolfinx_signorini.meshes.quadrature import rule
from dolfinx_signorini.meshes.sided_meshes import simplex_sizes

ORDERS = {1: 16, 2: 12, 3: 8}  # of the rules on pieces, by dimension
MOST_WORK = 1_000_000  # pieces that are divided, times the number of operations of a formula
PIECES = 8  # that are divided together, for each simplex: the price is in proportion to the mesh
# Of a formula: where polynomials miss more, it is bounded in parts, or by a higher degree.
KINKED = 1e-5


@dataclass(frozen=True)
class Approximation:
    """Polynomials in place of a formula on simplices:

        found = approximated(formula, comm, corners, degree=3, weights=weights, tolerance=1e-4)

    Attributes:
        coefficients: Each polynomial Q in terms of `polynomials`.
        missed: A bound of the root of the mean of (f - Q)^2 on each simplex.
        mean: A bound of the mean of (f - Q) p on each simplex, for polynomials p of the same degree
            with values of at most 1.
        hidden: The L2 norm over all simplices of weights times those parts of both bounds that come
            from between the points.
    """

    coefficients: Array
    missed: Array
    mean: Array
    hidden: float


@dataclass(frozen=True)
class _Branch:
    """Pieces of simplices on which a formula without branches stands for another one.

    The vertices of the pieces have reference coordinates first. What the formulas are apart is
    given as the root of the mean square, and the mean of the size, of the difference on each piece.
    """

    formula: Formula
    pieces: Array
    owners: Numbers
    apart: Array

    def some(self, rows: Mask) -> "_Branch":
        """Return some of the pieces."""
        return _Branch(self.formula, self.pieces[rows], self.owners[rows], self.apart[:, rows])


@dataclass(frozen=True)
class _Part:
    """Pieces of simplices with the formula at points."""

    pieces: Array
    owners: Numbers
    values: Array
    tails: Array  # of what points do not tell: of the root of mean squares, and of means

    def in_blocks(self, width: int) -> Iterator["_Part"]:
        """Yield the pieces in blocks, for so many numbers for each piece."""
        for some in blocks(len(self.pieces), width):
            kept = self.pieces[some], self.owners[some], self.values[some]
            yield _Part(*kept, self.tails[:, some])


@np.errstate(over="ignore", invalid="ignore")
def approximated(
    formula: Formula, comm: MPI.Comm, corners: Array, degree: int, weights: Array, tolerance: float
) -> Approximation:
    """Return polynomials in place of a formula; the call is collective.

    Args:
        formula: The formula f.
        comm: The communicator.
        corners: The vertices of the simplices of this rank, shape (simplices, vertices, dimension).
        degree: The degree of the polynomials, at most half of `ORDERS`.
        weights: What the two attributes `missed` and `mean` count, shape (2, simplices).
        tolerance: The L2 norms over all simplices of weights times bounds that are small enough,
            for what is hidden between the points.
    """
    dimension, count = corners.shape[1] - 1, len(corners)
    points, rule_weights = rule(dimension, ORDERS[dimension])
    limits = _Limits(comm, simplex_sizes(corners), weights, tolerance)
    branches = _branches(formula, corners, limits)
    moments = np.zeros((count, comb(degree + dimension, dimension)))
    # The tables of polynomials on all pieces would need much more memory than the pieces.
    width = moments.shape[1] * len(points)
    parts = [
        some
        for branch in branches
        for part in _parts(branch, degree, limits)
        for some in part.in_blocks(width)
    ]
    for part in parts:
        table = _table(part.pieces, points, degree)
        own = np.einsum("nq,niq->ni", part.values * rule_weights, table)
        np.add.at(moments, part.owners, relative_sizes(part.pieces)[:, None] * own)
    squares, between = np.zeros(count), np.zeros((2, count))
    for part in parts:
        table = _table(part.pieces, points, degree)
        rest = part.values - np.einsum("ni,niq->nq", moments[part.owners], table)
        root = np.sqrt(np.square(rest) @ rule_weights) + part.tails[0]
        squares += np.bincount(part.owners, relative_sizes(part.pieces) * root**2, count)
        between += limits.on_simplices(part.pieces, part.owners, part.tails)
    apart = np.zeros((2, count))
    for branch in branches:
        apart += limits.on_simplices(branch.pieces, branch.owners, branch.apart)
    missed, mean = np.sqrt(squares) + np.sqrt(apart[0]), between[1] + apart[1]
    hidden = limits.total(np.stack((np.sqrt(between[0]) + np.sqrt(apart[0]), mean)))
    return Approximation(moments, missed * UPWARDS, mean * UPWARDS, hidden)


@dataclass(frozen=True)
class _Limits:
    """How much may be hidden on the simplices of all ranks, see `approximated`."""

    comm: MPI.Comm
    sizes: Array
    weights: Array
    tolerance: float

    @cached_property
    def allowed(self) -> float:
        """The weighted value that is small enough if all pieces have the same."""
        size = self.comm.allreduce(float(self.sizes.sum()))
        return self.tolerance / math.sqrt(size or 1.0)

    @cached_property
    def most(self) -> int:
        """How many pieces of all ranks are divided together, at most: in proportion to the mesh."""
        cells = self.comm.allreduce(len(self.sizes))
        return min(MOST_PIECES, max(FINE, PIECES * cells))

    def on_simplices(self, pieces: Array, owners: Numbers, hidden: Array) -> Array:
        """Return mean squares and means over simplices, of such roots and means on pieces."""
        shares, count = relative_sizes(pieces), len(self.sizes)
        squares = np.bincount(owners, shares * hidden[0] ** 2, count)
        return np.stack((squares, np.bincount(owners, shares * hidden[1], count)))

    def total(self, hidden: Array) -> float:
        """Return the weighted L2 norm over the simplices of all ranks, the larger one of two."""
        sums = np.square(self.weights * hidden) @ self.sizes
        return float(np.sqrt(np.sum(self.comm.allgather(sums), axis=0).max()))

    def exceeded(self, pieces: Array, owners: Numbers, hidden: Array) -> Mask:
        """Return which pieces hide too much; none if all of them together hide little enough."""
        open_ = ~(hidden * self.weights[:, owners] <= self.allowed).all(axis=0)
        found = self.on_simplices(pieces, owners, np.where(open_, hidden, 0.0))
        found[0] = np.sqrt(found[0])
        return np.asarray(open_ & (not self.total(found) <= self.tolerance))


def _whole(pieces: Array) -> Mask:
    """Whether pieces are the simplices themselves."""
    dimension = pieces.shape[1] - 1
    return np.asarray((pieces[..., :dimension] == corners_of_reference(dimension)).all(axis=(1, 2)))


def _branches(formula: Formula, corners: Array, limits: _Limits) -> list[_Branch]:
    """Simplices, cut where the formula chooses, with its branches; as many on all ranks."""
    start, comm = with_reference(corners), limits.comm
    found: dict[tuple[Node, bool], list[_Branch]] = {}
    branches: list[_Branch] = []  # of the pieces that are looked at

    def look(pieces: Array, owners: Numbers, level: int) -> tuple[Mask, list[Numbers]]:
        squares, means, thick = np.zeros((3, len(pieces)))
        branches[:] = _cut(formula, pieces)
        for branch in branches:
            at = branch.owners
            shares = relative_sizes(branch.pieces) / relative_sizes(pieces)[at]
            squares += np.bincount(at, shares * branch.apart[0] ** 2, len(pieces))
            means += np.bincount(at, shares * branch.apart[1], len(pieces))
            # What rounding leaves on the wrong side of a cut, no division makes less.
            thin = branch.apart[1] <= math.sqrt(SOLVED) * branch.apart[0]
            thick += np.bincount(at, ~thin, len(pieces))
        open_ = limits.exceeded(pieces, owners, np.stack((np.sqrt(squares), means)))
        return open_ & (thick > 0.0), [np.arange(len(pieces))]

    most = MOST_PIECES // 2 ** (corners.shape[1] - 2)  # for a cut makes several pieces of one
    steps = subdivide(start, np.arange(len(corners)), look, comm, most)
    for _, owners, _, (numbers,) in steps:
        for branch in branches:
            whole, kept = _whole(branch.pieces), np.isin(branch.owners, numbers)
            for kind in (True, False):
                some = branch.some(kept & (whole == kind))
                some = replace(some, owners=owners[np.searchsorted(numbers, some.owners)])
                found.setdefault((branch.formula.root, kind), []).append(some)
    together = [
        _Branch(
            Formula(formula.text, root),
            np.concatenate([branch.pieces for branch in every]),
            np.concatenate([branch.owners for branch in every]),
            np.concatenate([branch.apart for branch in every], axis=1),
        )
        for (root, _), every in found.items()
    ]
    count = max(comm.allgather(len(together)))
    nothing = _Branch(formula, start[:0], np.arange(0), np.zeros((2, 0)))
    return together + [nothing] * (count - len(together))


def _cut(formula: Formula, pieces: Array) -> Iterator[_Branch]:
    """Yield branches of a formula with parts of pieces, which are cut where the formula chooses.

    The owners of the parts are the pieces. A piece on which the distance of the branches has no
    bound keeps the formula as it is.
    """
    dimension = pieces.shape[2] - pieces.shape[1] + 1
    parts = pieces
    own: Numbers = np.arange(len(pieces))
    for node in dict.fromkeys(f for m in margins(formula) for f in factors(m, signs=True)):
        parts, numbers = Interface(node).cut(parts, dimension)
        own = own[numbers]
    thick = relative_sizes(parts) > 0.0
    parts, own = parts[thick], own[thick]
    found, unknown = [], np.zeros(len(pieces), dtype=bool)
    for part in decided([formula], parts[..., -dimension:], finest=1) if len(parts) else ():
        apart = np.zeros((2, len(part.cells)))
        for (other,) in part.others:
            between = Formula("", part.formulas[0].root - other.root)
            ends = enclosed_on_simplices(between, parts[part.cells][..., -dimension:])
            far = np.abs(ends).max(axis=0)
            far = np.where(part.shares > 0.0, np.where(np.isnan(far), np.inf, far), 0.0)
            apart = np.maximum(apart, far * np.stack((np.sqrt(part.shares), part.shares)))
        found.append((part, apart))
        unknown[own[part.cells[np.isinf(apart).any(axis=0)]]] = True
    for part, apart in found:
        kept = ~unknown[own[part.cells]]
        cells = part.cells[kept]
        yield _Branch(part.formulas[0], parts[cells], own[cells], apart[:, kept])
    whole = np.flatnonzero(unknown)
    yield _Branch(formula, pieces[whole], whole, np.zeros((2, len(whole))))


def followed(formula: Formula, corners: Array, degree: int) -> tuple[Array, Array]:
    """Return polynomials that follow a formula at every point, with bounds of the differences.

    Args:
        formula: The formula.
        corners: The vertices of simplices, shape (simplices, vertices, dimension).
        degree: The degree of the polynomials.

    Returns:
        The coefficients, see `Approximation`, and the bounds, shape (simplices,).
    """
    dimension = corners.shape[1] - 1
    order = ORDERS[dimension] // 2
    points, weights = rule(dimension, 2 * order)
    values = evaluated(formula.root, inside(corners, points)).T
    full = (values * weights) @ polynomials(dimension, order, points).T
    tails = _tails(formula, corners, (order,))[0]
    norm = comb(order + dimension, dimension)
    terms = comb(degree + dimension, dimension)  # the basis goes from degree to degree
    cut = full.copy()
    cut[:, :terms] = 0.0
    bounds = ((1 + norm) * tails + largest(dimension, order, cut)) * UPWARDS
    coefficients = full[:, :terms]
    low, high = enclosed_on_simplices(formula, corners)
    flat = ~(bounds <= 0.5 * (high - low))
    coefficients[flat] = 0.0
    bounds[flat] = np.inf
    finite = flat & np.isfinite(low) & np.isfinite(high)
    coefficients[finite, 0] = 0.5 * (low[finite] + high[finite])
    bounds[finite] = 0.5 * (high[finite] - low[finite]) * UPWARDS
    return coefficients, bounds


def followed_in_parts(
    formula: Formula, corners: Array, degree: int, divisions: int = 4
) -> tuple[Array, Array]:
    """Return the same as `followed`, with less beside polynomials where a formula has kinks.

    On simplices with kinks the polynomials follow those in the mean that follow the formula, or a
    branch of it, on small parts. Bernstein coefficients bound the differences of both.

    Args:
        formula, corners, degree: See `followed`.
        divisions: How often the simplices are divided into parts: the bound of a cube above an
            obstacle with kinks is 16 % smaller with 4 than with 2.
    """
    coefficients, bounds = followed(formula, corners, degree)
    height = np.abs(coefficients).max(axis=1, initial=0.0)
    rough = np.flatnonzero(np.isfinite(bounds) & (bounds > KINKED * height))
    size = 2 ** (divisions * (corners.shape[1] - 1))
    for some in (rough[part] for part in blocks(len(rough), size) if len(rough)):
        whole, found = _by_parts(formula, corners[some], degree, divisions, height[some])
        better = found < bounds[some]
        coefficients[some[better]], bounds[some[better]] = whole[better], found[better]
    return coefficients, bounds


def _by_parts(
    formula: Formula, corners: Array, degree: int, divisions: int, height: Array
) -> tuple[Array, Array]:
    """What `followed_in_parts` has on simplices, by parts."""
    dimension, count = corners.shape[1] - 1, len(corners)
    parts = with_reference(corners)
    owners: Numbers = np.arange(count)
    for _ in range(divisions):
        parts, owners = divided(parts, owners)
    order = np.argsort(owners, kind="stable")  # all simplices have the same parts
    parts, small = parts[order], height[owners[order]] * KINKED
    own, apart = followed(formula, parts[..., dimension:], degree)
    kinked = np.flatnonzero(np.isfinite(apart) & (apart > small))
    for part in decided([formula], parts[kinked][..., dimension:]):
        cells = kinked[part.cells]
        series, far = _beside_branches(part, parts[cells][..., dimension:], degree)
        better = far < apart[cells]
        own[cells[better]], apart[cells[better]] = series[better], far[better]
    points, weights = rule(dimension, 2 * degree)
    size = 2 ** (dimension * divisions)
    table = _table(parts[:size], points, degree) * weights
    moments = table @ polynomials(dimension, degree, points).T
    whole = np.einsum("npo,pwo->nw", own.reshape(count, size, own.shape[1]), moments) / size
    there = np.einsum("nw,pwo->npo", whole, moments).reshape(own.shape)
    apart += largest(dimension, degree, own - there) * UPWARDS
    return whole, apart.reshape(count, size).max(axis=1, initial=0.0)


def _beside_branches(part: Decided, corners: Array, degree: int) -> tuple[Array, Array]:
    """Polynomials that follow one branch of a formula, and bounds of their distance to all."""
    own, apart = followed(part.formulas[0], corners, degree)
    open_ = np.flatnonzero(part.shares > 0.0)
    for (other,) in part.others:
        theirs, more = followed(other, corners[open_], degree)
        far = largest(corners.shape[1] - 1, degree, own[open_] - theirs)
        apart[open_] = np.maximum(apart[open_], (far + more) * UPWARDS)
    return own, apart


def _parts(branch: _Branch, degree: int, limits: _Limits) -> list[_Part]:
    """Divide pieces into smaller ones on which the formula is known well enough."""
    formula, comm, weights, parts = branch.formula, limits.comm, limits.weights, []
    dimension = branch.pieces.shape[1] - 1
    # Ranks may have different formulas, and all leave the loop at the same level.
    operations = len(nodes(formula.root))
    most = comm.allreduce(min(limits.most, MOST_WORK // operations), op=MPI.MIN)

    def look(pieces: Array, owners: Numbers, level: int) -> tuple[Mask, list[Array]]:
        allowed = np.asarray(limits.allowed / weights[:, owners])
        found = [
            _enclosed(formula, pieces[some, :, dimension:], degree, allowed[:, some])
            for some in blocks(len(pieces), operations)
        ]
        tails = np.concatenate([each for each, _ in found], axis=1)
        levels = np.concatenate([each for _, each in found])
        return limits.exceeded(pieces, owners, tails), [tails, levels]

    for pieces, owners, _, (tails, levels) in subdivide(
        branch.pieces, branch.owners, look, comm, most
    ):
        values = _values(formula, pieces[..., dimension:], levels)
        tails[:, ~np.isfinite(values).all(axis=1)] = np.inf
        parts.append(_Part(pieces, owners, np.nan_to_num(values), tails))
    return parts


def _enclosed(formula: Formula, pieces: Array, degree: int, allowed: Array) -> tuple[Array, Array]:
    """What is hidden on pieces, and constants in place of the values at points, or NaN.

    The formula is tested with polynomials of a degree; what is allowed has the shape (2, pieces).
    """
    order = ORDERS[pieces.shape[1] - 1]
    levels = np.full(len(pieces), np.nan)
    tails = 2.0 * _tails(formula, pieces, (order // 2, order - degree))
    rough = np.flatnonzero((tails > allowed).any(axis=0))
    low, high = enclosed_on_simplices(formula, pieces[rough])
    with np.errstate(invalid="ignore"):
        middle, radius = 0.5 * (low + high), 0.5 * (high - low)
    sizes = root_mean_squares(formula, pieces[rough])
    for level, size in ((middle, radius), (np.zeros(len(rough)), sizes)):
        better = size < tails[0, rough]
        levels[rough[better]] = level[better]
        tails[:, rough[better]] = size[better]
    return tails, levels


def _values(formula: Formula, pieces: Array, levels: Array) -> Array:
    """The values at the points of pieces, or levels in their places, shape (pieces, points)."""
    points, _ = rule(pieces.shape[1] - 1, ORDERS[pieces.shape[1] - 1])
    values: Array = np.repeat(levels[:, None], len(points), axis=1)
    known = np.flatnonzero(np.isnan(levels))
    values[known] = evaluated(formula.root, inside(pieces[known], points)).T
    return values


def _tails(formula: Formula, pieces: Array, degrees: tuple[int, ...]) -> Array:
    """What polynomials of some degrees miss of a formula, at most, shape (degrees, pieces)."""
    return missed_by_discs(
        formula, pieces, lambda reach: [reach**-n / (reach - 1.0) for n in degrees]
    )


def _table(pieces: Array, points: Array, degree: int) -> Array:
    """The polynomials on simplices at the points of pieces, shape (pieces, polynomials, points)."""
    dimension = points.shape[1]
    if _whole(pieces).all():  # one table is enough
        table = polynomials(dimension, degree, points)
        return np.broadcast_to(table, (len(pieces), *table.shape))
    places = inside(pieces[..., :dimension], points).transpose(1, 0, 2)
    return polynomials(dimension, degree, places).transpose(1, 0, 2)
