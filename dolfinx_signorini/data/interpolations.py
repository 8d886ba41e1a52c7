"""What the interpolation of formulas on segments misses, of values and of derivatives.

The Taylor polynomial of degree n misses E with |E| <= e and |E'| <= e' on the segment, see `discs`.
The interpolation with the Lebesgue constant L misses at most (1 + L) e of the values and, by
Markov's inequality, e' + n^2 L e of the derivatives, on a segment of length 2. Where that is not
known, the segment is divided into parts. On a part, the interpolation there may be known to follow
the formula, and differs from the interpolation on the segment by a polynomial; or an interval
around the derivatives of the formula takes its place.

At n + 1 Gauss-Lobatto points the squares of the Lagrange polynomials have a sum of at most 1, so
that L is at most the root of n + 1. Source: Fejer, Bestimmung derjenigen Abszissen eines
Intervalles..., Ann. Scuola Norm. Sup. Pisa 1 (1932) 263.
"""

import math

import numpy as np

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.tolerances import SIX_DIGITS, SOLVED, UNIT, UPWARDS
from dolfinx_signorini.data.analytic import missed_by_discs
from dolfinx_signorini.data.enclosures import enclosed_slopes
from dolfinx_signorini.data.formulas import Formula, evaluated
from dolfinx_signorini.data.interfaces.pieces import inside
from dolfinx_signorini.meshes.polynomials import (
    derivatives,
    gauss_lobatto,
    highest_on_parts,
    largest,
    polynomials,
)

PARTS = 64  # of a segment where a formula is not smooth


@np.errstate(over="ignore", invalid="ignore")  # at a pole there is no value
def missed_by_interpolation(formula: Formula, corners: Array, degree: int) -> Array:
    """Return what the interpolation at Gauss-Lobatto points misses, shape (3, segments).

    Args:
        formula: The formula.
        corners: The ends of the segments, shape (segments, 2, dimension).
        degree: The degree of the polynomials.

    Returns:
        Bounds of the differences, of their derivatives from end to end, and of the roots of the
        means of the squares of these derivatives.
    """
    slope = _by_discs(formula, corners, degree)
    root, height = slope.copy(), np.abs(evaluated(formula.root, corners)).max(axis=1, initial=0.0)
    rough = np.flatnonzero(~(slope <= SIX_DIGITS * height))
    apart = _in_parts(formula, corners[rough], degree)
    slope[rough] = np.fmin(slope[rough], apart.max(axis=1, initial=0.0))
    root[rough] = np.fmin(root[rough], np.sqrt(np.square(apart).mean(axis=1)))
    broken = _jumps_at_ends(formula, corners)
    parts = _divided(corners[rough])
    broken[rough] |= _jumps_at_ends(formula, parts).reshape(-1, PARTS).any(axis=1)
    slope[broken] = root[broken] = np.inf
    # The difference vanishes at both ends.
    return np.stack((0.5 * root, slope, root)) * UPWARDS


@np.errstate(divide="ignore", invalid="ignore")
def _jumps_at_ends(formula: Formula, corners: Array) -> Mask:
    """Whether the values at the ends of segments, or of parts, are not those next to them.

    Discs know of no jump within `SOLVED` of an end.
    """
    way = corners[:, 1] - corners[:, 0]
    rounding = UNIT * np.abs(corners).max(axis=(1, 2)) / np.linalg.norm(way, axis=1)
    step = np.maximum(2.0 * SOLVED, rounding)[:, None] * way
    near = np.stack((corners[:, 0], corners[:, 0] + step, corners[:, 1] - step, corners[:, 1]))
    values = evaluated(formula.root, near)
    apart = np.abs(values[::3] - values[1:3]).max(axis=0, initial=0.0)
    return ~(apart <= SIX_DIGITS * (np.abs(values).max(axis=0, initial=0.0) + SIX_DIGITS))


def _by_discs(formula: Formula, corners: Array, n: int) -> Array:
    """What the interpolation of degree n misses of derivatives from end to end of segments."""

    def missed(reach: float) -> float:
        value = reach**-n / (reach - 1.0)
        change = value * ((n + 1) * reach - n) / (reach - 1.0)
        return 2.0 * (change + n**2 * math.sqrt(n + 1.0) * value)

    return missed_by_discs(formula, corners, missed)


def _in_parts(formula: Formula, corners: Array, degree: int) -> Array:
    """The largest derivatives of the differences on parts of segments, shape (segments, parts)."""
    nodes = gauss_lobatto(degree)
    inverse = np.linalg.inv(polynomials(1, degree, nodes))
    series = evaluated(formula.root, inside(corners, nodes)).T @ inverse
    slopes = derivatives(series)
    most = highest_on_parts(PARTS, slopes)
    least = -highest_on_parts(PARTS, -slopes)
    parts = _divided(corners)
    low, high = PARTS * enclosed_slopes(formula, parts).reshape(2, -1, PARTS)
    apart = np.maximum(high - least, most - low)
    places = (np.arange(PARTS)[:, None, None] + nodes) / PARTS
    there = np.tensordot(series, polynomials(1, degree, places), 1).reshape(-1, len(nodes))
    own = evaluated(formula.root, inside(parts, nodes)).T - there
    between = largest(1, degree - 1, derivatives(own @ inverse))
    by_discs = PARTS * (_by_discs(formula, parts, degree) + between).reshape(-1, PARTS)
    return np.asarray(np.fmin(apart, by_discs))


def _divided(corners: Array) -> Array:
    """Equal parts of segments, shape (segments x parts, 2, dimension)."""
    places = np.linspace(0.0, 1.0, PARTS + 1)[:, None]
    points = (1.0 - places) * corners[:, :1] + places * corners[:, 1:]
    parts = np.stack((points[:, :-1], points[:, 1:]), axis=2)
    return parts.reshape(-1, 2, corners.shape[2])
