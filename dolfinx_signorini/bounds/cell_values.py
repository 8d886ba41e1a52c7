"""A discrete solution with the coefficients of its equation at points of cells."""

import math
from dataclasses import dataclass

import numpy as np

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.bounds.condensation import CellData
from dolfinx_signorini.bounds.frames import Frames, values_at
from dolfinx_signorini.bounds.reference_flux import (
    ReferenceFlux,
    barycentric,
    largest,
    polynomials,
    rule,
)
from dolfinx_signorini.bounds.remainders import MORE, Solved
from dolfinx_signorini.bounds.strong_form import polynomial_degree

# By dimension: the degree of rules for data that are no polynomials, above rules for polynomials,
# and the highest degree of a rule.
SAMPLED = {2: 10, 3: 6}
BEST = {2: 30, 3: 20}


@dataclass(frozen=True)
class _Diffusion:
    """The diffusion A at points of cells: a multiple of the identity, or a symmetric matrix."""

    values: Array  # shape (cells, points, 1), or (cells, points, d, d) for matrices
    inverses: Array  # of the values, with the same shape
    lowest: Array  # the smallest eigenvalue at the points of each cell
    upper: Array  # what A at the points of each cell does not exceed, shape (cells, d, d)

    @property
    def symmetric(self) -> bool:
        """Whether A is symmetric at all points, up to rounding."""
        if self.values.ndim == 3:
            return True
        apart = np.abs(self.values - self.values.swapaxes(2, 3)).max(axis=(2, 3))
        return bool((apart <= SOLVED * np.abs(self.values).max(axis=(2, 3))).all())

    def times(self, vectors: Array) -> Array:
        """Return the products of A with vectors, shape (cells, points, d)."""
        return _product(self.values, vectors)

    def divided(self, vectors: Array) -> Array:
        """Return the products of the inverse of A with vectors, shape (cells, points, d)."""
        return _product(self.inverses, vectors)

    def mean_inverse(self, weights: Array, dimension: int) -> Array:
        """The mean of the inverse of A over each cell, shape (cells, d, d)."""
        mean = np.asarray(np.tensordot(self.inverses, weights, (1, 0)), dtype=np.float64)
        return mean if mean.ndim == 3 else np.asarray(mean[..., None] * np.eye(dimension))


def _diffusion_at(entries: Array, dimension: int) -> _Diffusion:
    """The diffusion with given entries."""
    if entries.shape[2] == 1:
        lowest = entries.min(axis=(1, 2), initial=np.inf)
        upper = entries.max(axis=(1, 2), initial=-np.inf)[:, None, None] * np.eye(dimension)
        with np.errstate(divide="ignore"):
            return _Diffusion(entries, np.asarray(1.0 / entries, dtype=np.float64), lowest, upper)
    values = entries.reshape(*entries.shape[:2], dimension, dimension)
    spectrum = np.linalg.eigvalsh(values)
    lowest = spectrum.min(axis=(1, 2), initial=np.inf)
    largest = spectrum.max(axis=(1, 2), initial=-np.inf)[:, None, None]
    same = (values == values[:, :1]).all(axis=(1, 2, 3))[:, None, None]
    upper = np.where(same, values[:, 0], largest * np.eye(dimension))
    usable = bool((lowest > 0.0).all())
    inverses: Array = np.asarray(np.linalg.inv(values), dtype=np.float64) if usable else values
    return _Diffusion(values, inverses, lowest, upper)


def _product(matrices: Array, vectors: Array) -> Array:
    if matrices.ndim == 3:
        return np.asarray(matrices * vectors)
    return np.asarray((matrices @ vectors[..., None])[..., 0])


