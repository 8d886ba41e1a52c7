"""The data of a problem as a bound needs them: polynomials, and bounds of what these miss.

Formulas are known at every point. A formula that is no polynomial is replaced by polynomials on
cells or facets, and the differences are enclosed, see `approximated`. A formula without a bounded
enclosure stays, as data do that are no formulas, and is known at points only.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr
from ufl.corealg.traversal import traverse_unique_terminals

from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices, union
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.base.ranks import anywhere, highest
from dolfinx_signorini.base.sums_of_squares import summands
from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.bounds.cell_values import BEST
from dolfinx_signorini.bounds.enclosed_diffusion import cell_function, with_enclosed_diffusion
from dolfinx_signorini.bounds.feasible import known
from dolfinx_signorini.bounds.frames import cell_frames, on_frames
from dolfinx_signorini.bounds.remainders import IN_CELLS, MORE, Remainders, Solved
from dolfinx_signorini.bounds.strong_form import EnergyTerms, FacetPolynomials, polynomial_degree
from dolfinx_signorini.data.approximations import ORDERS, approximated, followed_in_parts
from dolfinx_signorini.data.branches import decided
from dolfinx_signorini.data.derivatives import simplified
from dolfinx_signorini.data.enclosures import enclosed_on_simplices, nowhere_negative
from dolfinx_signorini.data.formulas import Formula, evaluated
from dolfinx_signorini.data.interpolations import missed_by_interpolation
from dolfinx_signorini.data.reading import formula_of, has_derivatives, lowered, read
from dolfinx_signorini.data.readings import is_linear_in_normals
from dolfinx_signorini.meshes.polynomials import others
from dolfinx_signorini.meshes.sided_meshes import cell_corners, longest_side
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.problem.values import Data

NEGATIVE = "whether the reaction is negative somewhere is known at points only"
FACET = 2.1  # the constant of a trace over that of Payne and Weinberger, at most

Given = tuple[Data | FacetPolynomials | None, LocalIndices]  # data with their facets


class EnclosedData:
    """The data of a solved problem, with the formulas among them enclosed:

        data = EnclosedData(problem, terms)
        solved = data.enclosed(tolerance=1e-3)

    Args:
        problem: The solved problem; the call is collective.
        terms: Its strong form.

    Attributes:
        size: The energy that the load has on single cells, a first guess of a tolerance.
        hidden: The energy that was hidden between the points of rules at last.
    """

    def __init__(self, problem: BoundConstrainedProblem, terms: EnergyTerms):
        self.problem, self.given, self.domain = problem, terms, problem.space.mesh
        self.comm, self.degree = problem.comm, problem.space.element.basix_element.degree
        self.frames = cell_frames(self.domain)
        self.d = self.frames.dimension
        self.corners = cell_corners(self.domain)
        self.width = longest_side(self.domain)
        self.load, self.reaction = formula_of(terms.load), formula_of(terms.reaction)
        self.diffusion = [formula_of(entry) for entry in terms.entries(self.d)]
        self.size, self.hidden = self._load_on_cells(), 0.0
        self.same = self._at_any_tolerance()

    def _at_any_tolerance(self) -> tuple[EnergyTerms, Remainders]:
        """The strong form and remainders of the diffusion, obstacles and Dirichlet data."""
        terms, rest = with_enclosed_diffusion(
            self.given, self.diffusion, self.domain, self.corners, self.degree
        )
        obstacles = [(each.data, self.problem.contact) for each in self.problem.obstacles]
        on_boundary = [] if self.problem.in_domain else obstacles
        return terms, replace(
            rest,
            obstacle=self._interpolated(on_boundary),
            dirichlet=self._interpolated(self.given.dirichlet),
            obstacle_in_space=self._obstacle_in_space(on_boundary),
            obstacles_in_cells=self._obstacles_in_cells(),
        )

    def enclosed(self, tolerance: float) -> Solved:
        """Return the problem with polynomials in place of formulas; the call is collective.

        Args:
            tolerance: The energy that may be hidden between the points of rules.
        """
        self.hidden, self.tolerance = 0.0, tolerance
        self.terms, self.rest = self.same
        self._enclose_reaction()
        degree = polynomial_degree(self.given.load)
        if self.load is not None and (degree is None or 2 * degree > BEST[self.d]):
            self._fit("load", self.load, self._weights())
        self._enclose_fluxes()
        return Solved(self.problem, self.terms, self.frames, self.rest)

    def _load_on_cells(self) -> float:
        """The energy of the load at the middles of cells, or of what the solution tells of it."""
        middle = np.full((1, self.d), 1.0 / (self.d + 1))
        slopes = self.frames.points(middle).gradients(self.problem.u)[0]
        values = np.linalg.norm(slopes, axis=0)[:, 0] / self.width
        if self.load is not None:
            sizes = np.abs(evaluated(self.load.root, self.corners.mean(axis=1)))
            values = np.maximum(values, np.where(np.isfinite(sizes), sizes, 0.0))
        values *= self.frames.diameters / 6.0
        square = self.comm.allreduce(float(values**2 @ self.frames.volumes))
        cells = self.comm.allreduce(len(values))
        return math.sqrt(square) * cells ** (-(self.degree - 1) / self.d) or 1.0

    def _enclose_reaction(self) -> None:
        formula = self.reaction
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
        weights = self._weights() * highest(self.comm, np.abs(self.problem.u.x.array))
        if polynomial or self._fit("reaction", formula, weights):
            least = np.maximum(low, 0.0)
            self.rest = replace(self.rest, least_reaction=least, largest_reaction=high)

    def _enclose_fluxes(self) -> None:
        """Take polynomials on facets for the fluxes that are none, if all of these are formulas."""
        fluxes = self.given.neumann
        given = [(q, sides) for q, sides in fluxes if polynomial_degree(q) is None]
        read_ = [(self._components(q), sides) for q, sides in given]
        if not given or not all(formulas for formulas, _ in read_):
            return
        frames, shape, degree = self.frames, self.frames.facets.shape, self.degree + 2
        coefficients = np.zeros((*shape, math.comb(degree + self.d - 1, degree)))
        missed, means = np.zeros(shape), np.zeros(shape)
        lever = frames.facet_sizes / frames.volumes[:, None]
        inner, outer = self._weights()[:, :, None] * np.sqrt(lever)
        for formulas, sides in read_:
            cells, facets, corners = self._facets(sides)
            normals = -frames.gradients[cells, facets]
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            for formula, k in formulas:
                factors = np.ones(len(cells)) if k is None else normals[:, k]
                on = np.flatnonzero(np.abs(factors) > ROUNDING)
                at, factor = (cells[on], facets[on]), factors[on]
                share = np.abs(factor)
                weights = np.stack((FACET * inner[at], outer[at])) * share
                where = self.comm, corners[on], degree, weights, self.tolerance
                found = approximated(formula, *where)
                self.hidden = max(self.hidden, found.hidden)
                if anywhere(self.comm, ~np.isfinite(found.missed)):
                    return
                coefficients[at] += factor[:, None] * found.coefficients
                missed[at] += share * found.missed
                means[at] += share * found.mean
        sides = union(facets for _, facets in given)
        polynomials = [(q, facets) for q, facets in fluxes if polynomial_degree(q) is not None]
        flux = FacetPolynomials(degree, coefficients)
        self.terms = replace(self.terms, neumann=[*polynomials, (flux, sides)])
        missed *= np.sqrt(frames.facet_sizes)
        self.rest = replace(self.rest, flux=missed, flux_mean=means)

    def _components(self, flux: Any) -> list[tuple[Formula, int | None]]:
        """The formulas q and w_k of a flux q + w . n with k, None for q; nothing if not read."""
        if not isinstance(flux, Expr):
            return []
        normal, rest = ufl.FacetNormal(self.domain), []
        found: list[tuple[Formula | None, int | None]] = []
        for term in summands(lowered(flux)):
            if not any(part == normal for part in traverse_unique_terminals(term)):
                rest.append(term)
            elif is_linear_in_normals(term, self.domain):
                found += [(read(term, {normal: unit}), k) for k, unit in enumerate(np.eye(self.d))]
            else:
                return []
        if rest:
            found.append((formula_of(sum(rest)), None))
        terms = [(formula, k) for formula, k in found if formula is not None]
        if has_derivatives(flux):
            terms = [(simplified(formula), k) for formula, k in terms]
        return terms if len(terms) == len(found) else []

    def _formulas(
        self, given: Sequence[Given], degree: int
    ) -> list[tuple[Formula, Indices, Indices, Array]]:
        """The data on the boundary that are no polynomials of a degree, if all are formulas.

        With each formula come its facets, as facets of frames, and their vertices.
        """
        open_ = [(d, sides) for d, sides in given if d is not None and not known(d, degree)]
        found = [(formula_of(data), sides) for data, sides in open_]
        read_ = [(formula, *self._facets(on)) for formula, on in found if formula is not None]
        return read_ if len(read_) == len(open_) else []

    def _interpolated(self, given: Sequence[Given]) -> Array | None:
        """What interpolations miss of values on the boundary; None for nothing, or if not known."""
        more = IN_CELLS if self.problem.in_domain else MORE
        degree, result = self.degree + more[2], np.zeros((3, *self.frames.facets.shape))
        found = self._formulas(given, degree) if self.d == 2 else []
        for value, cells, facets, corners in found:
            result[:, cells, facets] = missed_by_interpolation(value, corners, degree)
        return result if found and not anywhere(self.comm, np.isinf(result)) else None

    def _obstacle_in_space(self, given: Sequence[Given]) -> tuple[FacetPolynomials, Array] | None:
        """Polynomials for the obstacle on facets in space, and what these polynomials miss."""
        degree, shape = min(self.degree + MORE[3], ORDERS[2] // 2), self.frames.facets.shape
        found = self._formulas(given, self.degree) if self.d == 3 else []
        coefficients, missed = np.zeros((*shape, math.comb(degree + 2, 2))), np.zeros(shape)
        for value, cells, facets, corners in found:
            both = followed_in_parts(value, corners, degree)
            coefficients[cells, facets], missed[cells, facets] = both
        if not found or anywhere(self.comm, np.isinf(missed)):
            return None
        return FacetPolynomials(degree, coefficients), missed

    def _obstacles_in_cells(self) -> tuple[tuple[fem.Function, Array] | None, ...]:
        """Polynomials for the obstacles in the domain, and what these polynomials miss."""
        obstacles = self.problem.obstacles if self.problem.in_domain else ()
        found = [self._in_cells(each.data) for each in obstacles]
        return tuple(found) if any(found) else ()

    def _in_cells(self, data: Data) -> tuple[fem.Function, Array] | None:
        """Polynomials for an obstacle; None where the obstacle is one, or is not known."""
        formula = formula_of(data)
        if formula is None or known(data, self.degree + IN_CELLS[self.d]):
            return None
        degree, missed = ORDERS[self.d] // 2, np.zeros(len(self.corners))
        coefficients = np.zeros((len(missed), math.comb(degree + self.d, degree)))
        contact = np.isin(self.frames.cells, self.problem.contact)
        x = ufl.SpatialCoordinate(self.domain)
        for part in decided([formula], self.corners):
            clear = part.shares == 0.0
            for chosen, own in ((part.formulas[0], clear), (formula, ~clear)):
                cells = part.cells[own & contact[part.cells]]
                both = followed_in_parts(chosen, self.corners[cells], degree, 8 // self.d)
                coefficients[cells], missed[cells] = both
                if known(chosen.ufl(x), degree):
                    missed[cells] = 0.0
        if anywhere(self.comm, np.isinf(missed)):
            return None
        return cell_function(self.domain, coefficients, degree), missed

    def _facets(self, sides: LocalIndices) -> tuple[Indices, Indices, Array]:
        """Facets of the mesh as facets of frames, with their vertices."""
        cells, facets = np.nonzero(on_frames(self.frames, [sides]))
        return cells, facets, self.frames.corners[cells[:, None], others(self.d)[facets]]

    def _weights(self) -> Array:
        """The energies of unit values, and of unit means, on cells of size 1."""
        rest = self.rest
        a = 1.0 if rest.least_diffusion is None else rest.least_diffusion
        c = np.zeros(1) if rest.least_reaction is None else rest.least_reaction
        wide = np.broadcast_to(self.width, self.frames.volumes.shape)
        with np.errstate(divide="ignore"):
            by_reaction = 1.0 / np.sqrt(c)
            by_gradient = np.stack((self.frames.diameters / math.pi, wide)) / np.sqrt(a)
        return np.asarray(np.minimum(by_gradient, by_reaction))

    def _fit(self, name: str, formula: Formula, weights: Array) -> bool:
        """Take polynomials on cells for the load or the reaction, if what is missed is bounded."""
        degree = min(self.degree + 2, ORDERS[self.d] // 2)
        where = self.comm, self.corners, degree, weights, self.tolerance
        found = approximated(formula, *where)
        self.hidden = max(self.hidden, found.hidden)
        if anywhere(self.comm, ~np.isfinite(found.missed)):
            return False
        missed = found.missed * np.sqrt(self.frames.volumes)
        data = cell_function(self.domain, found.coefficients, degree)
        self.terms = replace(self.terms, **{name: data})
        more: dict[str, Any] = {name: missed, f"{name}_mean": found.mean}
        self.rest = replace(self.rest, **more)
        return True
