"""The rows of PETSc's matrices as the compiled loops see them, without a copy."""

import ctypes
import functools
from typing import Any, TypeAlias

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices, Mask
from dolfinx_signorini.base.kernels import INT, loops, run
from dolfinx_signorini.base.petsc import destroy

# Entries of a matrix that change: their places among all entries, their rows, and by how much.
Changes: TypeAlias = tuple[Indices, Indices, Array]


@functools.cache
def _petsc() -> ctypes.CDLL:
    return ctypes.CDLL(PETSc.__file__)


class Rows:
    """The rows of a matrix that a rank owns, in their local columns and in those of other ranks.

    For example, one projected Gauss-Seidel sweep for the correction of x with the residual r:

        Rows(A).sweep("forward", r, lower, upper, x, step)

    Args:
        matrix: A matrix of PETSc's type AIJ, which must live as long as this object; the creation
            is collective.

    Attributes:
        others: The global numbers of the columns of other ranks.
    """

    def __init__(self, matrix: PETSc.Mat):
        self._ffi, _ = loops()
        self.matrix, self.others = matrix, np.empty(0, dtype=PETSc.IntType)
        local, other, numbers = (ctypes.c_void_p() for _ in range(3))
        if matrix.getType() == PETSc.Mat.Type.SEQAIJ:
            local.value = matrix.handle
        else:
            _petsc().MatMPIAIJGetSeqAIJ(
                ctypes.c_void_p(matrix.handle),
                *(ctypes.byref(each) for each in (local, other, numbers)),
            )
        self._local = self._pointers(local, matrix.getLocalSize()[0])
        self._other: tuple[Any, ...] | None = None
        if other.value is not None:
            count = ctypes.c_int64(0)
            _petsc().MatGetSize(other, None, ctypes.byref(count))
            size = count.value
            self._other = self._pointers(other, matrix.getLocalSize()[0])
            if size:
                memory = self._ffi.cast(f"{INT} *", numbers.value)
                buffer = self._ffi.buffer(memory, size * np.dtype(PETSc.IntType).itemsize)
                self.others = np.frombuffer(buffer, dtype=PETSc.IntType).copy()

    def sweep(
        self,
        kind: str,
        rest: PETSc.Vec,
        lower: Array,
        upper: Array,
        x: Array,
        step: PETSc.Vec,
        count: int = 1,
    ) -> None:
        """Correct x by Gauss-Seidel sweeps within bounds, with the columns of other ranks left out.

        Args:
            kind: "forward", "backward", or "settle" for `count` sweeps there and back.
            rest: The residual of x.
            lower, upper: The bounds of x, infinite where there is none.
            x: The values, changed in place.
            step: Set to the change of x.
        """
        counted = (count,) if kind == "settle" else ()
        run(kind, *self._local, rest.array_r, lower, upper, x, step.array_w, *counted)

    def largest(self, values: Array) -> Array:
        """Return for each own column the largest value of a row with an entry there; collective.

        Args:
            values: A value for each row of this rank.
        """
        found = np.full(self.matrix.getLocalSize()[1], -np.inf)
        run("largest", *self._local, values, found)
        if self.matrix.comm.size == 1:
            return found
        there = PETSc.Vec().createWithArray(np.full(len(self.others), -np.inf), comm=MPI.COMM_SELF)
        if self._other is not None:
            run("largest", *self._other, values, there.array_w)
        here = self.matrix.createVecRight()
        here.array_w[:] = found
        places = PETSc.IS().createGeneral(self.others, comm=MPI.COMM_SELF)
        scatter = PETSc.Scatter().create(here, places, there, None)
        mode = PETSc.ScatterMode.REVERSE
        scatter.scatter(there, here, addv=PETSc.InsertMode.MAX_VALUES, mode=mode)
        found[:] = here.array_r
        destroy(there, here, places, scatter)
        return found

    def fill(self, rows: LocalIndices, value: float) -> None:
        """Set diagonal entries of some owned rows of a square matrix; the call is collective."""
        run("fill", *self._local, len(rows), rows, value, self._local[-1])
        self.matrix.assemble()

    def coupling(self) -> Array:
        """Return for each row the sum of the sizes of its entries in columns of other ranks."""
        sums = np.zeros(self.matrix.getLocalSize()[0])
        if self._other is not None:
            run("sizes", *self._other, sums)
        return sums

    def changes(self, before: Mask, now: Mask, diagonal: float, result: "Rows") -> Changes:
        """Make the changes of this matrix without the rows and columns of held dofs.

        Args:
            before: Which dofs were held.
            now: Which dofs are held.
            diagonal: The diagonal entries of held dofs in the result.
            result: The matrix with these entries, on one rank, which is changed in place.

        Returns:
            The changes of the matrix whose diagonal entries of held dofs are 0.
        """
        dofs = np.flatnonzero(before != now).astype(np.int32)
        given = *self._local, before, now, len(dofs), dofs, diagonal, result._local[-1]
        found = self._noted("changed", *given)
        result.matrix.assemble()
        return found

    def renew(self, changes: Changes, prolongation: "Rows", product: "Rows") -> Changes:
        """Renew a Galerkin product of this matrix, and return the changes of the product.

        Args:
            changes: The changes of this matrix.
            prolongation: The prolongation, on one rank.
            product: The product, changed in place.
        """
        given = *self._local, len(changes[0]), *changes, *prolongation._local[1:]
        found = product._noted("carried", *given, *product._local[1:])
        product.matrix.assemble()
        return found

    def _noted(self, kind: str, *given: Any) -> Changes:
        """Run a loop that notes changes of this matrix."""
        entries = int(self._local[1][self._local[0]])
        slots = np.zeros(entries, dtype=PETSc.IntType)  # where each change is noted, from 1 on
        places, owners = (np.empty(entries, dtype=PETSc.IntType) for _ in range(2))
        by = np.empty(entries)
        count = run(kind, *given, slots, places, owners, by)
        return places[:count].copy(), owners[:count].copy(), by[:count].copy()

    def units(self) -> tuple[LocalIndices, Indices]:
        """Return the rows of this rank with one entry, 1 or -1, and the columns of these."""
        rows, columns = [], []
        first = self.matrix.getOwnershipRangeColumn()[0]
        numbers = first + np.arange(self.matrix.getLocalSize()[1]), self.others
        parts = [self._local] if self._other is None else [self._local, self._other]
        entries = np.zeros(self._local[0], dtype=np.int32)
        for part in parts:
            run("counts", *part, entries)
        for part, known in zip(parts, numbers, strict=False):
            found = np.empty((2, len(entries)), dtype=np.int32)
            count = run("units", *part, entries, *found)
            rows.append(found[0, :count])
            columns.append(known[found[1, :count]])
        return np.concatenate(rows), np.concatenate(columns).astype(PETSc.IntType)

    def injected(self, values: Array, none: float) -> Array:
        """Return for each own column the value of the row that is the same node; collective.

        Args:
            values: A value for each row of this rank.
            none: The value of columns without such a row.
        """
        rows, columns = self.units()
        result = self.matrix.createVecRight()
        result.set(none)
        result.assemble()
        result.setValues(columns, values[rows])
        result.assemble()
        found = result.array_r.copy()
        result.destroy()
        return found

    def _pointers(self, matrix: ctypes.c_void_p, rows: int) -> tuple[Any, ...]:
        """The number of rows and the arrays of a matrix of this rank alone."""
        arrays = [ctypes.c_void_p() for _ in range(3)]
        places = (ctypes.byref(each) for each in arrays)
        _petsc().MatSeqAIJGetCSRAndMemType(matrix, *places, None)
        kinds = (f"{INT} *", f"{INT} *", "double *")
        return rows, *(
            self._ffi.cast(kind, each.value or 0) for kind, each in zip(kinds, arrays, strict=True)
        )
