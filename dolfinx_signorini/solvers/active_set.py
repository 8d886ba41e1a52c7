"""The primal-dual active set method with conjugate gradients and algebraic multigrid.

Given a guess of the active set, the contact dofs in it are held at the obstacle and one linear
system is left. Its solution tells which dofs to release (multiplier negative) and which to hold
(gap negative). Where only a few have to change, a small problem around them finds out how far the
change goes, in place of one dof per linear solve, and the multigrid set-up is used again. Where the
form vanishes on constants some dof is always held: the forces balance. What ends the iteration is
the natural residual: where gap and multiplier vanish together, the set may keep changing within
rounding for ever.

Source: Hintermueller, Ito and Kunisch, SIAM J. Optim. 13 (2003) 865-888.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.errors import InputError
from dolfinx_signorini.solvers.patch import active_in_patch
from dolfinx_signorini.solvers.residual import Optimality, power_of_two
from dolfinx_signorini.system import DiscreteProblem

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

LINEAR_FRACTION = 0.1  # of rtol is left to the linear solver
LOOSE = 1e-3  # how far a linear solve goes, relative to the residual, while the set is a guess
SEVERE = 0.1  # relative to the largest defect: a dof that has to change
TRUST = 1e-3  # relative residual from which on a set corrected locally is solved for to the end
LOCAL_FRACTION = 0.02  # of the contact dofs have to change at most, for a change to count as local
STALL = 4  # steps without a lower residual, after which no more short cuts are taken
REUSE_LIMIT = 4  # dofs that may have changed since the multigrid set-up
MAX_STEPS = 60
MAX_LINEAR_ITERATIONS = 200
ROUNDED = 1e-6  # of the first residual: below it a negative curvature may be rounding

# One Gauss-Seidel sweep forward on the way down and one backward on the way up are symmetric
# together, and half the work of PETSc's default, which is symmetric each time. The last levels, a
# few dofs each, cost more than a direct solve.
DEFAULT_OPTIONS: dict[str, Any] = {
    "ksp_type": "cg",
    "pc_type": "hypre",
    "pc_hypre_type": "boomeramg",
    "pc_hypre_boomeramg_relax_type_down": "SOR/Jacobi",
    "pc_hypre_boomeramg_relax_type_up": "backward-SOR/Jacobi",
    "pc_hypre_boomeramg_max_coarse_size": 50,
}


class HeldSystem:
    """Linear solves with chosen contact dofs held at the obstacle.

    Args:
        problem: The problem.
        options: PETSc options of the linear solver, without prefix.

    Attributes:
        solves: Number of linear solves so far.
        setups: Number of multigrid set-ups so far.
        iterations: Number of conjugate gradient iterations so far.
    """

    def __init__(self, problem: DiscreteProblem, options: Mapping[str, Any] | None = None):
        self.problem = problem
        self.solves = self.setups = self.iterations = 0
        self._held: Mask | None = None
        self._set_up_for: Mask | None = None
        self.matrix: PETSc.Mat | None = None
        self.rhs = problem.A.createVecLeft()
        problem.ledger.add("vector", "right-hand side with held dofs", self.rhs)
        self.ksp = PETSc.KSP().create(problem.comm)
        prefix = "dolfinx_signorini_held_"
        self.ksp.setOptionsPrefix(prefix)
        database = PETSc.Options()
        settings = DEFAULT_OPTIONS | dict(options or {})
        for key, value in settings.items():
            database[prefix + key] = value
        try:
            self.ksp.setFromOptions()
        finally:
            for key in settings:
                database.delValue(prefix + key)
        self.ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)

    def solve(self, x: PETSc.Vec, held: Mask, atol: float) -> None:
        """Solve for the dofs that are not held, from x on, until the residual norm is atol.

        Raises:
            InputError: The form turned out to be indefinite.
        """
        self._hold(held)
        problem = self.problem
        dofs = problem.contact_dofs[held]
        x.array_w[dofs] = problem.obstacle[held]
        x.array_w[problem.fixed_dofs] = problem.fixed_values
        # The correction to x in the unit of its residual: no square overflows or underflows.
        unit = self._residual(x, dofs)
        self.ksp.setTolerances(
            rtol=0.0, atol=atol / unit, divtol=1e30, max_it=MAX_LINEAR_ITERATIONS
        )
        correction = x.duplicate()
        problem.ledger.add("vector", "correction with held dofs", correction)
        self.ksp.solve(self.rhs, correction)
        correction.array_w[dofs] = 0.0  # a hierarchy for another set moves them by rounding
        x.axpy(unit, correction)
        correction.destroy()
        self.solves += 1
        self.iterations += self.ksp.getIterationNumber()
        reason = self.ksp.getConvergedReason()
        if reason < 0:
            self._held = self._set_up_for = None  # no second solve with this hierarchy
        indefinite = reason in (
            PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT,
            PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_PC,
        )
        # A small residual or a form that vanishes on constants looks indefinite through rounding.
        if indefinite and not problem.singular and self.ksp.getResidualNorm() > ROUNDED:
            raise InputError("form a: not positive definite, found by conjugate gradients")

    def _hold(self, held: Mask) -> None:
        comm, problem = self.problem.comm, self.problem
        changed = True if self._held is None else bool((held != self._held).any())
        if not comm.allreduce(changed, op=MPI.LOR):
            return
        if self.matrix is None:
            self.matrix = problem.A.copy()
            problem.ledger.add("matrix", "A with held dofs", self.matrix)
        else:
            problem.A.copy(self.matrix, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        offset = self.matrix.getOwnershipRange()[0]
        rows = problem.contact_dofs[held] + offset
        self.matrix.zeroRowsColumns(rows, diag=self._diagonal())
        self._held = held.copy()
        # A set-up costs as much as eight iterations, a hierarchy that is few dofs off one or two.
        reuse = False
        if self._set_up_for is not None:
            off = comm.allreduce(int((held != self._set_up_for).sum()))
            reuse = off <= REUSE_LIMIT
        self.ksp.getPC().setReusePreconditioner(reuse)
        self.ksp.setOperators(self.matrix)
        self.ksp.setUp()
        if not reuse:
            self._set_up_for = self._held
            self.setups += 1

    def _diagonal(self) -> float:
        """A typical diagonal entry, so that held rows are not outliers of the matrix."""
        entries = self.problem.contact_diagonal
        total, count = self.problem.comm.allreduce(np.array([entries.sum(), len(entries)]))
        return float(total / count) if count else 1.0

    def _residual(self, x: PETSc.Vec, dofs: npt.NDArray[np.int32]) -> float:
        """Set the right-hand side to b - A x on the free dofs, 0 on others; return its unit."""
        problem = self.problem
        problem.A.mult(x, self.rhs)
        self.rhs.aypx(-1.0, problem.b)
        self.rhs.array_w[dofs] = 0.0
        self.rhs.array_w[problem.fixed_dofs] = 0.0
        largest = self.rhs.norm(PETSc.NormType.INFINITY)
        unit = power_of_two(largest) if largest > 0.0 else 1.0
        self.rhs.scale(1.0 / unit)
        return unit

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for item in (self.ksp, self.rhs, self.matrix):
            if item is not None:
                item.destroy()


def solve_active_set(
    system: HeldSystem,
    optimality: Optimality,
    x: PETSc.Vec,
    held: Mask,
    rtol: float,
    trusted: bool,
) -> float:
    """Run the primal-dual active set method.

    It takes two short cuts, loose linear solves and local corrections. Where they lead nowhere, it
    goes on without them: the sets of exact steps are monotone for an M-matrix, and a set that
    comes back is a cycle.

    Args:
        system: The linear solver.
        optimality: Measures the natural residual.
        x: Start for the linear solver; the solution on return.
        held: Guess of the active set, one entry per contact dof.
        rtol: Relative natural residual to reach.
        trusted: Whether the guess is good enough to solve for it to the end at once.

    Returns:
        The relative natural residual reached; larger than rtol where the set does not settle.
    """
    problem = system.problem
    residual, best, stalled, local = 1.0, np.inf, 0, 0
    exact: list[Mask] = []  # sets whose solution was found without short cuts
    for _ in range(MAX_STEPS):
        careful = stalled == STALL
        if careful and _any_equal(problem, exact, held):
            break
        if problem.singular and not problem.comm.allreduce(int(held.sum())):
            held = _closest(problem, optimality, x)
        target = rtol * LINEAR_FRACTION
        if not (trusted or careful):
            target = max(target, LOOSE * residual)
        system.solve(x, held, target * optimality.scale)
        residual = optimality.measure(x)
        if residual <= rtol:
            break
        update = None
        if careful:
            exact.append(held)
        else:
            stalled = 0 if optimality.norm < best else stalled + 1
            best = min(best, optimality.norm)
            if stalled < STALL:
                update = _correct_locally(problem, optimality, x, held, reach=2**local)
        local = 0 if update is None else local + 1
        held = _defect(problem, optimality, x) > 0.0 if update is None else update
        trusted = local > 0 and (trusted or residual < TRUST)
    return residual


def _closest(problem: DiscreteProblem, optimality: Optimality, x: PETSc.Vec) -> Mask:
    """Return the set of the contact dofs next to being held: without any, no forces balance."""
    optimality.measure(x)
    defect = _defect(problem, optimality, x)
    largest = problem.comm.allreduce(float(defect.max(initial=-np.inf)), op=MPI.MAX)
    return np.asarray(defect == largest)


def _any_equal(problem: DiscreteProblem, sets: Sequence[Mask], held: Mask) -> bool:
    equal = np.array([not (other != held).any() for other in sets], dtype=bool)
    problem.comm.Allreduce(MPI.IN_PLACE, equal, op=MPI.LAND)
    return bool(equal.any())


def _defect(problem: DiscreteProblem, optimality: Optimality, x: PETSc.Vec) -> Array:
    """Return multiplier minus scaled gap at the contact dofs: positive where to hold."""
    gap = x.array_r[problem.contact_dofs] - problem.obstacle
    pressure = optimality.multiplier.array_r[problem.contact_dofs]
    return np.asarray(pressure - problem.contact_diagonal * gap)


def _correct_locally(
    problem: DiscreteProblem, optimality: Optimality, x: PETSc.Vec, held: Mask, reach: int
) -> Mask | None:
    """Return the active set with its wrong parts replaced by those of patch problems.

    Args:
        problem: The problem.
        optimality: Holds the multiplier of x.
        x: The solution for the set held; made feasible if there is a local change.
        held: The active set.
        reach: How far the patches go, as a multiple of their usual size: doubled from one local
            correction to the next, so that an end of the contact set can move far in a few.

    Returns:
        The set, or None where the change is no local one.
    """
    defect = _defect(problem, optimality, x)
    wrong = (defect > 0.0) != held
    # What is far below the largest defect may be its consequence.
    largest = problem.comm.allreduce(float(np.abs(defect[wrong]).max(initial=0.0)), op=MPI.MAX)
    severe = wrong & (np.abs(defect) >= SEVERE * largest)
    counts = problem.comm.allreduce(np.array([severe.sum(), len(held)]))
    if counts[0] > max(LOCAL_FRACTION * counts[1], 8):
        return None
    problem.project(x)
    optimality.measure(x)
    seeds = problem.contact_dofs[severe]
    update = active_in_patch(problem, x, optimality.multiplier, held, seeds, reach)
    changed = problem.comm.allreduce(bool((update != held).any()), op=MPI.LOR)
    return update if changed else None
