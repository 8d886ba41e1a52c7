"""Which vertices slide along the boundary without changing the boundary or one of its sides."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.tolerances import SOLVED


def planes(
    corners: Array, sides: npt.NDArray[np.int64], mean: Callable[[Array], Array]
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return the planes of the boundary at vertices, and whether the vertices slide in them.

    Args:
        corners: The vertices of the facets of the boundary, shape (facets, dimension, dimension).
        sides: For each facet a number that stands for the sides of the facet.
        mean: Returns for each vertex the mean of one value per facet over the facets around the
            vertex, and 0 where no facet is.

    Returns:
        For each vertex the mean of n n^T over the normals n around the vertex, shape (vertices,
        dimension, dimension): 0 inside of the domain, and n n^T in a plane. And whether the facets
        around the vertex are in one plane and on the same sides, as for all vertices inside.
    """
    normals = np.linalg.svd(corners[:, 1:] - corners[:, :1], full_matrices=True)[2][:, -1]
    products = np.moveaxis(normals[:, :, None] * normals[:, None], 0, -1)
    result = np.array([[mean(values) for values in row] for row in products])
    result = np.moveaxis(result, -1, 0)
    parallel = (result**2).sum(axis=(1, 2)) >= (1.0 - SOLVED) * np.trace(result, axis1=1, axis2=2)
    numbers = sides.astype(np.float64)
    same = mean(numbers**2) - mean(numbers) ** 2 <= SOLVED * mean(numbers**2)
    return result, parallel & same
