"""The two ways to solve a system: active sets that TAO accepts, or TAO alone."""

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Mask
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.base.ranks import anywhere
from dolfinx_signorini.solvers.active_set import solve_active_set
from dolfinx_signorini.solvers.coarse_space import coarse_start, out_of_reach
from dolfinx_signorini.solvers.full_multigrid import full_multigrid
from dolfinx_signorini.solvers.history import Guess, History
from dolfinx_signorini.solvers.linear.direct import linear_solver
from dolfinx_signorini.solvers.patch import active_in_patch
from dolfinx_signorini.solvers.prediction import predict, settled
from dolfinx_signorini.solvers.pressure import ContactState
from dolfinx_signorini.solvers.residual import NaturalResidual
from dolfinx_signorini.solvers.result import SolveResult
from dolfinx_signorini.solvers.rough_steps import rough_step, swept
from dolfinx_signorini.solvers.stop import Stop
from dolfinx_signorini.solvers.system import System
from dolfinx_signorini.solvers.tao import TaoRounds
from dolfinx_signorini.solvers.unbounded import check_bounded

# TAO stops by the norm of the Fischer function, gap + multiplier - hypot(gap, multiplier), which is
# at most so many times the natural residual: where gap and multiplier are negative and the same.
FISCHER = 2.0 + math.sqrt(2.0)
# With an obstacle in the domain: the natural residual, relative to the data, up to which a rough
# step tries a guess from the last solutions. Loops with damage (benchmarks/time_steps.py) take up
# to a half longer with a tenth of that, and loops with a pump 1.7 times as long without a limit.
CLOSE = 0.1


class ActiveSetSolver:
    """Active sets and TAO's acceptance, for successive systems of one problem.

    The set-up of the linear solver, the objects of TAO and the last solutions serve the next solve:

        solver = ActiveSetSolver(system)
        result = solver.solve(system, x, rtol=1e-7, history=History())

    Args:
        system: The first system.
        prefix: The prefix of PETSc options.
        options: PETSc options of the linear solver, without prefix.

    Attributes:
        linear: The linear solver.
    """

    def __init__(self, system: System, prefix: str = "", options: Mapping[str, Any] | None = None):
        self.linear = linear_solver(system, prefix, options or {})
        self._prefix = prefix
        self._acceptance: TaoRounds | None = None

    def solve(
        self,
        system: System,
        x: PETSc.Vec,
        rtol: float,
        history: History,
        held: Mask | None = None,
        coarse: ContactState | None = None,
        early: bool = False,
    ) -> SolveResult:
        """Find the active set, and let TAO accept the solution or, if need be, improve it.

        Args:
            system: The system, with the matrix of the first one.
            x: A feasible start, overwritten by the solution.
            rtol: The natural residual to reach, relative to the data.
            history: Earlier solutions on this mesh, to which the solution is added.
            held: A guess of the active set, one entry per contact dof, which goes with x; by
                default the guess of the history, or everything if the history is empty.
            coarse: In place of a guess, a solution on another mesh that predicts the active set.
            early: Whether to stop where the discretisation error hides what is left, see `stop`.

        Raises:
            InputError: The form is found to be indefinite, or the energy to be unbounded.
            NotConvergedError: The natural residual was not reached.
        """
        began, linear = time.perf_counter(), self.linear
        counts = linear.solves, linear.iterations, linear.setups
        measure, stop = NaturalResidual(system, rtol), Stop() if early else None
        try:
            guess, trusted = self._start(system, measure, history, x, held, coarse)
            predicted = time.perf_counter()
            residual = solve_active_set(system, linear, measure, x, guess, rtol, trusted, stop)
            if stop is not None and stop.settled:
                rtol = max(rtol, residual)
            if not residual <= rtol:
                check_bounded(system)  # TAO would go on until its limit
            solved = time.perf_counter()
            rounds = self._rounds(system, residual <= rtol)
            try:
                residual = _run(rounds, x, measure, rtol, "cascade", residual)
            finally:
                if rounds is not self._acceptance:
                    rounds.destroy()
            history.add(system, x, measure.multiplier)
        finally:
            destroy(measure, stop)
        seconds = {
            "predict": predicted - began,
            "solve": solved - predicted,
            "accept": time.perf_counter() - solved,
        }
        spent = linear.solves - counts[0], linear.iterations - counts[1]
        more = {
            "algebraic_share": None if stop is None else stop.share,
            "preconditioner": linear.preconditioner,
            "setups": linear.setups - counts[2],
        }
        return _result(system, x, "cascade", rounds, residual, spent, seconds, **more)

    def destroy(self) -> None:
        """Free the PETSc objects."""
        destroy(self.linear, self._acceptance)

    def _start(
        self,
        system: System,
        measure: NaturalResidual,
        history: History,
        x: PETSc.Vec,
        held: Mask | None,
        coarse: ContactState | None,
    ) -> tuple[Mask, bool]:
        """Set x to the start, and return its active set, and whether that is predicted.

        The start is a user's, or from the last solutions, from coarser meshes or a coarse space.
        With an obstacle in the domain the coarser meshes of multigrid tell more of the long ends of
        the contact set than a solution on another mesh, or than solutions that are too far away,
        which a rough step tells: these are no better as a start of cycles than none. A problem
        without any of these starts with all contact dofs held.
        """
        if held is not None:
            return held, False
        guess = history.guess(system) if coarse is None else None
        if guess is not None:
            rough = system.layout.in_domain and not self.linear.exact
            held = _settled(system, measure, guess, x, rough)
            before = measure.relative
            if not rough or before <= measure.rtol:
                return held, False
            if before <= CLOSE and not system.singular:
                held = swept(system, "forward", x, measure.multiplier)
                step = system, self.linear, measure, x, held, "backward"
                held, _ = rough_step(*step, measure.rtol, last=True)
                system.project(x)
                if measure(x) < before:
                    return held, False
        elif coarse is None and out_of_reach(system, x):
            return np.full(len(system.contact_dofs), False), True
        multigrid = self.linear.multigrid
        if multigrid is not None and (coarse is None or system.layout.in_domain):
            found = full_multigrid(system, multigrid, x)
            if found is not None:
                # A coarse body may be far too stiff: the residual tells whether to trust the set.
                return settled(system, x, found), system.layout.block == 1
        if held is not None:
            return held, False
        if coarse is not None:
            return predict(system, coarse, x), True
        held = coarse_start(system, x)
        if held is not None:
            return held, True
        return np.full(len(system.contact_dofs), True), False

    def _rounds(self, system: System, reached: bool) -> TaoRounds:
        """Rounds of TAO that take no step on a vector that has the residual, or Newton's method."""
        if not reached:
            self.linear.free()  # Newton's method needs the memory
            return TaoRounds(system, "bntr", prefix=self._prefix)
        if self._acceptance is None:
            self._acceptance = TaoRounds(system, "bncg", prefix=self._prefix, stop=FISCHER)
        self._acceptance.renew(system)
        return self._acceptance


