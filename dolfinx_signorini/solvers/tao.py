"""Bound-constrained TAO solvers for the discrete Signorini problem.

TAO sees the correction d = (x - x0) / s to a start x0, with A divided by a power of two of the size
of its diagonal, in the unit s in which the natural residual of x0 has size one:

    minimise 1/2 d.A'd - r'.d  over  d >= (g - x0) / s,    A' = A / |A|,  r' = (b - A x0) / (s |A|),

or d <= (g - x0) / s for upper obstacles.

So neither the size of the load nor that of the operator matters (scaling by powers of two is
exact), and neither do the absolute safeguards inside TAO, nor cancellation: a round ends after a
few digits, the next round starts from the point reached, in a unit of its own, and the residual
goes down to rounding. In one round, BQNLS and BNCG stall at 1e-9 for tens of thousands of
iterations.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from petsc4py import PETSc

from dolfinx_signorini.base.errors import INDEFINITE, InputError, NotConvergedError
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.base.tolerances import ROUNDING, SOLVED, power_of_two
from dolfinx_signorini.solvers.linear.algebraic import AMG
from dolfinx_signorini.solvers.linear.options import options_set, warn_of_unread
from dolfinx_signorini.solvers.residual import NaturalResidual
from dolfinx_signorini.solvers.system import System
from dolfinx_signorini.solvers.unbounded import UNBOUNDED, falls_for_ever, moves_without_energy

FIRST_ORDER = ("bncg", "bqnls", "blmvm")
SECOND_ORDER = ("bntr", "bnls", "tron")
METHODS = FIRST_ORDER + SECOND_ORDER

DEFAULT_RTOL = 1e-8  # first-order methods leave smooth errors, which the residual hardly shows
# Of the residual asked for: where TAO stops, whose own norm is another one than the natural
# residual. The natural residual is then the one asked for, too, and no further solve follows.
MARGIN = 0.5
NOT_FINITE = 83  # PETSc's error where an energy or a gradient is not a finite number

REASONS = {
    PETSc.TAO.Reason.CONVERGED_GATOL: "the projected gradient is small enough",
    PETSc.TAO.Reason.CONVERGED_GRTOL: "the projected gradient is small against the energy",
    PETSc.TAO.Reason.CONVERGED_GTTOL: "the projected gradient is small against its start",
    PETSc.TAO.Reason.CONVERGED_STEPTOL: "the step is too small to go on",
    PETSc.TAO.Reason.CONVERGED_MINF: "the energy fell below the bound set by an option",
    PETSc.TAO.Reason.CONVERGED_USER: "a user's test was satisfied",
    PETSc.TAO.Reason.DIVERGED_MAXITS: "the iteration limit was reached",
    PETSc.TAO.Reason.DIVERGED_MAXFCN: "the evaluation limit was reached",
    PETSc.TAO.Reason.DIVERGED_NAN: "the energy is not a number",
    PETSc.TAO.Reason.DIVERGED_LS_FAILURE: "the line search found no lower energy",
    PETSc.TAO.Reason.DIVERGED_TR_REDUCTION: "the trust region shrank to nothing",
    PETSc.TAO.Reason.DIVERGED_USER: "a user's test asked to stop",
}

# How the names of options for one method begin.
OPTION_FAMILIES = {name: f"tao_{name}_" for name in METHODS}
OPTION_FAMILIES |= dict.fromkeys(("bntr", "bnls"), "tao_bnk_")


class TaoRounds:
    """Rounds of a TAO solver on one system, with the limits and the counts that they share.

    A run improves a feasible vector in place:

        rounds = TaoRounds(system, "bqnls")
        residual = rounds.run(x, NaturalResidual(system), rtol=1e-8)
        rounds.destroy()

    Args:
        system: The system.
        method: The type of the TAO solver: first-order "bncg" (nonlinear conjugate gradients),
            "bqnls" or "blmvm" (quasi-Newton), or second-order "bntr", "bnls" or "tron" (Newton,
            with CG and algebraic multigrid for the inactive dofs).
        prefix: The prefix of PETSc options.
        options: PETSc options without prefix, for example {"tao_bncg_type": "prp"}.
        max_iterations: The limit on the iterations of all rounds.
        max_evaluations: The limit on the evaluations of energy and gradient of all rounds; none by
            default: each line search has PETSc's own limit.
        stop: The norm of the Fischer function of gap and gradient at which TAO stops, relative to
            the residual asked for.

    Attributes:
        iterations, evaluations, linear_iterations: The counts of all rounds so far.
        reason: Why the last round stopped, in words.
    """

    def __init__(
        self,
        system: System,
        method: str,
        *,
        prefix: str = "",
        options: Mapping[str, Any] | None = None,
        max_iterations: int = 50_000,
        max_evaluations: int = np.iinfo(PETSc.IntType).max,
        stop: float = MARGIN,
    ):
        self.system, self.method = system, method
        self.prefix, self.options, self.stop = prefix, options or {}, stop
        self.max_iterations, self.max_evaluations = max_iterations, max_evaluations
        self.hessian: PETSc.Mat | None = None
        self._tao: PETSc.TAO | None = None
        self._vectors: dict[str, PETSc.Vec] = {}
        self._assembled = 0
        self.renew(system)
        if method in SECOND_ORDER:
            self.hessian = system.A.copy()
            self.hessian.scale(1.0 / self.size)

    def renew(self, system: System) -> None:
        """Turn to another system with the same matrix, or of a first-order method; count anew."""
        self.system = system
        self.iterations = self.evaluations = self.linear_iterations = 0
        self.reason = ""
        self._flaw = ""  # of the form, found by a solver
        if system.assembled != self._assembled:
            diagonal = system.A.getDiagonal()
            self.size = power_of_two(diagonal.norm(PETSc.NormType.INFINITY))
            self._diagonal = diagonal.array_r / self.size  # of the matrix that TAO sees
            diagonal.destroy()
        self._assembled = system.assembled

    def run(
        self, x: PETSc.Vec, measure: NaturalResidual, rtol: float, residual: float | None = None
    ) -> float:
        """Run rounds from a feasible vector, and return the relative natural residual reached.

        No gap is left where there is pressure.

        Args:
            x: The start, overwritten by the solution.
            measure: Measures the natural residual.
            rtol: The relative natural residual to reach.
            residual: The residual of x, if x is the vector that was measured last.

        Raises:
            InputError: The form is found to be indefinite, or the energy to be unbounded.
        """
        residual = measure(x) if residual is None else residual
        while True:
            previous = measure.norm
            # The error of the energy is reduced by the square of a round's factor: what is less
            # than `SOLVED` of the difference of two energies is rounding.
            if self._round(x, measure, max(rtol, SOLVED**0.5 * residual)):
                residual = measure(x)
            if residual <= rtol:
                residual = measure.close_gaps(x)
            if residual <= rtol or not measure.norm < 0.5 * previous or self.exhausted:
                return residual

    @property
    def exhausted(self) -> bool:
        """Whether a limit on iterations or evaluations has been reached."""
        return self.iterations >= self.max_iterations or self.evaluations >= self.max_evaluations

    def failure(self, name: str, residual: float, rtol: float) -> NotConvergedError:
        """Return the exception that says that a residual was not reached, a collective call.

        Args:
            name: The name of the solver.
            residual: The relative natural residual that was reached.
            rtol: The one that was asked for.
        """
        limits = "" if name == "cascade" else "raise max_iterations, "
        advice = (
            f"{limits}loosen rtol, or start from a coarser solution"
            if self.exhausted
            else "a further round hardly lowers it: loosen rtol, or look for thin cells and "
            "for coefficients far apart, whose rounding allows no less"
        )
        if moves_without_energy(self.system):
            advice = f"the form a {UNBOUNDED}"
        return NotConvergedError(
            f"{name} stopped at a relative natural residual of {residual:.3g}, not "
            f"{rtol:.3g}: {self.reason}",
            residual,
            self.reason,
            advice,
        )

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self._forget()
        destroy(self.hessian)

    def _forget(self) -> None:
        destroy(self._tao, *self._vectors.values())
        self._tao, self._vectors = None, {}

    def _round(self, x: PETSc.Vec, measure: NaturalResidual, target: float) -> bool:
        """Run TAO on the correction to x, and add the correction.

        An object of TAO that took no step is as new, and serves the next round.

        Args:
            x: The feasible start, overwritten.
            measure: Holds the multiplier A x - b and the residual of this x.
            target: The relative natural residual to stop at.

        Returns:
            Whether TAO took a step.
        """
        unit = power_of_two(measure.norm / self.size)
        try:
            tao = self._made(x) if self._tao is None else self._tao
            self._pose(x, measure.multiplier, unit)
            gatol = self.stop * target * measure.scale / (unit * self.size)
            tao.setTolerances(gatol=gatol, grtol=0.0, gttol=0.0)
            tao.setMaximumIterations(self.max_iterations - self.iterations)
            tao.setMaximumFunctionEvaluations(self.max_evaluations - self.evaluations)
            with options_set(self.prefix, self.options) as unread:
                tao.setFromOptions()
            if not self.iterations:
                warn_of_unread(unread, self.options, self._others())
            tao.solve()
            self.iterations += tao.getIterationNumber()
            self.reason = REASONS.get(tao.getConvergedReason(), "the reason has no name")
            step = self._vectors["step"]
            moved = step.dot(step) > 0.0
            if moved:
                x.axpy(unit, step)
                self.system.project(x)
                self._forget()
        except PETSc.Error as error:
            moved = False
            self._forget()
            if error.ierr == NOT_FINITE and not self._flaw:
                self._flaw = f"{UNBOUNDED}, or energies leave the range of numbers"
            if not self._flaw:
                raise
        if self._flaw:
            raise InputError(self._flaw, "form a")
        return moved

    def _pose(self, x: PETSc.Vec, multiplier: PETSc.Vec, unit: float) -> None:
        """Set the right-hand side, the start and the bounds of the correction."""
        vectors, fixed = self._vectors, self.system.fixed_dofs
        rhs = vectors["gradient"]
        multiplier.copy(rhs)
        rhs.array_w[fixed] = 0.0
        rhs.scale(-1.0 / (unit * self.size))
        vectors["step"].set(0.0)
        for name, bounds in zip(("lower", "upper"), self.system.bounds_with_data, strict=True):
            with np.errstate(over="ignore"):  # an obstacle out of reach is none
                values = (bounds - x.array_r) / unit
            vectors[name].array_w[:] = np.clip(values, PETSc.NINFINITY, PETSc.INFINITY)
            vectors[name].array_w[fixed] = 0.0

    def _others(self) -> tuple[str, ...]:
        """Return how options begin that this method does not read, but another one does."""
        return "ksp_", "pc_", *(set(OPTION_FAMILIES.values()) - {OPTION_FAMILIES[self.method]})

    def _count_linear(self, ksp: PETSc.KSP, iteration: int, norm: float) -> None:
        self.linear_iterations += iteration > 0

    def _made(self, x: PETSc.Vec) -> PETSc.TAO:
        """Make the object of TAO and its vectors, like x."""
        self._tao = tao = PETSc.TAO().create(self.system.comm)
        self._vectors = {name: x.duplicate() for name in ("gradient", "step", "lower", "upper")}
        rhs, d, lower, upper = self._vectors.values()

        def energy(tao: PETSc.TAO, v: PETSc.Vec, gradient: PETSc.Vec) -> float:
            self.evaluations += 1
            if v.dot(v) > 0.0:  # PETSc keeps norms, on ranks without dofs also outdated ones
                self.system.A.mult(v, gradient)
                gradient.scale(1.0 / self.size)
            else:
                gradient.set(0.0)
            curvature = v.dot(gradient)
            # An exception from here would leave PETSc's line search half-way.
            if curvature < 0.0 and curvature < -ROUNDING * v.dot(v):
                self._flaw = f"{INDEFINITE}, found by TAO {self.method}"
            elif falls_for_ever(self.system, v, curvature, v.dot(rhs), self._diagonal):
                self._flaw = UNBOUNDED
            value = 0.5 * curvature - v.dot(rhs)
            gradient.axpy(-1.0, rhs)
            return float(value)

        def stop(tao: PETSc.TAO) -> None:
            if self._flaw:
                tao.setConvergedReason(PETSc.TAO.Reason.DIVERGED_USER)

        tao.setType(self.method)
        tao.setObjectiveGradient(energy, None)
        tao.setMonitor(stop)
        tao.setSolution(d)
        tao.setVariableBounds((lower, upper))
        if self.hessian is not None:
            tao.setHessian(lambda tao, v, H, P: None, self.hessian)
            tao.getKSP().getPC().setType(AMG["pc_type"])
            tao.getKSP().setMonitor(self._count_linear)
        tao.setOptionsPrefix(self.prefix)
        return tao
