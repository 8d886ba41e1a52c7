"""The facets of the boundary by what is known about the flux through each of them."""

import functools
from dataclasses import dataclass

import numpy as np
from dolfinx import fem

from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices, Mask, union
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.base.ranks import marked
from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.bounds.condensation import CLOSED, DIRICHLET, INTERIOR, NEUMANN, OPEN, PARTLY
from dolfinx_signorini.bounds.frames import Frames, on_frames
from dolfinx_signorini.bounds.reference_flux import PARTS
from dolfinx_signorini.bounds.remainders import Solved
from dolfinx_signorini.bounds.strong_form import EnergyTerms, FacetPolynomials
from dolfinx_signorini.meshes.elements import facet_dofs
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.polynomials import barycentric, others, polynomials, positive_on_parts
from dolfinx_signorini.meshes.quadrature import rule
from dolfinx_signorini.meshes.sided_meshes import facet_vertices
from dolfinx_signorini.problem.assembly import dofs_on_facets
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.problem.values import Data, datum


@dataclass(frozen=True)
class FacetPoints:
    """Points on some facets of the frames of cells.

    Functions of the space and data have values at the points:

        points = facet_points(frames, kinds == NEUMANN, degree)
        flux = points.values(q)

    Attributes:
        frames: The cells of the mesh.
        cells, facets: The facets, as facets of the frames, shape (n,).
        reference: The points on the reference facet, shape (points, d - 1).
        weights: Weights of means over a facet.
    """

    frames: Frames
    cells: Indices
    facets: Indices
    reference: Array
    weights: Array

    def some(self, used: Mask, frames: Frames, cells: Indices) -> "FacetPoints":
        """Return the points of some facets, whose cells are all among some cells.

        Args:
            used: The facets, shape (n,).
            frames: Some of the frames.
            cells: The numbers of these frames in order.
        """
        own = np.searchsorted(cells, self.cells[used])
        return FacetPoints(frames, own, self.facets[used], self.reference, self.weights)

    @functools.cached_property
    def owners(self) -> Frames:
        """The cell of each facet."""
        return self.frames.some(self.cells)

    @property
    def sizes(self) -> Array:
        """The sizes of the facets."""
        return self.owners.facet_sizes[np.arange(len(self.facets)), self.facets]

    @property
    def pairs(self) -> Indices:
        """The facets as (cell, local facet) pairs of the mesh."""
        local = self.owners.order[np.arange(len(self.facets)), self.facets]
        return np.column_stack((self.owners.cells, local))

    @functools.cached_property
    def points(self) -> Points:
        """The points of the facets of the mesh."""
        return Points(self.frames.domain, self.pairs.astype(np.int32), self.reference)

    def values(self, data: "Data | FacetPolynomials") -> Array:
        """Return data at the points, shape (n, points)."""
        if isinstance(data, FacetPolynomials):
            own = data.coefficients[self.cells, self.facets]
            return np.einsum("nj,njq->nq", own, self.polynomials(data.degree))
        values = datum(self.frames.domain, data)(self.points)
        return np.broadcast_to(values, (len(self.cells), len(self.weights)))

    @functools.cached_property
    def inside(self) -> Array:
        """The points in the reference facets of the frames, shape (n, points, d - 1)."""
        corners = np.eye(self.frames.dimension + 1)[facet_vertices(self.frames.domain)]
        coordinates = (barycentric(self.reference) @ corners)[self.pairs[:, 1]]
        vertices = others(self.frames.dimension)[self.facets, 1:]
        columns = np.take_along_axis(self.owners.order, vertices, axis=1)
        return np.take_along_axis(coordinates, columns[:, None], axis=2)

    def polynomials(self, degree: int) -> Array:
        """Return the polynomials on the facets at the points, shape (n, polynomials, points).

        Args:
            degree: The degree of the polynomials.
        """
        values = polynomials(self.frames.dimension - 1, degree, self.inside)
        return values.transpose(1, 0, 2)


def facet_points(frames: Frames, marked: Mask, degree: int) -> FacetPoints:
    """Return a rule on some facets.

    Args:
        frames: The cells of the mesh.
        marked: The facets of the frames, shape (cells, d + 1).
        degree: The degree of the polynomials that are integrated exactly.
    """
    points, weights = rule(frames.dimension - 1, degree)
    cells, facets = np.nonzero(marked)
    return FacetPoints(frames, cells, facets, points, weights)


def rule_on_parts(degree: int) -> tuple[Array, Array]:
    """Return points and weights on the unit interval: a rule on each of its equal parts.

    Args:
        degree: The degree of the polynomials that are integrated exactly.
    """
    nodes, weights = rule(1, degree)
    t = (np.arange(PARTS)[:, None] + nodes[:, 0]) / PARTS
    return t.ravel(), np.tile(weights, PARTS) / PARTS