@dataclass(frozen=True)
class CellValues:
    """A solution with the coefficients of its equation, with the signs of a lower obstacle.

    The integral of f over each cell:

        (values.load @ values.weights) * values.frames.volumes

    Attributes:
        frames: The cells.
        points, weights: The rule on the reference cell of the mesh; the weights add up to 1.
        u: The solution, shape (cells, points).
        gradient: The gradient of the solution, shape (cells, points, d).
        diffusion: The diffusion A.
        reaction, load: c and f, shape (cells, points).
        least_reaction: The smallest value of c in each cell, as far as that is known.
    """

    frames: Frames
    points: Array
    weights: Array
    u: Array
    gradient: Array
    diffusion: _Diffusion
    reaction: Array
    load: Array
    least_reaction: Array

    @property
    def current(self) -> Array:
        """A grad u, shape (cells, points, d)."""
        return self.diffusion.times(self.gradient)

    @property
    def l2_weight(self) -> Array:
        """The L2 norm of w on each cell is at most this times that of c^(1/2) w."""
        with np.errstate(divide="ignore"):
            return np.asarray(1.0 / np.sqrt(self.least_reaction))

    @property
    def gradient_weight(self) -> Array:
        """The L2 norm of w - mean(w) is at most this times that of A^(1/2) grad w.

        Source: Payne and Weinberger, Arch. Rational Mech. Anal. 5 (1960) 286-292.
        """
        return self.frames.diameters / (math.pi * np.sqrt(self.diffusion.lowest))

    @property
    def weak(self) -> Mask:
        """Whether the reaction is weak, so that functions are tested with gradients."""
        return np.asarray(self.gradient_weight <= self.l2_weight)

    def moments(self, values: Array, degree: int) -> Array:
        """Return the means over cells of a function times polynomials, see `Frames.moments`.

        Args:
            values: The function at the points, shape (cells, points, ...).
            degree: The degree of the polynomials.
        """
        return self.frames.moments(values, self.points, self.weights, degree)

    def largest(self, field: Array, degree: int) -> Array:
        """Return bounds on cells of the size of a field whose components are polynomials.

        Args:
            field: At the points, shape (cells, points, d).
            degree: The degree of the polynomials.
        """
        sizes = largest(self.frames.dimension, degree, self.moments(field, degree))
        return np.asarray(np.linalg.norm(sizes, axis=1))

    def integrals(self, values: Array) -> Array:
        """Return the integrals over each cell of a function at the points."""
        return np.asarray((values @ self.weights) * self.frames.volumes)

    def rest(self, degree: int) -> Array:
        """Return f - c u without its projection on polynomials of a degree on each cell."""
        rest = self.load - self.reaction * self.u
        means = self.moments(rest, degree)
        for cells, order in self.frames.groups():
            own = barycentric(self.points)[:, order][:, 1:]
            rest[cells] -= means[cells] @ polynomials(self.frames.dimension, degree, own)
        return rest


def cell_values(solved: Solved, quadrature: int) -> CellValues:
    """Return the solution of a problem with the coefficients of its equation.

    Args:
        solved: The problem; the call is collective.
        quadrature: The degree of the rule.

    Raises:
        InputError: The reaction is negative, the diffusion is not positive definite, or data are
            not finite.
    """
    problem, terms, rest, d = solved.problem, solved.terms, solved.rest, solved.dimension
    points, weights = rule(d, quadrature)
    entries, inverses = terms.entries(d), rest.inverse_entries
    data = [terms.reaction or 0.0, terms.load or 0.0, *entries, *inverses]
    at = values_at(solved.frames.domain, data, points, solved.frames.cells)
    require(problem.comm, bool(np.isfinite(at).all()), "some data are not finite", "load")
    fitted = np.asarray(rest.reaction)[..., None] > 0.0  # polynomials that may be negative
    good = bool(((at[:, :, 0] >= 0.0) | fitted).all())
    require(problem.comm, good, "negative at some point", "reaction")
    A = _diffusion_at(at[:, :, 2 : 2 + len(entries)], d)
    require(problem.comm, A.symmetric, "not symmetric at some point", "diffusion")
    definite = bool((A.lowest > 0.0).all())
    require(problem.comm, definite, "not positive definite at some point", "diffusion")
    if inverses:
        inverse = at[:, :, 2 + len(entries) :]
        inverse = inverse.reshape(A.inverses.shape)
        least, largest = rest.least_diffusion, rest.largest_diffusion
        assert least is not None and largest is not None
        A = _Diffusion(A.values, inverse, least, largest[:, None, None] * np.eye(d))
    places = solved.frames.points(points)
    (u,), (gradient,) = places.values(problem.u), places.gradients(problem.u)
    c, least = at[:, :, 0], rest.least_reaction
    return CellValues(
        solved.frames,
        points,
        weights,
        problem.sign * u,
        problem.sign * np.stack(gradient, axis=2),
        A,
        c,
        problem.sign * at[:, :, 1],
        c.min(axis=1, initial=np.inf) if least is None else least,
    )


