"""Defects of meshes of triangles or tetrahedra: flat cells, and cells that overlap.

Cells overlap where a mesh is folded, and where two parts of a mesh, or two bodies, lie on each
other. All here works on the vertices of all cells, on one rank.
"""

import math
from collections.abc import Iterator
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_signorini.base.arrays import Array, Indices, Mask, blocks
from dolfinx_signorini.base.tolerances import HALF_OF_THE_DIGITS, SOLVED

# Of the width of the thinner cell: how far cells may overlap by the rounding of their vertices.
OVERLAP = SOLVED**0.5


def cell_defect(ids: Indices, corners: Array) -> str:
    """Return what is wrong with the cells of a mesh: flat or overlapping ones; "" for nothing.

    Args:
        ids: The numbers of the vertices of each cell, shape (cells, vertices).
        corners: The coordinates of the vertices, shape (cells, vertices, dimension).
    """
    if not len(ids):
        return ""
    edges = corners[:, 1:] - corners[:, :1]
    size = np.linalg.norm(edges, axis=2).max(axis=1)
    if not (np.abs(np.linalg.det(edges)) > SOLVED * size ** len(edges[0])).all():
        return "a cell has (almost) no volume"
    facets, opposite = _facets(ids)
    same = (facets[1:, :-1] == facets[:-1, :-1]).all(axis=1)
    if (same[1:] & same[:-1]).any():
        return "more than two cells meet in a facet"
    first = np.flatnonzero(same)
    folded = _folded(corners, facets[first, -1], opposite[first], facets[first + 1, -1])
    alone = np.append(~same, True) & np.append(True, ~same)
    if folded is None:
        folded = _covered(corners, np.unique(facets[alone, -1]))
    if folded is None:
        return ""
    return "cells overlap near (" + ", ".join(f"{c:.6g}" for c in folded) + ")"


def _facets(ids: Indices) -> tuple[Indices, Indices]:
    """The facets in an order with equal ones side by side.

    Returns:
        For each facet of each cell its vertices and the cell, shape (facets, dimension + 1); and
        which vertex of the cell is opposite.
    """
    count, corners = ids.shape
    rows = []
    for j in range(corners):
        vertices = np.sort(np.delete(ids, j, axis=1), axis=1)
        rows.append(np.column_stack((vertices, np.arange(count))))
    facets, opposite = np.concatenate(rows), np.repeat(np.arange(corners), count)
    order = np.lexsort(facets[:, :-1].T)
    return facets[order], opposite[order]


def _folded(corners: Array, cells: Indices, opposite: Indices, neighbours: Indices) -> Array | None:
    """The middle of a cell that lies on its neighbour, if there is one.

    Two cells with a common facet lie on different sides of the facet. Of the neighbour's vertices
    the one that is farthest from the facet is not on it.
    """
    x, pairs = corners[cells], np.arange(len(cells))
    base, apex = x[pairs, (opposite + 1) % x.shape[1]], x[pairs, opposite]
    edges = [x[pairs, (opposite + k) % x.shape[1]] - base for k in range(2, x.shape[1])]
    normal = _normal(*edges)
    height = np.einsum("ci,ci->c", apex - base, normal)
    others = np.einsum("cvi,ci->cv", corners[neighbours] - base[:, None], normal)
    far = others[pairs, np.abs(others).argmax(axis=1)]
    bad = np.flatnonzero(height * far > 0.0)
    return x[bad[0]].mean(axis=0) if len(bad) else None


def _covered(corners: Array, outer: Indices) -> Array | None:
    """The middle of a cell on the boundary that another cell overlaps, if there is one.

    Where a mesh without folds covers something twice, the part that is covered twice ends at the
    boundary of the mesh, and thus a cell on the boundary is covered twice.
    """
    for first, second in _near(corners, outer):
        a, b = corners[first], corners[second]
        meet = _meet(a, b, _normals(a)) & _meet(a, b, _normals(b))
        if corners.shape[2] == 3:
            left = np.flatnonzero(meet)
            a, b, first = a[left], b[left], first[left]
            meet = _meet(a, b, _crossed(a, b))
        if meet.any():
            return corners[first[meet][0]].mean(axis=0)
    return None


def _near(corners: Array, outer: Indices) -> Iterator[tuple[Indices, Indices]]:
    """Pairs of a cell of some, and another cell, whose boxes meet; cells of like size at a time."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    middle, radius = 0.5 * (low + high), 0.5 * np.linalg.norm(high - low, axis=1)
    classes = np.ceil(np.log2(radius)).astype(np.int64)
    for size in np.unique(classes):
        members = np.flatnonzero(classes == size)
        tree = cKDTree(middle[members])
        for some in (outer[part] for part in blocks(len(outer), 50)):
            found = tree.query_ball_point(middle[some], radius[some] + math.ldexp(1.0, int(size)))
            counts = np.array([len(f) for f in found])
            first = np.repeat(some, counts)
            second = members[np.concatenate([*map(np.asarray, found), []]).astype(np.int64)]
            boxes = (low[first] < high[second]) & (low[second] < high[first])
            kept = boxes.all(axis=1) & (first != second)
            yield first[kept], second[kept]


def _normals(x: Array) -> Array:
    """The normals of the facets of cells, shape (cells, facets, dimension)."""
    facets = combinations(range(x.shape[1]), x.shape[2])
    normals = [_normal(*(x[:, j] - x[:, i] for j in others)) for i, *others in facets]
    return np.stack(normals, axis=1)


def _normal(first: Array, *second: Array) -> Array:
    """The normals of facets from one edge, or two at a vertex, shape (facets, dimension)."""
    if not second:
        return np.stack((-first[:, 1], first[:, 0]), axis=1)
    return np.asarray(np.cross(first, second[0]), dtype=np.float64)


def _crossed(a: Array, b: Array) -> Array:
    """The normals of pairs of edges of tetrahedra, shape (pairs, 36, 3); 0 for parallel ones."""
    i, j = np.triu_indices(4, 1)
    e, f = a[:, j] - a[:, i], b[:, j] - b[:, i]
    normals = np.asarray(np.cross(e[:, :, None], f[:, None]), dtype=np.float64)
    sizes = np.linalg.norm(e, axis=2)[:, :, None] * np.linalg.norm(f, axis=2)[:, None]
    normals[np.linalg.norm(normals, axis=3) < HALF_OF_THE_DIGITS * sizes] = 0.0
    return normals.reshape(len(a), 36, 3)


def _meet(a: Array, b: Array, axes: Array) -> Mask:
    """Whether no axis separates cells: along each of them their shadows overlap."""
    p, q = (np.einsum("pvi,pni->pnv", x, axes) for x in (a, b))
    common = np.minimum(p.max(axis=2), q.max(axis=2)) - np.maximum(p.min(axis=2), q.min(axis=2))
    thinner = np.minimum(np.ptp(p, axis=2), np.ptp(q, axis=2))
    rounding = 1e-14 * np.abs(p).max(axis=2)
    return ((common > OVERLAP * thinner + rounding) | (thinner == 0.0)).all(axis=1)
