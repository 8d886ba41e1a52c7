"""Estimates of the error: the share that is left of the difference of two solutions.

One solution is computed on a mesh, the other one on the mesh with every cell divided. The measured
rates of convergence tell what is left of the difference in the error of the other one. What no
comparison shows is added: the obstacle between the nodes, and data inside of cells.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.accuracy.cells import over
from dolfinx_signorini.accuracy.contact_ends import (
    cells_at_contact_ends,
    cells_at_kinks,
    places_of_ends,
    rate_at_ends,
)
from dolfinx_signorini.accuracy.corners import exponents_at_corners
from dolfinx_signorini.accuracy.cut_cells import cut_errors
from dolfinx_signorini.accuracy.indicators import Indicators, indicators
from dolfinx_signorini.accuracy.kinks import kink_errors
from dolfinx_signorini.accuracy.marking import NOTABLE, SAFETY, Prediction
from dolfinx_signorini.accuracy.moved_sides import MovedSides
from dolfinx_signorini.accuracy.predicted_error import predicted_error
from dolfinx_signorini.accuracy.rates import Rates
from dolfinx_signorini.accuracy.targets import Target, size
from dolfinx_signorini.accuracy.terms import Solved
from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.ranks import anywhere, highest
from dolfinx_signorini.base.tolerances import PRECISION
from dolfinx_signorini.data.coefficients import Coefficients
from dolfinx_signorini.data.powers import SingularPoint
from dolfinx_signorini.meshes.sided_meshes import cell_corners, owned_cells
from dolfinx_signorini.norms.orders import KINK_EXPONENT, SMOOTH, is_finite
from dolfinx_signorini.norms.power_sums import joined, total
from dolfinx_signorini.norms.sectors import LOGARITHM
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem

# Returns what is known of the coefficients of a problem.
Reader: TypeAlias = Callable[[BoundConstrainedProblem], Coefficients]


class Estimator:
    """The estimates on one mesh after the other, with elements of one degree.

    For example:

        estimator = Estimator(coarse.space, target("L4"))
        estimator.compare(Solved(coarse, fine, refinement.parents, target("L4")))
        print(estimator.estimate)

    Args:
        space: The space of the first solution.
        target: What is to be accurate, see `checked_target`.
        read: Returns what is known of the coefficients of a problem; None where nothing is read.
        singular: Where data make the solution like a power of the distance.

    Attributes:
        rates: The rates of the cells of the present mesh.
        found: The indicators of these cells.
        prediction: What these cells leave in the error.
        local: In L^p norms what they leave there by themselves; None elsewhere.
        estimate: The estimated error of the finer solution.
        along_curves: The part of the estimate that no degree makes smaller: facets in place of
            curved sides, and jumps and kinks of data inside of cells.
        exponent: The least power of the distance that the solution may have at a corner.
        logarithm: The least power that the solution may have there with a logarithm.
    """

    found: Indicators
    prediction: Prediction
    local: Prediction | None
    estimate: float
    along_curves: float

    def __init__(
        self,
        space: fem.FunctionSpace,
        target: Target,
        read: Reader | None = None,
        singular: Sequence[SingularPoint] = (),
    ):
        domain, degree = space.mesh, space.element.basix_element.degree
        self._target, self._read, self._comm = target, read, domain.comm
        self._singular = singular
        self.rates = Rates(target, degree, len(owned_cells(domain)), domain.topology.dim)
        self.exponent = self.logarithm = SMOOTH

    @property
    def predictions(self) -> list[Prediction]:
        """What is to become smaller: the terms of the error, and what cells leave by themselves."""
        return [self.prediction] if self.local is None else [self.prediction, self.local]

    def compare(self, solved: Solved) -> None:
        """Estimate what two solutions tell of the error of the finer one; the call is collective.

        Args:
            solved: The two solutions, on the first mesh or on that of which `rates.refine` was
                told.
        """
        self.found = found = indicators(solved)
        if self._read is not None:
            self._look_at_corners(solved)
        if self._singular:
            self._look_at_data(solved)
        self.rates.measure(found.local)
        self.rates.assume(found.lost)
        domain = solved.coarse.u.function_space.mesh
        for zone in solved.fine.zones:
            here = cells_at_contact_ends(zone, solved.parents, solved.count)
            self.rates.know(here, rate_at_ends(self._target, zone.in_domain))
            self.rates.places[here] = places_of_ends(zone, domain, here)
        kinks = cells_at_kinks(solved.fine, solved.parents, solved.count)
        rate = float(self._target.singular_order(KINK_EXPONENT, KINK_EXPONENT, 1))
        self.rates.know(kinks, rate, rate)
        self.prediction, self.along_curves = self.rates.prediction(found.cells), 0.0
        value = self._left_over(solved)
        self.local = None
        if self._target.has_own:
            value = self._with_own(solved, value)
        value += found.algebra + PRECISION * size(solved.fine.u, self._target)
        whole = total(self.prediction.remaining, self.rates.power, self._comm)
        scale = SAFETY * (value / whole if whole > 0.0 else 1.0)
        self.prediction = replace(self.prediction, remaining=self.prediction.remaining * scale)
        self.estimate = SAFETY * value
        self._add(SAFETY * found.unseen)
        if self._read is not None:
            data = self._read(solved.fine)
            parts = SAFETY * solved.reach * data_errors(solved, data)
            self._add_along_curves(parts, 2.0 ** -self._target.order(1))

    def _look_at_corners(self, solved: Solved) -> None:
        """Find the rates of divisions towards corners; the dual solution has the same exponents."""
        least, places = exponents_at_corners(solved.fine)
        exponents = np.full(solved.count, SMOOTH)
        np.minimum.at(exponents, solved.parents, least)
        corners = self._target.singular_order(exponents, exponents)
        self.rates.at_corners = corners < self.rates.order
        here = self.rates.at_corners[solved.parents] & (least == exponents[solved.parents])
        self.rates.places[solved.parents[here]] = places[here]
        # With exponents of bodies a loop ended above its aim at the edge of a punch, where the
        # pressure is infinite, too (tests/accuracy/test_elastic_scene_requests.py).
        if solved.fine.space.dofmap.bs == 1:
            self.rates.corners = corners
        finite = exponents[np.isfinite(exponents)]
        logarithms = np.abs(finite - np.rint(finite)) < 2.0 * LOGARITHM
        self.exponent, self.logarithm = (
            self._comm.allreduce(float(part.min(initial=SMOOTH)), op=MPI.MIN)
            for part in (finite[~logarithms], finite[logarithms])
        )

    def _look_at_data(self, solved: Solved) -> None:
        """Find the singular points of data, and the rates there; dual solutions are smooth."""
        corners = cell_corners(solved.coarse.u.function_space.mesh)
        exponents = np.full(solved.count, SMOOTH)
        for point in self._singular:
            here = point.is_vertex_of(corners)
            exponents[here] = np.minimum(exponents[here], point.exponent)
            self.rates.places[here] = (*point.place, 0.0)
        if not self._target.weighted:
            known = self._target.singular_order(exponents, exponents)
            self.rates.corners = np.minimum(self.rates.corners, known)

    @property
    def doubt(self) -> str:
        """Why the norm of solutions is infinite in general, in words; "" where it is finite."""
        return self._told_infinite(self.exponent)

    def infinite_at(self, corners: Mask) -> str:
        """Return why the norm of the solution is infinite, in words; "" for no reason; collective.

        A logarithm is a reason if corners have the error and keep it. Data are those of a
        polynomial, without a logarithm, more often than by chance; and while other cells have
        errors as large, a corner may stand because a layer is not yet resolved.

        Args:
            corners: Whether each owned cell is at a corner that makes a doubt a reason.
        """
        if self.doubt and anywhere(self._comm, corners):
            return self.doubt
        left = self.prediction.remaining
        worst = left >= NOTABLE * highest(self._comm, left)
        others = anywhere(self._comm, worst & ~self.rates.standing_corners)
        return "" if others else self._told_infinite(self.logarithm)

    def _told_infinite(self, exponent: float) -> str:
        target = self._target
        if target.norm is None or is_finite(target.norm, exponent):
            return ""
        power = f"r^{exponent:.3g}{' log r' if exponent == self.logarithm else ''}"
        return (
            f"{target.name} of the solution is infinite if u ~ {power} at a corner, "
            "as the angles and the conditions have it"
        )

    def add_polygon(self, moved: MovedSides, solved: Solved) -> None:
        """Add what facets in place of curves leave in the error; the call is collective.

        Args:
            moved: The curved sides that have been moved.
            solved: The solutions, of which the finer one was solved after that.
        """
        self._add_along_curves(SAFETY * moved.parts(solved), moved.factor)

    def _add(self, parts: Array) -> None:
        """Add what terms have on each cell to the estimate, and to the prediction."""
        left, power = self.prediction.remaining, self.rates.power
        self.prediction = replace(self.prediction, remaining=joined(left, parts, power))
        self.estimate = self._both(self.estimate, total(parts, power, self._comm))

    def _both(self, one: float, other: float) -> float:
        """Return the size of two parts of the error; in norms of the boundary they are apart."""
        return float(joined(np.array(one), np.array(other), self._target.exponent))

    def _add_along_curves(self, parts: Array, factor: float) -> None:
        """Add what no degree makes smaller.

        Args:
            parts: What curves leave in the error on each cell.
            factor: By how much a division of cells multiplies that.
        """
        self._add(parts)
        shares = over(parts, self.prediction.remaining)
        self.prediction = replace(
            self.prediction,
            factors=(1.0 - shares) * self.prediction.factors + shares * factor,
            singular=self.prediction.singular & (shares < NOTABLE),
        )
        whole = total(parts, self.rates.power, self._comm)
        self.along_curves = self._both(self.along_curves, whole)

    def _left_over(self, solved: Solved) -> float:
        """What the difference leaves in the error of the solution on the divided mesh.

        Where a dual solution weighs the cells of a norm, the error is predicted as a function: the
        dual solution looks where the difference is largest, and hardly sees what slow cells leave
        at other places. In a sup norm w may be farther from u_h than from its interpolant: the
        larger distance counts. In a functional cells cancel each other, but for the share by which
        rates may be off.
        """
        if self._target.weighted and self._target.norm is not None:
            return size(predicted_error(solved, self.rates.shares), self._target)
        found, power = self.found, self.rates.power
        parts = self.prediction.remaining, found.cells
        left, whole = (total(values, power, self._comm) for values in parts)
        value = left * max(found.difference / whole, 1.0) if whole > 0.0 else found.difference
        if self._target.norm is not None:
            return value
        signed = abs(self._comm.allreduce(float((found.signed * self.rates.shares).sum())))
        return (min(signed, value) + (SAFETY - 1.0) * value) / SAFETY

    def _with_own(self, solved: Solved, value: float) -> float:
        """Raise an estimate to what the worst cell leaves by itself, and note what all cells leave.

        One cell may be the worst by far: the derivatives tell what such a cell leaves, and need no
        rate. In a sup norm the largest of these errors are those of the norm. At a singular point
        two solutions may be farther apart than the finer one and its interpolant, where errors of
        other cells have moved the point: dividing cells there does not help.

        Args:
            solved: The two solutions; the call is collective.
            value: The estimate.
        """
        norm, left = self._target.norm, self.found.left
        assert norm is not None
        if self._target.weighted:
            norms = solved.norms(solved.detail)
            self.local = self.rates.local_prediction(norms, left, norm.p, self.found.lost)
            own = self.local.remaining
        else:
            own = np.where(self.prediction.singular, 0.0, left)
            remaining = np.maximum(self.prediction.remaining, own)
            self.prediction = replace(self.prediction, remaining=remaining)
            confirmed = self.prediction.confirmed & ~self.rates.known
            if anywhere(self._comm, confirmed):
                apart = solved.felt(solved.error) * self.rates.shares
                own = np.where(confirmed, np.maximum(own, apart), own)
        return max(value, highest(self._comm, own))


def data_errors(solved: Solved, data: Coefficients) -> Array:
    """Return what jumps and kinks of data inside of cells leave in the error of each owned cell.

    Args:
        solved: The two solutions.
        data: What is known of the coefficients of the finer problem.
    """
    parts = cut_errors(solved, data), kink_errors(solved, data)
    return np.asarray(joined(*parts, solved.target.power))
