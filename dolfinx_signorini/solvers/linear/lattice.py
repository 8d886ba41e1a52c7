"""The lattice behind a structured mesh, and its coarsening by index arithmetic.

The nodes of a divided interval, of a Friedrichs-Keller triangulation, or of the division of a cube
into tetrahedra around the diagonals of small cubes, are the points of a lattice. Every second node
in each direction, with both ends, are the nodes of a coarser lattice, whatever the numbers of
cells: a node in between lies on an edge of the coarser mesh, in the direction of an axis or of the
main diagonal. So the nodes know their two coarse neighbours by index arithmetic, and no coarse mesh
is needed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from dolfinx import mesh
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices
from dolfinx_signorini.base.lookups import Lookup
from dolfinx_signorini.base.tolerances import HALF_OF_THE_DIGITS

FLAT = 1.5  # times the least width of cells: larger widths in other directions stay as they are


@dataclass(frozen=True)
class Lattice:
    """The nodes of a lattice that a rank owns, in the order of their global numbers:

        lattice = find_lattice(domain, nodes)
        coarse, parents, weights = coarsened(lattice)

    Attributes:
        comm: The communicator that shares the lattice.
        corner: The coordinates of the node where all directions begin, shape (directions,).
        unit: The unit of length in each direction, shape (directions,).
        lines: The distances of the nodes from the corner in each direction, in units.
        places: The nodes of this rank, counted in each direction, shape (directions, nodes).
    """

    comm: MPI.Intracomm
    corner: Array
    unit: Array
    lines: tuple[Array, ...]
    places: LocalIndices

    @property
    def cells(self) -> tuple[int, ...]:
        """The number of cells in each direction."""
        return tuple(len(line) - 1 for line in self.lines)

    @property
    def size(self) -> int:
        """The number of nodes on all ranks."""
        return math.prod(n + 1 for n in self.cells)


def find_lattice(domain: mesh.Mesh, nodes: LocalIndices) -> Lattice | None:
    """Return the lattice of the vertices of a mesh; None if the vertices are none; collective.

    Args:
        domain: A mesh of intervals, or of straight-sided triangles or tetrahedra.
        nodes: The vertices that this rank owns, as nodes of the geometry.
    """
    dim, comm = domain.topology.dim, domain.comm
    if domain.geometry.dim != dim:
        return None
    if dim == 1:
        return _line(domain, nodes)
    x: list[Array] = [np.take(domain.geometry.x[:, d], nodes) for d in range(dim)]
    first = domain.geometry.x[domain.geometry.dofmap[:1].ravel(), :dim]
    width = np.ptp(first, axis=0) if len(first) else np.zeros(dim)
    low, high = ([np.max(sign * y, initial=-np.inf) for y in x] for sign in (-1.0, 1.0))
    ends = np.array([width, low, high])
    comm.Allreduce(MPI.IN_PLACE, ends, op=MPI.MAX)
    width, extent = ends[0], ends[1] + ends[2]
    if not (width > 0.0).all():
        return None
    cells = np.rint(extent / width)
    if np.prod(cells + 1.0) != domain.geometry.index_map().size_global:
        return None
    places, off = np.empty((dim, len(nodes)), dtype=np.int32), 0.0
    for d in range(dim):
        scaled = (x[d] + ends[1, d]) * (cells[d] / extent[d])
        places[d] = np.rint(scaled)
        off = max(off, float(np.abs(scaled - places[d]).max(initial=0.0)))
    lines = tuple(np.arange(n + 1.0) for n in cells)
    lattice = Lattice(comm, -ends[1], extent / cells, lines, places)
    fits = comm.allreduce(off, op=MPI.MAX) < HALF_OF_THE_DIGITS
    return lattice if fits and _complete(lattice) else None


def _line(domain: mesh.Mesh, nodes: LocalIndices) -> Lattice | None:
    """The vertices of a division of an interval, however unequal; None if two are at one place."""
    own = domain.geometry.x[nodes, 0]
    line = np.sort(np.concatenate(domain.comm.allgather(own)))
    if len(line) < 2 or not (np.diff(line) > 0.0).all():
        return None
    corner, unit = line[:1], np.ptp(line, keepdims=True) / (len(line) - 1)
    places = np.searchsorted(line, own)[None].astype(np.int32)
    return Lattice(domain.comm, corner, unit, ((line - corner) / unit,), places)


def _complete(lattice: Lattice) -> bool:
    """Whether every place of a lattice with the right number of nodes is taken.

    The sum of the squares of the nodes' numbers, modulo 2^64, tells.
    """
    numbers, count = _numbers(lattice.places, lattice.cells).astype(np.uint64), lattice.size
    found = sum(lattice.comm.allgather(int((numbers * numbers).sum(dtype=np.uint64))))
    return (found - (count - 1) * count * (2 * count - 1) // 6) % 2**64 == 0


def coarsened(lattice: Lattice) -> tuple[Lattice, Indices, Array | float] | None:
    """Return the lattice of every second node, and the coarse parents of each node; collective.

    On flat cells nodes are left out only in the directions in which the cells are narrow, until the
    cells are about as wide as long: point smoothers smooth across narrow cells only. A coarse node
    belongs to the rank of the fine node at its place.

    Returns:
        The coarse lattice; for each fine node the global numbers of the two coarse nodes that the
        node lies between, or twice that of the node at its place, shape (2, nodes); and the weight
        of the second one: 1/2 but for nodes next to a first or last cell of another width. None for
        a single cell.

    Source: Trottenberg, Oosterlee and Schueller, Multigrid, Academic Press (2001), Section 5.1, for
    the directions.
    """
    comm, places = lattice.comm, lattice.places
    narrow = _narrow(lattice)
    if not any(narrow):
        return None
    tables = [_parents(line, halved) for line, halved in zip(lattice.lines, narrow, strict=True)]
    low, high = (
        np.stack([table[side].take(p) for p, table in zip(places, tables, strict=True)])
        for side in (0, 1)
    )
    box = _Box(low, high)
    ends = np.stack([box.at(low), box.at(high)])
    kept = ends[0] == ends[1]
    lines = tuple(
        line[table[0] == table[1]] for line, table in zip(lattice.lines, tables, strict=True)
    )
    coarse = replace(lattice, lines=lines, places=low[:, kept])
    count = coarse.places.shape[1]
    first = comm.exscan(count) or 0
    box.table[ends[0, kept]] = numbers = np.arange(first, first + count)
    if comm.size > 1:
        _look_up(coarse, numbers, box, np.unique(ends[box.table[ends] < 0]))
    return coarse, box.table[ends], _weights(lattice, tables, lines)


def surrounding(lattice: Lattice, first: int, x: Array) -> tuple[Indices, Array]:
    """Return the nodes of the simplices in which points lie, and the barycentric coordinates.

    The simplex of a point belongs to the division of its small square or cube around the main
    diagonal. A point outside of the lattice is moved into it, along the axes. Collective.

    Args:
        lattice: The lattice.
        first: The global number of the first node of this rank.
        x: The points of this rank, shape (directions, points).

    Returns:
        The global numbers of the nodes and the coordinates, both of shape (directions + 1, points).
    """
    low, share = np.empty(x.shape, dtype=np.int32), np.empty(x.shape)
    for d, line in enumerate(lattice.lines):
        s = np.clip((x[d] - lattice.corner[d]) / lattice.unit[d], 0.0, line[-1])
        low[d] = np.minimum(np.searchsorted(line, s, side="right") - 1, len(line) - 2)
        share[d] = (s - line[low[d]]) / (line[low[d] + 1] - line[low[d]])
    order, points = np.argsort(-share, axis=0), np.arange(x.shape[1])
    places = np.repeat(low[None], len(x) + 1, axis=0)  # from the low end of the main diagonal
    for step, axis in enumerate(order, start=1):
        places[step:, axis, points] += 1
    bounds = np.ones((len(x) + 2, x.shape[1]))
    bounds[1:-1], bounds[-1] = np.take_along_axis(share, order, axis=0), 0.0
    asked = np.moveaxis(places, 0, 1).reshape(len(x), -1)
    box = _Box(asked, asked)
    index, numbers = box.at(asked), first + np.arange(lattice.places.shape[1])
    _look_up(lattice, numbers, box, np.unique(index))
    weights = bounds[:-1] - bounds[1:]
    return box.table[index].reshape(weights.shape), weights


def _weights(
    lattice: Lattice, tables: Sequence[tuple[LocalIndices, LocalIndices]], lines: Sequence[Array]
) -> Array | float:
    """The weights of the second parents: the mean over the directions in which a node lies between.

    Args:
        lattice: The fine lattice.
        tables: The coarse neighbours in each direction.
        lines: The coarse coordinates in each direction.
    """
    inner, shares = [low != high for low, high in tables], []
    for fine, coarse, (low, high), between in zip(lattice.lines, lines, tables, inner, strict=True):
        width = np.where(between, coarse[high] - coarse[low], 1.0)
        shares.append((fine - coarse[low]) / width)
    if all((share[between] == 0.5).all() for share, between in zip(shares, inner, strict=True)):
        return 0.5
    total, count = (np.zeros(lattice.places.shape[1]) for _ in range(2))
    for share, between, places in zip(shares, inner, lattice.places, strict=True):
        total += share.take(places)
        count += between.take(places)
    return np.asarray(total / np.maximum(count, 1.0))


def _narrow(lattice: Lattice) -> list[bool]:
    """In which directions cells are narrow, among those with more than one cell."""
    cells = np.array(lattice.cells)
    widths = lattice.unit * [line[-1] for line in lattice.lines] / cells
    widths[cells == 1] = np.inf
    return ((cells > 1) & (widths <= FLAT * widths.min())).tolist()


def _parents(line: Array, halved: bool) -> tuple[LocalIndices, LocalIndices]:
    """The coarse neighbours of nodes in a row, on the low and on the high side.

    Of an odd number of cells one stays as it is, the wider one of the first and the last: so no
    level has a cell that is much narrower than the others.

    Args:
        line: The coordinates of the nodes.
        halved: Whether nodes are left out.
    """
    i = np.arange(len(line), dtype=np.int32)
    if not halved:
        return i, i
    odd = len(line) % 2 == 0
    shift = int(odd and line[1] - line[0] > line[-1] - line[-2])
    low, high = (i + shift) // 2, (i + shift + 1) // 2
    low[-1] = high[-1]  # the ends are kept
    high[0] = low[0]
    return low, high


def _numbers(places: LocalIndices, cells: Sequence[int]) -> Indices:
    """The numbers of nodes of a lattice, counted along the axes."""
    numbers = places[-1].astype(np.int64)
    for d in reversed(range(len(cells) - 1)):
        numbers *= cells[d] + 1
        numbers += places[d]
    return numbers


class _Box:
    """A table over the smallest box of coarse places that holds those of this rank.

    Args:
        low, high: LocalIndices of this rank.

    Attributes:
        table: The global number of each place; -1 where that is not known.
    """

    def __init__(self, low: LocalIndices, high: LocalIndices):
        empty = not low.shape[1]
        self.origin = np.zeros((len(low), 1), np.int32) if empty else low.min(1, keepdims=True)
        last = self.origin if empty else high.max(1, keepdims=True)
        self.extent = [int(n) for n in (last - self.origin).ravel()]
        self.table = np.full(math.prod(n + 1 for n in self.extent), -1, dtype=PETSc.IntType)

    def at(self, places: LocalIndices) -> Indices:
        """Return the indices of places in the table."""
        return _numbers(places - self.origin, self.extent)

    def places(self, index: Indices) -> LocalIndices:
        """Return the places at some indices of the table."""
        shape = [n + 1 for n in self.extent[::-1]]
        return np.asarray(np.stack(np.unravel_index(index, shape)[::-1]) + self.origin)


def _look_up(lattice: Lattice, numbers: Indices, box: _Box, missing: Indices) -> None:
    """Fill in global numbers that other ranks gave, by way of the rank in charge of a place.

    The ranks are in charge of equal shares of the places, so that no rank needs all of them.

    Args:
        lattice: The lattice.
        numbers: The global numbers of the nodes of this rank.
        box: The table.
        missing: The indices to fill in.
    """
    comm, own = lattice.comm, _numbers(lattice.places, lattice.cells)
    share = -(-lattice.size // comm.size)
    asked = _numbers(box.places(missing), lattice.cells)
    charge = Lookup(comm, share, np.concatenate((own, asked)))
    told = charge.sent(np.concatenate((numbers, np.full(len(asked), -1))))
    table, known = np.full(share, -1, dtype=PETSc.IntType), told >= 0
    table[charge.items[known]] = told[known]
    box.table[missing] = charge.of(table)[len(own) :]
