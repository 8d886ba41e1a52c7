"""Loose motions of the connected components of a mesh, which contact alone holds."""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.tolerances import ROUNDING


@dataclass(frozen=True)
class Loose:
    """Motions of bodies on which the form vanishes and that are zero at Dirichlet data.

    Only contact holds such motions: of one component the constants, of vectors some rigid motions.

        loose = Loose(comm, counts, numbers, rows)
        work = loose.sums(b.array_r)

    Attributes:
        comm: The communicator of the mesh.
        counts: The number of motions of each component of the mesh; none where nothing is loose.
        numbers: The number of the component of each owned dof.
        rows: The motions of its component at each owned dof, of size 1 in the mean over the nodes;
            shape (dofs, motions), with zeros for components that have less.
    """

    comm: MPI.Comm
    counts: LocalIndices
    numbers: LocalIndices
    rows: Array

    @staticmethod
    def nothing(comm: MPI.Comm) -> "Loose":
        """Return that nothing is loose."""
        none = np.empty(0, dtype=np.int32)
        return Loose(comm, none, none, np.empty((0, 0)))

    def __bool__(self) -> bool:
        return bool(self.counts.any())

    def sums(self, values: Array) -> Array:
        """Return the sums of values times motions, shape (components, motions); collective.

        Args:
            values: One value for each owned dof.
        """
        found = [np.bincount(self.numbers, values * row, len(self.counts)) for row in self.rows.T]
        return np.asarray(self.comm.allreduce(np.stack(found, axis=1)))

    def products(self, u: Array | None = None, v: Array | None = None) -> list[Array]:
        """Return the sums of products of columns over the dofs of each component; collective.

        Args:
            u, v: Columns with a row for each owned dof; the motions by default.

        Returns:
            For each component an array, shape (columns of u, columns of v).
        """
        u, v, count = self.rows if u is None else u, self.rows if v is None else v, len(self.counts)
        found = np.zeros((count, u.shape[1], v.shape[1]))
        for i, j in np.ndindex(found.shape[1:]):
            found[:, i, j] = np.bincount(self.numbers, u[:, i] * v[:, j], count)
        return list(self.comm.allreduce(found))

    def parted(self, dofs: LocalIndices) -> list[tuple[Array, Array]]:
        """Return for each component which combinations move some dofs, and which move none.

        Args:
            dofs: Owned dofs; the call is collective.

        Returns:
            Two arrays of orthonormal columns with a row for each motion.
        """
        some = Loose(self.comm, self.counts, self.numbers[dofs], self.rows[dofs])
        found, most = [], self.rows.shape[1]
        for number, square in zip(self.counts, some.products(), strict=True):
            values, vectors = np.linalg.eigh(square[:number, :number])
            whole = np.zeros((most, number))
            whole[:number] = vectors
            moving = values > ROUNDING * max(1.0, values.max(initial=0.0))
            found.append((whole[:, moving], whole[:, ~moving]))
        return found

    def combined(self, parts: "list[Array]") -> "Loose":
        """Return the motions that are combinations of these, for each component some.

        Args:
            parts: For each component the combinations, as columns with a row for each motion.
        """
        counts = np.array([part.shape[1] for part in parts], dtype=np.int32)
        whole = np.zeros((len(parts), self.rows.shape[1], counts.max(initial=0)))
        for part, into in zip(parts, whole, strict=True):
            into[: len(part), : part.shape[1]] = part
        rows = np.einsum("ni,nij->nj", self.rows, whole[self.numbers])
        return Loose(self.comm, counts, self.numbers, rows)
