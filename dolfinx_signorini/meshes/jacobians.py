"""Determinants and inverses of many matrices, of two or three rows faster than LAPACK has them.

The entries are numbers, or for inverses of square matrices objects with the operators of numbers.
"""

import itertools

import numpy as np

from dolfinx_signorini.base.arrays import Array

SQUARE = (2, 2), (3, 3)


def determinants(matrices: Array) -> Array:
    """Return the determinants of 2 x 2 or 3 x 3 matrices, shape (..., rows, columns)."""
    if matrices.shape[-1] == 2:
        (a, b), (c, d) = np.moveaxis(matrices, (-2, -1), (0, 1))
        return np.asarray(a * d - b * c)
    return np.asarray(sum(matrices[..., 0, i] * _cofactor(matrices, 0, i) for i in range(3)))


def spanned(columns: Array) -> Array:
    """Return the volumes that the columns of matrices span, shape (..., rows, columns)."""
    if columns.shape[-2:] in SQUARE:
        return np.abs(determinants(columns))
    squares = np.linalg.det(np.swapaxes(columns, -1, -2) @ columns)
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)))


def inverses(matrices: Array) -> Array:
    """Return the inverses of 2 x 2 or 3 x 3 matrices, and the pseudo-inverses of others."""
    if matrices.shape[-2:] not in SQUARE:
        return np.asarray(np.linalg.pinv(matrices))
    if matrices.shape[-1] == 2:
        (a, b), (c, d) = np.moveaxis(matrices, (-2, -1), (0, 1))
        adjugates = np.moveaxis(np.array([[d, -b], [-c, a]]), (0, 1), (-2, -1))
        return np.asarray(adjugates / determinants(matrices)[..., None, None])
    result, determinant = np.empty_like(matrices), determinants(matrices)
    for i, j in itertools.product(range(3), repeat=2):
        np.divide(_cofactor(matrices, i, j), determinant, out=result[..., j, i])
    return result


def _cofactor(matrices: Array, i: int, j: int) -> Array:
    """The cofactor of an entry of each 3 x 3 matrix."""
    rows, columns = ((i + 1) % 3, (i + 2) % 3), ((j + 1) % 3, (j + 2) % 3)
    (a, b), (c, d) = ([matrices[..., row, column] for column in columns] for row in rows)
    return np.asarray(a * d - b * c)