def cell_data(
    values: CellValues,
    kinds: Indices,
    touching: Indices,
    fluxes: Array,
    gaps: Array,
    reference: ReferenceFlux,
) -> CellData:
    """Return what patches need to know of the cells.

    Args:
        values: The solution and the coefficients.
        kinds: The kinds of the facets, shape (cells, d + 1).
        touching: Whether the vertices touch the obstacle, shape (cells, d + 1).
        fluxes: The moments of given fluxes on facets.
        gaps: The means of gap times polynomial on contact facets.
        reference: The fields.
    """
    frames, degree, J = values.frames, reference.degree, values.frames.jacobians
    inverse = values.diffusion.mean_inverse(values.weights, frames.dimension)
    det = frames.volumes * math.factorial(frames.dimension)
    source = values.load - values.reaction * values.u
    current = values.moments(values.current, degree)
    return CellData(
        vertices=frames.vertices,
        facets=frames.facets,
        kinds=kinds,
        touching=touching,
        sizes=np.column_stack((frames.volumes, frames.facet_sizes)),
        metric=J.transpose(0, 2, 1) @ inverse @ J / det[:, None, None],
        # The energy of the distance to A grad u, measured with the mean of the inverse of A.
        gradient=J.transpose(0, 2, 1) @ inverse @ current,
        current=frames.inverses @ current * frames.volumes[:, None, None],
        source=values.moments(source, degree) * frames.volumes[:, None],
        fluxes=fluxes,
        gaps=gaps,
        strength=np.where(values.l2_weight < values.gradient_weight, values.least_reaction, 0.0),
    )


def flux_values(values: CellValues, coefficients: Array, reference: ReferenceFlux) -> Array:
    """Return a field at points, shape (cells, points, d).

    Args:
        values: The solution and the coefficients of the equation.
        coefficients: The coefficients of the field, shape (cells, fields).
        reference: The fields.
    """
    frames = values.frames
    result = np.zeros((len(coefficients), len(values.weights), frames.dimension))
    for cells, order in frames.groups():
        own = barycentric(values.points)[:, order][:, 1:]
        result[cells] = np.tensordot(coefficients[cells], reference.fields(own), (1, 1))
    det = frames.volumes * math.factorial(frames.dimension)
    return np.asarray(result @ (frames.jacobians / det[:, None, None]).transpose(0, 2, 1))


def quadrature_degree(solved: Solved, degree: int) -> tuple[int, list[str]]:
    """Return the degree of a rule for cells, with what the rule knows at its points only.

    Args:
        solved: The problem.
        degree: The degree of the flux.
    """
    terms, rest, dimension = solved.terms, solved.rest, solved.dimension
    load, c = polynomial_degree(terms.load), polynomial_degree(terms.reaction)
    A = [polynomial_degree(entry) for entry in terms.entries(dimension)]
    current = max(degree + 1, degree - 1 + max(a or 0 for a in A))
    need = 2 * max(degree + 1, load or 0, (c or 0) + degree)
    found = {"diffusion": any(a != 0 for a in A), "reaction": c != 0, "load": load is None}
    if rest.inverse_entries:
        inverse = max(polynomial_degree(entry) or 0 for entry in rest.inverse_entries)
        found["diffusion"], need = False, max(need, 2 * current + inverse)
    if rest.least_reaction is not None:
        found["reaction"] = c is None
    if rest.obstacle_in_space is not None:
        need = max(need, 2 * (degree + MORE[3]))
    if any(found.values()):
        need = max(need, 2 * degree + SAMPLED[dimension])
    if need > BEST[dimension]:
        found["load"] = True
    notes = [f"the {name} is known at quadrature points only" for name, few in found.items() if few]
    return min(need, BEST[dimension]), notes
