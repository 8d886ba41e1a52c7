"""The primal-dual active set method with conjugate gradients and algebraic multigrid.

Given a guess of the active set, the contact dofs in the set are held at the obstacle and one linear
system is left. The solution of this system tells which dofs to release (multiplier negative) and
which to hold (gap negative). Where only a few have to change, a small problem around them finds out
how far the change goes, in place of one dof per linear solve. Where the form vanishes on constants
some dof is always held: the forces balance. What ends the iteration is the natural residual: where
gap and multiplier vanish together, the set may keep changing within rounding for ever.

Source: Hintermueller, Ito and Kunisch, SIAM J. Optim. 13 (2003) 865-888.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Mask
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.solvers.linear.solver import LinearSolver
from dolfinx_signorini.solvers.patch import active_in_patch
from dolfinx_signorini.solvers.residual import ROUNDING, NaturalResidual
from dolfinx_signorini.solvers.stop import LOOSEST, Stop
from dolfinx_signorini.solvers.system import System
from dolfinx_signorini.solvers.unbounded import check_bounded

LINEAR_FRACTION = 0.5  # of rtol is left to the linear solver
LOOSE = 1e-2  # how far a linear solve goes, relative to the residual, while the set is a guess
PROBE = 1e-4  # how far a solve with a predicted set goes before the set is looked at
NOISE = 10.0  # of the linear tolerance: a smaller natural residual tells nothing about the set
SEVERE = 0.1  # relative to the largest defect: a dof that has to change
SETTLED = 1e-3  # relative residual from which on a set corrected locally is solved for to the end
LOCAL_FRACTION = 0.02  # of the contact dofs have to change at most, for a change to count as local
STALL = 4  # steps without a lower residual, after which no more short cuts are taken
MAX_STEPS = 60


@dataclass(frozen=True)
class Start:
    """What the active set method starts from, whoever gives the start.

    The start of a user, of the last solutions, or of a coarser mesh:

        Start(x, held)
        Start(x, held, trust=1e-2)
        Start(x, held, trust=math.inf)

    Attributes:
        x: A feasible vector, overwritten by the solution.
        held: The guess of the active set, one entry per contact dof of this rank.
        trust: The relative residual of x up to which linear systems with this set are solved to
            the end at once; with infinity the set is trusted whatever x is.
    """

    x: PETSc.Vec
    held: Mask
    trust: float = 0.0


def solve_active_set(
    system: System,
    solver: LinearSolver,
    measure: NaturalResidual,
    start: Start,
    rtol: float,
    stop: Stop | None = None,
) -> float:
    """Run the primal-dual active set method.

    The method takes two short cuts, loose linear solves and local corrections. Where the short cuts
    lead nowhere, the method goes on without them: the sets of exact steps are monotone for an
    M-matrix, and a set that comes back is a cycle. Solves with a set that is trusted whatever the
    residual are interrupted after some digits: by then the set shows where its ends are wrong, and
    what is solved to the end has the right ends.

    Args:
        system: The system.
        solver: The linear solver.
        measure: Measures the natural residual, and holds the multiplier of the solution afterwards.
        start: The start, whose vector is overwritten by a feasible solution without a gap where
            there is pressure.
        rtol: The relative natural residual to reach.
        stop: Ends linear solves, and with a settled set the method, earlier.

    Returns:
        The relative natural residual reached; larger than rtol where the set does not settle or
        where there was an earlier stop.

    Raises:
        InputError: The form is found to be indefinite, or the energy to be unbounded.
    """
    x, held = start.x, start.held
    residual, best, stalled = _measured(measure, x, rtol), np.inf, 0
    if residual <= rtol:
        return residual
    trusted = residual <= start.trust
    probing = start.trust == np.inf and not solver.exact
    exact: list[Mask] = []  # sets whose solution was found without short cuts
    for _ in range(MAX_STEPS):
        careful = solver.exact or stalled == STALL
        if careful and _any_equal(system, exact, held):
            break
        if ROUNDING * residual > rtol:  # of A x: x cannot be corrected, and zero is a better start
            check_bounded(system)
            x.set(0.0)
            system.project(x)
            residual = measure(x)
        if system.singular:
            held = _hold_loose(system, measure, x, held)
        target = rtol * LINEAR_FRACTION
        if not (trusted or careful):
            target = max(target, LOOSE * residual)
        if probing:
            target = max(target, PROBE * residual)
        if stop is not None:
            stop.allowed = LOOSEST * measure.scale
        solver.solve(system, x, held, target * measure.scale, measure.multiplier, stop)
        residual = _measured(measure, x, rtol)
        if residual <= rtol:
            break
        if stop is not None and stop.reached:
            if stop.settle(x, _any_equal(system, [held], measure.defect(x) > 0.0)):
                break
            probing = False
        corrected = None
        if careful:
            exact.append(held)
        elif not (probing and residual <= NOISE * target):
            stalled = 0 if measure.norm < best else stalled + 1
            best = min(best, measure.norm)
            if stalled < STALL:
                corrected = _correct_locally(system, measure, x, held)
        if probing and corrected is None:  # few digits show the wrong ends of a set, and no more
            probing = False
            solver.solves -= 1  # which goes on
            continue
        before, held = held, measure.defect(x) > 0.0 if corrected is None else corrected
        settled = corrected is not None or _any_equal(system, [before], held)
        trusted = settled and (trusted or residual < SETTLED)
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
    system: System, measure: NaturalResidual, x: PETSc.Vec, held: Mask
) -> Mask | None:
    """Return the active set with its wrong parts replaced by those of patch problems.

    Args:
        system: The system.
        measure: Holds the multiplier of x, before and afterwards.
        x: The solution for the set held; if there is a local change, made feasible and replaced by
            the solution of the patches.
        held: The active set.

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
    update = active_in_patch(system, x, measure.multiplier, held, seeds)
    measure(x)
    return None if _any_equal(system, [held], update) else update
