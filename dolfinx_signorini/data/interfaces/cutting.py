"""Triangles and tetrahedra fitted to the line or plane where a function changes its sign.

Vertices near the zeros are moved onto them, and the edges that still cross the zeros are split
there: every cell with such an edge into two, so that the cells conform at any time.

Source of the order of the two: Labelle and Shewchuk, Isosurface stuffing, ACM Trans. Graph. 26
(2007) 57, who also move vertices first, and split afterwards.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.tolerances import HALF_OF_THE_DIGITS, SOLVED
from dolfinx_signorini.data.interfaces.interface import Interface
from dolfinx_signorini.data.interfaces.pieces import widths
from dolfinx_signorini.meshes.jacobians import inverses
from dolfinx_signorini.meshes.polynomials import barycentric

NEAR = 0.4  # of an edge: vertices that are nearer to a zero are moved
SHAPE = 0.3  # of a cell, over its shape before: moves that leave less are given up
THIN = 0.1  # of a cell: what a curve may cut off


@dataclass(frozen=True)
class Simplices:
    """A whole mesh on one rank, to be fitted to the zeros of a function:

        fixed = np.zeros(len(x), dtype=bool)
        whole = fitted(Simplices(x, cells, facets, sides, regions, fixed), interface)

    Attributes:
        x: The vertices, shape (vertices, dimension).
        cells: The numbers of the vertices of each cell.
        facets: The numbers of the vertices of each facet of the boundary, and between regions.
        sides: For each of these facets a number that stands for its sides, or for the regions.
        regions: For each cell a number that stands for its regions.
        fixed: Whether a vertex is what the mesh has been fitted to, or on such zeros.
    """

    x: Array
    cells: Indices
    facets: Indices
    sides: Indices
    regions: Indices
    fixed: Mask


def fitted(whole: Simplices, interface: Interface) -> Simplices:
    """Return a mesh that has an interface along facets, and next to them if curved.

    Args:
        whole: The mesh.
        interface: The interface.

    Returns:
        The mesh itself where the interface is in no cell, and where cells are so large that the
        interface is too curved for them.
    """
    if not interface.depths(whole.x[whole.cells]).any():
        return whole
    on = np.zeros(len(whole.x), dtype=bool)
    edges, places = _cuts(whole, interface, on)
    moved, onto = _moved(whole, edges, places)
    on = (on & (moved.x == whole.x).all(axis=1)) | onto
    edges, places = _cuts(moved, interface, on)
    if not (onto.any() or len(edges)):
        return whole
    result = _split(moved, edges, places)
    fixed = np.concatenate((moved.fixed | on, np.ones(len(edges), dtype=bool)))
    thin = (interface.depths(result.x[result.cells]) < THIN).all()
    return replace(result, fixed=fixed) if thin else whole


def with_vertex(whole: Simplices, point: Array) -> Simplices:
    """Return a mesh with a vertex at a point.

    The nearest corner of the cell around the point is moved there, where that leaves cells their
    shapes and the boundary its sides. Elsewhere cells are bisected first, at edges that no cell
    around has a longer one than.

    Args:
        whole: The mesh.
        point: The point, shape (dimension,).

    Returns:
        The mesh itself where the point is in no cell.
    """
    while True:
        away = np.linalg.norm(whole.x - point, axis=1)
        if away.min() <= HALF_OF_THE_DIGITS * np.ptp(whole.x, axis=0).max():
            return replace(whole, fixed=whole.fixed | (away == away.min()))
        corners = whole.x[whole.cells]
        edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
        shares = barycentric(np.einsum("cij,cj->ci", inverses(edges), point - corners[:, 0]))
        cell = shares.min(axis=1).argmax()
        if shares[cell].min() < -SOLVED:
            return whole
        whole, moved = _onto(whole, whole.cells[cell, shares[cell].argmax(), None], point[None])
        if not moved.any():
            whole = _split(whole, _longest_edge(whole, cell)[None], np.array([0.5]))


def _longest_edge(whole: Simplices, cell: np.int64) -> Indices:
    """The edge at the end of a path of longest edges, which no cell around has a longer one than.

    Source: Rivara, New longest-edge algorithms for the refinement and/or improvement of
    unstructured triangulations, Int. J. Numer. Meth. Engng 40 (1997) 3313-3324.
    """
    around, edge, length = np.array([cell]), whole.cells[cell, :2], 0.0
    while True:
        pairs = _edges(whole.cells[around]).reshape(-1, 2)
        lengths = _lengths(whole.x, pairs)
        if lengths.max() <= (1.0 + SOLVED) * length:
            return edge
        edge, length = pairs[lengths.argmax()], lengths.max()
        around = np.flatnonzero(np.isin(whole.cells, edge).sum(axis=1) == 2)


def _cuts(whole: Simplices, interface: Interface, on: Mask) -> tuple[Indices, Array]:
    """Find the edges that cross an interface.

    Args:
        whole: The mesh.
        interface: The interface.
        on: Whether a vertex is known to be at a zero; vertices that turn out to be are added.

    Returns:
        The ends of the edges, shape (edges, 2), in the order of their numbers, and where the zeros
        are, as shares of the edges from the first end.
    """
    edges = np.unique(_edges(whole.cells).reshape(-1, 2), axis=0)
    signs = np.sign(interface.values(whole.x))
    on |= signs == 0.0
    edges = edges[~on[edges].any(axis=1) & (signs[edges].prod(axis=1) < 0.0)]
    places = interface.zeros(*whole.x[edges.T])
    on[edges[places < SOLVED, 0]] = on[edges[places > 1.0 - SOLVED, 1]] = True
    kept = ~on[edges].any(axis=1)
    return edges[kept], places[kept]


def _edges(simplices: Indices) -> Indices:
    """The ends of the edges of simplices in their order, shape (simplices, edges, 2)."""
    pairs = list(itertools.combinations(range(simplices.shape[1]), 2))
    return np.sort(simplices[:, pairs], axis=2)


def _lengths(x: Array, edges: Indices) -> Array:
    """The lengths of edges."""
    return np.asarray(np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1))


def _between(x: Array, edges: Indices, places: Array) -> Array:
    """The points at shares of edges."""
    return np.asarray(x[edges[:, 0]] + places[:, None] * (x[edges[:, 1]] - x[edges[:, 0]]))


def _moved(whole: Simplices, edges: Indices, places: Array) -> tuple[Simplices, Mask]:
    """Move vertices onto the zeros on their edges, and tell which vertices have been moved."""
    ends = np.where(places[:, None] < 0.5, edges, edges[:, ::-1])
    near = np.minimum(places, 1.0 - places) < NEAR
    return _onto(whole, ends[near, 0], _between(whole.x, edges, places)[near])


def _onto(whole: Simplices, vertices: Indices, points: Array) -> tuple[Simplices, Mask]:
    """Move vertices onto points where that leaves cells their shapes, and tell which were moved."""
    ways = points - whole.x[vertices]
    order = np.flatnonzero(~whole.fixed[vertices] & _slides(whole, vertices, ways))
    order = order[np.argsort(-np.linalg.norm(ways[order], axis=1), kind="stable")]
    points, onto = whole.x.copy(), points[order]
    points[vertices[order]] = onto  # the last one is the nearest
    chosen = np.zeros(len(points), dtype=bool)
    chosen[vertices[order]] = True
    before = _shapes(whole.x[whole.cells])
    while True:
        x = np.where(chosen[:, None], points, whole.x)
        bad = _shapes(x[whole.cells]) / before < SHAPE
        worse = np.unique(whole.cells[bad])
        if not chosen[worse].any():
            return replace(whole, x=x), chosen
        chosen[worse] = False


def _shapes(corners: Array) -> Array:
    """The volumes of cells over cubes of their widths, with the sign of the numbering."""
    edges = corners[:, 1:] - corners[:, :1]
    return np.asarray(np.linalg.det(edges) / widths(corners) ** edges.shape[1])


def _slides(whole: Simplices, vertices: Indices, ways: Array) -> Mask:
    """Whether moves of vertices change neither the boundary nor one of its sides.

    Args:
        whole: The mesh.
        vertices: The vertices.
        ways: Where each of them goes, from where the vertex is.
    """
    facets, count = whole.facets, len(whole.x)
    numbers = np.bincount(facets.ravel(), minlength=count)

    def mean(values: Array) -> Array:
        sums = np.bincount(facets.ravel(), np.repeat(values, facets.shape[1]), count)
        return np.asarray(sums / np.maximum(numbers, 1))

    normal, free = planes(whole.x[facets], whole.sides, mean)
    across = np.linalg.norm(np.einsum("vij,vj->vi", normal[vertices], ways), axis=1)
    return free[vertices] & (across <= SOLVED * np.linalg.norm(ways, axis=1))


def planes(corners: Array, sides: Indices, mean: Callable[[Array], Array]) -> tuple[Array, Mask]:
    """Return the planes of the boundary at vertices, and whether the vertices slide in them.

    Args:
        corners: The vertices of the facets of the boundary, shape (facets, dimension, dimension).
        sides: For each facet a number that stands for the sides of the facet.
        mean: Returns for each vertex the mean of one value per facet over the facets around the
            vertex, and 0 where no facet is.

    Returns:
        For each vertex the mean of n n^T over the normals n around the vertex, shape (vertices,
        dimension, dimension): 0 inside of the domain, and n n^T in a plane. And whether the facets
        around the vertex are in one plane and on the same sides, as for all vertices inside.
    """
    normals = np.linalg.svd(corners[:, 1:] - corners[:, :1], full_matrices=True)[2][:, -1]
    products = np.moveaxis(normals[:, :, None] * normals[:, None], 0, -1)
    result = np.array([[mean(values) for values in row] for row in products])
    result = np.moveaxis(result, -1, 0)
    parallel = (result**2).sum(axis=(1, 2)) >= (1.0 - SOLVED) * np.trace(result, axis1=1, axis2=2)
    numbers = sides.astype(np.float64)
    same = mean(numbers**2) - mean(numbers) ** 2 <= SOLVED * mean(numbers**2)
    return result, parallel & same


def _split(whole: Simplices, edges: Indices, places: Array) -> Simplices:
    """Split edges with all cells and facets around them, the longest edge of a cell first."""
    if not len(edges):
        return whole
    count = len(whole.x)
    x = np.concatenate((whole.x, _between(whole.x, edges, places)))
    lengths = _lengths(whole.x, edges)
    ranks = np.empty(len(edges), dtype=np.int64)
    ranks[np.lexsort((np.arange(len(edges)), lengths))] = np.arange(len(edges))
    cells, facets, sides, regions = whole.cells, whole.facets, whole.sides, whole.regions
    while True:
        found = _numbers(cells, edges, len(x))
        best = np.where(found >= 0, ranks[found], -1).max(axis=1, initial=-1)
        if (best < 0).all():
            fixed = np.concatenate((whole.fixed, np.zeros(len(edges), dtype=bool)))
            return Simplices(x, cells, facets, sides, regions, fixed)
        ready = np.ones(len(edges), dtype=bool)
        ready[found[(found >= 0) & (ranks[found] < best[:, None])]] = False
        cells, parents = _halves(cells, edges, ready, count, len(x))
        regions = regions[parents]
        facets, parents = _halves(facets, edges, ready, count, len(x))
        sides = sides[parents]


def _numbers(simplices: Indices, edges: Indices, count: int) -> Indices:
    """The numbers of the edges of simplices in a list of edges, or -1; `count` vertices."""
    keys, known = _edges(simplices) @ (count, 1), edges @ (count, 1)
    places = np.minimum(np.searchsorted(known, keys), len(known) - 1)
    return np.where(known[places] == keys, places, -1)


def _halves(
    simplices: Indices, edges: Indices, ready: Mask, first: int, count: int
) -> tuple[Indices, Indices]:
    """Split simplices at those of their edges that are ready, at most one of each simplex.

    Args:
        simplices: The simplices.
        edges: The edges.
        ready: Whether an edge is split.
        first: The number of the vertex in the first edge, and so on.
        count: The number of vertices.

    Returns:
        The simplices, and which one each of them comes from.
    """
    found = _numbers(simplices, edges, count)
    chosen = np.where((found >= 0) & ready[found], found, -1).max(axis=1, initial=-1)
    split = np.flatnonzero(chosen >= 0)
    middles = first + chosen[split, None]
    halves = [
        np.where(simplices[split] == edges[chosen[split], k, None], middles, simplices[split])
        for k in range(2)
    ]
    kept = np.flatnonzero(chosen < 0)
    return np.concatenate((simplices[kept], *halves)), np.concatenate((kept, split, split))
