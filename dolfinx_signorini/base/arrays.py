"""Names of arrays in annotations, for the whole package; unions, rows in blocks and in an order."""

from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

Array: TypeAlias = npt.NDArray[np.float64]
Indices: TypeAlias = npt.NDArray[np.int64]  # of rows of other arrays, and global numbers
LocalIndices: TypeAlias = npt.NDArray[np.int32]  # of dofs, cells and facets, as DOLFINx has them
Mask: TypeAlias = npt.NDArray[np.bool_]

BLOCK = 131_072  # rows of an array that are worked on at a time: little memory for NumPy


def blocks(rows: int, width: int, comm: MPI.Comm = MPI.COMM_SELF) -> list[slice]:
    """Return slices of rows of some numbers, each so short that caches hold the rows.

    Args:
        rows: The number of rows.
        width: The number of numbers in each.
        comm: The ranks that have the same number of slices; collective.
    """
    count = comm.allreduce(1 + rows * width // BLOCK, op=MPI.MAX)
    ends = np.linspace(0, rows, count + 1).astype(int)
    return list(map(slice, ends[:-1], ends[1:]))


def union(parts: Iterable[npt.NDArray[np.integer[Any]]]) -> LocalIndices:
    """Return the indices that are in some of several arrays, each once and in order."""
    return np.unique(np.concatenate([np.empty(0, dtype=np.int32), *parts])).astype(np.int32)


def by_place(
    points: Sequence[Sequence[float]] | Array,
    first: Sequence[float] | Array | None = None,
    digits: int = 9,
) -> Indices:
    """Return the order of points by their coordinates, which no rounding and no rank decides.

    Args:
        points: Coordinates, shape (points, dimension).
        first: Values that count before the coordinates.
        digits: The digits of places in the box around the points that are not rounding.
    """
    x = np.asarray(points, dtype=np.float64)
    if not len(x):
        return np.empty(0, dtype=np.int64)
    low, high = x.min(axis=0), x.max(axis=0)
    keys = np.round((x - low) / (float((high - low).max()) or 1.0), digits)
    return np.lexsort((*keys.T[::-1], *(() if first is None else (first,))))
