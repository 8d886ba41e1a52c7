"""Polynomials on simplices: an orthonormal basis, and bounds by Bernstein coefficients.

A polynomial lies between the least and the largest of its Bernstein coefficients.

Source: Farouki, The Bernstein polynomial basis: a centennial retrospective, Computer Aided
Geometric Design 29 (2012) 379-419.
"""

import functools
import math

import basix
import numpy as np

from dolfinx_signorini.base.arrays import Array, Indices

CELLS = {1: basix.CellType.interval, 2: basix.CellType.triangle, 3: basix.CellType.tetrahedron}


def polynomials(dimension: int, degree: int, points: Array) -> Array:
    """Return polynomials on the reference simplex that are orthonormal for the mean.

    Args:
        dimension: The dimension of the simplex.
        degree: The total degree of the polynomials; the first one is 1.
        points: Points of the reference simplex, shape (..., dimension).

    Returns:
        The values of the polynomials, shape (polynomials, ...).
    """
    kind, more = basix.PolynomialType.legendre, np.zeros((1, dimension))  # some, not none
    some = np.vstack((points.reshape(-1, dimension), more))
    values = np.asarray(basix.tabulate_polynomials(kind, CELLS[dimension], degree, some))[:, :-1]
    return values.reshape(len(values), *points.shape[:-1]) / math.sqrt(math.factorial(dimension))


def lowest(dimension: int, degree: int, coefficients: Array) -> Array:
    """Return lower bounds of polynomials on a simplex: their least Bernstein coefficients.

    Args:
        dimension: The dimension of the simplex.
        degree: The degree of the polynomials.
        coefficients: The polynomials in terms of `polynomials`, shape (..., polynomials).
    """
    return np.asarray((coefficients @ _to_bernstein(dimension, degree)).min(axis=-1))


def largest(dimension: int, degree: int, coefficients: Array) -> Array:
    """Return upper bounds of the absolute values of polynomials on a simplex.

    Args:
        dimension, degree, coefficients: See `lowest`.
    """
    return np.asarray(np.abs(coefficients @ _to_bernstein(dimension, degree)).max(axis=-1))


def positive_on_parts(count: int, coefficients: Array, places: Array) -> Array:
    """Return functions that are not below the positive parts of polynomials on the unit interval.

    On each of some equal parts of the interval the functions are polynomials, too: negative
    Bernstein coefficients become 0.

    Args:
        count, coefficients: See `highest_on_parts`.
        places: Points of the unit interval for each polynomial, shape (n, points).
    """
    degree = coefficients.shape[1] - 1
    part = np.minimum((count * places).astype(np.int64), count - 1)
    above = np.maximum(coefficients @ on_parts(degree, count), 0.0)
    basis = _bernstein(degree, (count * places - part).reshape(-1, 1))
    basis = basis.reshape(degree + 1, *places.shape)
    return np.asarray(np.einsum("nqk,knq->nq", above[part, np.arange(len(part))[:, None]], basis))


def highest_on_parts(count: int, coefficients: Array) -> Array:
    """Return upper bounds of polynomials on equal parts of the unit interval.

    Args:
        count: The number of parts.
        coefficients: The polynomials in terms of `polynomials`, shape (n, polynomials).

    Returns:
        The bounds, shape (n, count).
    """
    degree = coefficients.shape[1] - 1
    return np.asarray((coefficients @ on_parts(degree, count)).max(axis=2).T)


@functools.cache
def on_parts(degree: int, count: int) -> Array:
    """Return the Bernstein coefficients of the polynomials on equal parts of the unit interval.

    Args:
        degree: The degree of the polynomials.
        count: The number of parts.

    Returns:
        The coefficients, shape (count, polynomials, coefficients).
    """
    lattice = equispaced(1, degree)
    table = polynomials(1, degree, (lattice + np.arange(count)[:, None, None]) / count)
    return np.asarray(table.transpose(1, 0, 2) @ np.linalg.inv(_bernstein(degree, lattice)))


def derivatives(coefficients: Array) -> Array:
    """Return the coefficients of the derivatives of polynomials on the unit interval.

    Args:
        coefficients: The polynomials in terms of `polynomials`, shape (n, polynomials).
    """
    scale = np.sqrt(2.0 * np.arange(coefficients.shape[1]) + 1.0)  # to Legendre's polynomials
    slopes = np.polynomial.legendre.legder(coefficients * scale, axis=1)
    return np.asarray(2.0 * slopes / scale[:-1])


def gauss_lobatto(degree: int) -> Array:
    """Return the Gauss-Lobatto points of the unit interval for polynomials of a degree."""
    kind, method = basix.LatticeType.gll, basix.LatticeSimplexMethod.isaac
    points = np.asarray(basix.create_lattice(CELLS[1], degree, kind, True, method))
    return np.clip(points, 0.0, 1.0)  # where rounding has the first one outside


def equispaced(dimension: int, degree: int) -> Array:
    """Return the points of the equispaced lattice of a degree, with those of the boundary."""
    kind = basix.LatticeType.equispaced
    return np.asarray(basix.create_lattice(CELLS[dimension], degree, kind, True))


def _bernstein(degree: int, points: Array) -> Array:
    """The Bernstein basis at points of a reference simplex, shape (functions, points).

    The factorials of Basix are wrong from degree 13 on.
    """
    shares = barycentric(points)
    powers = np.indices((degree + 1,) * shares.shape[1]).reshape(shares.shape[1], -1).T
    powers = powers[powers.sum(axis=1) == degree]
    factorials = np.array([math.factorial(k) for k in range(degree + 1)], dtype=np.float64)
    scales = factorials[degree] / factorials[powers].prod(axis=1)
    values = [
        scale * (shares**alpha).prod(axis=1) for scale, alpha in zip(scales, powers, strict=True)
    ]
    return np.array(values)


@functools.cache
def _to_bernstein(dimension: int, degree: int) -> Array:
    """The Bernstein coefficients of the polynomials, one row each."""
    points = equispaced(dimension, degree)
    table = polynomials(dimension, degree, points)
    return np.asarray(table @ np.linalg.inv(_bernstein(degree, points)))


def from_bernstein(dimension: int, degree: int) -> Array:
    """Return the coefficients of the Bernstein basis in terms of `polynomials`, one row each.

    Args:
        dimension: The dimension of the simplex.
        degree: The degree of the polynomials.
    """
    return np.asarray(np.linalg.inv(_to_bernstein(dimension, degree)))


def others(dimension: int) -> Indices:
    """Return for each vertex of a simplex the facets with this vertex, and the other way round."""
    numbers = range(dimension + 1)
    return np.array([[k for k in numbers if k != a] for a in numbers])


def barycentric(points: Array) -> Array:
    """Return the barycentric coordinates of points of a reference simplex, one column each."""
    return np.column_stack((1.0 - points.sum(axis=1), points))


def depths(points: Array) -> Array:
    """Return how far inside of the reference simplex points are, negative for points outside.

    Args:
        points: The points, shape (..., dimension).
    """
    along = [*np.moveaxis(points, -1, 0)]  # NumPy is slow along a last axis of a few numbers
    return np.asarray(np.minimum.reduce([*along, 1.0 - sum(along)]))
