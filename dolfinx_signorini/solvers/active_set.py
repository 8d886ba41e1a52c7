"""The primal-dual active set method with conjugate gradients and algebraic multigrid.

Given a guess of the active set, the contact dofs in the set are held at the obstacle and one linear
system is left. The solution of this system tells which dofs to release (multiplier negative) and
which to hold (gap negative). Where only a few have to change, a small problem around them finds out
how far the change goes, in place of one dof per linear solve. The long ends of contact in the
domain settle in rough steps before, see `rough_steps`. Where the form vanishes on constants or on
rigid motions some dofs are always held: the forces balance. What ends the iteration is the natural
residual: where gap and multiplier vanish together, the set may keep changing within rounding for
ever.

Source: Hintermueller, Ito and Kunisch, SIAM J. Optim. 13 (2003) 865-888.
"""

import math
from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Mask
from dolfinx_signorini.base.ranks import anywhere
from dolfinx_signorini.base.tolerances import HALF_OF_THE_DIGITS
from dolfinx_signorini.solvers.linear.solver import LinearSolver
from dolfinx_signorini.solvers.patch import MAX_STEPS, SETTLED, active_in_patch
from dolfinx_signorini.solvers.residual import ROUNDING, NaturalResidual
from dolfinx_signorini.solvers.rough_steps import rough_steps
from dolfinx_signorini.solvers.stop import LOOSEST, Stop
from dolfinx_signorini.solvers.system import System
from dolfinx_signorini.solvers.unbounded import check_bounded

# Times the linear residual: with a smaller natural residual no set is judged. Larger numbers take
# more iterations on meshes of gmsh, and smaller ones judge by chance (`benchmarks/any_mesh.py`).
NOISE = 4.0
# Of the residual asked for: conjugate gradients, with the right set, know the natural residual but
# for a drift of their recurrences.
REACHED = 0.99
LOCAL = 0.05  # of the contact dofs, or 8: so many changes at most count as local
STALL = 4  # steps without a lower residual, after which no more short cuts are taken


def solve_active_set(
    system: System,
    solver: LinearSolver,
    measure: NaturalResidual,
    x: PETSc.Vec,
    held: Mask,
    rtol: float,
    predicted: bool = False,
    stop: Stop | None = None,
) -> float:
    """Run the primal-dual active set method.

    The method takes short cuts, loose linear solves and local corrections; with an obstacle in the
    domain, rough steps in place of both. Where the short cuts lead nowhere, the method goes on
    without them: the sets of exact steps are monotone for an M-matrix, and a set that comes back is
    a cycle. Only the last set may come back once: of a start far away rounding is left, which a
    second solve corrects. A set that is trusted whatever the residual is checked during its linear
    solve: after some digits the set shows where its ends are wrong, and what is solved to the end
    has the right ends.

    Args:
        system: The system.
        solver: The linear solver.
        measure: Measures the natural residual, and holds the multiplier of the solution afterwards.
        x: A feasible vector, overwritten by a feasible solution without a gap where there is
            pressure.
        held: The guess of the active set, one entry per contact dof of this rank.
        rtol: The relative natural residual to reach.
        predicted: Whether a solution on a coarser mesh or space predicts the set, which is then
            trusted whatever the residual of x is. Else the set is trusted where x is a rough
            solution, up to a residual of `LOOSEST`.
        stop: Ends linear solves, and with a settled set the method, earlier.

    Returns:
        The relative natural residual reached; larger than rtol where the set does not settle or
        where there was an earlier stop.

    Raises:
        InputError: The form is found to be indefinite, or the energy to be unbounded.
    """
    residual, best, stalled = _measured(measure, x, rtol), np.inf, 0
    if residual <= rtol:
        return residual
    trusted = predicted or residual <= LOOSEST
    exact: list[Mask] = []  # sets whose solution was found without short cuts
    for _ in range(2 * MAX_STEPS if solver.exact else MAX_STEPS):  # cheap steps of small problems
        careful = solver.exact or stalled == STALL
        if careful and _any_equal(system, exact[:-1], held):
            break
        if ROUNDING * residual > rtol:  # of A x: x cannot be corrected, and zero is a better start
            check_bounded(system)
            x.set(0.0)
            system.project(x)
            residual = measure(x)
        rough = system.layout.in_domain and not (careful or system.singular)
        if system.singular:
            held = _hold_loose(system, measure, x, held)
        target, solved = REACHED * rtol, False
        if rough:
            held, solved = rough_steps(system, solver, measure, x, target, stop is None)
            trusted = True
        if not (trusted or careful):
            target = max(target, LOOSEST * residual)
        if stop is not None:
            stop.allowed = LOOSEST * measure.scale
        local = not (careful or rough)
        probe = Probe(measure, solver, x, held) if trusted and local else None
        check = None if probe is None else probe.enough
        known = None if rough else measure.multiplier
        if not solved:
            solver.solve(system, x, held, target * measure.scale, known, stop, check)
        corrected, norm = (None, 0.0) if probe is None else probe.take()
        if corrected is None:
            residual, norm = _measured(measure, x, rtol), measure.norm
            if residual <= rtol:
                break
            if stop is not None and stop.reached:
                same = _any_equal(system, [held], measure.defect(x) > 0.0)
                if stop.settle(x, same):
                    break
        else:
            residual = norm / measure.scale
        if careful:
            exact.append(held)
        else:
            stalled = 0 if norm < best else stalled + 1
            best = min(best, norm)
            if corrected is None and stalled < STALL and local:
                corrected = _correct_locally(measure, x, held)
        before, held = held, measure.defect(x) > 0.0 if corrected is None else corrected
        settled = corrected is not None or _any_equal(system, [before], held)
        trusted = settled and (trusted or residual < SETTLED)
    return measure.close_gaps(x)


