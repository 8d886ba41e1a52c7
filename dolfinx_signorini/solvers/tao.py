"""Bound-constrained TAO solvers for the discrete Signorini problem.

TAO sees the correction d = (x - x0) / s to a start x0, with A divided by a power of two of the size
of its diagonal, in the unit s in which the natural residual of x0 has size one:

    minimise 1/2 d.A'd - r'.d  over  d >= (g - x0) / s,    A' = A / |A|,  r' = (b - A x0) / (s |A|).

So neither the size of the load nor that of the operator matters (scaling by powers of two is
exact), and neither do the absolute safeguards inside TAO, nor cancellation: a round ends after a
few digits, the next one starts from the point reached, in a unit of its own, and the residual goes
down to rounding. In one round, BQNLS and BNCG stall at 1e-9 for tens of thousands of iterations.
"""

import itertools
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from dolfinx_signorini.errors import InputError, NotConvergedError
from dolfinx_signorini.solvers.residual import Optimality, SolveResult, power_of_two
from dolfinx_signorini.system import DiscreteProblem

FIRST_ORDER = ("bncg", "bqnls", "blmvm")
SECOND_ORDER = ("bntr", "bnls", "tron")
METHODS = FIRST_ORDER + SECOND_ORDER

# One round reduces the residual by this factor at the most: the energy is then known to its square.
ROUND_REDUCTION = 1e-4
DEFAULT_RTOL = 1e-8  # first-order methods leave smooth errors, which the residual hardly shows
MAX_ITERATIONS = 50_000
MAX_EVALUATIONS = 200_000
ROUNDED = 1e-12  # of |A| |v|^2: a negative v.A v above it may be rounding

_counter = itertools.count()

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


def solve_tao(
    problem: DiscreteProblem,
    method: str = "bqnls",
    *,
    rtol: float = DEFAULT_RTOL,
    start: fem.Function | None = None,
    max_iterations: int = MAX_ITERATIONS,
    max_evaluations: int = MAX_EVALUATIONS,
    options: Mapping[str, Any] | None = None,
) -> SolveResult:
    """Solve the discrete problem with a bound-constrained TAO solver.

    Args:
        problem: The assembled problem.
        method: First-order "bncg" (nonlinear conjugate gradients), "bqnls" or "blmvm"
            (quasi-Newton); second-order "bntr", "bnls" or "tron" (Newton, with CG and algebraic
            multigrid for the inactive dofs).
        rtol: The natural residual to reach, relative to the data.
        start: Where to start, for example a coarser solution interpolated to the problem's
            space; zero by default. It is lifted to the obstacle first.
        max_iterations: Limit on TAO's iterations in all.
        max_evaluations: Limit on the evaluations of energy and gradient in all.
        options: PETSc options for TAO, without prefix, for example {"tao_bncg_type": "prp"}.

    Returns:
        The solution; its `iterations` are TAO's.

    Raises:
        InputError: The method or rtol make no sense, or the form is found to be indefinite.
        NotConvergedError: The natural residual was not reached.
    """
    if method not in METHODS:
        raise InputError(f"method: unknown {method!r}, known are {', '.join(METHODS)}")
    if not 0.0 < rtol < 1.0:
        raise InputError(f"rtol: must lie between 0 and 1, not {rtol}")
    began = time.perf_counter()
    x = problem.start_values() if start is None else problem.vector_of(start)
    problem.project(x)
    optimality = Optimality(problem, rtol)
    rounds = TaoRounds(problem, method, options or {}, max_iterations, max_evaluations)
    try:
        residual = rounds.run(x, optimality, rtol)
        seconds = {"solve": time.perf_counter() - began}
        return rounds.result(x, residual, rtol, method, (0, 0), seconds)
    finally:
        optimality.destroy()
        x.destroy()


