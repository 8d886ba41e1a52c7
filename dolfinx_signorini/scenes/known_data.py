"""The data of a scene as a bound needs them: polynomials, and bounds of what these miss.

The formulas of a scene file are known at every point. A formula that is no polynomial is replaced
by polynomials on cells or facets, and the differences are enclosed, see `fits`. Where a formula has
no bounded enclosure, the formula stays, and is known at points only.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from dolfinx import fem, mesh
from mpi4py import MPI
from ufl import SpatialCoordinate, as_matrix
from ufl.core.expr import Expr

from dolfinx_signorini.bounds.boundary_facets import on_frames
from dolfinx_signorini.bounds.cell_values import BEST, FILLING
from dolfinx_signorini.bounds.cones import MORE
from dolfinx_signorini.bounds.frames import cell_frames
from dolfinx_signorini.bounds.reference_flux import polynomials
from dolfinx_signorini.bounds.remainders import Remainders
from dolfinx_signorini.bounds.strong_form import EnergyTerms, FacetPolynomials, polynomial_degree
from dolfinx_signorini.meshes import boundary_facets
from dolfinx_signorini.scenes.choices import Decided, decided
from dolfinx_signorini.scenes.conditions import BoundaryCondition, Contact, Dirichlet, Neumann
from dolfinx_signorini.scenes.enclosures import enclosed_on_simplices
from dolfinx_signorini.scenes.fits import ORDERS, fit, followed, followed_in_parts
from dolfinx_signorini.scenes.formulas import Formula, evaluated
from dolfinx_signorini.scenes.interpolations import missed_by_interpolation
from dolfinx_signorini.scenes.matrices import eigenvalues, inverse_entries
from dolfinx_signorini.scenes.posing import PosedScene

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Marks = npt.NDArray[np.bool_]
Known = tuple[EnergyTerms, Remainders]

COEFFICIENTS = {2: 3, 3: 2}  # degrees of the polynomials for the diffusion, by dimension
FACET = 2.1  # the constant of a trace over that of Payne and Weinberger, at most
ROUGH = 0.3  # of the diffusion: what polynomials may miss


class KnownData:
    """The formulas of a scene on the mesh of a solved problem:

        terms, rest = KnownData(posed).enclosed(energy_terms(posed), tolerance=1e-3)

    Args:
        posed: The scene on a mesh; the call is collective.

    Attributes:
        size: The energy that the load has on single cells, a first guess of a tolerance.
        hidden: The energy that was hidden between the points of rules at last.
    """

    def __init__(self, posed: PosedScene):
        self.scene, self.sided, self.domain = posed.scene, posed.sided, posed.sided.mesh
        self.comm, self.degree = self.domain.comm, posed.scene.degree
        self.height = float(np.abs(posed.problem.u.x.array).max(initial=0.0))
        self.frames = frames = cell_frames(self.domain)
        self.d, count = frames.dimension, len(frames.order)
        x: Array = np.asarray(self.domain.geometry.x[:, : self.d], dtype=np.float64)
        self.corners = x[self.domain.geometry.dofmap[:count]]
        ends = (x.max(axis=0, initial=-np.inf), (-x).max(axis=0, initial=-np.inf))
        self.width = float(np.max(self.comm.allgather(ends), axis=0).sum(axis=0).max())
        self.size, self.hidden = self._load_on_cells(), 0.0

    def enclosed(self, terms: EnergyTerms, tolerance: float) -> Known:
        """Return the strong form with polynomials in place of formulas; the call is collective.

        Args:
            terms: The strong form.
            tolerance: The energy that may be hidden between the points of rules.
        """
        self.hidden = 0.0
        terms, rest = self._diffusion(terms)
        terms, rest = self._reaction(terms, rest, tolerance)
        terms, rest = self._load(terms, rest, tolerance)
        terms, rest = self._fluxes(terms, rest, tolerance)
        return terms, replace(
            rest,
            obstacle=self._on_boundary(Contact),
            dirichlet=self._on_boundary(Dirichlet),
            obstacle_in_space=self._obstacle_in_space(),
        )

    def _load_on_cells(self) -> float:
        if self.scene.load is None:
            return 1.0
        values = evaluated(self.scene.load.root, self.corners.mean(axis=1))
        values = np.where(np.isfinite(values), values, 0.0)
        values *= self.frames.diameters / 6.0
        square = self.comm.allreduce(float(values**2 @ self.frames.volumes))
        cells = self.comm.allreduce(len(values))
        return math.sqrt(square) * cells ** (-(self.degree - 1) / self.d) or 1.0

    def _diffusion(self, terms: EnergyTerms) -> Known:
        """The diffusion and its inverse, entry by entry."""
        rows, rest = self.scene.diffusion, Remainders()
        entries = [entry for row in rows for entry in row]
        if all(entry.constant is not None for entry in entries):
            return terms, rest
        parts = decided(entries, self.corners)
        data, missed = self._polynomials(entries, [(p.cells, p.formulas) for p in parts])
        inverses, inverse_missed = self._polynomials(
            inverse_entries(entries), [(p.cells, inverse_entries(p.formulas)) for p in parts]
        )
        least, largest, thin = self._spectra(parts)
        all_missed = np.linalg.norm(missed, axis=1)
        inverse_missed = np.linalg.norm(inverse_missed, axis=1)
        rough = ~(all_missed < ROUGH * least) | ~np.isfinite(inverse_missed) | ~(thin[1] > 0.0)
        rough |= ~np.isfinite(largest + thin[2])
        if self._any(rough):
            return terms, rest  # the notes of a bound tell
        n = len(rows)
        matrix = data[0] if n == 1 else as_matrix([data[n * i : n * i + n] for i in range(n)])
        known = replace(
            rest,
            diffusion=all_missed,
            inverse=inverse_missed,
            inverse_entries=tuple(inverses),
            least_diffusion=np.minimum(least, thin[1]),
            largest_diffusion=largest,
            thin=thin,
        )
        return replace(terms, diffusion=matrix), known

    def _spectra(self, parts: list[Decided]) -> tuple[Array, Array, Array]:
        """The extreme eigenvalues of the diffusion on cells, and see `Remainders.thin`."""
        count = len(self.corners)
        least, largest = np.zeros(count), np.zeros(count)
        thin = np.array([[0.0], [np.inf], [0.0]]) * np.ones(count)
        for part in parts:
            least[part.cells], largest[part.cells] = eigenvalues(
                part.formulas, self.corners[part.cells]
            )
            thin[0, part.cells] = part.shares
            open_ = part.cells[part.shares > 0.0]
            for formulas in part.others:
                low, high = eigenvalues(formulas, self.corners[open_])
                thin[1, open_] = np.minimum(thin[1, open_], low)
                thin[2, open_] = np.maximum(thin[2, open_], high)
        return least, largest, thin

    def _reaction(self, terms: EnergyTerms, rest: Remainders, tolerance: float) -> Known:
        formula = self.scene.reaction
        if formula is None or formula.constant is not None:
            return terms, rest
        low, high = enclosed_on_simplices(formula, self.corners)
        if self._any(np.isinf(low) | np.isinf(high)):
            return terms, rest
        extrema = {"least_reaction": np.maximum(low, 0.0), "largest_reaction": high}
        if polynomial_degree(terms.reaction) is not None:
            return terms, replace(rest, **extrema)
        weights = self._weights(rest) * max(self.comm.allgather(self.height))
        found = self._fit(formula, weights, tolerance)
        if found is None:
            return terms, rest
        data, missed, mean = found
        known = replace(rest, **extrema, reaction=missed, reaction_mean=mean)
        return replace(terms, reaction=data), known

    def _load(self, terms: EnergyTerms, rest: Remainders, tolerance: float) -> Known:
        formula, degree = self.scene.load, polynomial_degree(terms.load)
        exact = degree is not None and 2 * degree <= BEST[self.d]
        if formula is None or self.scene.manufactured or exact:
            return terms, rest
        found = self._fit(formula, self._weights(rest), tolerance)
        if found is None:
            return terms, rest
        data, missed, mean = found
        return replace(terms, load=data), replace(rest, load=missed, load_mean=mean)

    def _fluxes(self, terms: EnergyTerms, rest: Remainders, tolerance: float) -> Known:
        parts = [c for c in self.scene.conditions if isinstance(c, Neumann) and c.value]
        if self.scene.manufactured or all(_polynomial(c.value, self.domain) for c in parts):
            return terms, rest
        frames, shape = self.frames, self.frames.facets.shape
        degree = self.degree + 2
        coefficients = np.zeros((*shape, degree + 1 if self.d == 2 else math.comb(degree + 2, 2)))
        missed, means = np.zeros(shape), np.zeros(shape)
        lever = frames.facet_sizes / frames.volumes[:, None]
        inner, outer = self._weights(rest)[:, :, None] * np.sqrt(lever)
        for condition in parts:
            cells, facets, corners = self._facets(condition)
            assert condition.value is not None
            weights = np.stack((inner[cells, facets], outer[cells, facets]))
            weights[0] *= FACET
            found = fit(condition.value, self.comm, corners, degree, weights, tolerance)
            self.hidden = max(self.hidden, found.hidden)
            if self._any(~np.isfinite(found.missed)):
                return terms, rest
            coefficients[cells, facets] = found.coefficients
            missed[cells, facets], means[cells, facets] = found.missed, found.mean
        sides = np.concatenate([self.sided.facets(c.sides) for c in parts])
        flux = FacetPolynomials(degree, coefficients)
        known = replace(rest, flux=missed * np.sqrt(frames.facet_sizes), flux_mean=means)
        return replace(terms, neumann=[(flux, np.unique(sides))]), known

    def _on_boundary(self, kind: type[BoundaryCondition]) -> Array | None:
        """What interpolations miss of values on the boundary; None where nothing or not known."""
        degree, result = self.degree + MORE, np.zeros((3, *self.frames.facets.shape))
        found = False
        for condition in self.scene.conditions:
            if not isinstance(condition, kind) or condition.value is None:
                continue
            if _polynomial(condition.value, self.domain, degree):
                continue
            if self.d == 3:
                return None
            cells, facets, corners = self._facets(condition)
            missed = missed_by_interpolation(condition.value, corners, degree)
            if self._any(np.isinf(missed)):
                return None
            result[:, cells, facets], found = missed, True
        return result if found else None

    def _obstacle_in_space(self) -> tuple[FacetPolynomials, Array] | None:
        """Polynomials for the obstacle on facets in space, and what they miss."""
        contact = self.scene.contact
        if (
            self.d == 2
            or contact.value is None
            or _polynomial(contact.value, self.domain, self.degree)
        ):
            return None
        degree = min(self.degree + FILLING, ORDERS[2] // 2)
        cells, facets, corners = self._facets(contact)
        shape = self.frames.facets.shape
        coefficients, missed = np.zeros((*shape, math.comb(degree + 2, 2))), np.zeros(shape)
        found = followed_in_parts(contact.value, corners, degree)
        coefficients[cells, facets], missed[cells, facets] = found
        if self._any(np.isinf(missed)):
            return None
        return FacetPolynomials(degree, coefficients), missed

    def _facets(self, condition: BoundaryCondition) -> tuple[Indices, Indices, Array]:
        """The facets of a condition as facets of frames, with their vertices."""
        frames, d = self.frames, self.d
        sides = [self.sided.facets(condition.sides)]
        marks = on_frames(self.domain, frames, sides)
        marks &= on_frames(self.domain, frames, [boundary_facets(self.domain)])
        cells, facets = np.nonzero(marks)
        others = np.array([[j for j in range(d + 1) if j != k] for k in range(d + 1)])
        return cells, facets, frames.corners[cells[:, None], others[facets]]

    def _weights(self, rest: Remainders) -> Array:
        """The energies of unit values, and of unit means, on cells of size 1."""
        a = 1.0 if rest.least_diffusion is None else rest.least_diffusion
        constant = [e.constant for row in self.scene.diffusion for e in row]
        if constant and None not in constant:
            matrix = np.array(constant, dtype=np.float64).reshape(len(self.scene.diffusion), -1)
            a = float(np.linalg.eigvalsh(matrix)[0])
        known = self.scene.reaction.constant if self.scene.reaction is not None else 0.0
        c: float | Array = 0.0 if known is None else known
        if rest.least_reaction is not None:
            c = rest.least_reaction
        with np.errstate(divide="ignore"):
            by_reaction = 1.0 / np.sqrt(np.asarray(c, dtype=np.float64))
        wide = np.broadcast_to(self.width, self.frames.volumes.shape)
        by_gradient = np.stack((self.frames.diameters / math.pi, wide)) / np.sqrt(a)
        return np.asarray(np.minimum(by_gradient, by_reaction))

    def _fit(
        self, formula: Formula, weights: Array, tolerance: float
    ) -> tuple[fem.Function, Array, Array] | None:
        """Polynomials on cells, and the L2 norms and means that they miss; None if unbounded."""
        degree = min(self.degree + 2, ORDERS[self.d] // 2)
        found = fit(formula, self.comm, self.corners, degree, weights, tolerance)
        self.hidden = max(self.hidden, found.hidden)
        if self._any(~np.isfinite(found.missed)):
            return None
        missed = found.missed * np.sqrt(self.frames.volumes)
        return self._function(found.coefficients, degree), missed, found.mean

    def _polynomials(
        self, entries: Sequence[Formula], parts: list[tuple[Indices, list[Formula]]]
    ) -> tuple[list[Expr], Array]:
        """Formulas, or polynomials in their places with what these miss at most on each cell.

        Args:
            entries: The formulas.
            parts: Cells with the formulas as they are there.
        """
        data: list[Expr] = []
        missed = np.zeros((len(self.corners), len(entries)))
        degree = COEFFICIENTS[self.d]
        for k, entry in enumerate(entries):
            if _polynomial(entry, self.domain, 2 * degree):
                data.append(entry.ufl(SpatialCoordinate(self.domain)))
                continue
            coefficients = np.zeros((len(self.corners), math.comb(degree + self.d, self.d)))
            for cells, formulas in parts:
                found = followed(formulas[k], self.corners[cells], degree)
                coefficients[cells], missed[cells, k] = found
            data.append(self._function(coefficients, degree))
        return data, missed

    def _function(self, coefficients: Array, degree: int) -> fem.Function:
        """A function with given polynomials on the cells of this rank."""
        function = fem.Function(fem.functionspace(self.domain, ("DG", degree)))
        space = function.function_space
        table = polynomials(self.d, degree, space.element.basix_element.points)
        function.x.array[space.dofmap.list[: len(coefficients)]] = coefficients @ table
        function.x.scatter_forward()
        return function

    def _any(self, marks: Marks) -> bool:
        return bool(self.comm.allreduce(bool(marks.any()), op=MPI.LOR))


def _polynomial(formula: Formula | None, domain: mesh.Mesh, most: int | None = None) -> bool:
    """Whether a formula is a polynomial of at most some degree."""
    if formula is None or formula.constant is not None:
        return True
    degree = polynomial_degree(formula.ufl(SpatialCoordinate(domain)))
    return degree is not None and (most is None or degree <= most)
