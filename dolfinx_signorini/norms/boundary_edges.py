"""The boundary of a plane mesh as closed curves of edges, the same on all ranks.

The curves have O(N) edges where the mesh has O(N^2) cells: every rank holds all of them, and
algorithms on the curves are plain NumPy.
"""

import functools

import numpy as np
import numpy.typing as npt
from dolfinx import mesh
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array, Indices
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.data.formula_values import values_at
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, facet_cells, facet_nodes


class BoundaryEdges:
    """The edges on the boundary of a plane domain, and the closed curves that they make:

        edges = BoundaryEdges(domain)
        for curve in edges.curves:
            lengths = edges.lengths[curve[:, 0]]

    Args:
        domain: A mesh of a plane domain; the call is collective.

    Attributes:
        domain: The mesh.
        facets: The boundary facets of this rank as (cell, local facet) pairs.
        x: Coordinates of the two ends of every edge, shape (edges, 2, 2).
    """

    def __init__(self, domain: mesh.Mesh):
        self.domain = domain
        facets = boundary_facets(domain)
        self.facets, self._ends = facet_cells(domain, facets), facet_nodes(domain, facets)
        self.x = self.gathered(domain.geometry.x[self._ends][:, :, :2])

    @functools.cached_property
    def curves(self) -> list[Indices]:
        """The closed curves, see `closed_curves`; the first call is collective."""
        number, ends = self.domain.geometry.index_map().local_to_global, self._ends
        return closed_curves(self.gathered(number(ends.ravel()).reshape(ends.shape)))

    @property
    def lengths(self) -> Array:
        """The length of each edge."""
        return np.asarray(np.hypot(*(self.x[:, 1] - self.x[:, 0]).T))

    def samples(self, expressions: list[Expr], points: npt.NDArray) -> Array:
        """Evaluate expressions at points of every edge.

        Args:
            expressions: UFL expressions of any shape.
            points: Positions along an edge from 0 to 1, ascending and symmetric about 1/2.

        Returns:
            Shape (edges, points, components), from the first to the second end of each edge.
        """
        at = Points(self.domain, self.facets, np.asarray(points)[:, None])
        return self.gathered(np.stack(values_at(self.domain, expressions)(at), axis=2))

    def gathered(self, local: npt.NDArray) -> npt.NDArray:
        """Return values at the boundary facets of this rank for the edges of all ranks."""
        return np.concatenate(self.domain.comm.allgather(local))


def closed_curves(vertices: Indices) -> list[Indices]:
    """Chain edges into closed curves.

    Args:
        vertices: The two vertices of every edge, shape (edges, 2).

    Returns:
        The curves, see `edge_chains`.

    Raises:
        InputError: Some vertex does not belong to exactly two edges.
    """
    _, counts = np.unique(vertices, return_counts=True)
    if (counts != 2).any():
        raise InputError(
            "the boundary is not made of closed curves: a vertex has not two edges", "mesh"
        )
    return edge_chains(vertices)


def edge_chains(edges: Indices) -> list[Indices]:
    """Chain edges into curves: open ones, which end where a vertex has one edge, and closed ones.

    Args:
        edges: The two vertices of each edge, shape (edges, 2).

    Returns:
        For each curve its edges in order, shape (edges of the curve, 2): the row of the edge in
        `edges`, and 1 where the curve runs from the second to the first vertex of the edge, else
        0. Open curves come first.

    Raises:
        InputError: Some vertex belongs to more than two edges.
    """
    order = np.argsort(edges.ravel(), kind="stable")
    ids = edges.ravel()[order]
    same = np.flatnonzero(ids[1:] == ids[:-1])
    if (np.diff(same) == 1).any():
        raise InputError("the edges are no curves: a vertex has more than two of them", "mesh")
    partner = np.full(len(order), -1)  # the other edge end at the same vertex
    partner[order[same]], partner[order[same + 1]] = order[same + 1], order[same]
    free = np.flatnonzero(partner < 0)
    seen = np.zeros(len(edges), dtype=bool)
    curves = []
    for start in [*map(int, free), *range(0, 2 * len(edges), 2)]:
        curve, end = [], start
        while end >= 0 and not seen[end // 2]:
            seen[end // 2] = True
            curve.append((end // 2, end % 2))
            end = int(partner[end ^ 1])
        if curve:
            curves.append(np.array(curve, dtype=np.int64))
    return curves
