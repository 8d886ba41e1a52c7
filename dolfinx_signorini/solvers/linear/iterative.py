"""Linear solves with some contact dofs held at the obstacle.

A preconditioner needs a matrix. The matrix with the rows and columns of the held dofs replaced by a
diagonal is made when the preconditioner is set up.

The preconditioner is multigrid over the lower degrees and the coarser meshes that are known, see
`hierarchy`, or algebraic multigrid alone, see `algebraic`. Coefficients that no coarse mesh
resolves may slow the former down: a solver that sees this turns to the latter for good. The former
is set up for each set of held dofs. A set-up of the latter, which costs more, serves another set,
see `projected`, if no more than a share of the contact dofs has changed. A set-up that costs more
additional iterations than a new one is dropped.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Mask
from dolfinx_signorini.base.errors import INDEFINITE, InputError
from dolfinx_signorini.base.petsc import NO_NODES, destroy
from dolfinx_signorini.base.ranks import anywhere
from dolfinx_signorini.base.tolerances import SIX_DIGITS, TINY
from dolfinx_signorini.solvers.linear.algebraic import amg_options
from dolfinx_signorini.solvers.linear.multigrid import multigrid_for
from dolfinx_signorini.solvers.linear.options import options_set, warn_of_unread
from dolfinx_signorini.solvers.linear.projected import Projected
from dolfinx_signorini.solvers.linear.solver import Check, LinearSolver, has_few_dofs, set_residual
from dolfinx_signorini.solvers.motions import attach_motions, motions_of
from dolfinx_signorini.solvers.stop import Stop
from dolfinx_signorini.solvers.system import System

SETUP_ITERATIONS = 10  # what a set-up of BoomerAMG costs in the plane, in iterations; in space 17
GEOMETRIC_ITERATIONS = 4  # what a set-up of geometric multigrid costs
# Geometric multigrid is slow where so many iterations reduce the residual by less than a factor, or
# a multiple of them by less than its power: on stretched cells the first digits are quick. By
# dimension: BoomerAMG costs as much as 40 iterations in the plane and 80 in space.
PERIOD = 8
LITTLE = {1: 1e-2, 2: 1e-2, 3: 1e-1}
# Of the contact dofs: so many may have changed since the set-up. With half of them three ranks take
# twice the iterations on small problems in the plane, and with a twentieth every second step of a
# loop in space makes a set-up (benchmarks/time_steps.py).
REUSE = 0.2
MAX_ITERATIONS = 500


class IterativeSolver(LinearSolver):
    """A linear solver by conjugate gradients, see `LinearSolver`.

    The preconditioner is multigrid over degrees and meshes where coarser ones are known, else
    algebraic multigrid. An option that begins with "pc_" chooses PETSc's preconditioners, of which
    BoomerAMG is the default, or GAMG for vectors.
    """

    def __init__(self, system: System, prefix: str = "", options: Mapping[str, Any] | None = None):
        super().__init__(system, prefix, options)
        self._block = system.layout.block
        self._pace = self._excess = 0.0
        self._checks: list[Check] = []  # of the present solve
        self._unit = 1.0  # of the correction
        self._contact_rows: PETSc.Mat | None = None
        self._multiplied = 0  # how often the matrix of these rows had been assembled
        self._little = LITTLE[system.space.mesh.topology.dim]
        self._watched = math.inf  # the residual above which the iterations so far were slow
        self._ksp.setOptionsPrefix(prefix)
        alone = system.comm.size == 1
        amg = amg_options(self._block, has_few_dofs(system), alone=alone)
        self._defaults = {"ksp_type": "cg"} | amg
        with options_set(prefix, self._options, self._defaults) as self._unread:
            self._ksp.setFromOptions()
        self._pc = self._ksp.getPC()
        coarsest = amg_options(self._block, coarsest=True, alone=alone)
        self.multigrid = multigrid_for(system, prefix, self._options, coarsest)
        self._projected = Projected(system.A, self._pc)
        self._ksp.setPC(self._projected.preconditioner)
        self._ksp.setOperators(self._projected.operator)
        self._ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        self._ksp.addConvergenceTest(self._ended)

    def solve(
        self,
        system: System,
        x: PETSc.Vec,
        held: Mask,
        atol: float,
        multiplier: PETSc.Vec | None = None,
        stop: Stop | None = None,
        check: Check | None = None,
    ) -> None:
        """Solve by conjugate gradients, see `LinearSolver`."""
        if system.place(x, held):
            multiplier = None
        self.solves += 1
        fresh = self._prepare(system, held)
        self._checks = [] if check is None else [check]
        if stop is not None and self.multigrid is not None:
            self._checks.append(stop.enough)
        if stop is not None and not stop.begun and self.multigrid is not None:
            self._begin_coarse(system, x, held, multiplier, stop)
            multiplier = None
        converged = self._correct(system, x, held, atol, fresh, multiplier)
        while not converged and (not fresh or self.multigrid is not None):
            if fresh:
                self._drop_levels()
            self._set_up(system, held)
            fresh = True
            converged = self._correct(system, x, held, atol, fresh, None)
        self._checks = []  # which refer to the caller, who has this solver

    def _begin_coarse(
        self, system: System, x: PETSc.Vec, held: Mask, multiplier: PETSc.Vec | None, stop: Stop
    ) -> None:
        """Add the solution on the next coarser mesh to x, which may say nothing at first."""
        assert self.multigrid is not None
        unit = set_residual(system, x, held, multiplier, self._rhs)
        known = np.zeros(x.getLocalSize(), dtype=bool)
        known[system.known_dofs(held)] = True
        if anywhere(self.comm, x.array_r[known] != 0.0):
            other, rest = x.copy(), self._rhs.duplicate()
            self.multigrid.extended(other, known)
            other_unit = set_residual(system, other, held, None, rest)
            if other_unit * rest.norm() <= unit * self._rhs.norm():
                other.copy(x)
                rest.copy(self._rhs)
                unit = other_unit
            destroy(other, rest)
        ratio = self.multigrid.nested(self._rhs, self._correction)
        if ratio > 0.0:
            self._projected.project(self._correction)
            self._add(x, unit)
            stop.begin(ratio ** (2.0 / system.space.mesh.topology.dim) - 1.0)

    def multiply(self, system: System, iterate: PETSc.Vec, result: PETSc.Vec) -> None:
        """Set a vector to A x - b for the present iterate, see `LinearSolver`."""
        if system.layout.in_domain:
            system.set_forces(iterate, result)
            return
        if self._contact_rows is None or self._multiplied != system.assembled:
            self._multiplied = system.assembled
            self._contact_rows = _contact_rows(system, self._contact_rows)
        dofs, forces = system.layout.free_dofs, self._contact_rows.createVecLeft()
        self._contact_rows.mult(iterate, forces)
        self._ksp.buildResidual(result)
        result.scale(-self._unit)
        result.array_w[dofs] = forces.array_r - system.b.array_r[dofs]
        forces.destroy()

    @property
    def preconditioner(self) -> str:
        """The preconditioner in words: geometric multigrid, or the type of PETSc."""
        if self.multigrid is not None:
            return self.multigrid.name
        kind = self._pc.getType()
        return str(self._pc.getHYPREType() if kind == PETSc.PC.Type.HYPRE else kind)

    def free(self) -> None:
        """Free the set-up of the preconditioner and its matrix; a next solve makes both anew."""
        self._pc.reset()
        if self.multigrid is not None:
            self.multigrid.free()
        destroy(self._matrix)
        self._matrix = self._held = None

    def destroy(self) -> None:
        """Free the PETSc objects."""
        super().destroy()
        destroy(self.multigrid, self._contact_rows, self._pc)
        self._projected.free()

    def _prepare(self, system: System, held: Mask) -> bool:
        """Hold the dofs, and set the preconditioner up unless the last set-up will do.

        Returns:
            Whether the set-up is new.
        """
        same = system.assembled == self._assembled
        if self._held is not None and (self.multigrid is None or self.multigrid.is_set_up):
            counts = np.array([(held != self._held).sum(), len(held)])
            changed, total = self.comm.allreduce(counts)
            # A method without iterations does not mend what a set-up lacks.
            mended = self._ksp.getType() != PETSc.KSP.Type.PREONLY
            reuse = 0.0 if self.multigrid is not None else REUSE
            if (changed == 0 and same) or (
                changed <= reuse * total and mended and self._excess < self._setup_iterations
            ):
                off = system.contact_dofs[held != self._held] if changed else None
                self._projected.hold(system, held, off)
                return False
        self._set_up(system, held)
        return True

    @property
    def _setup_iterations(self) -> int:
        """What a set-up costs, in iterations."""
        return SETUP_ITERATIONS if self.multigrid is None else GEOMETRIC_ITERATIONS

    def _drop_levels(self) -> None:
        """Put algebraic multigrid in place of the coarser meshes, or else of all levels."""
        assert self.multigrid is not None
        if not self.multigrid.drop_meshes():
            self.multigrid.destroy()
            self.multigrid, self._projected.pc = None, self._pc

    def _set_up(self, system: System, held: Mask) -> None:
        """Set the preconditioner up, whose parts read their options each time they are made."""
        with (
            options_set("", {}, {NO_NODES: None}),
            options_set(self._prefix, self._options, self._defaults) as unread,
        ):
            self._make_preconditioner(system, held)
        if self.setups == 1:
            known = {*self._options, *self._defaults}
            warn_of_unread(self._unread & unread, known, ("tao_",))

    def _make_preconditioner(self, system: System, held: Mask) -> None:
        if self.multigrid is None:
            matrix = self._hold(system.contact_dofs[held], _typical(system))
            if self._block > 1:  # constants are known without
                attach_motions(matrix, motions_of(system.layout), system.known_dofs(held))
            if self._pc.getType() == PETSc.PC.Type.GAMG:
                self._pc.reset()  # else a second set-up may wait for a rank without dofs for ever
            self._pc.setOperators(matrix)
            self._pc.setUp()
        else:
            known, number = system.known_dofs(held), system.assembled
            self.multigrid.set_up(system.A, known, _typical(system), number)
            self._projected.pc = self.multigrid.pc
        self._projected.hold(system, held)
        self._held, self._assembled = held.copy(), system.assembled
        self._pace = self._excess = 0.0
        self.setups += 1

    def _correct(
        self,
        system: System,
        x: PETSc.Vec,
        held: Mask,
        atol: float,
        fresh: bool,
        multiplier: PETSc.Vec | None,
    ) -> bool:
        """Add the correction that CG finds to x; return whether the residual was reached.

        With a set-up that is not fresh CG may take as many iterations more than with a fresh one
        as a set-up costs.
        """
        unit = set_residual(system, x, held, multiplier, self._rhs)
        start, target = self._rhs.norm(), atol / unit
        limit = MAX_ITERATIONS
        if not fresh and self._pace > 0.0 and target > 0.0:
            expected = self._pace * max(math.log10(max(start, target) / target), 1.0)
            limit = min(limit, math.ceil(expected) + self._setup_iterations)
        self._ksp.setTolerances(rtol=0.0, atol=target, divtol=1.0 / TINY, max_it=limit)
        self._unit = unit
        watched = fresh and self.multigrid is not None
        self._watched = self._little * start if watched else math.inf
        self._ksp.solve(self._rhs, self._correction)
        self._add(x, unit)
        iterations, end = self._ksp.getIterationNumber(), self._ksp.getResidualNorm()
        self.iterations += iterations
        self._wear(iterations, start, end)
        reason = self._ksp.getConvergedReason()
        if reason < 0:
            self._held = None  # no second solve with this set-up
        indefinite = reason in (
            PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT,
            PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_PC,
        )
        # A small residual or a form that vanishes on constants looks indefinite through rounding.
        final = self.multigrid is None
        if indefinite and final and not system.singular and end > SIX_DIGITS:
            raise InputError(f"{INDEFINITE}, found by conjugate gradients", "form a")
        return bool(reason > 0)

    def _add(self, x: PETSc.Vec, unit: float) -> None:
        """Add the correction to x, unless a preconditioner that failed has left no numbers."""
        if math.isfinite(self._correction.norm()):
            x.axpy(unit, self._correction)

    def _ended(self, ksp: PETSc.KSP, iterations: int, norm: float) -> Any:
        """Why a solve is to end: enough of convergence, or slow convergence of multigrid."""
        known = (ksp.vec_sol, iterations, norm, self._unit)
        if any(check(*known) for check in self._checks):
            return PETSc.KSP.ConvergedReason.CONVERGED_ATOL
        if self.multigrid is None or iterations == 0 or iterations % PERIOD != 0:
            return None
        slow = norm > self._watched
        self._watched *= self._little
        return PETSc.KSP.ConvergedReason.DIVERGED_DTOL if slow else None

    def _wear(self, iterations: int, start: float, end: float) -> None:
        """Count the iterations beyond those that the first solve after the set-up needed."""
        digits = math.log10(start / end) if 0.0 < end < start else 0.0
        if digits < 0.5:
            return
        if self._pace == 0.0:
            self._pace = iterations / digits
        self._excess += max(0.0, iterations - self._pace * digits)


def _contact_rows(system: System, rows: PETSc.Mat | None) -> PETSc.Mat:
    """Return the rows of the contact dofs of A, in those of an earlier matrix where given."""
    first, last = system.A.getOwnershipRange()
    chosen = PETSc.IS().createGeneral(system.layout.free_dofs + first, comm=system.comm)
    every = PETSc.IS().createStride(last - first, first, 1, comm=system.comm)
    found = system.A.createSubMatrix(chosen, every, rows)
    destroy(chosen, every)
    return found


def _typical(system: System) -> float:
    """A typical diagonal entry, so that held rows are no outliers of the matrix."""
    entries = system.contact_diagonal
    total, count = system.comm.allreduce(np.array([entries.sum(), len(entries)]))
    return float(total / count) if count else 1.0
