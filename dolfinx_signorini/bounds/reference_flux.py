"""Raviart-Thomas fields on the reference simplex, in a basis made for equilibration.

The basis is dual to the moments of the normal flux on the facets and of the divergence. A field
with given fluxes and a given divergence is then written down, not solved for, and what is left are
the fields without flux and divergence. The vertices of each cell of a mesh are taken in the order
of their global numbers, so that two cells agree about the moments on their facet.

Source: Brezzi and Fortin, Mixed and Hybrid Finite Element Methods, 1991, Section III.3.
"""

import functools
import math
from dataclasses import dataclass
from typing import Any

import basix
import numpy as np
from scipy.linalg import null_space

from dolfinx_signorini.base.arrays import Array, Indices

PARTS = 8  # of a facet, each with its own answer to whether a function is positive
MOST_NUMBERS = 4_000_000  # of a matrix, or of several ones that are solved at once
CELLS = {1: basix.CellType.interval, 2: basix.CellType.triangle, 3: basix.CellType.tetrahedron}


def polynomials(dimension: int, degree: int, points: Array) -> Array:
    """Return polynomials on the reference simplex that are orthonormal for the mean.

    Args:
        dimension: The dimension of the simplex.
        degree: The total degree of the polynomials; the first one is 1.
        points: Points of the reference simplex, shape (points, dimension).

    Returns:
        The values of the polynomials, shape (polynomials, points).
    """
    kind, some = basix.PolynomialType.legendre, np.vstack((points, np.zeros((1, dimension))))
    values = np.asarray(basix.tabulate_polynomials(kind, CELLS[dimension], degree, some))
    return np.asarray(values[:, :-1] / math.sqrt(math.factorial(dimension)))  # some, not none


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


def positive_on_parts(degree: int, count: int, coefficients: Array, places: Array) -> Array:
    """Return functions that are not below the positive parts of polynomials on the unit interval.

    On each of some equal parts of the interval the functions are polynomials, too: negative
    Bernstein coefficients become 0.

    Args:
        degree, count, coefficients: See `highest_on_parts`.
        places: Points of the unit interval for each polynomial, shape (n, points).
    """
    part = np.minimum((count * places).astype(np.int64), count - 1)
    above = np.maximum(coefficients @ on_parts(degree, count), 0.0)
    basis = _bernstein(degree, (count * places - part).reshape(-1, 1))
    basis = basis.reshape(degree + 1, *places.shape)
    return np.asarray(np.einsum("nqk,knq->nq", above[part, np.arange(len(part))[:, None]], basis))


def highest_on_parts(degree: int, count: int, coefficients: Array) -> Array:
    """Return upper bounds of polynomials on equal parts of the unit interval.

    Args:
        degree: The degree of the polynomials.
        count: The number of parts.
        coefficients: The polynomials in terms of `polynomials`, shape (n, polynomials).

    Returns:
        The bounds, shape (n, count).
    """
    return np.asarray((coefficients @ on_parts(degree, count)).max(axis=2).T)


@functools.cache
def on_parts(degree: int, count: int) -> Array:
    """Return the Bernstein coefficients of the polynomials on equal parts of the unit interval.

    Args:
        degree, count: See `highest_on_parts`.

    Returns:
        The coefficients, shape (count, polynomials, coefficients).
    """
    lattice = _lattice(1, degree)
    places = (lattice[:, 0] + np.arange(count)[:, None]).reshape(-1, 1) / count
    table = polynomials(1, degree, places).reshape(-1, count, degree + 1)
    return np.asarray(table.transpose(1, 0, 2) @ np.linalg.inv(_bernstein(degree, lattice)))


def _lattice(dimension: int, degree: int) -> Array:
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
    points = _lattice(dimension, degree)
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


def rule(dimension: int, degree: int) -> tuple[Array, Array]:
    """Return points and positive weights on a reference simplex; the weights add up to 1.

    Args:
        dimension: The dimension of the simplex.
        degree: The degree of the polynomials that are integrated exactly.
    """
    for kind in (basix.QuadratureType.default, basix.QuadratureType.gauss_jacobi):
        points, weights = map(np.asarray, basix.make_quadrature(CELLS[dimension], degree, kind))
        if (weights > 0.0).all():
            break
    return points, weights * math.factorial(dimension)


