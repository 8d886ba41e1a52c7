"""The gap of a feasible function on contact facets, and what contact fluxes cost there."""

import numpy as np

from dolfinx_signorini.base.arrays import Array, Indices
from dolfinx_signorini.bounds.boundary_facets import FacetPoints, facet_points, on_parts
from dolfinx_signorini.bounds.condensation import CLOSED, OPEN
from dolfinx_signorini.bounds.feasible import Feasible, above, known
from dolfinx_signorini.bounds.remainders import Solved


def gaps(solved: Solved, near: Feasible, kinds: Indices) -> tuple[FacetPoints, Array]:
    """Return the gap of a feasible function at points of contact facets, or more than the gap.

    Args:
        solved: The problem; the call is collective.
        near: What makes the solution feasible.
        kinds: The kinds of the facets of cells.

    Returns:
        The points, with a rule for the gap times polynomials of the degree of the solution, and the
        values.
    """
    contact, told = kinds >= OPEN, solved.rest.obstacle_in_space
    if near.gap is not None:
        points, gap = on_parts(solved.frames, contact, near.gap[0])
        gap += near.gap[1][:, None]
    else:
        points = facet_points(solved.frames, contact, 2 * solved.degree + 8)
        if solved.problem.in_domain:
            return points, np.zeros((0, len(points.weights)))
        gap = np.maximum(above(solved, near, points), 0.0)
    if told is not None:
        gap += told[1][contact][:, None]
    elif solved.dimension == 2 or known(solved.problem.obstacle_data, solved.degree):
        gap[kinds[points.cells, points.facets] == CLOSED] = 0.0
    return points, gap


def gap_means(points: FacetPoints, gap: Array, degree: int) -> Array:
    """Return the means of gap times polynomial, shape (cells, d + 1, moments).

    Args:
        points, gap: See `gaps`.
        degree: The degree of the polynomials.
    """
    p = points.polynomials(degree)
    means = np.zeros((*points.frames.order.shape, p.shape[1]))
    means[points.cells, points.facets] = np.einsum("q,nq,njq->nj", points.weights, gap, p)
    return means


def contact_energy(points: FacetPoints, gap: Array, moments: Array, degree: int) -> Array:
    """Return the integrals of contact flux times gap over the contact facets of each cell.

    Args:
        points, gap: See `gaps`.
        moments: The moments of the flux on facets, shape (cells, d + 1, moments).
        degree: The degree of the flux.
    """
    own = moments[points.cells, points.facets]
    flux = np.einsum("nj,njq->nq", own, points.polynomials(degree))
    sums = np.maximum(flux, 0.0) * gap @ points.weights
    return np.asarray(np.bincount(points.cells, sums, len(moments)), dtype=np.float64)
