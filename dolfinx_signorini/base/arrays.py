"""Names of arrays in annotations, the same in the whole package."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
Indices: TypeAlias = npt.NDArray[np.int64]  # of rows of other arrays, and global numbers
LocalIndices: TypeAlias = npt.NDArray[np.int32]  # of dofs, cells and facets, as DOLFINx has them
Mask: TypeAlias = npt.NDArray[np.bool_]

PLACES = 9  # digits of a place in a box that are not rounding
BLOCK = 131_072  # rows of an array that are worked on at a time: little memory for NumPy


def places(points: Sequence[Sequence[float]] | Array, digits: int = PLACES) -> Array:
    """Return rounded places of points in the box around them, which no unit and no rank decides.

    Args:
        points: Coordinates, shape (points, dimension).
        digits: The digits that are kept.
    """
    x = np.asarray(points, dtype=np.float64)
    if not len(x):
        return np.zeros((0, 1))
    low, high = x.min(axis=0), x.max(axis=0)
    return np.asarray(np.round((x - low) / (float((high - low).max()) or 1.0), digits) + 0.0)
