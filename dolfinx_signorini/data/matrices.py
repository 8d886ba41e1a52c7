"""Matrices of formulas with one, two or three rows, entry by entry, row by row.

By Weyl's inequality the eigenvalues and the singular values of a matrix differ from those of a
matrix in the middle of an enclosure by at most the norm of the radii.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.data.enclosures import enclosed_gradients, enclosed_on_simplices
from dolfinx_signorini.data.formulas import Formula, Node
from dolfinx_signorini.meshes.jacobians import inverses


def eigenvalues(entries: Sequence[Formula], corners: Array) -> tuple[Array, Array]:
    """Return bounds of the eigenvalues of a symmetric matrix on simplices.

    Args:
        entries: The entries of the matrix.
        corners: The vertices of the simplices, shape (simplices, vertices, dimension).

    Returns:
        The lower bounds and the upper ones; infinite ones where a formula has no enclosure.
    """
    n = math.isqrt(len(entries))
    ends = np.stack([enclosed_on_simplices(entry, corners) for entry in entries], axis=2)
    middle, spread = _centred(ends.reshape(2, -1, n, n))
    spectrum = np.linalg.eigvalsh(middle)
    return spectrum[:, 0] - spread, spectrum[:, -1] + spread


def least_stretch(pair: Sequence[Node], corners: Array) -> Array:
    """Return lower bounds of the smaller singular value of the derivatives of two functions.

    The bounds are those on simplices, shape (simplices, vertices, dimension), and minus infinity
    where a function has no enclosure.
    """
    slopes = [enclosed_gradients(Formula("", node), corners) for node in pair]
    middle, spread = _centred(np.stack(slopes, axis=2))
    return np.asarray(np.linalg.svd(middle, compute_uv=False)[:, -1] - spread)


def _centred(ends: Array) -> tuple[Array, Array]:
    """Matrices in the middle of enclosures, and the norms of the radii, infinite for no bounds."""
    with np.errstate(invalid="ignore"):
        middle, radius = 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])
    spread = np.linalg.norm(radius, axis=(1, 2))
    known = np.isfinite(spread)
    return np.where(known[:, None, None], middle, 0.0), np.where(known, spread, np.inf)


def inverse_entries(entries: Sequence[Formula]) -> list[Formula]:
    """Return the entries of the inverse of a matrix of formulas, by cofactors."""
    n = math.isqrt(len(entries))
    matrix = np.array([entry.root for entry in entries], dtype=object).reshape(n, n)
    inverse: Any = inverses(matrix) if n > 1 else 1.0 / matrix
    return [Formula("an entry of the inverse of the diffusion", entry) for entry in inverse.flat]
