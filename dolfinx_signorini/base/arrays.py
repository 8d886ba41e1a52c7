"""Names of arrays in annotations, the same in the whole package."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
Indices: TypeAlias = npt.NDArray[np.int64]  # of rows of other arrays, and global numbers
LocalIndices: TypeAlias = npt.NDArray[np.int32]  # of dofs, cells and facets, as DOLFINx has them
Mask: TypeAlias = npt.NDArray[np.bool_]

BLOCK = 131_072  # rows of an array that are worked on at a time: little memory for NumPy


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
