"""Rows of numbers that are alike: cells and patches of one shape share what depends on the shape.

Rows are compared by 64 bits each. Rows that differ have the same bits by an accident of probability
1e-19.
"""

import functools

import numpy as np
import numpy.typing as npt

from dolfinx_signorini.base.arrays import Array, Indices
from dolfinx_signorini.base.tolerances import SOLVED

Codes = npt.NDArray[np.uint64]


def alike(numbers: Array) -> tuple[Indices, Indices]:
    """Return the first of equal rows each, and for every row the number of its equals.

    Args:
        numbers: The rows, whose entries are equal where they are so near, up to rounding, as sizes
            near 1 can be told apart.
    """
    code = codes(np.rint(numbers / SOLVED).astype(np.int64))
    _, first, inverse = np.unique(code, return_index=True, return_inverse=True)
    return first, inverse.ravel()


def codes(rows: Indices) -> Codes:
    """Return 64 bits for each row of integers."""
    return np.asarray(rows.view(np.uint64) @ _factors(rows.shape[1]))


def codes_of_groups(members: Codes, begin: Indices, place: Indices) -> Codes:
    """Return 64 bits for each group of rows, which tell the order of the rows.

    Args:
        members: The bits of the rows, one group after the other.
        begin: The first row of each group.
        place: The place of each row in its group.
    """
    scrambled = members * _factors(int(place.max(initial=0)) + 1)[place]
    return np.asarray(np.add.reduceat(scrambled, begin))


@functools.cache
def _factors(count: int) -> Codes:
    return 2 * np.random.default_rng(count).integers(2**63, size=count, dtype=np.uint64) + 1
