"""The gap between a feasible function and the obstacle, and what contact forces do on the way."""

import math

import numpy as np

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.bounds.boundary_facets import FacetPoints, facet_points, on_parts
from dolfinx_signorini.bounds.condensation import CLOSED, OPEN
from dolfinx_signorini.bounds.frames import Frames
from dolfinx_signorini.bounds.lifting import Feasible
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
    problem, frames = solved.problem, solved.frames
    if near.gap is not None:
        series, missed = near.gap
        if frames.dimension == 2:
            points, gap = on_parts(frames, kinds >= OPEN, series)
        else:
            points, gap = _in_space(frames, kinds >= OPEN, series)
        gap += missed[:, None]
    else:
        points = facet_points(frames, kinds >= OPEN, 2 * solved.degree + 8)
        v = problem.sign * points.function(problem.space, problem.u.x.array)
        v += points.function(near.change.function_space, near.change.x.array)
        gap = np.maximum(v - problem.sign * points.values(problem.obstacle_data), 0.0)
    if near.meets:
        gap[kinds[points.cells, points.facets] == CLOSED] = 0.0
    return points, gap


def _in_space(frames: Frames, marked: Mask, series: Array) -> tuple[FacetPoints, Array]:
    """Polynomials on facets at points of a rule for their products with polynomials."""
    order = round((math.sqrt(8.0 * series.shape[1] + 1.0) - 3.0) / 2.0)
    points = facet_points(frames, marked, 2 * order)
    return points, np.einsum("nj,njq->nq", series, points.polynomials(order))


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
        points, gap, degree: See `gap_means`.
        moments: The moments of the fluxes on facets, shape (cells, d + 1, moments).
    """
    own = moments[points.cells, points.facets]
    flux = np.einsum("nj,njq->nq", own, points.polynomials(degree))
    sums = np.maximum(flux, 0.0) * gap @ points.weights
    return np.asarray(np.bincount(points.cells, sums, len(moments)), dtype=np.float64)