@dataclass(frozen=True)
class ReferenceFlux:
    """Fields of one degree on the reference simplex, with the integrals that patches need.

    Fields are given by coefficients in this order: moments of the normal flux (facet by facet),
    moments of the divergence with all polynomials but the first, fields without either.

        reference = reference_flux(2, 1)
        values = np.einsum("i,qia->qa", coefficients, reference.fields(points))

    Attributes:
        dimension: The dimension of the simplex.
        degree: The degree of the divergence, which may be any polynomial of this degree.
        combination: The fields in terms of the fields of Basix, one column each.
        mass: Integrals of products of components, shape (d, d, fields, fields).
        targets: Integrals of a hat function times a polynomial times a component, shape
            (vertices, d, polynomials, fields).
        products: Means of a hat function times two polynomials, shape
            (vertices, polynomials, polynomials).
        facet_products: The same on a facet, shape (vertices of the facet, ...).
    """

    dimension: int
    degree: int
    combination: Array
    mass: Array
    targets: Array
    products: Array
    facet_products: Array

    @property
    def per_facet(self) -> int:
        """The number of moments on a facet."""
        return self.facet_products.shape[1]

    @property
    def fluxes(self) -> int:
        """The number of moments on all facets."""
        return (self.dimension + 1) * self.per_facet

    @property
    def given(self) -> int:
        """The number of moments on facets and in the cell: later fields have no moments."""
        return self.fluxes + self.products.shape[1] - 1

    @property
    def gradients(self) -> Array:
        """The gradients of the barycentric coordinates, one row each."""
        return _gradients(self.dimension)

    def fields(self, points: Array) -> Array:
        """Return the fields at points of the simplex, shape (points, fields, dimension)."""
        values = _tabulated(_element(self.dimension, self.degree), points)[0]
        return np.asarray(np.einsum("qba,bi->qia", values, self.combination))


@functools.cache
def reference_flux(dimension: int, degree: int) -> ReferenceFlux:
    """Return fields on the reference simplex.

    Args:
        dimension: The dimension of the simplex, 2 or 3.
        degree: The degree of the divergence, at least 1.
    """
    element = _element(dimension, degree)
    functionals = np.concatenate((*_fluxes(element, degree), _divergences(element, degree)))
    combination = np.column_stack((np.linalg.pinv(functionals), null_space(functionals)))
    points, weights = rule(dimension, 3 * degree + 3)
    values = np.einsum("qba,bi->qia", _tabulated(element, points)[0], combination)
    hats, scaled = barycentric(points), weights / math.factorial(dimension)
    p = polynomials(dimension, degree, points)
    on_facet, facet_weights = rule(dimension - 1, 2 * degree + 1)
    mu = polynomials(dimension - 1, degree, on_facet)
    return ReferenceFlux(
        dimension,
        degree,
        combination,
        np.einsum("q,qia,qjb->abij", scaled, values, values),
        np.einsum("q,qv,nq,qia->vani", scaled, hats, p, values),
        np.einsum("q,qv,nq,mq->vnm", weights, hats, p, p),
        np.einsum("q,qv,jq,lq->vjl", facet_weights, barycentric(on_facet), mu, mu),
    )


@functools.cache
def _element(dimension: int, degree: int) -> basix.finite_element.FiniteElement:
    return basix.create_element(
        basix.ElementFamily.RT,
        CELLS[dimension],
        degree + 1,
        lagrange_variant=basix.LagrangeVariant.legendre,
    )


def _tabulated(element: Any, points: Array) -> Array:
    """Values and first derivatives, shape (1 + d, points, fields of Basix, d)."""
    return np.asarray(element.tabulate(1, np.ascontiguousarray(points)))


def _gradients(dimension: int) -> Array:
    return np.vstack((-np.ones(dimension), np.eye(dimension)))


def _fluxes(element: basix.finite_element.FiniteElement, degree: int) -> list[Array]:
    """The moments of the outward flux through each facet, shape (moments, fields of Basix)."""
    dimension = element.value_shape[0]
    points, weights = rule(dimension - 1, 2 * degree + 2)
    mu = polynomials(dimension - 1, degree, points)
    corners = np.vstack((np.zeros(dimension), np.eye(dimension)))
    moments = []
    for k in range(dimension + 1):
        x = barycentric(points) @ np.delete(corners, k, axis=0)
        # The outward normal times the size of the facet.
        normal = -_gradients(dimension)[k] / math.factorial(dimension - 1)
        values = _tabulated(element, x)[0] @ normal
        moments.append((mu * weights) @ values)
    return moments


def _divergences(element: basix.finite_element.FiniteElement, degree: int) -> Array:
    """The integrals of the divergence with all polynomials but the first."""
    dimension = element.value_shape[0]
    points, weights = rule(dimension, 2 * degree + 2)
    divergence = np.einsum("aqba->qb", _tabulated(element, points)[1:])
    p = polynomials(dimension, degree, points)[1:] * weights / math.factorial(dimension)
    return np.asarray(p @ divergence)
