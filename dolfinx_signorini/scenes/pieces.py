"""Pieces of cells and facets: segments, triangles and tetrahedra that are divided into equal parts.

Pieces are given by their vertices, shape (pieces, vertices, coordinates).
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx_signorini.bounds.reference_flux import barycentric

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[Any]

# The children of a segment, a triangle and a tetrahedron: vertex 10 i + j is the middle of
# vertices i and j.
CHILDREN = {
    1: [[0, 1], [11, 1]],
    2: [[0, 1, 2], [11, 1, 12], [22, 2, 12], [1, 12, 2]],
    3: [
        [0, 1, 2, 3],
        [11, 1, 12, 13],
        [22, 2, 12, 23],
        [33, 3, 13, 23],
        [1, 2, 3, 13],
        [1, 2, 12, 13],
        [2, 3, 13, 23],
        [2, 12, 13, 23],
    ],
}


def inside(pieces: Array, points: Array) -> Array:
    """Return points of the reference simplex in each piece, shape (points, pieces, coordinates).

    Args:
        pieces: The pieces.
        points: The points, shape (points, dimension of the pieces).
    """
    return np.asarray(np.tensordot(barycentric(points), pieces, (1, 1)), dtype=np.float64)


def divided(pieces: Array, owners: Numbers) -> tuple[Array, Numbers]:
    """Divide each piece into 2 segments, 4 triangles or 8 tetrahedra.

    Args:
        pieces: The pieces.
        owners: The number of the cell around each piece.

    Returns:
        The parts, and the numbers of their cells.
    """
    middles = 0.5 * (pieces[:, :, None] + pieces[:, None])
    children = [middles[:, *np.divmod(c, 10)] for c in CHILDREN[pieces.shape[1] - 1]]
    return np.concatenate(children), np.tile(owners, len(children))