def on_parts(frames: Frames, marked: Mask, series: Array) -> tuple[FacetPoints, Array]:
    """Return a rule on parts of some segments, and functions above the positive parts of others.

    Args:
        frames: The cells of a mesh of triangles.
        marked: The facets of the frames, shape (cells, d + 1).
        series: Polynomials on the facets, shape (n, polynomials).

    Returns:
        The points, with a rule for products of two polynomials of the degree of the series, and
        the values at the points, see `positive_on_parts`.
    """
    t, weights = rule_on_parts(2 * (series.shape[1] - 1))
    cells, facets = np.nonzero(marked)
    points = FacetPoints(frames, cells, facets, t[:, None], weights)
    return points, positive_on_parts(PARTS, series, points.inside[:, :, 0])


def facet_kinds(solved: Solved) -> tuple[Indices, Indices]:
    """Return the kinds of the facets of cells, and which of their vertices touch the obstacle.

    Args:
        solved: The problem; the call is collective.

    Returns:
        Two arrays of the shape (cells, d + 1).

    Raises:
        InputError: A facet has Dirichlet data and is a contact facet or has a flux, or a dof has
            Dirichlet data and is on none of the facets with Dirichlet data.
    """
    problem, terms, frames, comm = solved.problem, solved.terms, solved.frames, solved.comm
    fixed = on_frames(frames, [facets for _, facets in terms.dirichlet])
    contact = on_frames(frames, [] if problem.in_domain else [problem.contact])
    flux = on_frames(frames, [facets for _, facets in (*terms.neumann, *terms.robin)])
    twice = bool((contact & flux).any())
    require(comm, not twice, "a facet has a flux, and is a contact facet", "neumann")
    twice = bool((fixed & (contact | flux)).any())
    require(comm, not twice, "a facet with data is a contact facet or has a flux", "dirichlet")
    _check_fixed(problem, terms)
    kinds = np.where(frames.outer, NEUMANN, INTERIOR)
    kinds[fixed] = DIRICHLET
    kinds[contact] = OPEN
    cells, facets = np.nonzero(kinds >= OPEN)
    pairs = np.column_stack((cells, frames.order[cells, facets])).astype(np.int32)
    touching = problem.gap.x.array <= solved.tiny
    kinds[cells, facets] = _contact_kinds(problem, facet_dofs(problem.space, pairs), touching)
    corners = np.ravel(problem.space.element.basix_element.entity_dofs[0])[frames.order]
    corners = np.take_along_axis(problem.space.dofmap.list[: len(corners)], corners, axis=1)
    return kinds.astype(np.int64), touching[corners].astype(np.int64)


def _contact_kinds(problem: BoundConstrainedProblem, dofs: LocalIndices, touching: Mask) -> Indices:
    """Whether facets with these dofs touch the obstacle nowhere, in part, or all over."""
    free = ~marked(problem.space, problem.fixed_dofs)
    light = weightless(problem.space, problem.space.mesh.topology.dim - 1)
    closed = (touching[dofs] | (light & free[dofs])).all(axis=1)
    # Of higher degree: where a facet touches with a vertex alone, the force is on its neighbours.
    degree, d = problem.space.element.basix_element.degree, problem.space.mesh.topology.dim
    inner = dofs if degree == 1 else dofs[:, d:]
    partly = (touching[inner] & free[inner]).any(axis=1)
    return np.where(closed, CLOSED, np.where(partly, PARTLY, OPEN))


def weightless(space: fem.FunctionSpace, dim: int) -> Mask:
    """Return whether the integral of the function of a dof over a facet or cell is not positive.

    The functions of vertices in space at degree 2 have the integral 0: contact forces at these
    vertices are small and of any sign, and tell nothing about contact.

    Args:
        space: The space.
        dim: The dimension of facets or cells.
    """
    element, d = space.element.basix_element, space.mesh.topology.dim
    points, weights = rule(dim, element.degree)
    inside = np.hstack((np.zeros((len(points), d - dim)), points))  # of the facet where x[0] = 0
    dofs = element.entity_closure_dofs[dim][d - dim]
    means = weights @ element.tabulate(0, inside)[0, :, dofs, 0].T
    return np.asarray(means <= ROUNDING)


def _check_fixed(problem: BoundConstrainedProblem, terms: EnergyTerms) -> None:
    facets, fixed = union(facets for _, facets in terms.dirichlet), problem.fixed_dofs
    dofs = dofs_on_facets(problem.space, facets)
    message = "a dof with Dirichlet data is on none of the facets that are named"
    require(problem.comm, bool(np.isin(fixed, dofs).all()), message, "dirichlet")
    message = "a dof on one of the facets that are named has no Dirichlet data"
    require(problem.comm, bool(np.isin(dofs, fixed).all()), message, "dirichlet")
