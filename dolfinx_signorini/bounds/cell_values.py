"""A discrete solution with the coefficients of its equation at points of cells."""

import functools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from dolfinx_signorini.base.arrays import Array, Indices, blocks
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.bounds.cell_scales import (
    CellScales,
    Diffusion,
    diffusion_at,
    mean_matrices,
    means,
    stacked,
)
from dolfinx_signorini.bounds.condensation import CellData
from dolfinx_signorini.bounds.frames import Frames
from dolfinx_signorini.bounds.reference_flux import ReferenceFlux
from dolfinx_signorini.bounds.remainders import MORE, Remainders, Solved
from dolfinx_signorini.bounds.strong_form import polynomial_degree
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.polynomials import largest, polynomials
from dolfinx_signorini.meshes.quadrature import rule
from dolfinx_signorini.problem.values import datum

# By dimension: the degree of rules for data that are no polynomials, above rules for polynomials,
# and the highest degree of a rule.
SAMPLED = {2: 10, 3: 6}
BEST = {2: 30, 3: 20}


@dataclass(frozen=True)
class CellValues:
    """A solution with the coefficients of its equation, with the signs of a lower obstacle.

    What is asked for is computed once, by calls that are collective. The integral of f over each
    cell:

        (values.load @ values.weights) * values.frames.volumes

    Attributes:
        solved: The problem, or what concerns some of its cells.
        points, weights: The rule on the reference cell of the mesh; the weights add up to 1.
        formulas: By the names of coefficients, functions with the values of their entries.
    """

    solved: Solved
    points: Array
    weights: Array
    formulas: dict[str, list[Callable[[Points], Array]]]

    @property
    def frames(self) -> Frames:
        """The cells."""
        return self.solved.frames

    @property
    def rest(self) -> Remainders:
        """What the data have beside polynomials."""
        return self.solved.rest

    def batches(self) -> Iterator[tuple[slice, "CellValues"]]:
        """Yield cells and their values, so few that caches hold them; collective."""
        for some in blocks(len(self.frames.cells), len(self.weights), self.solved.comm):
            yield some, replace(self, solved=self.solved.some(some))

    @functools.cached_property
    def at(self) -> Points:
        """The points in the cells of the mesh."""
        return self.frames.points(self.points)

    def _values(self, name: str) -> list[Array]:
        """The values of the entries of a coefficient."""
        found = [formula(self.at) for formula in self.formulas[name]]
        finite = all(bool(np.isfinite(values).all()) for values in found)
        require(self.solved.comm, finite, "some data are not finite", "load")
        return found

    @functools.cached_property
    def u(self) -> Array:
        """The solution, shape (cells, points)."""
        return self.solved.problem.sign * self.at.values(self.solved.problem.u)[0]

    @functools.cached_property
    def gradient(self) -> Array:
        """Its gradient, shape (cells, points, d), or (cells, 1, d) for a solution of degree 1."""
        at = self.frames.points(self.points[:1]) if self.solved.degree == 1 else self.at
        (gradient,) = at.gradients(self.solved.problem.u)
        return np.asarray(self.solved.problem.sign * np.stack(gradient, axis=2))

    @functools.cached_property
    def aim(self) -> Array:
        """The gradient that a flux is compared with, see `Solved.change`."""
        if self.solved.change is None:
            return self.gradient
        (more,) = self.at.gradients(self.solved.change)
        return np.asarray(self.gradient + np.stack(more, axis=2))

    @functools.cached_property
    def diffusion(self) -> Diffusion:
        """The diffusion A.

        Raises:
            InputError: The diffusion is not positive definite and symmetric at the points.
        """
        comm, rest, d = self.solved.comm, self.rest, self.solved.dimension
        A = diffusion_at(stacked(self._values("diffusion"), d), d, len(self.frames.cells))
        require(comm, A.symmetric, "not symmetric at some point", "diffusion")
        definite = bool((A.lowest > 0.0).all())
        require(comm, definite, "not positive definite at some point", "diffusion")
        if not rest.inverse_entries:
            return A
        least, largest = rest.least_diffusion, rest.largest_diffusion
        assert least is not None and largest is not None
        inverse = stacked(self._values("inverse"), d)
        return Diffusion(A.values, inverse, least, largest[:, None, None] * np.eye(d))

    @functools.cached_property
    def reaction(self) -> Array:
        """The reaction c, shape (cells, points), or (1, 1) for a number.

        Raises:
            InputError: The reaction is negative at a point.
        """
        (c,) = self._values("reaction")
        fitted = np.asarray(self.rest.reaction)[..., None] > 0.0  # polynomials may be negative
        good = bool(((c >= 0.0) | fitted).all())
        require(self.solved.comm, good, "negative at some point", "reaction")
        return c

    @functools.cached_property
    def load(self) -> Array:
        """The load f, shape (cells, points), or (1, 1) for a number."""
        return np.asarray(self.solved.problem.sign * self._values("load")[0])

    @functools.cached_property
    def residual(self) -> Array:
        """The part f - c u of the residual, shape (cells, points)."""
        return np.asarray(self.load - self.reaction * self.u)

    @functools.cached_property
    def scales(self) -> CellScales:
        """What bounds functions in the cells."""
        least, most = self.rest.least_reaction, self.rest.largest_reaction
        return CellScales(
            self.frames.volumes,
            self.frames.diameters,
            self.diffusion.lowest,
            self.diffusion.upper,
            self._extreme(np.min, np.inf) if least is None else least,
            self._extreme(np.max, 0.0) if most is None else most,
        )

    def _extreme(self, of: Callable[..., Array], none: float) -> Array:
        """The least or largest value of the reaction at the points of each cell."""
        return np.broadcast_to(of(self.reaction, axis=1, initial=none), len(self.frames.cells))

    @property
    def current(self) -> Array:
        """A grad u, shape (cells, points, d), or (cells, 1, d) where it is constant."""
        return self.diffusion.times(self.gradient)

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
        return means(values, self.weights) * self.frames.volumes

    def beside(self, source: Array, degree: int) -> Array:
        """Return f - c u without its projection on polynomials on each cell, at the points.

        Args:
            source: The moments of f - c u, see `CellData`.
            degree: The degree of the polynomials.
        """
        rest, mean = self.residual.copy(), source / self.frames.volumes[:, None]
        for cells, own in self.frames.groups(self.points):
            rest[cells] -= mean[cells] @ polynomials(self.frames.dimension, degree, own)
        return rest


