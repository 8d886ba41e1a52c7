"""The data of a scene as a bound needs them: polynomials, and bounds of what these miss.

The formulas of a scene file are known at every point. A formula that is no polynomial is replaced
by polynomials on cells or facets, and the differences are enclosed, see `approximated`. A formula
without a bounded enclosure stays, and is known at points only.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from dolfinx import fem

from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.base.ranks import anywhere, highest
from dolfinx_signorini.base.tolerances import ROUNDING, SOLVED, UPWARDS
from dolfinx_signorini.bounds.cell_values import BEST
from dolfinx_signorini.bounds.frames import cell_frames, on_frames
from dolfinx_signorini.bounds.remainders import IN_CELLS, MORE, Remainders
from dolfinx_signorini.bounds.strong_form import EnergyTerms, FacetPolynomials, polynomial_degree
from dolfinx_signorini.data.approximations import ORDERS, approximated, followed_in_parts
from dolfinx_signorini.data.branches import decided
from dolfinx_signorini.data.enclosures import enclosed_on_simplices, nowhere_negative
from dolfinx_signorini.data.formulas import Formula, evaluated
from dolfinx_signorini.data.interpolations import missed_by_interpolation
from dolfinx_signorini.data.smoothness import load_is_a_function
from dolfinx_signorini.meshes.polynomials import others
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, cell_corners, longest_side
from dolfinx_signorini.scenes.files.condition import BoundaryCondition
from dolfinx_signorini.scenes.files.conditions import Contact, Dirichlet, Neumann
from dolfinx_signorini.scenes.posing import PosedScene, coefficients, facets_by_kind, load_and_flux
from dolfinx_signorini.scenes.proven.known_diffusion import (
    cell_function,
    is_polynomial,
    with_known_diffusion,
)

NEGATIVE = "whether the reaction is negative somewhere is known at points only"
KINKED = "whether the flux of the manufactured solution is continuous is known at points only"
FACET = 2.1  # the constant of a trace over that of Payne and Weinberger, at most


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
        self.d = frames.dimension
        self.corners = cell_corners(self.domain)
        self.width = longest_side(self.comm, self.domain.geometry.x)
        made, self.load = self.scene.manufactured, coefficients(self.scene).load
        self.solution = self.scene.solution if made else None
        self.current = load_and_flux(self.scene)[1] if made else []
        self.contact = np.isin(frames.cells, posed.problem.contact)
        self.free = facets_by_kind(posed.parts)[Neumann.acts_like]
        self.size, self.hidden = self._load_on_cells(), 0.0

    def enclosed(self, terms: EnergyTerms, tolerance: float) -> tuple[EnergyTerms, Remainders]:
        """Return the strong form with polynomials in place of formulas; the call is collective.

        Args:
            terms: The strong form.
            tolerance: The energy that may be hidden between the points of rules.
        """
        self.hidden, self.tolerance = 0.0, tolerance
        known = with_known_diffusion(terms, self.scene, self.domain, self.corners)
        self.terms, self.rest = known
        self._enclose_reaction()
        degree = polynomial_degree(terms.load)
        if self.load is not None and (degree is None or 2 * degree > BEST[self.d]):
            self._fit("load", self.load, self._weights())
        if any(polynomial_degree(data) is None for data, _ in terms.neumann):
            self._enclose_fluxes()
        sampled = self.rest.sampled
        if self.solution is not None:
            entries = self.scene.diffusion_entries
            if anywhere(self.comm, not load_is_a_function(self.solution, entries, self.corners)):
                sampled = (*sampled, KINKED)
        return self.terms, replace(
            self.rest,
            sampled=sampled,
            obstacle=self._interpolated(Contact),
            dirichlet=self._interpolated(Dirichlet),
            obstacle_in_space=self._obstacle_in_space(),
            obstacles_in_cells=self._obstacles_in_cells(),
        )

    def _load_on_cells(self) -> float:
        if self.load is None:
            return 1.0
        middles = self.corners.mean(axis=1)
        values = evaluated(self.load.root, middles)
        if self.current:  # whose load may vanish
            parts = [evaluated(w.root, middles) for w in self.current]
            values = np.linalg.norm(parts, axis=0) / self.width
        values = np.where(np.isfinite(values), values, 0.0)
        values *= self.frames.diameters / 6.0
        square = self.comm.allreduce(float(values**2 @ self.frames.volumes))
        cells = self.comm.allreduce(len(values))
        return math.sqrt(square) * cells ** (-(self.degree - 1) / self.d) or 1.0

    def _enclose_reaction(self) -> None:
        formula = self.scene.reaction
        if formula is None:
            return
        low, high = enclosed_on_simplices(formula, self.corners)
        if anywhere(self.comm, np.isinf(low) | np.isinf(high)):
            return
        require(self.comm, bool((high >= 0.0).all()), "negative at some point", "reaction")
        tiny = ROUNDING * highest(self.comm, high)
        if not nowhere_negative(self.comm, formula, self.corners, tiny):
            self.rest = replace(self.rest, sampled=(*self.rest.sampled, NEGATIVE))
        polynomial = polynomial_degree(self.terms.reaction) is not None
        weights = self._weights() * max(self.comm.allgather(self.height))
        if polynomial or self._fit("reaction", formula, weights):
            least = np.maximum(low, 0.0)
            self.rest = replace(self.rest, least_reaction=least, largest_reaction=high)

    def _enclose_fluxes(self) -> None:
        frames, shape, degree = self.frames, self.frames.facets.shape, self.degree + 2
        coefficients = np.zeros((*shape, math.comb(degree + self.d - 1, degree)))
        missed, means = np.zeros(shape), np.zeros(shape)
        lever = frames.facet_sizes / frames.volumes[:, None]
        inner, outer = self._weights()[:, :, None] * np.sqrt(lever)
        for formula, at, corners, factors in self._fluxes():
            share = np.abs(factors)
            weights = np.stack((FACET * inner[at], outer[at])) * share
            found = approximated(formula, self.comm, corners, degree, weights, self.tolerance)
            self.hidden = max(self.hidden, found.hidden)
            if anywhere(self.comm, ~np.isfinite(found.missed)):
                return
            coefficients[at] += factors[:, None] * found.coefficients
            missed[at] += share * found.missed
            means[at] += share * found.mean
        sides = np.unique(np.concatenate([facets for _, facets in self.terms.neumann]))
        flux = FacetPolynomials(degree, coefficients)
        self.terms = replace(self.terms, neumann=[(flux, sides)])
        missed *= np.sqrt(frames.facet_sizes)
        self.rest = replace(self.rest, flux=missed, flux_mean=means)

    def _fluxes(self) -> Iterator[tuple[Formula, tuple[Indices, Indices], Array, Array]]:
        """Yield formulas with facets of frames, their vertices, and the factor in the flux.

        The formulas are those of fluxes, or of the components of a vector A grad u.
        """
        given = (
            [(self.free, self.current)]
            if self.current
            else [
                (self.sided.facets(c.sides), [c.value])
                for c in self.scene.conditions
                if isinstance(c, Neumann) and c.value is not None
            ]
        )
        for sides, formulas in given:
            cells, facets, corners = self._facets(sides)
            normals = -self.frames.gradients[cells, facets]
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            for k, formula in enumerate(formulas):
                factors = normals[:, k] if self.current else np.ones(len(cells))
                on = np.flatnonzero(np.abs(factors) > ROUNDING)
                yield formula, (cells[on], facets[on]), corners[on], factors[on]

    def _on_boundary(
        self, kind: type[BoundaryCondition], degree: int
    ) -> list[tuple[Formula, Indices, Indices, Array]]:
        """Values of conditions that are no polynomials, with facets of frames and vertices."""
        given = [(c.value, c.sides) for c in self.scene.conditions if isinstance(c, kind)]
        if kind is Dirichlet:
            given = [(value or self.solution, sides) for value, sides in given]
        return [
            (value, *self._facets(self.sided.facets(sides)))
            for value, sides in given
            if value is not None and not is_polynomial(value, self.domain, degree)
        ]

    def _interpolated(self, kind: type[BoundaryCondition]) -> Array | None:
        """What interpolations miss of values on the boundary; None for nothing, or if not known."""
        more = MORE if self.scene.obstacle is None else IN_CELLS
        degree, result = self.degree + more[2], np.zeros((3, *self.frames.facets.shape))
        found = self._on_boundary(kind, degree)
        for value, cells, facets, corners in found if self.d == 2 else ():
            result[:, cells, facets] = missed_by_interpolation(value, corners, degree)
        known = self.d == 2 and len(found) > 0 and not anywhere(self.comm, np.isinf(result))
        return result if known else None

    def _obstacle_in_space(self) -> tuple[FacetPolynomials, Array] | None:
        """Polynomials for the obstacle on facets in space, and what these polynomials miss."""
        degree, shape = min(self.degree + MORE[3], ORDERS[2] // 2), self.frames.facets.shape
        found = self._on_boundary(Contact, self.degree) if self.d == 3 else []
        coefficients, missed = np.zeros((*shape, math.comb(degree + 2, 2))), np.zeros(shape)
        for value, cells, facets, corners in found:
            both = followed_in_parts(value, corners, degree)
            coefficients[cells, facets], missed[cells, facets] = both
        known = len(found) > 0 and not anywhere(self.comm, np.isinf(missed))
        return (FacetPolynomials(degree, coefficients), missed) if known else None

    def _obstacles_in_cells(self) -> tuple[tuple[fem.Function, Array] | None, ...]:
        """Polynomials for the obstacles in the domain, and what these polynomials miss."""
        obstacle = self.scene.obstacle
        found = [] if obstacle is None else [self._in_cells(g) for _, g in obstacle.named]
        return tuple(found) if any(found) else ()

    def _in_cells(self, formula: Formula) -> tuple[fem.Function, Array] | None:
        """Polynomials for an obstacle; None where the obstacle is one, or is not known."""
        if is_polynomial(formula, self.domain, self.degree + IN_CELLS[self.d]):
            return None
        degree, missed = ORDERS[self.d] // 2, np.zeros(len(self.corners))
        coefficients = np.zeros((len(missed), math.comb(degree + self.d, degree)))
        for part in decided([formula], self.corners):
            clear = part.shares == 0.0
            for chosen, own in ((part.formulas[0], clear), (formula, ~clear)):
                cells = part.cells[own & self.contact[part.cells]]
                both = followed_in_parts(chosen, self.corners[cells], degree, 8 // self.d)
                coefficients[cells], missed[cells] = both
                if is_polynomial(chosen, self.domain, degree):
                    missed[cells] = 0.0
        if anywhere(self.comm, np.isinf(missed)):
            return None
        return cell_function(self.domain, coefficients, degree), missed

    def _facets(self, sides: LocalIndices) -> tuple[Indices, Indices, Array]:
        """Facets of the mesh as facets of frames, with their vertices."""
        frames = self.frames
        marks = on_frames(frames, [sides]) & on_frames(frames, [boundary_facets(self.domain)])
        cells, facets = np.nonzero(marks)
        return cells, facets, frames.corners[cells[:, None], others(self.d)[facets]]

    def _weights(self) -> Array:
        """The energies of unit values, and of unit means, on cells of size 1."""
        rest = self.rest
        a = 1.0 if rest.least_diffusion is None else rest.least_diffusion
        if (matrix := self.scene.constant_diffusion) is not None:
            a = float(np.linalg.eigvalsh(matrix)[0])
        c = np.zeros(1) if rest.least_reaction is None else rest.least_reaction
        with np.errstate(divide="ignore"):
            by_reaction = 1.0 / np.sqrt(c)
        wide = np.broadcast_to(self.width, self.frames.volumes.shape)
        by_gradient = np.stack((self.frames.diameters / math.pi, wide)) / np.sqrt(a)
        return np.asarray(np.minimum(by_gradient, by_reaction))

    def _fit(self, name: str, formula: Formula, weights: Array) -> bool:
        """Take polynomials on cells for the load or the reaction, if what is missed is bounded."""
        degree, count = min(self.degree + 2, ORDERS[self.d] // 2), len(self.corners)
        coefficients = np.zeros((count, math.comb(degree + self.d, degree)))
        missed, mean, hidden = np.zeros(count), np.zeros(count), 0.0
        parts, shares, apart = self._one_sided(formula)
        nothing = np.empty(0, dtype=np.int64), formula
        for k in range(max(self.comm.allgather(len(parts)))):
            cells, chosen = parts[k] if k < len(parts) else nothing
            where = self.corners[cells], degree, weights[:, cells]
            found = approximated(chosen, self.comm, *where, self.tolerance)
            coefficients[cells] = found.coefficients
            missed[cells], mean[cells] = found.missed, found.mean
            hidden = math.hypot(hidden, found.hidden)
        missed += np.sqrt(shares) * apart
        mean += shares * apart
        self.hidden = max(self.hidden, hidden)
        if anywhere(self.comm, ~np.isfinite(missed)):
            return False
        missed *= np.sqrt(self.frames.volumes)
        data = cell_function(self.domain, coefficients, degree)
        self.terms = replace(self.terms, **{name: data})
        known: dict[str, Any] = {name: missed, f"{name}_mean": mean}
        self.rest = replace(self.rest, **known)
        return True

    def _one_sided(self, formula: Formula) -> tuple[list[tuple[Indices, Formula]], Array, Array]:
        """The cells on one side of the jumps and kinks of a formula, and those that are cut.

        With the cells comes a formula that stands for the other one there, and for all cells the
        share where it may not, and how far apart the two may be.
        """
        cut, result = np.zeros(len(self.corners), dtype=bool), []
        shares, apart = np.zeros((2, len(cut)))
        for part in decided([formula], self.corners):
            chosen, open_ = part.formulas[0], part.cells[part.shares > 0.0]
            low, high = enclosed_on_simplices(chosen, self.corners[open_])
            for (other,) in part.others:
                least, most = enclosed_on_simplices(other, self.corners[open_])
                with np.errstate(invalid="ignore"):
                    far = np.maximum(most - low, high - least)
                apart[open_] = np.maximum(apart[open_], np.where(np.isnan(far), np.inf, far))
            # On slivers data may have another side's values, and the cell is not cut.
            thin = (part.shares <= SOLVED) & np.isfinite(apart[part.cells])
            cut[part.cells[~thin]] = True
            shares[part.cells] = part.shares * UPWARDS
            result.append((part.cells[thin], chosen))
        shares[cut] = apart[cut] = 0.0
        return [*result, (np.flatnonzero(cut), formula)], shares, apart
