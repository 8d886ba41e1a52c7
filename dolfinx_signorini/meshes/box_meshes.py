"""Meshes of rectangles and boxes, whose nodes are the points of a lattice.

Each square is cut into two triangles, and each cube into six tetrahedra, around the main diagonal:
a simplex goes from the low corner to the high one along the axes, in one of the d! orders. So every
rank writes down its own block of cells and the ghosts around the block, and nothing is sent.
DOLFINx puts the cells of other meshes in a new order by a graph of their neighbours, which takes
longer than all the rest; cells row by row are in a good order already.

Source: Freudenthal, Ann. of Math. 43 (1942) 580-582, for the division.
"""

import math
from collections.abc import Sequence
from itertools import permutations, product
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import mesh
from mpi4py import MPI

from dolfinx_signorini.base import compat
from dolfinx_signorini.base.arrays import Indices, LocalIndices
from dolfinx_signorini.base.kinds import COMMUNICATOR, check, integer, sequence


def friedrichs_keller(comm: MPI.Comm, n: int) -> mesh.Mesh:
    """Return the Friedrichs-Keller triangulation of the unit square.

    Args:
        comm: The communicator that shares the mesh, see `box_mesh`.
        n: Cells per side; every one of the n * n squares is cut into two triangles.

    Raises:
        InputError: n is no integer, or smaller than 1.
    """
    check(n=(n, integer(1)))
    return box_mesh(comm, [np.linspace(0.0, 1.0, n + 1)] * 2)


def box_mesh(comm: MPI.Comm, lines: Sequence[npt.ArrayLike]) -> mesh.Mesh:
    """Return a mesh of a rectangle or a box, with nodes at all combinations of coordinates.

    For example, 64 x 32 squares on the rectangle (0, 2) x (0, 1):

        box_mesh(MPI.COMM_WORLD, [np.linspace(0.0, 2.0, 65), np.linspace(0.0, 1.0, 33)])

    The ranks share the cells in blocks: unlike a graph partitioner's, this partition is the same in
    every run. A rank knows the cells of other ranks that have a facet of one of its own cells.

    Args:
        comm: The communicator that shares the mesh; the call is collective.
        lines: The coordinates of the nodes along each of the two or three axes, increasing.

    Raises:
        InputError: An argument is of another kind.
    """
    check(comm=(comm, COMMUNICATOR), lines=(lines, _lines))
    coordinates = [np.asarray(line, dtype=np.float64) for line in lines]
    block = _Block(comm, [len(line) - 1 for line in coordinates])
    own = block.cells()
    ghosts, owners = block.ghosts(own)
    cells = np.concatenate((own, ghosts))
    vertices = block.vertices(cells)
    nodes, surface = block.nodes()
    if len(ghosts):
        nodes = np.union1d(nodes, vertices[len(own) :])
    along = zip(coordinates, block.places(nodes), strict=True)
    x = np.stack([line[place] for line, place in along], axis=1)
    return compat.simplicial_mesh(comm, vertices, cells, owners, nodes, x, surface)


def _lines(value: Any) -> str:
    """The kind of coordinates along two or three axes."""
    words = "two or three lists of coordinates"
    message = sequence(_line, words)(value)
    return message or ("" if len(value) in (2, 3) else f"must be {words}, not {len(value)}")


def _line(value: Any) -> str:
    """The kind of increasing coordinates."""
    try:
        line = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        line = np.empty(0)
    increasing = line.ndim == 1 and len(line) > 1 and bool((np.diff(line) > 0.0).all())
    good = increasing and np.isfinite(line).all()
    return "" if good else "must be lists of at least two finite numbers in increasing order"