def solve_by_tao(
    system: System,
    method: str,
    x: PETSc.Vec,
    history: History,
    rtol: float,
    prefix: str,
    options: Mapping[str, Any],
    limits: Mapping[str, int],
) -> SolveResult:
    """Solve a system with a bound-constrained TAO solver alone.

    Args:
        system: The system.
        method: The type of the TAO solver, see `TaoRounds`.
        x: A feasible start, overwritten by the solution.
        history: Earlier solutions; the solution is added.
        rtol: The natural residual to reach, relative to the data.
        prefix: The prefix of PETSc options.
        options: PETSc options without prefix.
        limits: The limits `max_iterations` and `max_evaluations`, where they are given.

    Raises:
        InputError: The form is found to be indefinite, or the energy to be unbounded.
        NotConvergedError: The natural residual was not reached.
    """
    began = time.perf_counter()
    measure = NaturalResidual(system, rtol)
    rounds = TaoRounds(system, method, prefix=prefix, options=options, **limits)
    try:
        residual = _run(rounds, x, measure, rtol, method)
        history.add(system, x, measure.multiplier)
    finally:
        destroy(rounds, measure)
    seconds = {"solve": time.perf_counter() - began}
    return _result(system, x, method, rounds, residual, (0, 0), seconds)


def _settled(
    system: System, measure: NaturalResidual, guess: Guess, x: PETSc.Vec, rough: bool
) -> Mask:
    """Set x to a guess, and return its active set.

    Where the guess may be rough, patch problems make it smooth and settle the set, unless
    rough steps do that later.
    """
    x.array_w[:] = guess.values
    system.project(x)
    system.place(x, guess.held)
    if measure(x) <= measure.rtol or rough:
        return guess.held
    doubtful = guess.doubtful | ((measure.defect(x) > 0.0) != guess.held)
    if not anywhere(system.comm, doubtful):
        return guess.held
    return active_in_patch(system, x, measure.multiplier, guess.held, system.contact_dofs[doubtful])


def _run(
    rounds: TaoRounds,
    x: PETSc.Vec,
    measure: NaturalResidual,
    rtol: float,
    name: str,
    residual: float | None = None,
) -> float:
    """Run TAO, and return the residual; raise NotConvergedError unless the residual is rtol."""
    residual = rounds.run(x, measure, rtol, residual)
    if not residual <= rtol:
        raise rounds.failure(name, residual, rtol)
    return residual


def _result(
    system: System,
    x: PETSc.Vec,
    method: str,
    rounds: TaoRounds,
    residual: float,
    linear: tuple[int, int],
    seconds: dict[str, float],
    **more: Any,
) -> SolveResult:
    return SolveResult(
        method=method,
        reason=f"TAO {rounds.method}: {rounds.reason}",
        iterations=rounds.iterations,
        linear_solves=linear[0],
        linear_iterations=linear[1] + rounds.linear_iterations,
        natural_residual=residual,
        active_dofs=system.comm.allreduce(int(system.touching_once(x).sum())),
        seconds=seconds,
        **more,
    )
