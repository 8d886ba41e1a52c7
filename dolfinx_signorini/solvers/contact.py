"""The two ways to solve a system: active sets that TAO accepts, or TAO alone."""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from dolfinx_signorini.solvers.active_set import solve_active_set
from dolfinx_signorini.solvers.held import HeldSolver
from dolfinx_signorini.solvers.history import History
from dolfinx_signorini.solvers.prediction import predict
from dolfinx_signorini.solvers.pressure import ContactState
from dolfinx_signorini.solvers.residual import NaturalResidual
from dolfinx_signorini.solvers.result import SolveResult
from dolfinx_signorini.solvers.tao import STOP, TaoRounds
from dolfinx_signorini.system import System

Mask = npt.NDArray[np.bool_]

# TAO stops by the norm of the Fischer function, gap + multiplier - hypot(gap, multiplier). At a dof
# in contact whose multiplier is negative within the tolerance that is twice the natural residual.
FISCHER = 2.5


def solve_by_active_sets(
    system: System,
    solver: HeldSolver,
    x: PETSc.Vec,
    held: Mask | None,
    start: ContactState | History | None,
    rtol: float,
    prefix: str,
) -> SolveResult:
    """Find the active set, and let TAO accept the solution or, if need be, improve it.

    Args:
        system: The system.
        solver: The linear solver of this system, which may have a set-up from earlier solves.
        x: A feasible start, overwritten by the solution.
        held: A guess of the active set, one entry per contact dof; None for everything in contact.
        start: In place of x and the guess, a solution on another mesh that predicts the active set,
            or earlier solutions on this mesh.
        rtol: The natural residual to reach, relative to the data.
        prefix: The prefix of PETSc options.

    Raises:
        InputError: The form is found to be indefinite.
        NotConvergedError: The natural residual was not reached.
    """
    began = time.perf_counter()
    counts = solver.solves, solver.iterations
    measure = NaturalResidual(system, rtol)
    if isinstance(start, ContactState):
        held = predict(system, start)
    elif start is not None:
        held = _best_guess(system, measure, start, x)
    if held is None:
        held = np.full(len(system.contact_dofs), True)
    predicted = time.perf_counter()
    try:
        trusted = isinstance(start, ContactState)
        solve_active_set(system, solver, measure, x, held, rtol, trusted)
        system.project(x)
        solved = time.perf_counter()
        # TAO takes no step on a vector that has the residual.
        kind, stop = ("bncg", FISCHER)
        if measure(x) > rtol:
            kind, stop = ("bntr", STOP)
            solver.free()  # Newton's method needs the memory
        rounds = TaoRounds(system, kind, prefix=prefix, stop=stop)
        residual = _run(rounds, x, measure, rtol, "cascade")
    finally:
        measure.destroy()
    seconds = {
        "predict": predicted - began,
        "solve": solved - predicted,
        "accept": time.perf_counter() - solved,
    }
    linear = solver.solves - counts[0], solver.iterations - counts[1]
    return _result(system, x, "cascade", rounds, residual, linear, seconds)


def solve_by_tao(
    system: System,
    method: str,
    x: PETSc.Vec,
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
        rtol: The natural residual to reach, relative to the data.
        prefix: The prefix of PETSc options.
        options: PETSc options without prefix.
        limits: The limits `max_iterations` and `max_evaluations`, where they are given.

    Raises:
        InputError: The form is found to be indefinite.
        NotConvergedError: The natural residual was not reached.
    """
    began = time.perf_counter()
    measure = NaturalResidual(system, rtol)
    rounds = TaoRounds(system, method, prefix=prefix, options=options, **limits)
    try:
        residual = _run(rounds, x, measure, rtol, method)
    finally:
        measure.destroy()
    seconds = {"solve": time.perf_counter() - began}
    return _result(system, x, method, rounds, residual, (0, 0), seconds)


def _best_guess(
    system: System, measure: NaturalResidual, history: History, x: PETSc.Vec
) -> Mask | None:
    """Set x to the guess with the smallest natural residual, and return its active set."""
    best, chosen = np.inf, None
    guesses = history.guesses(system)
    for values, held in guesses:
        guess = system.start(values)
        guess.array_w[system.contact_dofs[held]] = system.obstacle[held]
        residual = measure(guess) if len(guesses) > 1 else 0.0
        if residual < best:
            best, chosen = residual, held
            guess.copy(x)
        guess.destroy()
    return chosen


def _run(
    rounds: TaoRounds, x: PETSc.Vec, measure: NaturalResidual, rtol: float, name: str
) -> float:
    """Run TAO, and return the residual; raise NotConvergedError unless the residual is rtol."""
    try:
        residual = rounds.run(x, measure, rtol)
    finally:
        rounds.destroy()
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
) -> SolveResult:
    system.ledger.add("vector", "solution u", x)
    for phase, value in seconds.items():
        system.ledger.add("phase", phase, seconds=value)
    return SolveResult(
        method=method,
        reason=f"TAO {rounds.method}: {rounds.reason}",
        iterations=rounds.iterations,
        linear_solves=linear[0],
        linear_iterations=linear[1] + rounds.linear_iterations,
        natural_residual=residual,
        active_dofs=system.comm.allreduce(int(system.touching(x).sum())),
        seconds=seconds,
    )
