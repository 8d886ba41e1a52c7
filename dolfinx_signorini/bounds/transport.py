"""Fluxes that carry sources left in cells through the mesh, where the cells have no reaction.

Algebraic errors and the quadrature of the discrete problem leave a source in some cells. Without a
reaction in a cell, the source is carried from cell to cell along a tree, to a facet with Dirichlet
data, a cell with a reaction, or a contact facet with a flux large enough. The flux of the tree is
in H(div), so that no constant of Friedrichs is needed.

Source: Papez, Ruede, Vohralik and Wohlmuth, Comput. Methods Appl. Mech. Engrg. 371 (2020) 113243,
Section 5, carry algebraic errors on a hierarchy of meshes.
"""

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI
from scipy.sparse.csgraph import breadth_first_order
from scipy.sparse.linalg import cg

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.bounds.frames import Frames


def transported(
    comm: MPI.Comm, facets: Indices, wanted: Array, exits: Mask, ends: Mask
) -> tuple[Array, bool]:
    """Return outward fluxes of cells with given sums; the call is collective.

    Args:
        comm: The communicator.
        facets: The global numbers of the facets of cells, shape (cells, d + 1).
        wanted: The sum of the fluxes of each cell.
        exits: Boundary facets with any flux, shape (cells, d + 1).
        ends: Cells whose fluxes may have any sum.

    Returns:
        The fluxes, shape (cells, d + 1), and whether every cell has a way to an exit or end.
    """
    parts = comm.gather((facets, wanted, exits, ends))
    answers = None
    if parts is not None:
        sizes = np.cumsum([len(part[0]) for part in parts])[:-1]
        fluxes, found = _on_one_rank(*(np.concatenate(p) for p in zip(*parts, strict=True)))
        answers = [(part, found) for part in np.split(fluxes, sizes)]
    answer: tuple[Array, bool] = comm.scatter(answers)
    return answer


def spread(comm: MPI.Comm, frames: Frames, wanted: Array, exits: Mask, ends: Mask) -> Array:
    """Return outward fluxes of cells, nearly with given sums, that are nowhere large.

    The fluxes belong to a potential with one value in each cell, which is 0 in the ends and outside
    of the exits; the call is collective.

    Args:
        comm: The communicator.
        frames: The cells.
        wanted, exits, ends: See `transported`.

    Returns:
        The fluxes, shape (cells, d + 1); 0 for a mesh with neither exits nor ends.
    """
    ease = frames.facet_sizes**2 / frames.volumes[:, None]  # over the distance from the middle
    parts = comm.gather((frames.facets, wanted, exits, ends, ease))
    answers = None
    if parts is not None:
        sizes = np.cumsum([len(part[0]) for part in parts])[:-1]
        fluxes = _by_potential(*(np.concatenate(p) for p in zip(*parts, strict=True)))
        answers = np.split(fluxes, sizes)
    answer: Array = comm.scatter(answers)
    return answer


def _by_potential(facets: Indices, wanted: Array, exits: Mask, ends: Mask, ease: Array) -> Array:
    count, columns = facets.shape
    order = np.argsort(facets.ravel(), kind="stable")
    numbers, flat = facets.ravel()[order], ease.ravel()
    first = np.flatnonzero(numbers[1:] == numbers[:-1])
    one, other = order[first], order[first + 1]
    weight = np.zeros(len(flat))
    weight[one] = weight[other] = 1.0 / (1.0 / flat[one] + 1.0 / flat[other])
    weight[exits.ravel()] = flat[exits.ravel()]
    if not (exits.any() or ends.any()):
        return np.zeros(facets.shape)
    matrix = sp.coo_matrix((-weight[one], (one // columns, other // columns)), (count, count))
    matrix = (matrix + matrix.T + sp.diags(weight.reshape(facets.shape).sum(axis=1))).tocsr()
    inner = np.flatnonzero(~ends)
    matrix, potential = matrix[inner][:, inner], np.zeros(count)
    scale = sp.diags(1.0 / matrix.diagonal())
    potential[inner], _ = cg(matrix, wanted[inner], M=scale)
    fluxes = weight * np.repeat(potential, columns)
    fluxes[one] -= weight[one] * potential[other // columns]
    fluxes[other] -= weight[other] * potential[one // columns]
    return np.asarray(fluxes.reshape(facets.shape))


def _on_one_rank(facets: Indices, wanted: Array, exits: Mask, ends: Mask) -> tuple[Array, bool]:
    count, fluxes = len(facets), np.zeros(facets.shape)
    order = np.argsort(facets.ravel(), kind="stable")
    numbers = facets.ravel()[order]
    first = np.flatnonzero(numbers[1:] == numbers[:-1])
    out = np.flatnonzero(exits)
    # Two sides of each edge of the graph, as places in the fluxes; the outside is one more cell.
    here = np.concatenate((order[first], out, np.full(np.count_nonzero(ends), -1)))
    there = np.concatenate((order[first + 1], np.full(len(here) - len(first), -1)))
    cell = np.concatenate((order[first], out)) // facets.shape[1]
    cell = np.concatenate((cell, np.flatnonzero(ends)))
    other = np.where(there >= 0, there // facets.shape[1], count)
    graph = sp.coo_matrix((np.ones(len(cell)), (cell, other)), shape=(count + 1, count + 1))
    visited, parents = breadth_first_order(graph.tocsr(), count, directed=False)
    if len(visited) <= count:
        return fluxes, False
    keys, edge = np.unique(cell * (count + 1) + other, return_index=True)
    child = visited[1:]
    parent = parents[child]
    forth, back = (a * (count + 1) + b for a, b in ((child, parent), (parent, child)))
    at = np.minimum(np.searchsorted(keys, forth), len(keys) - 1)
    forwards = keys[at] == forth
    at = np.where(forwards, at, np.searchsorted(keys, back))
    amount = np.append(wanted, 0.0)
    for level in _levels(visited, parents)[::-1]:
        np.add.at(amount, parents[level], amount[level])
    inner, outer = (
        np.where(forwards, *sides)
        for sides in ((here[edge[at]], there[edge[at]]), (there[edge[at]], here[edge[at]]))
    )
    for place, sign in ((inner, 1.0), (outer, -1.0)):
        used = place >= 0
        fluxes.ravel()[place[used]] += sign * amount[child[used]]
    return fluxes, True


def _levels(visited: Indices, parents: Indices) -> list[Indices]:
    """The nodes of a tree by their distance from the root, which is left out."""
    place = np.empty(len(visited), dtype=np.int64)
    place[visited] = np.arange(len(visited))
    above = place[parents[visited[1:]]]  # ascending
    levels, start = [], 0
    end = 1  # of the level above, as places
    while start < len(above):
        stop = int(np.searchsorted(above, end))
        levels.append(visited[1 + start : 1 + stop])
        start, end = stop, 1 + stop
    return levels
