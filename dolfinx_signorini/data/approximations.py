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

from dataclasses import dataclass
from math import comb

import numpy as np
from mpi4py import MPI

from dolfinx_signorini.base.arrays import BLOCK, Array, Indices, Mask
from dolfinx_signorini.base.tolerances import UPWARDS
from dolfinx_signorini.data.analytic import missed_by_discs
from dolfinx_signorini.data.branches import Decided, decided
from dolfinx_signorini.data.enclosures import enclosed_on_simplices
from dolfinx_signorini.data.formulas import Formula, evaluated, nodes
from dolfinx_signorini.data.interfaces.pieces import (
    MOST_PIECES,
    Numbers,
    divided,
    inside,
    subdivide,
    with_reference,
)
from dolfinx_signorini.data.singular import root_mean_squares
from dolfinx_signorini.meshes.polynomials import largest, polynomials, rule
from dolfinx_signorini.meshes.sided_meshes import simplex_sizes

ORDERS = {1: 16, 2: 12, 3: 8}  # of the rules on pieces, by dimension
MOST_WORK = 1_000_000  # pieces that are divided, times the number of operations of a formula
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
class _Part:
    """Pieces of simplices with the formula at points; vertices have reference coordinates first."""

    pieces: Array
    owners: Indices
    share: float  # of a piece in its simplex
    values: Array
    tails: Array  # of what points do not tell: of the root of mean squares, and of means


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
    dimension = corners.shape[1] - 1
    points, rule_weights = rule(dimension, ORDERS[dimension])
    parts = _parts(formula, comm, corners, degree, weights, tolerance)
    tables = [_table(part.pieces, points, degree, part.share == 1.0) for part in parts]
    count, terms = len(corners), comb(degree + dimension, dimension)
    moments, squares, mean = np.zeros((count, terms)), np.zeros(count), np.zeros(count)
    for part, table in zip(parts, tables, strict=True):
        own = part.share * np.einsum("nq,niq->ni", part.values * rule_weights, table)
        np.add.at(moments, part.owners, own)
    between = np.zeros((2, count))
    for part, table in zip(parts, tables, strict=True):
        rest = part.values - np.einsum("ni,niq->nq", moments[part.owners], table)
        root = np.sqrt(np.square(rest) @ rule_weights) + part.tails[0]
        squares += part.share * np.bincount(part.owners, root**2, count)
        mean += part.share * np.bincount(part.owners, part.tails[1], count)
        between[0] += part.share * np.bincount(part.owners, part.tails[0] ** 2, count)
    between[1] = mean**2
    sums = (weights**2 * between) @ simplex_sizes(corners)
    hidden = float(np.sqrt(np.sum(comm.allgather(sums), axis=0).max()))
    return Approximation(moments, np.sqrt(squares) * UPWARDS, mean * UPWARDS, hidden)


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
    count = len(rough) * 2 ** (divisions * (corners.shape[1] - 1))
    for some in np.array_split(rough, 1 + count // BLOCK) if count else ():
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


def _parts(
    formula: Formula, comm: MPI.Comm, corners: Array, degree: int, weights: Array, tolerance: float
) -> list[_Part]:
    """Divide simplices into pieces on which the formula is known well enough."""
    dimension, count = corners.shape[1] - 1, len(corners)
    sizes, parts = simplex_sizes(corners), []
    # Ranks may have different formulas, and all leave the loop at the same level.
    most = comm.allreduce(min(MOST_PIECES, MOST_WORK // len(nodes(formula.root))), op=MPI.MIN)
    allowed = tolerance / np.sqrt(comm.allreduce(float(sizes.sum())) or 1.0)

    def look(pieces: Array, owners: Numbers, level: int) -> tuple[Mask, list[Array]]:
        share = 0.5 ** (dimension * level)
        limits = allowed / weights[:, owners]
        tails, levels = _enclosed(formula, pieces[..., dimension:], degree, limits)
        open_ = ~(tails * weights[:, owners] <= allowed).all(axis=0)
        rest = share * np.bincount(owners, np.where(open_, tails[0] ** 2, 0.0), count)
        mean = share * np.bincount(owners, np.where(open_, tails[1], 0.0), count)
        sums = [sizes @ (weights[0] ** 2 * rest), sizes @ (weights[1] * mean) ** 2]
        enough = np.sum(comm.allgather(sums), axis=0).max() <= tolerance**2
        return open_ & ~enough, [tails, levels]

    start = with_reference(corners), np.arange(count)
    for pieces, owners, level, (tails, levels) in subdivide(*start, look, comm, most):
        values = _values(formula, pieces[..., dimension:], levels)
        tails[:, ~np.isfinite(values).all(axis=1)] = np.inf
        share = 0.5 ** (dimension * level)
        parts.append(_Part(pieces, owners, share, np.nan_to_num(values), tails))
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


def _table(pieces: Array, points: Array, degree: int, whole: bool = False) -> Array:
    """The polynomials on simplices at the points of pieces, shape (pieces, polynomials, points)."""
    dimension = points.shape[1]
    if whole:  # one table is enough
        table = polynomials(dimension, degree, points)
        return np.broadcast_to(table, (len(pieces), *table.shape))
    places = inside(pieces[..., :dimension], points).transpose(1, 0, 2)
    table = polynomials(dimension, degree, places.reshape(-1, dimension))
    return table.reshape(len(table), len(pieces), len(points)).transpose(1, 0, 2)
