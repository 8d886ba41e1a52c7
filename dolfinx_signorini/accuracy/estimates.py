"""Estimates of the error: the share that is left of the difference of two solutions.

One solution is computed on a mesh, the other one on the mesh with every cell divided. The measured
rates of convergence tell what is left of the difference in the error of the other one. What no
comparison shows is added: the obstacle between the nodes, and data inside of cells.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinx_signorini.accuracy.cells import collected, joined, shared_out, total
from dolfinx_signorini.accuracy.contact_ends import cells_at_contact_ends, rate_at_ends
from dolfinx_signorini.accuracy.indicators import (
    Indicators,
    Solution,
    difference,
    indicators,
    size,
)
from dolfinx_signorini.accuracy.marking import Prediction
from dolfinx_signorini.accuracy.moved_sides import MovedSides
from dolfinx_signorini.accuracy.obstacle_defects import obstacle_defects
from dolfinx_signorini.accuracy.rates import Rates
from dolfinx_signorini.accuracy.targets import Target, check_functional
from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.errors import together
from dolfinx_signorini.meshes.refinement import carried_across
from dolfinx_signorini.meshes.sided_meshes import owned_cells
from dolfinx_signorini.problem.signorini import SignoriniProblem

SAFETY = 1.3  # safety factor: the estimate over what the measured rates say
SURE = 1.1  # the same in H1, where errors of levels are orthogonal
SHARPNESS = 1.5  # of the mean of what cells leave, if a dual solution weighs the cells
SIGNS = 2.0  # the same in L^1, whose dual solution knows the sign of the difference alone
SPREAD = 1.7  # times what the data hide inside of cells: the cells around have part in the error
FALLEN = 0.3  # of the estimate before: steps that gain less do not correct the next estimate
CORRECTION = 5.0  # at most
FEW = 1.1  # times as many dofs: after so few divisions the estimate before is as good as the next

Hidden = Callable[[SignoriniProblem, Target], Array]


class Estimator:
    """The estimates on one mesh after the other, with elements of one degree.

    For example:

        estimator = Estimator(coarse.space, target("L4"), None)
        value = estimator.compared(coarse, fine, refinement.parents, None)
        error = estimator.settled(value, fine, refinement.parents, None)

    Args:
        space: The space of the first solution.
        target: What is to be accurate.
        hidden: Returns what the data add to the error inside of each owned cell; None for nothing.

    Raises:
        InputError: The functional is not linear, or 0 for all functions of the space.

    Attributes:
        rates: The rates of the cells of the present mesh.
        found: The indicators of these cells.
        prediction: What these cells leave in the error.
        polygon: The part of the last estimate that facets in place of curves have.
    """

    found: Indicators
    prediction: Prediction
    polygon: float
    # The last solution, the parents of the cells of its mesh, and its uncorrected estimate.
    _last: tuple[fem.Function, LocalIndices, float]

    def __init__(self, space: fem.FunctionSpace, target: Target, hidden: Hidden | None):
        check_functional(target, space)
        domain, degree = space.mesh, space.element.basix_element.degree
        self._target, self._hidden, self._comm = target, hidden, domain.comm
        self.rates = Rates(target, degree, len(owned_cells(domain)), domain.topology.dim)
        self._correction = 1.0

    def compared(
        self,
        coarse: Solution,
        fine: SignoriniProblem,
        parents: LocalIndices,
        owners: LocalIndices | None,
    ) -> float:
        """Return what two solutions tell of the error of the finer one; the call is collective.

        `settled` makes the estimate of a step from this value.

        Args:
            coarse: The solution on the mesh.
            fine: The solved problem on the mesh with every cell divided.
            parents: For each owned cell of the divided mesh the cell of the mesh around the cell.
            owners: For each cell of the mesh the cell of the mesh before; None for the first mesh.
        """
        self.found = found = indicators(coarse, fine, parents, self._target)
        if owners is not None:
            self.rates.measure(found.local)
        ends = cells_at_contact_ends(fine, parents, len(found.cells))
        self.rates.limit(ends, rate_at_ends(self._target))
        self.prediction = self.rates.prediction(found.cells)
        value = self._left_over(found)
        if math.isinf(self.rates.power):
            value = self._with_least(value, ends)
        value = self._with_obstacle(value, fine, parents)
        return self._with_data(value, fine, parents)

    def settled(
        self,
        value: float,
        fine: SignoriniProblem,
        parents: LocalIndices,
        owners: LocalIndices | None,
        moved: MovedSides | None = None,
    ) -> float:
        """Return the estimate of a step; the call is collective.

        The estimate before is tried out: if the solution has moved by more than the estimate has
        fallen, all estimates are too small by about this ratio.

        Args:
            value: What `compared` has returned.
            fine: The solved problem of the step.
            parents, owners: See `compared`.
            moved: The curved sides that have been moved since; `fine` was solved after that.
        """
        self.polygon = 0.0
        if moved:
            self.polygon, cells = moved.left(fine.u)
            value = self._with_polygon(value, cells, moved.factor)
        if owners is not None:
            value = self._corrected_by_motion(value, fine, owners[parents])
        self._last = fine.u, parents, value
        safety = (SURE if self._target.is_energy else SAFETY) * self._correction
        self.polygon *= safety
        return safety * value

    def _with_polygon(self, value: float, cells: Array, factor: float) -> float:
        """Add to an estimate, and to the prediction, what facets in place of curves leave."""
        prediction, power = self.prediction, self.rates.power
        whole = total(prediction.remaining, power, self._comm)
        remaining = prediction.remaining * (value / whole if whole > 0.0 else 1.0)
        both = remaining + cells
        shares = np.divide(cells, both, out=np.zeros_like(both), where=both > 0.0)
        self.prediction = replace(
            prediction,
            remaining=both,
            factors=(1.0 - shares) * prediction.factors + shares * factor,
            singular=prediction.singular & (shares < 0.5),
        )
        return value + self.polygon

    def _left_over(self, found: Indicators) -> float:
        """What the difference leaves in the error of the solution on the divided mesh.

        A dual solution looks where the difference is largest, and hardly sees what slow cells leave
        at other places: a mean with the exponent SHARPNESS of the shares of cells sees more of the
        slow ones. In a sup norm two solutions may be nearer to each other than to interpolants.
        """
        sharpness = self._sharpness()
        cells, power, shares = found.cells, self.rates.power, self._shares()
        left, whole = (
            total(values, power, self._comm) for values in (cells * shares**sharpness, cells)
        )
        # Solutions on two meshes are not farther apart than their indicators say, unless the data
        # jump between the points of a quadrature rule: what this moves hardly falls in one step.
        excess = max(found.difference - whole, 0.0) if self._target.weighted else 0.0
        apart = found.difference - excess
        # What cells add to a functional has signs, and may cancel in one difference alone.
        if math.isinf(power) or self._target.norm is None:
            apart = max(apart, whole)
        return excess + (apart * (left / whole) ** (1.0 / sharpness) if whole > 0.0 else apart)

    def _sharpness(self) -> float:
        norm = self._target.norm
        if norm is None or not self._target.weighted:
            return 1.0
        return SIGNS if norm.p == 1.0 else min(norm.p, SHARPNESS)

    def _shares(self) -> Array:
        """What cells leave, over their indicators; 0 for cells without an indicator."""
        cells = self.found.cells
        return np.asarray(self.prediction.remaining / np.where(cells > 0.0, cells, 1.0))

    def _with_least(self, value: float, ends: npt.NDArray[np.bool_]) -> float:
        """Raise an estimate, and the prediction, to what cells leave at least in a sup norm.

        Where the solution is smooth, its derivatives tell. At a singular point two solutions may be
        farther apart than what the finer one has beyond its interpolant.
        """
        prediction, found = self.prediction, self.found
        least = np.where(prediction.singular, 0.0, found.left)
        least = np.where(prediction.confirmed & ~ends, found.moved * self._shares(), least)
        self.prediction = replace(prediction, remaining=np.maximum(prediction.remaining, least))
        return max(value, total(least, self.rates.power, self._comm))

    def _corrected_by_motion(
        self, value: float, fine: SignoriniProblem, cells: LocalIndices
    ) -> float:
        """Correct later estimates if the solution has moved too far, and this one if too little.

        Where a dual solution weighs the cells, a few divisions may put an end to what single cells
        have by chance. The error falls by no more than the solution moves, in squares.
        """
        u, parents, before = self._last
        old = carried_across(u, parents, fine.space, cells)
        moved = size(difference(fine.u, old), self._target)
        fallen = math.sqrt(abs(before**2 - value**2))
        if before - value > FALLEN * before:
            self._correction = min(max(moved / fallen, 1.0), CORRECTION)
        few = fine.unknowns < FEW * u.function_space.dofmap.index_map.size_global
        least = math.sqrt(max(before**2 - moved**2, 0.0))
        return max(value, least) if few and self._target.weighted else value

    def _with_obstacle(self, value: float, fine: SignoriniProblem, parents: LocalIndices) -> float:
        """Add to an estimate and the prediction what obstacle and pressure show between nodes."""
        norm = self._target.norm
        if norm is None or norm.boundary:
            return value
        defects = obstacle_defects(fine, norm)
        parts = collected(defects, parents, len(self.prediction.remaining), norm.p)
        parts = joined(parts, self.found.gaps, norm.p)
        whole = total(parts, norm.p, self._comm)
        if whole == 0.0:
            return value
        if self._target.weighted:  # parts of cells add up as they are
            remaining = self.prediction.remaining + shared_out(parts, norm.p, whole)
        else:
            remaining = joined(self.prediction.remaining, parts, norm.p)
        self.prediction = replace(self.prediction, remaining=remaining)
        return float(joined(np.array(value), np.array(whole), norm.p))

    def _with_data(self, value: float, fine: SignoriniProblem, parents: LocalIndices) -> float:
        """Add to an estimate, and to the prediction, what the data hide inside of cells."""
        if self._hidden is None:
            return value
        power, remaining = self.rates.power, self.prediction.remaining
        with together(self._comm, "hidden"):
            parts = SPREAD * self._hidden(fine, self._target)
        parts = collected(parts, parents, len(remaining), power)
        if total(parts, power, self._comm) == 0.0:
            return value
        whole = total(remaining, power, self._comm)
        remaining = np.maximum(remaining * (value / whole if whole > 0.0 else 1.0), parts)
        self.prediction = replace(self.prediction, remaining=remaining)
        return max(value, total(remaining, power, self._comm))