class TaoRounds:
    """TAO rounds on one problem, with the limits and the counts that they share.

    Args:
        problem: The problem.
        method: TAO's type.
        options: PETSc options for TAO, without prefix.
        max_iterations: Limit on the iterations of all rounds.
        max_evaluations: Limit on the evaluations of all rounds.
    """

    def __init__(
        self,
        problem: DiscreteProblem,
        method: str,
        options: Mapping[str, Any] | None = None,
        max_iterations: int = MAX_ITERATIONS,
        max_evaluations: int = MAX_EVALUATIONS,
    ):
        self.problem, self.method, self.options = problem, method, options or {}
        self.max_iterations, self.max_evaluations = max_iterations, max_evaluations
        self.iterations = self.evaluations = self.linear_iterations = 0
        self.reason = ""
        self.indefinite = False
        diagonal = problem.A.getDiagonal()
        self.size = power_of_two(diagonal.norm(PETSc.NormType.INFINITY))
        diagonal.destroy()

    def run(self, x: PETSc.Vec, optimality: Optimality, rtol: float) -> float:
        """Run rounds from a feasible x, overwritten, and return the residual reached."""
        residual = optimality.measure(x)
        while True:
            previous = optimality.norm
            self.round(x, optimality, max(rtol, ROUND_REDUCTION * residual))
            residual = optimality.measure(x)
            if residual <= rtol or not optimality.norm < 0.5 * previous or self.exhausted:
                return residual

    def result(
        self,
        x: PETSc.Vec,
        residual: float,
        rtol: float,
        method: str,
        linear: tuple[int, int],
        seconds: dict[str, float],
    ) -> SolveResult:
        """Return x as a result.

        Args:
            x: The vector reached.
            residual: Its relative natural residual.
            rtol: The residual that was asked for.
            method: What to call the solver.
            linear: Linear solves and their iterations before TAO.
            seconds: Wall-clock seconds of the phases of the solve.

        Raises:
            NotConvergedError: The residual is larger than rtol.
        """
        if not residual <= rtol:
            advice = (
                "raise max_iterations, loosen rtol, or start from a coarser solution"
                if self.exhausted
                else "a further round hardly lowers it: loosen rtol, or look for thin cells and "
                "for coefficients far apart, whose rounding allows no less"
            )
            raise NotConvergedError(
                f"{method} stopped at a relative natural residual of {residual:.3g}, not "
                f"{rtol:.3g}: {self.reason}; {advice}",
                residual,
                self.reason,
            )
        problem = self.problem
        u = fem.Function(problem.space, name="u")
        u.x.array[: x.getLocalSize()] = x.array_r
        u.x.scatter_forward()
        problem.ledger.add("vector", "solution u", x)
        for phase, value in seconds.items():
            problem.ledger.add("phase", phase, seconds=value)
        active = int((x.array_r[problem.contact_dofs] <= problem.obstacle).sum())
        return SolveResult(
            u=u,
            method=method,
            reason=f"TAO {self.method}: {self.reason}",
            iterations=self.iterations,
            linear_solves=linear[0],
            linear_iterations=linear[1] + self.linear_iterations,
            natural_residual=residual,
            active_dofs=problem.comm.allreduce(active),
            seconds=problem.seconds | seconds,
        )

    @property
    def exhausted(self) -> bool:
        return self.iterations >= self.max_iterations or self.evaluations >= self.max_evaluations

    def round(self, x: PETSc.Vec, optimality: Optimality, target: float) -> None:
        """Run TAO on the correction to x, and add it.

        Args:
            x: Feasible start, overwritten.
            optimality: Holds the multiplier A x - b and the residual of this x.
            target: The relative natural residual to stop at.
        """
        rhs = optimality.multiplier.copy()
        rhs.array_w[self.problem.fixed_dofs] = 0.0
        unit = power_of_two(optimality.norm / self.size) if optimality.norm > 0.0 else 1.0
        rhs.scale(-1.0 / (unit * self.size))
        d = rhs.duplicate()
        d.set(0.0)
        lower, upper = self._bounds(x, unit)
        for name, vec in (("gradient", rhs), ("step", d), ("lower", lower), ("upper", upper)):
            self.problem.ledger.add("vector", f"TAO: {name}", vec)
        tao = PETSc.TAO().create(self.problem.comm)
        self.problem.A.scale(1.0 / self.size)
        try:
            gatol = 0.5 * target * optimality.scale / (unit * self.size)
            tao.setTolerances(gatol=gatol, grtol=0.0, gttol=0.0)
            self._configure(tao, rhs, d, (lower, upper))
            tao.solve()
            self.iterations += tao.getIterationNumber()
            self.reason = REASONS.get(tao.getConvergedReason(), "the reason has no name")
            x.axpy(unit, d)
            self.problem.project(x)
        except PETSc.Error:
            if not self.indefinite:  # else energies may have left the range of numbers
                raise
        finally:
            self.problem.A.scale(self.size)
            for item in (tao, rhs, d, lower, upper):
                item.destroy()
        if self.indefinite:
            raise InputError(f"form a: not positive definite, found by TAO {self.method}")

    def _bounds(self, x: PETSc.Vec, unit: float) -> tuple[PETSc.Vec, PETSc.Vec]:
        lower, upper = x.duplicate(), x.duplicate()
        lower.set(PETSc.NINFINITY)
        upper.set(PETSc.INFINITY)
        dofs = self.problem.contact_dofs
        with np.errstate(over="ignore"):  # an obstacle out of reach is none
            gap = (x.array_r[dofs] - self.problem.obstacle) / unit
        lower.array_w[dofs] = np.maximum(-gap, PETSc.NINFINITY)
        lower.array_w[self.problem.fixed_dofs] = 0.0
        upper.array_w[self.problem.fixed_dofs] = 0.0
        return lower, upper

    def _count_linear(self, ksp: PETSc.KSP, iteration: int, norm: float) -> None:
        self.linear_iterations += iteration > 0

    def _configure(
        self, tao: PETSc.TAO, rhs: PETSc.Vec, d: PETSc.Vec, bounds: tuple[PETSc.Vec, PETSc.Vec]
    ) -> None:
        A = self.problem.A

        def energy(tao: PETSc.TAO, v: PETSc.Vec, gradient: PETSc.Vec) -> float:
            self.evaluations += 1
            A.mult(v, gradient)
            curvature = v.dot(gradient)
            # No exception from here: it would leave PETSc's line search half-way.
            if curvature < 0.0 and curvature < -ROUNDED * v.dot(v):
                self.indefinite = True
            value = 0.5 * curvature - v.dot(rhs)
            gradient.axpy(-1.0, rhs)
            return float(value)

        def stop(tao: PETSc.TAO) -> None:
            if self.indefinite:
                tao.setConvergedReason(PETSc.TAO.Reason.DIVERGED_USER)

        tao.setType(self.method)
        tao.setObjectiveGradient(energy, None)
        tao.setMonitor(stop)
        tao.setSolution(d)
        tao.setVariableBounds(bounds)
        tao.setMaximumIterations(self.max_iterations - self.iterations)
        tao.setMaximumFunctionEvaluations(self.max_evaluations - self.evaluations)
        if self.method in SECOND_ORDER:
            tao.setHessian(lambda tao, v, H, P: None, A)
            tao.getKSP().getPC().setType("hypre")
            tao.getKSP().setMonitor(self._count_linear)
        prefix = f"dolfinx_signorini_tao_{next(_counter)}_"
        tao.setOptionsPrefix(prefix)
        database = PETSc.Options()
        for key, value in self.options.items():
            database[prefix + key] = value
        try:
            tao.setFromOptions()
        finally:
            for key in self.options:
                database.delValue(prefix + key)
