"""The patches of cells around vertices, in groups that are solved at once.

Patches are congruent where one is the other one, translated: with cells of the same shapes around
their vertices, in one order along the direction of the frames, and with the same kinds of facets.
Their systems of equations are the same but for the right sides.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dolfinx_signorini.base.arrays import BLOCK, Array, Indices, Mask
from dolfinx_signorini.bounds.condensation import CLOSED, DIRICHLET, PARTLY, CellData
from dolfinx_signorini.bounds.congruence import codes, codes_of_groups
from dolfinx_signorini.bounds.reference_flux import MOST_NUMBERS
from dolfinx_signorini.meshes.polynomials import others

# What is free on contact facets, see `patches.patch_fluxes`.
FREE, HALF, SPREAD = range(3)


@dataclass(frozen=True)
class Group:
    """Patches with the same numbers of cells and facets, congruent ones one after the other.

    Attributes:
        corners: The places of pairs of cell and vertex in `Patches.corners`, shape
            (patches, cells).
        first: The first patch of each class of congruent patches.
        unknowns: For each class and each facet at the vertex the number of the facet in the patch,
            shape (classes, cells, d); -1 where the flux is given.
        signs: The signs of the fluxes on these facets; 0 where the flux is given.
        count: The number of facets in a patch with unknown fluxes.
        closed: Whether the sum of the total fluxes of the cells in a patch is given.
    """

    corners: Indices
    first: Indices
    unknowns: Indices
    signs: Indices
    count: int
    closed: bool


class Patches:
    """Which cells form the patch of which vertex.

    Attributes:
        corners: Pairs of a cell and one of its vertices, as one number, patch by patch.
        cells, local: The cell and the number of the vertex in the cell.
        patch: The number of the patch of each pair.
        kind: The kinds of the facets of the cell at the vertex, shape (pairs, d).
        held: Whether each patch has a facet at its vertex with any flux, or a cell with any
            divergence.
    """

    def __init__(self, data: CellData, here: Mask, modes: Indices):
        self.here, vertices = here, here.shape[1]
        corners = np.flatnonzero(here)
        rank = np.empty(len(here), dtype=np.int64)
        rank[np.argsort(data.places)] = np.arange(len(here))  # along the direction of the frames
        keys = data.vertices.ravel()[corners] * len(here) + rank[corners // vertices]
        order = np.argsort(keys)
        self.corners, names = corners[order], keys[order] // len(here)
        self.cells, self.local = np.divmod(self.corners, vertices)
        new = np.diff(names, prepend=-1) > 0
        self.patch, self.begin = np.cumsum(new) - 1, np.flatnonzero(new)
        self.kind = data.kinds[self.cells[:, None], others(vertices - 1)[self.local]]
        rim = np.nonzero(self.kind >= PARTLY)
        kind, mode = self.kind[rim], modes.ravel()[self.corners[rim[0]]]
        free = ((kind == CLOSED) & (mode < SPREAD)) | ((kind == PARTLY) & (mode == FREE))
        self.kind[rim] = np.where(free, DIRICHLET, kind)  # any flux is balanced on both
        self.slack = data.strength[self.cells] > 0.0
        free = np.isinf(data.strength[self.cells]) | (self.kind == DIRICHLET).any(axis=1)
        self.held = np.bincount(self.patch[free], minlength=len(self.begin)) > 0

    @functools.cached_property
    def number(self) -> Indices:
        """The patch of each vertex of each cell that is here."""
        number = np.zeros(self.here.size, dtype=np.int64)
        number[self.corners] = self.patch
        return number.reshape(self.here.shape)

    def sums(self, values: Array, cells: Indices) -> Array:
        """Return the sums over patches for the vertices of some cells; 0 elsewhere.

        Args:
            values: For each cell and vertex.
            cells: The cells.
        """
        total = np.add.reduceat(values.ravel()[self.corners], self.begin)
        return np.where(self.here[cells], total[self.number[cells]], 0.0)

    def balanced(self, total: Array, sizes: Array) -> Array:
        """Return total outward fluxes of cells that add up to zero where no facet is free.

        Args:
            total: The total flux of each cell for each vertex, shape (cells, d + 1).
            sizes: The sizes of the cells, which share what is left over, shape (cells,).

        Returns:
            The fluxes for the pairs of cell and vertex, patch by patch.
        """
        own, shares = total.ravel()[self.corners], sizes[self.cells]
        defect, area = (np.add.reduceat(values, self.begin) for values in (own, shares))
        return np.asarray(own - np.where(self.held, 0.0, defect / area)[self.patch] * shares)

    def groups(self, facets: Indices, shapes: Indices, width: int) -> Iterator[Group]:
        """Yield patches with the same numbers of cells and facets.

        Args:
            facets: The facets of the cells.
            shapes: The numbers of the shapes of the cells.
            width: The number of unknown moments of a cell.
        """
        cells = np.diff(np.append(self.begin, len(self.patch)))
        row = 2 * (shapes[self.cells] * self.here.shape[1] + self.local + 1) + self.slack
        for kind in self.kind.T:
            row = row * (CLOSED + 1) + kind
        place = np.arange(len(self.patch)) - self.begin[self.patch]
        code = codes_of_groups(codes(row[:, None]), self.begin, place)
        _, first, same = np.unique(code, return_index=True, return_inverse=True)
        begin, local, signs = self._unknowns(facets, first, cells[first])
        count = np.add.reduceat((signs > 0).sum(axis=1), begin)
        closed = ~(self.held | np.logical_or.reduceat(self.slack, self.begin))[first]
        rank = np.lexsort((closed, count, cells[first]))
        table = np.column_stack((cells[first], count, closed))[rank]
        order = np.argsort(np.argsort(rank)[same], kind="stable")
        new = np.append(True, (table[1:] != table[:-1]).any(axis=1))
        members = np.bincount(same)[rank]
        for part in np.split(order, np.cumsum(members)[np.flatnonzero(new[1:])]):
            n, m, whole = cells[part[0]], count[same[part[0]]], closed[same[part[0]]]
            size = m * width // self.kind.shape[1] + n
            matrices = (1 + np.count_nonzero(np.diff(same[part]))) * size**2
            most = max(len(part) * n * width // BLOCK, matrices // MOST_NUMBERS)
            for some in np.array_split(part, 1 + most):
                first_ones = np.flatnonzero(np.diff(same[some], prepend=-1))
                at = begin[same[some[first_ones]], None] + np.arange(n)
                corners = self.begin[some, None] + np.arange(n)
                yield Group(corners, first_ones, local[at], signs[at], int(m), bool(whole))

    def _unknowns(
        self, facets: Indices, patches: Indices, cells: Indices
    ) -> tuple[Indices, Indices, Indices]:
        """Where some patches begin, and their facets' numbers in the patch, with signs.

        Args:
            facets: The facets of the cells.
            patches: The patches.
            cells: Their numbers of cells.
        """
        begin = np.cumsum(cells) - cells
        patch = np.repeat(np.arange(len(patches)), cells)
        at = np.arange(len(patch)) + (self.begin[patches] - begin)[patch]
        unknown = self.kind[at] <= DIRICHLET
        own = facets[self.cells[at, None], others(facets.shape[1] - 1)[self.local[at]]]
        keys = np.where(unknown, patch[:, None] * (facets.max(initial=0) + 1) + own, -1)
        _, first, inverse = np.unique(keys.ravel(), return_index=True, return_inverse=True)
        owner = first[inverse.ravel()].reshape(keys.shape)  # where a facet comes first in its patch
        mine = unknown & (owner == np.arange(keys.size).reshape(keys.shape))
        before = np.cumsum(mine) - 1
        start = (before[begin * keys.shape[1]] - mine[begin, 0])[patch] + 1
        local = np.where(unknown, before[owner] - start[:, None], -1)
        return begin, local, np.where(unknown, np.where(mine, 1, -1), 0)
