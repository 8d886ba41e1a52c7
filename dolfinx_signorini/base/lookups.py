"""Values of items, for example of the cells of a mesh, that other ranks own."""

from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Indices, LocalIndices

Rows = npt.NDArray[Any]  # one row for each item, of any shape and kind


class Lookup:
    """Items that this rank asks for, wherever they are owned:

        lookup = Lookup(comm, len(values), numbers)
        found = lookup.of(values)

    The making of one, and all its methods, are collective. A rank sends each other rank what that
    one has asked for, and nothing else.

    Args:
        comm: The communicator.
        count: How many items this rank owns. The items are numbered from rank to rank.
        numbers: The items that this rank asks for, by their numbers among those of all ranks.

    Attributes:
        numbers: These numbers.
        items: The owned items that ranks ask for, from rank to rank, by their local numbers. On one
            rank they are the numbers themselves.
    """

    def __init__(self, comm: MPI.Comm, count: int, numbers: Indices):
        self.comm, self.count, self.numbers = comm, count, numbers
        ends = np.cumsum(comm.allgather(count))
        owners = np.searchsorted(ends, numbers, side="right")
        self._order = np.argsort(owners, kind="stable")
        self._asked = np.bincount(owners, minlength=comm.size)
        self._told = np.empty_like(self._asked)
        comm.Alltoall(self._asked, self._told)
        first = ends[comm.rank] - count
        self.items: LocalIndices = (self.sent(numbers) - first).astype(np.int32)

    def of(self, values: Rows) -> Rows:
        """Return the rows of the items that this rank asks for, of one row for each owned item."""
        return self.returned(values[self.items])

    def sent(self, values: Rows) -> Rows:
        """Send a row for each item that this rank asks for to the rank that owns the item.

        Returns:
            The rows that have come here, in the order of `items`.
        """
        return self._exchanged(values[self._order], self._asked, self._told)

    def returned(self, values: Rows) -> Rows:
        """Send a row for each of `items` to the rank that asks for the item.

        Returns:
            The rows that have come here, in the order of `numbers`.
        """
        found = self._exchanged(values, self._told, self._asked)
        result = np.empty_like(found)
        result[self._order] = found
        return result

    def through(self, step: "Lookup") -> "Lookup":
        """Return for each item of another lookup, which asks for rows of this one, what is asked
        here."""
        return Lookup(self.comm, self.count, step.of(self.numbers))

    def _exchanged(self, values: Rows, given: Indices, taken: Indices) -> Rows:
        if self.comm.size == 1:
            return values
        values = np.ascontiguousarray(values)
        shape = values.shape[1:]
        row = MPI.BYTE.Create_contiguous(values.itemsize * int(np.prod(shape))).Commit()
        result = np.empty((int(taken.sum()), *shape), dtype=values.dtype)
        self.comm.Alltoallv([values, given, row], [result, taken, row])
        row.Free()
        return result
