"""The facets of the boundary by what is known about the flux through each of them."""

import functools
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.base.ranks import highest, marked
from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.bounds.condensation import CLOSED, DIRICHLET, INTERIOR, NEUMANN, OPEN, PARTLY
from dolfinx_signorini.bounds.frames import Frames, on_frames, values_at
from dolfinx_signorini.bounds.reference_flux import (
    PARTS,
    others,
    polynomials,
    positive_on_parts,
    rule,
)
from dolfinx_signorini.bounds.remainders import Solved
from dolfinx_signorini.bounds.strong_form import EnergyTerms, FacetPolynomials
from dolfinx_signorini.meshes.elements import facet_dofs
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.assembly import Data, called, dofs_on_facets
from dolfinx_signorini.problem.signorini import SignoriniProblem


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

    @property
    def sizes(self) -> Array:
        """The sizes of the facets."""
        return self.frames.facet_sizes[self.cells, self.facets]

    @property
    def pairs(self) -> Indices:
        """The facets as (cell, local facet) pairs of the mesh."""
        return np.column_stack((self.cells, self.frames.order[self.cells, self.facets]))

    def values(self, data: "Data | FacetPolynomials") -> Array:
        """Return data at the points, shape (n, points)."""
        if isinstance(data, FacetPolynomials):
            own = data.coefficients[self.cells, self.facets]
            return np.einsum("nj,njq->nq", own, self.polynomials(data.degree))
        if callable(data) and not isinstance(data, Expr):
            x = np.zeros((3, len(self.cells) * len(self.weights)))
            x[: self.frames.dimension] = self.places.reshape(-1, self.frames.dimension).T
            values = called(self.frames.domain.comm, data, x)
            return values.reshape(len(self.cells), len(self.weights))
        return values_at(self.frames.domain, [data], self.reference, self.pairs)[:, :, 0]

    @functools.cached_property
    def places(self) -> Array:
        """The coordinates of the points, shape (n, points, d), where UFL has them."""
        x = ufl.SpatialCoordinate(self.frames.domain)
        return values_at(self.frames.domain, list(x), self.reference, self.pairs)

    @functools.cached_property
    def coordinates(self) -> Array:
        """The barycentric coordinates in the frames, shape (n, points, d + 1)."""
        first = self.frames.corners[self.cells, 0]
        inner = np.einsum(
            "nab,nqb->nqa", self.frames.inverses[self.cells], self.places - first[:, None]
        )
        return np.concatenate((1.0 - inner.sum(axis=2, keepdims=True), inner), axis=2)

    @property
    def along(self) -> Array:
        """The share of the way from the first end of segments to the second, shape (n, points)."""
        last = np.where(self.facets == 2, 1, 2)
        return np.take_along_axis(self.coordinates, last[:, None, None], axis=2)[:, :, 0]

    def polynomials(self, degree: int) -> Array:
        """Return the polynomials on the facets at the points, shape (n, polynomials, points).

        Args:
            degree: The degree of the polynomials.
        """
        d = self.frames.dimension
        columns = others(d)[self.facets][:, None, 1:]
        inside = np.take_along_axis(self.coordinates, columns, axis=2).reshape(-1, d - 1)
        values = polynomials(d - 1, degree, inside)
        return values.reshape(len(values), len(self.cells), len(self.weights)).transpose(1, 0, 2)

    def function(self, space: fem.FunctionSpace, dofs: Array) -> Array:
        """Return a function of a space at the points, shape (n, points).

        Args:
            space: A scalar space.
            dofs: The values of the function at the dofs of this rank.
        """
        d = self.frames.dimension
        order = np.argsort(self.frames.order[self.cells], axis=1)
        places = np.take_along_axis(self.coordinates, order[:, None, :], axis=2)[:, :, 1:]
        places = np.vstack((places.reshape(-1, d), np.zeros((1, d))))  # Basix needs a point
        table = space.element.basix_element.tabulate(0, places)[0, :-1, :, 0]
        table = table.reshape(len(self.cells), len(self.weights), table.shape[1])
        return np.einsum("nqi,ni->nq", table, dofs[space.dofmap.list[self.cells]])


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
    degree = series.shape[1] - 1
    nodes, weights = rule(1, 2 * degree)
    t = (np.arange(PARTS)[:, None] + nodes[:, 0]) / PARTS
    cells, facets = np.nonzero(marked)
    weights = np.tile(weights, PARTS) / PARTS
    points = FacetPoints(frames, cells, facets, t.reshape(-1, 1), weights)
    # The rule is symmetric, but the points may run from the second end of a facet to the first.
    place = np.argsort(np.argsort(points.along, axis=1), axis=1)
    order = np.argsort(t.ravel())
    values = positive_on_parts(degree, PARTS, series, nodes)[:, order]
    return points, np.take_along_axis(values, place, axis=1)


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
    outer = on_frames(frames, [boundary_facets(frames.domain)])
    fixed = on_frames(frames, [facets for _, facets in terms.dirichlet])
    contact = on_frames(frames, [problem.contact])
    flux = on_frames(frames, [facets for _, facets in (*terms.neumann, *terms.robin)])
    twice = bool((contact & flux).any())
    require(comm, not twice, "a facet has a flux, and is a contact facet", "neumann")
    twice = bool((fixed & (contact | flux)).any())
    require(comm, not twice, "a facet with data is a contact facet or has a flux", "dirichlet")
    _check_fixed(problem, terms)
    kinds = np.where(outer, NEUMANN, INTERIOR)
    kinds[fixed & outer] = DIRICHLET
    kinds[contact & outer] = OPEN
    cells, facets, dofs = contact_closures(problem, frames, kinds)
    size = highest(comm, np.abs(problem.u.x.array))
    touching = problem.gap.x.array <= ROUNDING * size
    kinds[cells, facets] = _contact_kinds(problem, dofs, touching)
    vertices = problem.space.element.basix_element.entity_dofs[0]
    corners = np.array([dofs[0] for dofs in vertices])[frames.order]
    corners = np.take_along_axis(problem.space.dofmap.list[: len(corners)], corners, axis=1)
    return kinds.astype(np.int64), touching[corners].astype(np.int64)


