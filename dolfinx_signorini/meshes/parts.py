"""Reference cells and their division into equal parts."""

import functools
from dataclasses import dataclass

import basix
import numpy as np

from dolfinx_signorini.base.arrays import Array, Indices, Mask

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

ALIKE = 8  # parts for each map, from which on parts are grouped by their maps


@dataclass(frozen=True)
class Parts:
    """Parts of places (cells or facets), each the image of the reference cell under an affine map:

        parts = Parts.whole(len(places), cell).divided(cell, marks)

    Attributes:
        rows: The row of the place of each part.
        maps: The number of the map of each part: parts of different places may have the same one.
        origins, axes: The maps x -> origin + x @ axes, shapes (maps, d) and (maps, d, d).
        share: The size of each part as a share of the size of the reference cell.
    """

    rows: Indices
    maps: Indices
    origins: Array
    axes: Array
    share: float = 1.0

    @classmethod
    def whole(cls, count: int, cell: basix.CellType) -> "Parts":
        """Return places themselves as parts.

        Args:
            count: The number of places.
            cell: Their reference cell.
        """
        dim = len(basix.topology(cell)) - 1
        zeros = np.zeros(count, dtype=np.int64)
        return cls(np.arange(count), zeros, np.zeros((1, dim)), np.eye(dim)[None])

    def points(self, reference: Array, chosen: Indices) -> Array:
        """Return points of some parts, from those of the reference cell.

        Args:
            reference: The points in the reference cell, shape (points, d).
            chosen: The numbers of the parts.

        Returns:
            Shape (parts, points, d); or (points, d) where all these parts have the same map.
        """
        maps = self.maps[chosen]
        if (maps == maps[:1]).all():
            maps = maps[:1].sum()
        return np.asarray(self.origins[maps, ..., None, :] + reference @ self.axes[maps])

    def alike(self, chosen: Indices) -> list[Indices]:
        """Group parts by their maps, where these are few: equal points are faster to evaluate at.

        Args:
            chosen: The numbers of the parts.

        Returns:
            The groups, none of them empty.
        """
        if not self.few_maps or not len(chosen):
            return [chosen] if len(chosen) else []
        order = np.argsort(self.maps[chosen], kind="stable")
        ends = np.flatnonzero(np.diff(self.maps[chosen][order])) + 1
        return np.split(chosen[order], ends)

    @property
    def few_maps(self) -> bool:
        """Whether most parts share their maps with others."""
        return len(self.rows) >= ALIKE * len(self.origins)

    @staticmethod
    def children(cell: basix.CellType) -> int:
        """Return how many children a part has."""
        return len(_children(cell)[0])

    def divided(self, cell: basix.CellType, chosen: Mask) -> "Parts":
        """Return the children of some parts.

        Args:
            cell: The reference cell.
            chosen: Whether a part is divided.
        """
        (origins, axes), old = _children(cell), len(self.origins)
        numbers = np.concatenate([self.maps[chosen] + old * i for i in range(len(origins))])
        used, maps = np.unique(numbers, return_inverse=True)
        child, parent = np.divmod(used, old)
        return Parts(
            np.tile(self.rows[chosen], len(origins)),
            maps,
            self.origins[parent] + np.einsum("ni,nij->nj", origins[child], self.axes[parent]),
            axes[child] @ self.axes[parent],
            self.share / len(origins),
        )


@functools.cache
def _children(cell: basix.CellType) -> tuple[Array, Array]:
    """The maps of the reference cell on its children, of equal size: origins and axes."""
    vertices = np.asarray(basix.geometry(cell), dtype=np.float64)
    dim = vertices.shape[1]
    if len(vertices) > dim + 1:  # towards each corner of a box
        return 0.5 * vertices, np.tile(0.5 * np.eye(dim), (len(vertices), 1, 1))
    middles = 0.5 * (vertices[:, None] + vertices)
    children = np.array([middles[*np.divmod(child, 10)] for child in CHILDREN[dim]])
    return children[:, 0], children[:, 1:] - children[:, :1]