class Probe:
    """Checks the active set of a linear solve at some iterates, and ends the solve of a wrong set.

    While the set holds, conjugate gradients go on undisturbed:

        probe = Probe(measure, solver, x, held)
        solver.solve(system, x, held, atol, multiplier, stop, probe.enough)
        corrected, norm = probe.take()

    Args:
        measure: Measures natural residuals.
        solver: The solver.
        x: The vector that the solve improves, at its start while the solve goes on.
        held: The active set of the solve.
    """

    def __init__(self, measure: NaturalResidual, solver: LinearSolver, x: PETSc.Vec, held: Mask):
        self._measure, self._solver, self._x, self._held = measure, solver, x, held
        self._iterate: PETSc.Vec | None = None
        self._due = self._norm = math.inf
        self._corrected: Mask | None = None

    def enough(self, correction: PETSc.Vec, iteration: int, norm: float, unit: float) -> bool:
        """Return whether the iterate shows that the set is wrong, and where.

        Args:
            correction: The sum of all steps of this linear solve so far.
            iteration: The number of the iteration.
            norm: The norm of the residual.
            unit: The unit of correction and residual.
        """
        if iteration == 0:
            self._due = norm / NOISE
        if norm > self._due:
            return False
        self._iterate = self._x.copy(self._iterate)
        self._iterate.axpy(unit, correction)
        measure = self._measure
        self._solver.multiply(measure.system, self._iterate, measure.multiplier)
        measure.with_multiplier(self._iterate)
        self._norm = measure.norm
        self._due = self._norm / unit / NOISE
        if norm < self._due:
            self._due = 0.0  # where so many digits show no local change, more digits do not either
            self._corrected = _correct_locally(self._measure, self._iterate, self._held)
        return self._corrected is not None

    def take(self) -> tuple[Mask | None, float]:
        """Give x the corrected iterate; return its set, and its natural residual uncorrected."""
        if self._iterate is not None:
            if self._corrected is not None:
                self._iterate.copy(self._x)
            self._iterate.destroy()
        return self._corrected, self._norm


def _measured(measure: NaturalResidual, x: PETSc.Vec, rtol: float) -> float:
    """Return the residual of x; where the residual is small enough, x gets its contact exactly."""
    residual = measure(x)
    return measure.close_gaps(x) if residual <= rtol else residual


def _hold_loose(system: System, measure: NaturalResidual, x: PETSc.Vec, held: Mask) -> Mask:
    """Return a set that holds each loose motion, if only at the dofs next to being held.

    Without all of them held, no forces on a body balance.
    """
    loose, dofs = system.loose, system.contact_dofs
    numbers, rows = loose.numbers[dofs], loose.rows[dofs]
    while True:
        free = [still @ still.T for _, still in loose.parted(dofs[held])]
        moved = np.einsum("ni,nij->nj", rows, np.array(free)[numbers])
        stops = np.linalg.norm(moved, axis=1) > HALF_OF_THE_DIGITS
        if not anywhere(system.comm, stops):
            return held
        defect = measure.defect(x)
        largest = np.full(len(free), -np.inf)
        np.maximum.at(largest, numbers[stops], defect[stops])
        largest = np.max(system.comm.allgather(largest), axis=0)
        held = np.asarray(held | (stops & (defect == largest[numbers])))


def _any_equal(system: System, sets: Sequence[Mask], held: Mask) -> bool:
    equal = np.array([not (other != held).any() for other in sets], dtype=bool)
    system.comm.Allreduce(MPI.IN_PLACE, equal, op=MPI.LAND)
    return bool(equal.any())


def _correct_locally(measure: NaturalResidual, x: PETSc.Vec, held: Mask) -> Mask | None:
    """Return the active set with its wrong parts replaced by those of patch problems.

    Args:
        measure: Holds the multiplier of x, before and afterwards.
        x: The solution for the set held; if there is a local change, made feasible and replaced by
            the solution of the patches.
        held: The active set.

    Returns:
        The set, or None where the change is no local one.
    """
    system = measure.system
    wrong = (measure.defect(x) > 0.0) != held
    counts = system.comm.allreduce(np.array([wrong.sum(), len(held)]))
    if not 0 < counts[0] <= max(LOCAL * counts[1], 8):
        return None
    if system.project(x):
        measure(x)
    seeds = system.contact_dofs[wrong]
    update = active_in_patch(system, x, measure.multiplier, held, seeds)
    measure(x)
    return None if _any_equal(system, [held], update) else update