def _contact_kinds(problem: SignoriniProblem, dofs: Indices, touching: Mask) -> Indices:
    """Whether facets with these dofs touch the obstacle nowhere, in part, or all over."""
    free = ~marked(problem.space, problem.fixed_dofs)
    closed = (touching[dofs] | (_weightless(problem)[None, :] & free[dofs])).all(axis=1)
    # Of higher degree: where a facet touches with a vertex alone, the force is on its neighbours.
    degree, d = problem.space.element.basix_element.degree, problem.space.mesh.topology.dim
    inner = dofs if degree == 1 else dofs[:, d:]
    partly = (touching[inner] & free[inner]).any(axis=1)
    return np.where(closed, CLOSED, np.where(partly, PARTLY, OPEN))


def contact_closures(
    problem: SignoriniProblem, frames: Frames, kinds: Indices
) -> tuple[Indices, Indices, Indices]:
    """Return the cells and numbers of the contact facets of frames, with the dofs on each.

    Args:
        problem: The problem.
        frames: The cells of the mesh.
        kinds: The kinds of the facets of the cells.
    """
    cells, facets = np.nonzero(kinds >= OPEN)
    pairs = np.column_stack((cells, frames.order[cells, facets])).astype(np.int32)
    return cells, facets, facet_dofs(problem.space, pairs).astype(np.int64)


def _weightless(problem: SignoriniProblem) -> Mask:
    """Whether the integral of the function of a dof over a facet is not positive.

    The functions of vertices in space at degree 2 have the integral 0: contact forces at these
    vertices are small and of any sign, and tell nothing about contact.
    """
    element = problem.space.element.basix_element
    d = problem.space.mesh.topology.dim
    points, weights = rule(d - 1, element.degree)
    outside = np.hstack((np.zeros((len(points), 1)), points))  # of the facet where x[0] = 0
    dofs = element.entity_closure_dofs[d - 1][1]
    means = weights @ element.tabulate(0, outside)[0, :, dofs, 0].T
    return np.asarray(means <= ROUNDING)


def _check_fixed(problem: SignoriniProblem, terms: EnergyTerms) -> None:
    parts = [facets for _, facets in terms.dirichlet]
    facets = np.concatenate([*parts, np.empty(0, dtype=np.int32)]).astype(np.int32)
    dofs, fixed = dofs_on_facets(problem.space, facets), problem.fixed_dofs
    message = "a dof with Dirichlet data is on none of the facets that are named"
    require(problem.comm, bool(np.isin(fixed, dofs).all()), message, "dirichlet")
    message = "a dof on one of the facets that are named has no Dirichlet data"
    require(problem.comm, bool(np.isin(dofs, fixed).all()), message, "dirichlet")
