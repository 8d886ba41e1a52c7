"""Fluxes through facets, as Neumann and Robin conditions give them."""

import numpy as np
from dolfinx import fem

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.bounds.boundary_facets import FacetPoints, facet_points, on_frames
from dolfinx_signorini.bounds.frames import Frames
from dolfinx_signorini.bounds.reference_flux import polynomials
from dolfinx_signorini.bounds.strong_form import EnergyTerms, FacetPolynomials, polynomial_degree
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.assembly import Data
from dolfinx_signorini.problem.signorini import SignoriniProblem


def given_fluxes(
    problem: SignoriniProblem, terms: EnergyTerms, frames: Frames, degree: int
) -> tuple[Array, Array, list[str]]:
    """Return the fluxes on Neumann and Robin facets, and what polynomials miss of the fluxes.

    Args:
        problem: The solved problem; the call is collective.
        terms: The strong form of the problem.
        frames: The cells of the mesh.
        degree: The degree of the polynomials on facets.

    Returns:
        The moments, shape (cells, d + 1, moments), the L2 norms of the rest on each facet, shape
        (cells, d + 1), both with the signs of a lower obstacle, and what is sampled.

    Raises:
        InputError: A Robin coefficient is negative at a point.
    """
    domain, d = problem.space.mesh, frames.dimension
    count = len(polynomials(d - 1, degree, np.zeros((1, d - 1))))
    moments = np.zeros((len(frames.order), d + 1, count))
    squares = np.zeros(moments.shape[:2])
    marked = on_frames(domain, frames, [f for _, f in (*terms.neumann, *terms.robin)])
    marked &= on_frames(domain, frames, [boundary_facets(domain)])
    fluxes = [polynomial_degree(data) for data, _ in terms.neumann]
    robin = [polynomial_degree(data) for data, _ in terms.robin]
    found = [n for n in (*fluxes, *robin) if n is not None]
    sampled = len(found) < len(fluxes) + len(robin)
    quadrature = 2 * (max(found, default=0) + degree) + (8 if sampled else 0)
    notes = ["a flux is known at quadrature points only"] if sampled else []
    points = facet_points(domain, frames, marked, quadrature)
    total = problem.sign * _flux_at(points, problem, terms)
    p = points.polynomials(degree)
    means = np.einsum("q,nq,njq->nj", points.weights, total, p)
    rest = total - np.einsum("nj,njq->nq", means, p)
    at = points.cells, points.facets
    moments[at] = means * points.sizes[:, None]
    squares[at] = np.square(rest) @ points.weights * points.sizes
    return moments, np.sqrt(squares), notes


def _flux_at(points: FacetPoints, problem: SignoriniProblem, terms: EnergyTerms) -> Array:
    """The flux q - k u at points of facets, shape (facets, points)."""
    total = np.zeros((len(points.cells), len(points.weights)))

    def inside(data: "Data | FacetPolynomials", facets: LocalIndices) -> Array:
        marks = on_frames(points.domain, points.frames, [facets])[points.cells, points.facets]
        return np.where(marks[:, None], points.values(data), 0.0)

    for data, facets in terms.neumann:
        total += inside(data, facets)
    u = points.function(problem.space, problem.u.x.array) if terms.robin else 0.0
    for data, facets in terms.robin:
        coefficient = inside(data, facets)
        require(problem.comm, bool((coefficient >= 0.0).all()), "negative at some point", "robin")
        total -= coefficient * u
    return total


def robin_energy(
    problem: SignoriniProblem, terms: EnergyTerms, frames: Frames, w: fem.Function
) -> Array:
    """Return the integrals of k w^2, for the Robin coefficient k, over the facets of each cell.

    Args:
        problem: The solved problem; the call is collective.
        terms: The strong form of the problem.
        frames: The cells of the mesh.
        w: The function.
    """
    result = np.zeros(len(frames.order))
    for data, facets in terms.robin:
        marked = on_frames(problem.space.mesh, frames, [facets])
        degree = 2 * w.function_space.element.basix_element.degree + 4
        points = facet_points(problem.space.mesh, frames, marked, degree)
        square = points.function(w.function_space, w.x.array) ** 2
        sums = points.values(data) * square @ points.weights * points.sizes
        result += np.bincount(points.cells, sums, len(result))
    return result
