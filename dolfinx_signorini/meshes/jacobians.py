"""Determinants and inverses of many matrices of two or three rows, faster than LAPACK has them."""

import numpy as np

from dolfinx_signorini.base.arrays import Array


def determinants(matrices: Array) -> Array:
    """Return the determinants of 2 x 2 or 3 x 3 matrices, shape (..., rows, columns)."""
    if matrices.shape[-1] == 2:
        (a, b), (c, d) = np.moveaxis(matrices, (-2, -1), (0, 1))
        return np.asarray(a * d - b * c)
    first, second, third = np.moveaxis(matrices, -1, 0)
    return np.asarray((first * np.cross(second, third)).sum(axis=-1))


def inverses(matrices: Array) -> Array:
    """Return the inverses of 2 x 2 or 3 x 3 matrices, shape (..., rows, columns)."""
    if matrices.shape[-1] == 2:
        (a, b), (c, d) = np.moveaxis(matrices, (-2, -1), (0, 1))
        adjugates = np.moveaxis(np.array([[d, -b], [-c, a]]), (0, 1), (-2, -1))
    else:
        first, second, third = np.moveaxis(matrices, -1, 0)
        rows = np.cross(second, third), np.cross(third, first), np.cross(first, second)
        adjugates = np.stack(rows, axis=-2)
    return np.asarray(adjugates / determinants(matrices)[..., None, None])