def _blocks(ranks: int, cubes: Sequence[int]) -> tuple[int, ...]:
    """Return how many blocks of cubes lie along each axis.

    The largest block is as small as can be, and has as small a surface as can be then. In doubt
    the first axes are cut, so that ranks share a bottom in contact.
    """
    divisors = [k for k in range(1, ranks + 1) if ranks % k == 0]

    def cost(blocks: tuple[int, ...]) -> tuple[int, ...]:
        sides = [-(-n // k) for n, k in zip(cubes, blocks, strict=True)]
        volume = math.prod(sides)
        return volume, sum(volume // side for side in sides), *(-k for k in blocks)

    grids = product(divisors, repeat=len(cubes))
    return min((blocks for blocks in grids if math.prod(blocks) == ranks), key=cost)


class _Block:
    """The cubes of one rank, among those of all ranks.

    Nodes, cubes and ranks are numbered along the axes, the first axis fastest, and cells cube by
    cube.

    Args:
        comm: The communicator.
        cubes: The number of cubes along each axis.
    """

    def __init__(self, comm: MPI.Comm, cubes: Sequence[int]):
        self._comm, self._cubes = comm, np.array(cubes, dtype=np.int64)
        self._blocks = np.array(_blocks(comm.size, cubes))
        place = np.array(np.unravel_index(comm.rank, self._blocks, order="F"))
        # A cube at i of n belongs to the block i k // n of k.
        self._low, self._high = (-(-(place + end) * self._cubes // self._blocks) for end in (0, 1))
        self._orders = np.array(list(permutations(range(len(cubes)))))

    def cells(self) -> Indices:
        """Return the cells of this rank."""
        count = len(self._orders)
        cubes = self._box(self._high, self._cubes)
        return np.asarray(np.add.outer(count * cubes, np.arange(count)).ravel())

    def vertices(self, cells: Indices) -> Indices:
        """Return the vertices of some cells, shape (cells, dimension + 1)."""
        steps = np.cumprod([1, *(self._cubes[:-1] + 1)])
        ways = np.cumsum(steps[self._orders], axis=1)
        cubes, orders = np.divmod(cells, len(self._orders))
        first = steps @ np.array(np.unravel_index(cubes, self._cubes, order="F"))
        return first[:, None] + np.insert(ways, 0, 0, axis=1)[orders]

    def ghosts(self, own: Indices) -> tuple[Indices, LocalIndices]:
        """Return the cells of other ranks at the facets of the own ones, and their ranks.

        A cell that goes along the axes p, q, r has two facets on the surface of its cube. Beyond
        one begins, a step along p, the cell that goes along q, r, p; beyond the other one begins, a
        step back along r, the cell that goes along r, p, q.

        Args:
            own: The cells of this rank.
        """
        found = [np.empty((2, 0), dtype=np.int64)]
        for way in (1, -1) if self._comm.size > 1 else ():
            cubes, orders = np.divmod(own, len(self._orders))
            axes = self._orders[orders, (0 if way == 1 else -1)]
            ends = (self._high - 1 if way == 1 else self._low)[axes]
            places = np.array(np.unravel_index(cubes, self._cubes, order="F"))
            last = places[axes, np.arange(len(own))] == ends
            places, axes, orders = places[:, last], axes[last], orders[last]
            places[axes, np.arange(len(axes))] += way
            inside = ((places >= 0) & (places < self._cubes[:, None])).all(axis=0)
            places, orders = places[:, inside], orders[inside]
            owners = places * self._blocks[:, None] // self._cubes[:, None]
            turned = np.roll(self._orders, -way, axis=1)
            matches = (turned[:, None] == self._orders).all(axis=2).argmax(axis=1)
            behind = np.ravel_multi_index(tuple(places), tuple(self._cubes), order="F")
            ranks = np.ravel_multi_index(tuple(owners), tuple(self._blocks), order="F")
            found.append(np.stack((len(self._orders) * behind + matches[orders], ranks)))
        cells, owners = np.unique(np.concatenate(found, axis=1), axis=1)
        return cells, owners.astype(np.int32)

    def nodes(self) -> tuple[Indices, Indices]:
        """Return the nodes of the own cells, and those of them on the surface of the block."""
        if (self._low == self._high).any():
            return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
        nodes = self._box(self._high + 1, self._cubes + 1)
        places, ends = self.places(nodes), np.array([self._low, self._high])
        surface = [(p == low) | (p == high) for p, low, high in zip(places, *ends, strict=True)]
        return nodes, nodes[np.any(surface, axis=0)]

    def places(self, nodes: Indices) -> tuple[Indices, ...]:
        """Return the places of some nodes along each axis."""
        return np.unravel_index(nodes, self._cubes + 1, order="F")

    def _box(self, ends: Indices, counts: Indices) -> Indices:
        """The numbers of the places from the low end of the block up to some ends."""
        ranges = [np.arange(*pair) for pair in zip(self._low, ends, strict=True)]
        return np.ravel_multi_index(np.ix_(*ranges), tuple(counts), order="F").ravel(order="F")
