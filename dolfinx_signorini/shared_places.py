"""What ranks tell each other of the dofs, vertices and facets that they share: sums and marks."""

from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import common, fem, la


def summed(
    index_map: common.IndexMap, places: npt.NDArray[np.integer[Any]], values: npt.ArrayLike = 1.0
) -> npt.NDArray[np.float64]:
    """Return for each place the sum of the values that all ranks have for the place; collective.

    Args:
        index_map: The places: dofs, vertices or facets.
        places: Places that this rank knows, ghosts included; a place may come more than once.
        values: One value for each of them, or one for all.
    """
    sums = la.vector(index_map)
    weights = np.broadcast_to(values, places.shape).ravel()
    sums.array[:] = np.bincount(places.ravel(), weights, len(sums.array))
    sums.scatter_reverse(la.InsertMode.add)
    sums.scatter_forward()
    return np.array(sums.array)


def marked(space: fem.FunctionSpace, dofs: npt.NDArray[np.integer[Any]]) -> npt.NDArray[np.bool_]:
    """Return which dofs of this rank, ghosts included, some rank names; the call is collective.

    Args:
        space: A scalar function space.
        dofs: Dofs that this rank names, ghosts included.
    """
    return summed(space.dofmap.index_map, dofs) > 0.0
