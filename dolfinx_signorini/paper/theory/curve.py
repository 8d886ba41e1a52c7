"""The boundary of a plane domain as a closed curve of mesh edges, the same on all ranks.

The curve has O(N) nodes where the mesh has O(N^2): every rank holds it whole, and algorithms on it
are plain NumPy.
"""

import basix
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_signorini import compat
from dolfinx_signorini.errors import require
from dolfinx_signorini.fractional import closed_curves
from dolfinx_signorini.meshes import boundary_facets, facet_cells

Array = npt.NDArray[np.float64]


class BoundaryCurve:
    """The nodes on the boundary, counterclockwise from the leftmost of the lowest nodes.

    Edge i joins node i to node i + 1, the last edge the last node to the first:

        curve = BoundaryCurve(space)
        values = curve.values(u_h)  # at arc length curve.s

    Args:
        space: A scalar space of continuous, piecewise linear functions on a plane mesh.

    Attributes:
        dofs: Global dof of each node, shape (n,).
        x: Coordinates of the nodes, shape (n, 2).
        s: Arc length of the nodes from the first, shape (n,).
        length: Length of the curve.
        facets: Boundary facets of this rank as (cell, local facet) pairs.

    Raises:
        InputError: The elements are not linear, or the boundary is not one closed curve.
    """

    def __init__(self, space: fem.FunctionSpace):
        domain = space.mesh
        degree = space.element.basix_element.degree
        require(domain.comm, degree == 1, f"space: degree 1 is needed, not {degree}")
        self.space = space
        self.facets = facet_cells(domain, boundary_facets(domain))
        corners = np.array(basix.topology(basix.CellType[domain.topology.cell_name()])[1])
        dofs = space.dofmap.list[self.facets[:, 0, None], corners[self.facets[:, 1]]]
        geometry = domain.geometry.dofmap[self.facets[:, 0, None], corners[self.facets[:, 1]]]
        ids = space.dofmap.index_map.local_to_global(dofs.ravel().astype(np.int32))
        ends = self._gather(ids.reshape(-1, 2))
        x = self._gather(domain.geometry.x[geometry][:, :, :2])
        curves = closed_curves(ends)
        require(domain.comm, len(curves) == 1, f"boundary: {len(curves)} closed curves, not one")
        rows, reverse = curves[0][:, 0], curves[0][:, 1]
        start = x[rows, reverse]
        following = np.roll(start, -1, axis=0)
        if (start[:, 0] * following[:, 1] - start[:, 1] * following[:, 0]).sum() < 0.0:
            rows, reverse = rows[::-1], 1 - reverse[::-1]
            start = x[rows, reverse]
        first = int(np.lexsort((start[:, 0], start[:, 1]))[0])
        self._rows, self._reverse = np.roll(rows, -first), np.roll(reverse, -first) == 1
        self.x = np.roll(start, -first, axis=0)
        self.dofs = np.roll(ends[rows, reverse], -first)
        lengths = np.linalg.norm(np.roll(self.x, -1, axis=0) - self.x, axis=1)
        self.s = np.concatenate(([0.0], np.cumsum(lengths)[:-1]))
        self.length = float(lengths.sum())

    @property
    def widths(self) -> Array:
        """The length of each edge."""
        return np.diff(np.append(self.s, self.length))

    @property
    def corners(self) -> Array:
        """Arc length of the nodes at which the curve changes its direction."""
        edges = np.roll(self.x, -1, axis=0) - self.x
        before = np.roll(edges, 1, axis=0)
        turn = before[:, 0] * edges[:, 1] - before[:, 1] * edges[:, 0]
        return self.s[np.abs(turn) > 1e-8 * (edges**2).sum(axis=1)]

    def values(self, function: fem.Function) -> Array:
        """Return the nodal values of a function of the space along the curve."""
        index_map = self.space.dofmap.index_map
        first, last = index_map.local_range
        owned = np.flatnonzero((self.dofs >= first) & (self.dofs < last))
        local = np.zeros(len(self.dofs))
        local[owned] = function.x.array[self.dofs[owned] - first]
        return np.asarray(self.space.mesh.comm.allreduce(local))

    def function(self, values: Array) -> fem.Function:
        """Return the function with given values along the curve and 0 at all other nodes."""
        first, last = self.space.dofmap.index_map.local_range
        owned = (self.dofs >= first) & (self.dofs < last)
        result = fem.Function(self.space)
        result.x.array[self.dofs[owned] - first] = values[owned]
        result.x.scatter_forward()
        return result

    def samples(self, expressions: list[Expr], points: Array) -> Array:
        """Evaluate expressions at points of every edge.

        Args:
            expressions: UFL expressions.
            points: Positions along an edge from 0 to 1, ascending and symmetric about 1/2.

        Returns:
            Shape (n, points, expressions), edges and points in the order of the curve.
        """
        domain = self.space.mesh
        vector = fem.Expression(
            ufl.as_vector(expressions), np.asarray(points)[:, None], comm=domain.comm
        )
        local = compat.evaluate(vector, domain, self.facets)
        values = self._gather(local.reshape(-1, len(points), len(expressions)))[self._rows]
        values[self._reverse] = values[self._reverse, ::-1]
        return values

    def facets_between(self, edges: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
        """Return the owned facets (local indices) of the marked edges."""
        domain = self.space.mesh
        counts = domain.comm.allgather(len(self.facets))
        offset = sum(counts[: domain.comm.rank])
        rows = self._rows[edges]
        mine = self.facets[rows[(rows >= offset) & (rows < offset + len(self.facets))] - offset]
        connectivity = domain.topology.connectivity(2, 1)
        facets = [connectivity.links(cell)[facet] for cell, facet in mine]
        return np.array(sorted(facets), dtype=np.int32)

    def _gather(self, local: npt.NDArray) -> npt.NDArray:
        return np.concatenate(self.space.mesh.comm.allgather(local))
