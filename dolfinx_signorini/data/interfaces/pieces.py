"""Pieces of cells and facets: segments, triangles and tetrahedra that are divided into equal parts.

Pieces are given by their vertices, shape (pieces, vertices, coordinates).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.meshes.jacobians import spanned
from dolfinx_signorini.meshes.parts import CHILDREN
from dolfinx_signorini.meshes.polynomials import barycentric

Numbers = npt.NDArray[Any]

Look = Callable[[Array, Numbers, int], tuple[Mask, Sequence[npt.NDArray[Any]]]]

MOST_PIECES = 20_000  # on all ranks that are divided once more
FINE = 1_500  # pieces, about: of one cell, or of few cells before the first division
DEEPEST = round(-math.log2(ROUNDING))  # divisions of a cell: then a piece is as small as rounding


def inside(pieces: Array, points: Array) -> Array:
    """Return points of the reference simplex in each piece, shape (points, pieces, coordinates).

    Args:
        pieces: The pieces.
        points: The points, shape (points, dimension of the pieces).
    """
    return np.asarray(np.tensordot(barycentric(points), pieces, (1, 1)), dtype=np.float64)


def widths(pieces: Array) -> Array:
    """Return the lengths of the longest edges of pieces."""
    longest = np.zeros(len(pieces))
    for a, b in combinations(range(pieces.shape[1]), 2):
        edges = pieces[:, a] - pieces[:, b]
        np.maximum(longest, np.einsum("ni,ni->n", edges, edges), out=longest)
    return np.sqrt(longest)


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


def corners_of_reference(dimension: int) -> Array:
    """Return the vertices of the reference simplex."""
    return np.vstack((np.zeros(dimension), np.eye(dimension)))


def with_reference(corners: npt.NDArray[np.floating]) -> Array:
    """Return cells as pieces with the coordinates in the reference cell and in space side by side.

    Args:
        corners: The vertices of the cells, shape (cells, vertices, dimension).
    """
    unit = corners_of_reference(corners.shape[1] - 1)
    reference = np.broadcast_to(unit, (len(corners), *unit.shape))
    return np.concatenate((reference, corners), axis=2, dtype=np.float64)


def relative_sizes(pieces: Array) -> Array:
    """Return the shares of pieces in their cells, from the coordinates in the reference cell."""
    edges = (pieces[:, 1:] - pieces[:, :1])[..., : pieces.shape[1] - 1]
    return spanned(edges)


def subdivide(
    pieces: Array,
    owners: Numbers,
    look: Look,
    comm: MPI.Comm = MPI.COMM_SELF,
    most: float = math.inf,
    deepest: int = DEEPEST,
) -> Iterator[tuple[Array, Numbers, int, list[npt.NDArray[Any]]]]:
    """Divide pieces until nothing is undecided, and yield those that are not divided any more.

    For example, the area of a disc:

        def look(pieces, owners, level):
            sizes = np.linalg.norm(pieces, axis=2)
            return (sizes.min(axis=1) < 1.0) & (sizes.max(axis=1) > 1.0), [sizes.max(axis=1) < 1.0]

        for parts, owners, level, (inside,) in subdivide(cells, numbers, look, deepest=5):
            area += areas(parts[inside]).sum()

    Args:
        pieces: The pieces.
        owners: The number of the cell around each piece.
        look: Returns whether pieces are undecided, and arrays of what was found, pieces last; gets
            the pieces, the owners, and how often they have been divided.
        comm: The communicator, over which the call is collective.
        most: The number of pieces on all ranks that are divided together, at most.
        deepest: How often a piece is divided, at most.

    Yields:
        Pieces that are decided, or past one of the limits, with their owners, how often they have
        been divided, and what was found of them.
    """
    for level in range(deepest + 1):
        open_, found = look(pieces, owners, level)
        count = comm.allreduce(int(open_.sum()))
        if count > most or level == deepest:
            count, open_ = 0, np.zeros_like(open_)
        yield pieces[~open_], owners[~open_], level, [array[..., ~open_] for array in found]
        if not count:
            return
        pieces, owners = divided(pieces[open_], owners[open_])


def cut(pieces: Array, values: Array) -> tuple[Array, Numbers]:
    """Cut pieces where a function is zero that is linear in each of them.

    An edge at a time is cut, with all that is around: the two parts are segments, triangles or
    tetrahedra again, and have fewer edges that cross the zeros.

    Args:
        pieces: The pieces.
        values: The values of the function at the vertices, shape (pieces, vertices).

    Returns:
        The parts, in none of which the function changes its sign, and the numbers of their pieces.
    """
    numbers = np.arange(len(pieces))
    while True:
        crossed = (values.min(axis=1) < 0.0) & (values.max(axis=1) > 0.0)
        if not crossed.any():
            return pieces, numbers
        rows = np.arange(crossed.sum())
        ends = values[crossed].argmin(axis=1), values[crossed].argmax(axis=1)
        parts, at = (np.stack((array[crossed], array[crossed])) for array in (pieces, values))
        low, high = (at[0][rows, end][:, None] for end in ends)
        one, other = (parts[0][rows, end] for end in ends)
        middle = one + low / (low - high) * (other - one)
        for part, end in enumerate(ends):
            parts[part, rows, end], at[part, rows, end] = middle, 0.0
        pieces = np.concatenate((pieces[~crossed], *parts))
        values = np.concatenate((values[~crossed], *at))
        numbers = np.concatenate((numbers[~crossed], numbers[crossed], numbers[crossed]))
