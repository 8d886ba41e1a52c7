"""The exponents of the distance from a corner in solutions: an eigenvalue problem on sectors.

Around a corner, sectors with the constant coefficients C meet, and solutions of

    div(C grad u) = 0

are sums of r^a U(t), with r the distance and t the angle. The exponents a are those for which the
equation has a solution U on the whole angle w: with C_rt for the part of C between the directions r
and t,

    int_0^w  C_tt U'.V' + a (C_tr U.V' - C_rt U'.V) - a^2 C_rr U.V  dt = 0    for all V.

Values that are given at one of the two sides are 0 there, in U and V; nothing is asked at a side
without a flux. Where the sectors go all around, U is periodic. Polynomials have integers a, and are
no singularities.

Where an integer is an exponent and data meet at the corner, the polynomials of this degree satisfy
some data only: for others the solution has a part like r^a log r. In the domain data are smooth.

The problem covers all corners: for the Laplacian a = pi / w between sides with the same condition,
and pi / (2 w) where the condition changes; anisotropic and jumping coefficients; elastic bodies.

Sources: Leguillon and Sanchez-Palencia, Computation of Singular Solutions in Elliptic Problems and
Elasticity (1987); Grisvard, Elliptic Problems in Nonsmooth Domains (1985), Theorem 4.4.3.7; Dauge,
Elliptic Boundary Value Problems on Corner Domains (1988), for edges.
"""

import functools
import math
from collections.abc import Sequence

import basix
import numpy as np
from scipy import linalg

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.tolerances import SIX_DIGITS
from dolfinx_signorini.meshes.elements import HIGHEST_DEGREE
from dolfinx_signorini.meshes.quadrature import rule
from dolfinx_signorini.norms.orders import SMOOTH

DEGREE = 10  # of the polynomials for U, on pieces of WIDTH at most: nine digits of exponents
WIDTH = math.radians(60.0)  # at most three pieces of a sector at a convex corner
WHOLE = 1e-3  # an exponent that is so near to an integer is the integer
LOGARITHM = SIX_DIGITS  # r^a log r is taken as r to a power that is so much less
DIGITS = 10  # of angles and coefficients, by which corners are the same


def sector_exponent(
    directions: Sequence[float] | Array,
    tensors: Array,
    given: Sequence[Array] | None,
    logarithms: bool = False,
) -> float:
    """Return the least real part of the exponents of singular solutions at a corner.

    Args:
        directions: The angles at which the sectors begin, and at which the last one ends; radians,
            increasing.
        tensors: The coefficients C of each sector, shape (sectors, n, 2, n, 2), for n unknowns:
            component and derivative of the test function, and of the solution.
        given: For the first and the last side the directions of the unknowns that have given
            values, orthonormal columns, each of shape (n, any number); None where the sectors go
            all around.
        logarithms: Whether integers count, less `LOGARITHM`.

    Returns:
        The exponent; `SMOOTH` where all exponents up to 4 are integers, which belong to
        polynomials.
    """
    scale = np.abs(tensors).max()
    known = np.asarray(directions) - directions[0], tensors / (scale if scale > 0.0 else 1.0)
    turned = _turned(known[1], float(directions[0]))
    rounded = [np.round(values, DIGITS) + 0.0 for values in (known[0], turned, *(given or ()))]
    key = tuple((part.shape, part.tobytes()) for part in rounded)
    singular, whole = _exponents(key, given is None)
    return min(singular, whole - LOGARITHM) if logarithms else singular


def _turned(tensors: Array, angle: float) -> Array:
    """The coefficients in axes for the derivatives of which the first one has a direction."""
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, s], [-s, c]])
    return np.asarray(np.einsum("pa,kiajb,qb->kipjq", turn, tensors, turn))


@functools.lru_cache(maxsize=4096)
def _exponents(key: tuple[tuple[tuple[int, ...], bytes], ...], around: bool) -> tuple[float, float]:
    """The least exponent that is no integer, and the least integer."""
    directions, tensors, *given = (np.frombuffer(data).reshape(shape) for shape, data in key)
    stiff, skew, mass = _pencil(directions, tensors, around)
    if not around:
        kept = linalg.block_diag(
            linalg.null_space(given[0].T), np.eye(len(mass) - 2 * len(given[0])),
            linalg.null_space(given[1].T),
        )  # fmt: skip
        stiff, skew, mass = (kept.T @ matrix @ kept for matrix in (stiff, skew, mass))
    try:
        inverse = linalg.inv(mass)
        companion = np.block(
            [[np.zeros_like(mass), np.eye(len(mass))], [inverse @ stiff, inverse @ skew]]
        )
        found = linalg.eigvals(companion)
    except (linalg.LinAlgError, ValueError):  # the coefficients are not positive or not finite
        return SMOOTH, SMOOTH
    # Elements converge in no norm faster than with exponents above their degree.
    found = found[(found.real > WHOLE) & (found.real < HIGHEST_DEGREE)]
    singular = np.abs(found - np.rint(found.real)) > WHOLE
    parts = found.real[singular], np.rint(found.real[~singular])
    least, whole = (float(part.min(initial=SMOOTH)) for part in parts)
    return least, whole


def _pencil(directions: Array, tensors: Array, around: bool) -> list[Array]:
    """The matrices of U'.V', of U.V' - U'.V and of U.V; the unknowns of a node come together."""
    element = basix.create_element(
        basix.ElementFamily.P, basix.CellType.interval, DEGREE, basix.LagrangeVariant.gll_warped
    )
    points, weights = rule(1, 2 * DEGREE + 4)
    order = [0, *range(2, DEGREE + 1), 1]  # along the interval
    table: Array = np.asarray(element.tabulate(1, points))
    values, slopes = table[:, :, order, 0]
    counts = np.maximum(np.ceil(np.diff(directions) / WIDTH - WHOLE), 1.0).astype(int)
    size, nodes = tensors.shape[1], DEGREE * int(counts.sum()) + 1
    matrices: list[Array] = [np.zeros((nodes * size, nodes * size)) for _ in range(3)]
    first = 0
    for start, end, count, tensor in zip(directions, directions[1:], counts, tensors, strict=False):
        width = (end - start) / count
        for k in range(count):
            t = start + width * (k + points[:, 0])
            axes = {"r": (np.cos(t), np.sin(t)), "t": (-np.sin(t), np.cos(t))}
            C = {a + b: np.einsum("iajb,aq,bq->qij", tensor, axes[a], axes[b])
                 for a in axes for b in axes}  # fmt: skip
            sub = "q,qij,qm,qn->minj"
            flux = np.einsum(sub, weights, C["tr"], slopes, values)
            parts = (
                np.einsum(sub, weights / width, C["tt"], slopes, slopes),
                flux - np.einsum(sub, weights, C["rt"], values, slopes),
                np.einsum(sub, weights * width, C["rr"], values, values),
            )
            rows = slice(first * size, (first + DEGREE + 1) * size)
            for matrix, part in zip(matrices, parts, strict=True):
                length = (DEGREE + 1) * size
                matrix[rows, rows] += part.reshape(length, length)
            first += DEGREE
    if around:
        joined = np.vstack([np.eye((nodes - 1) * size), np.eye(size, (nodes - 1) * size)])
        matrices = [joined.T @ matrix @ joined for matrix in matrices]
    return matrices
