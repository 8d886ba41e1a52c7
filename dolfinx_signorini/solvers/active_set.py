"""The primal-dual active set method with conjugate gradients and algebraic multigrid.

Given a guess of the active set, the contact dofs in the set are held at the obstacle and one linear
system is left. The solution of this system tells which dofs to release (multiplier negative) and
which to hold (gap negative). Where only a few have to change, a small problem around them finds out
how far the change goes, in place of one dof per linear solve. Where the form vanishes on constants
some dof is always held: the forces balance. What ends the iteration is the natural residual: where
gap and multiplier vanish together, the set may keep changing within rounding for ever.

Source: Hintermueller, Ito and Kunisch, SIAM J. Optim. 13 (2003) 865-888.
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.solvers.linear.direct import LinearSolver
from dolfinx_signorini.solvers.patch import active_in_patch
from dolfinx_signorini.solvers.residual import ROUNDING, NaturalResidual
from dolfinx_signorini.solvers.stop import LOOSEST, Stop
from dolfinx_signorini.solvers.system import System

Mask = npt.NDArray[np.bool_]

LINEAR_FRACTION = 0.1  # of rtol is left to the linear solver
LOOSE = 1e-2  # how far a linear solve goes, relative to the residual, while the set is a guess
PROBE = 1e-4  # how far a solve with a predicted set goes before the set is looked at
NOISE = 10.0  # natural residual, over the one of a linear solve, that says nothing about the set
SEVERE = 0.1  # relative to the largest defect: a dof that has to change
TRUST = 1e-3  # relative residual from which on a set corrected locally is solved for to the end
LOCAL_FRACTION = 0.02  # of the contact dofs have to change at most, for a change to count as local
STALL = 4  # steps without a lower residual, after which no more short cuts are taken
MAX_STEPS = 60


def solve_active_set(
    system: System,
    solver: LinearSolver,
    measure: NaturalResidual,
    x: PETSc.Vec,
    held: Mask,
    rtol: float,
    trust: float,
    fraction: float = LINEAR_FRACTION,
    stop: Stop | None = None,
) -> float:
    """Run the primal-dual active set method.

    The method takes two short cuts, loose linear solves and local corrections. Where the short cuts
    lead nowhere, the method goes on without them: the sets of exact steps are monotone for an
    M-matrix, and a set that comes back is a cycle. Solves with a predicted
    set, which is trusted whatever the residual, are interrupted after some digits: by then the set
    shows where its ends are wrong, and what is solved to the end has the right ends.

    Args:
        system: The system.
        solver: The linear solver.
        measure: Measures the natural residual.
        x: The start of the linear solver, overwritten by a feasible solution without a gap where
            there is pressure.
        held: The guess of the active set, one entry per contact dof.
        rtol: The relative natural residual to reach.
        trust: The relative residual of x up to which the guess is solved for to the end at once.
        fraction: What a linear solve to the end leaves, relative to rtol.
        stop: Ends linear solves, and with a settled set the method, earlier.

    Returns:
        The relative natural residual reached; larger than rtol where the set does not settle or
        where there was an earlier stop.
    """
    residual, best, stalled, local = _measured(measure, x, rtol), np.inf, 0, 0
    if residual <= rtol:
        return residual
    trusted = residual <= trust
    probing = math.isinf(trust) and not solver.exact
    known = True  # whether the measure holds the multiplier of x
    exact: list[Mask] = []  # sets whose solution was found without short cuts
    for _ in range(MAX_STEPS):
        careful = solver.exact or stalled == STALL
        if careful and _any_equal(system, exact, held):
            break
        if ROUNDING * residual > rtol:  # of A x: x cannot be corrected, and zero is a better start
            x.set(0.0)
            system.project(x)
            residual, known = measure(x), True
        if system.singular:
            held = _hold_loose(system, measure, x, held)
        target = rtol * fraction
        if not (trusted or careful):
            target = max(target, LOOSE * residual)
        if probing:
            target = max(target, PROBE * residual)
        if stop is not None:
            stop.allowed = LOOSEST * measure.scale
        multiplier = measure.multiplier if known else None
        solver.solve(system, x, held, target * measure.scale, multiplier, stop)
        residual = _measured(measure, x, rtol)
        known = True
        if residual <= rtol:
            break
        if stop is not None and stop.reached:
            if stop.settle(x, _any_equal(system, [held], measure.defect(x) > 0.0)):
                break
            probing = False
        update, doubtful = None, probing and residual <= NOISE * target
        if careful:
            exact.append(held)
        elif not doubtful:
            stalled = 0 if measure.norm < best else stalled + 1
            best = min(best, measure.norm)
            if stalled < STALL:
                update = _correct_locally(system, measure, x, held, reach=2**local)
                known = update is None
        if probing and update is None:  # so few digits show wrong ends of a predicted set, no more
            probing = False
            solver.solves -= 1  # which goes on
            continue
        local = 0 if update is None else local + 1
        before, held = held, measure.defect(x) > 0.0 if update is None else update
        settled = local > 0 or _any_equal(system, [before], held)
        trusted = settled and (trusted or residual < TRUST)
    if not known:
        measure(x)
    return measure.close_gaps(x)


def _measured(measure: NaturalResidual, x: PETSc.Vec, rtol: float) -> float:
    """Return the residual of x; where the residual is small enough, x gets its contact exactly."""
    residual = measure(x)
    return measure.close_gaps(x) if residual <= rtol else residual


def _hold_loose(system: System, measure: NaturalResidual, x: PETSc.Vec, held: Mask) -> Mask:
    """Return a set that holds each loose body, if only at the dofs next to being held.

    Without any dof held, no forces on the body balance.
    """
    parts, dofs = system.layout.bodies, system.contact_dofs
    free = system.loose & (parts.counts(dofs[held]) == 0)
    if not free.any():
        return held
    measure(x)
    defect, numbers = measure.defect(x), parts.numbers[dofs]
    largest = np.full(parts.count, -np.inf)
    np.maximum.at(largest, numbers, defect)
    largest = np.max(system.comm.allgather(largest), axis=0)
    return np.asarray(held | (free[numbers] & (defect == largest[numbers])))


def _any_equal(system: System, sets: Sequence[Mask], held: Mask) -> bool:
    equal = np.array([not (other != held).any() for other in sets], dtype=bool)
    system.comm.Allreduce(MPI.IN_PLACE, equal, op=MPI.LAND)
    return bool(equal.any())


def _correct_locally(
    system: System, measure: NaturalResidual, x: PETSc.Vec, held: Mask, reach: int
) -> Mask | None:
    """Return the active set with its wrong parts replaced by those of patch problems.

    Args:
        system: The system.
        measure: Holds the multiplier of x.
        x: The solution for the set held; if there is a local change, made feasible and replaced by
            the solution of the patches.
        held: The active set.
        reach: How far the patches go, as a multiple of their usual size: doubled from one local
            correction to the next, so that an end of the contact set can move far in a few.

    Returns:
        The set, or None where the change is no local one.
    """
    defect = measure.defect(x)
    wrong = (defect > 0.0) != held
    # What is far below the largest defect may be its consequence.
    largest = highest(system.comm, np.abs(defect[wrong]))
    severe = wrong & (np.abs(defect) >= SEVERE * largest)
    counts = system.comm.allreduce(np.array([severe.sum(), len(held)]))
    if not 0 < counts[0] <= max(LOCAL_FRACTION * counts[1], 8):
        return None
    system.project(x)
    measure(x)
    seeds = system.contact_dofs[severe]
    update = active_in_patch(system, x, measure.multiplier, held, seeds, reach)
    if _any_equal(system, [held], update):
        measure(x)  # the patches have changed x
        return None
    return update
