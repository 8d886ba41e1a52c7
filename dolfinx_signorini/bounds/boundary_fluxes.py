"""Fluxes through facets, as Neumann and Robin conditions give them."""

import numpy as np

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.bounds.boundary_facets import FacetPoints, facet_points
from dolfinx_signorini.bounds.frames import on_frames
from dolfinx_signorini.bounds.remainders import Solved
from dolfinx_signorini.bounds.strong_form import FacetPolynomials, polynomial_degree
from dolfinx_signorini.problem.values import Data


def given_fluxes(solved: Solved) -> tuple[Array, Array, list[str]]:
    """Return the fluxes on Neumann and Robin facets, and what polynomials miss of the fluxes.

    Args:
        solved: The problem; the call is collective.

    Returns:
        The moments, shape (cells, d + 1, moments), the L2 norms of the rest on each facet, shape
        (cells, d + 1), both with the signs of a lower obstacle, and what is sampled.

    Raises:
        InputError: A Robin coefficient is negative at a point.
    """
    terms, frames, degree = solved.terms, solved.frames, solved.degree
    marked = on_frames(frames, [f for _, f in (*terms.neumann, *terms.robin)])
    fluxes = [polynomial_degree(data) for data, _ in terms.neumann]
    robin = [polynomial_degree(data) for data, _ in terms.robin]
    found = [n for n in (*fluxes, *robin) if n is not None]
    sampled = len(found) < len(fluxes) + len(robin)
    quadrature = 2 * (max(found, default=0) + degree) + (8 if sampled else 0)
    notes = ["a flux is known at quadrature points only"] if sampled else []
    points = facet_points(frames, marked, quadrature)
    total = solved.problem.sign * _flux_at(points, solved)
    p = points.polynomials(degree)
    moments, squares = np.zeros((*marked.shape, p.shape[1])), np.zeros(marked.shape)
    means = np.einsum("q,nq,njq->nj", points.weights, total, p)
    rest = total - np.einsum("nj,njq->nq", means, p)
    at = points.cells, points.facets
    moments[at] = means * points.sizes[:, None]
    squares[at] = np.square(rest) @ points.weights * points.sizes
    return moments, np.sqrt(squares), notes


def _flux_at(points: FacetPoints, solved: Solved) -> Array:
    """The flux q - k u at points of facets, shape (facets, points)."""
    problem, terms = solved.problem, solved.terms
    total = np.zeros((len(points.cells), len(points.weights)))

    def inside(data: "Data | FacetPolynomials", facets: LocalIndices) -> Array:
        marks = on_frames(points.frames, [facets])[points.cells, points.facets]
        return np.where(marks[:, None], points.values(data), 0.0)

    for data, facets in terms.neumann:
        total += inside(data, facets)
    u = points.points.values(problem.u)[0] if terms.robin else 0.0
    for data, facets in terms.robin:
        coefficient = inside(data, facets)
        require(problem.comm, bool((coefficient >= 0.0).all()), "negative at some point", "robin")
        total -= coefficient * u
    return total