def cell_values(solved: Solved, quadrature: int) -> CellValues:
    """Return the solution of a problem with the coefficients of its equation.

    Args:
        solved: The problem; the call is collective.
        quadrature: The degree of the rule.
    """
    terms, domain = solved.terms, solved.frames.domain
    data = {
        "reaction": [terms.reaction or 0.0],
        "load": [terms.load or 0.0],
        "diffusion": terms.entries(solved.dimension),
        "inverse": list(solved.rest.inverse_entries),
    }
    formulas = {name: [datum(domain, item) for item in items] for name, items in data.items()}
    return CellValues(solved, *rule(solved.dimension, quadrature), formulas)


def cell_data(
    values: CellValues,
    degree: int,
    kinds: Indices,
    touching: Indices,
    fluxes: Array,
    gaps: Array,
    sides: Indices,
    rises: Array,
) -> CellData:
    """Return what patches need to know of cells.

    Args:
        values: The solution and the coefficients.
        degree: The degree of the flux.
        kinds: The kinds of the facets, shape (cells, d + 1).
        touching: Whether the vertices touch the obstacle, shape (cells, d + 1).
        fluxes: The moments of given fluxes on facets.
        gaps: The means of gap times polynomial on contact facets.
        sides: Which obstacle may press on each cell, see `CellData`.
        rises: The means of v - g times polynomial over cells, up to this degree or a higher one.
    """
    frames, scales, J = values.frames, values.scales, values.frames.jacobians
    inverse = mean_matrices(values.diffusion.inverses, values.weights, frames.dimension)
    weighted = J.transpose(0, 2, 1) @ inverse
    det = frames.volumes * math.factorial(frames.dimension)
    current = aim = values.moments(values.current, degree)
    if values.aim is not values.gradient:
        aim = values.moments(values.diffusion.times(values.aim), degree)
    source = values.moments(values.residual, degree) * frames.volumes[:, None]
    strength = np.where(scales.l2_weight < scales.gradient_weight, scales.least_reaction, 0.0)
    return CellData(
        vertices=frames.vertices,
        facets=frames.facets,
        kinds=kinds,
        touching=touching,
        sizes=np.column_stack((frames.volumes, frames.facet_sizes)),
        edges=J,
        metric=weighted @ J / det[:, None, None],
        # The energy of the distance to A grad u, measured with the mean of the inverse of A.
        gradient=weighted @ aim,
        current=frames.inverses @ current * frames.volumes[:, None, None],
        source=source,
        fluxes=fluxes,
        gaps=gaps,
        strength=np.where(sides != 0, np.inf, strength),
        sides=sides,
        rises=rises[:, : source.shape[1]],
        places=frames.places,
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
    for cells, own in frames.groups(values.points):
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
    current = max(degree + 1, max(degree, solved.order) - 1 + max(a or 0 for a in A))
    need = 2 * max(degree + 1, load or 0, (c or 0) + degree)
    found = {"diffusion": any(a != 0 for a in A), "reaction": c != 0, "load": load is None}
    if rest.inverse_entries:
        inverse = max(polynomial_degree(entry) or 0 for entry in rest.inverse_entries)
        found["diffusion"], need = False, max(need, 2 * current + inverse)
    if rest.least_reaction is not None:
        found["reaction"] = c is None
    if rest.obstacle_in_space is not None:
        need = max(need, 2 * (degree + MORE[3]))
    need = max(need, 2 * solved.order)
    if any(found.values()):
        need = max(need, 2 * degree + SAMPLED[dimension])
    if need > BEST[dimension]:
        found["load"] = True
    notes = [f"the {name} is known at quadrature points only" for name, few in found.items() if few]
    return min(need, BEST[dimension]), notes
