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

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.data.interfaces.pieces import corners_of_reference
from dolfinx_signorini.meshes.polynomials import CELLS, barycentric, polynomials
from dolfinx_signorini.meshes.quadrature import rule

PARTS = 8  # of a facet, each with its own answer to whether a function is positive
MOST_NUMBERS = 4_000_000  # of a matrix, or of several ones that are solved at once


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
    corners = corners_of_reference(dimension)
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
