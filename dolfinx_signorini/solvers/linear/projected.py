"""The operator and the preconditioner on the dofs that are not held.

With the held dofs eliminated, the operator is P A P, P the projection that zeroes the held dofs: no
matrix is changed or copied for the elimination. A preconditioner M that was set up for another set
of held dofs serves as P M P between two local solves around the dofs that have changed since:
without the local solves each released dof costs CG about one iteration.
"""

from contextlib import suppress
from typing import Any

import numpy as np
import scipy.sparse as sp
from petsc4py import PETSc
from scipy.sparse.linalg import splu

from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.solvers.patch import affordable_patch, patch_dofs
from dolfinx_signorini.solvers.system import System

# Of all dofs: a local solve with more of them costs more than the iterations that it saves. On
# meshes graded towards a point the usual layers around the point are nearly the whole mesh.
LARGE = 0.05
# Of SuperLU, for positive definite matrices: no pivoting, and an order for symmetric patterns; the
# factors have half of the entries.
SYMMETRIC: dict[str, Any] = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.0,
    "options": {"SymmetricMode": True},
}


class Projected:
    """The operator P A P and its preconditioner, as PETSc objects for a KSP.

    For example:

        projected = Projected(A, pc)
        projected.hold(system, held)
        ksp.setOperators(projected.operator)
        ksp.setPC(projected.preconditioner)

    Args:
        A: The matrix.
        pc: The preconditioner M, set up by the caller.
    """

    def __init__(self, A: PETSc.Mat, pc: PETSc.PC):
        self.A, self.pc = A, pc
        self._zeroed: LocalIndices = np.empty(0, dtype=np.int32)
        self._local: LocalSolve | None = None
        self._first, self._rest = A.createVecRight(), A.createVecLeft()
        self.operator = PETSc.Mat().createPython(A.getSizes(), self, comm=A.comm)
        self.operator.setUp()
        self.preconditioner = PETSc.PC().create(A.comm)
        self.preconditioner.setType(PETSc.PC.Type.PYTHON)
        self.preconditioner.setPythonContext(self)

    def hold(self, system: System, held: Mask, changed: LocalIndices | None = None) -> None:
        """Choose the dofs to hold.

        Args:
            system: The system.
            held: Which constraints of this rank hold their dofs at the obstacle.
            changed: Owned dofs that M treats otherwise, on some rank; None where no rank has any.
        """
        self._zeroed = system.known_dofs(held)
        self._local = None if changed is None else LocalSolve(system, changed, self._zeroed)

    def project(self, vec: PETSc.Vec) -> None:
        """Zero the held dofs of a vector."""
        vec.array_w[self._zeroed] = 0.0

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to P A x, for an x that is zero at the held dofs."""
        self.A.mult(x, y)
        self.project(y)

    def apply(self, pc: PETSc.PC, r: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to P M r, corrected locally before and after."""
        if self._local is None:
            self.pc.apply(r, y)
            self.project(y)
            return
        if self.A.comm.size == 1:
            first = self._local.before(r, self._rest)
            self.pc.apply(self._rest, y)
            self.project(y)
            self._local.after(r, y, first)
            return
        self._local(r, self._first)
        self._remainder(r, self._first)
        self.pc.apply(self._rest, y)
        y.axpy(1.0, self._first)
        self.project(y)
        self._remainder(r, y)
        self._local(self._rest, self._first)
        y.axpy(1.0, self._first)

    def free(self) -> None:
        """Free the PETSc objects; a method `destroy` would be called by PETSc, too."""
        destroy(self.preconditioner, self.operator, self._first, self._rest)

    def _remainder(self, r: PETSc.Vec, y: PETSc.Vec) -> None:
        self.mult(self.operator, y, self._rest)
        self._rest.aypx(-1.0, r)


class LocalSolve:
    """A direct solve with the free dofs of a rank near some dofs, all others held.

    On one rank the remainders need only the rows near the dofs; see `before` and `after`.

    Args:
        system: The system.
        seeds: The owned dofs around which to solve; the creation is collective.
        held: Owned dofs that are held.
    """

    def __init__(self, system: System, seeds: LocalIndices, held: LocalIndices):
        first, last = system.A.getOwnershipRange()
        free = np.ones(last - first, dtype=bool)
        free[held] = False
        near, layers = affordable_patch(system, seeds, LARGE)
        near, around = (
            dofs[(dofs >= first) & (dofs < last)] - first
            for dofs in (near, patch_dofs(system, seeds, layers + 1))
        )
        self._dofs, self._around = near[free[near]], around[free[around]]
        index_set = PETSc.IS().createGeneral(self._around + first, comm=PETSc.COMM_SELF)
        (matrix,) = system.A.createSubMatrices(index_set)
        self._factors = None
        if len(self._dofs):
            entries = sp.csr_matrix(matrix.getValuesCSR()[::-1], shape=matrix.getSize())
            inside = np.isin(self._around, self._dofs)
            self._rows = entries[inside]
            self._columns = self._rows.T.tocsr()
            # A block that is singular through rounding, on this rank alone, saves no iterations.
            with suppress(RuntimeError):
                self._factors = splu(self._rows[:, inside].tocsc(), **SYMMETRIC)
        destroy(matrix, index_set)

    def __call__(self, r: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to the solution for the right-hand side r, and to zero away from the dofs."""
        y.set(0.0)
        if self._factors is not None:
            y.array_w[self._dofs] = self._factors.solve(r.array_r[self._dofs])

    def before(self, r: PETSc.Vec, rest: PETSc.Vec) -> Array:
        """Return the local solution for the right-hand side r, and set `rest` to the remainder."""
        r.copy(rest)
        if self._factors is None:
            return np.empty(0)
        solution = np.asarray(self._factors.solve(r.array_r[self._dofs]))
        rest.array_w[self._around] -= self._columns @ solution
        return solution

    def after(self, r: PETSc.Vec, y: PETSc.Vec, solution: Array) -> None:
        """Add to y the solution from `before`, then the local solution of what y leaves of r."""
        if self._factors is None:
            return
        values = y.array_w
        values[self._dofs] += solution
        left = r.array_r[self._dofs] - self._rows @ values[self._around]
        values[self._dofs] += self._factors.solve(left)
