"""The boundary of a plane domain as one closed curve of the nodes of a finite element space."""

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.meshes.boundary_edges import BoundaryEdges


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
        widths: The length of each edge.
        length: Length of the curve.

    Raises:
        InputError: The elements are not linear, or the boundary is not one closed curve.
    """

    def __init__(self, space: fem.FunctionSpace):
        degree, comm = space.element.basix_element.degree, space.mesh.comm
        require(comm, degree == 1, f"degree 1 is needed, not {degree}", "space")
        self.space = space
        self.edges = BoundaryEdges(space.mesh)
        curves = self.edges.curves
        require(comm, len(curves) == 1, f"{len(curves)} closed curves, not one", "boundary")
        rows, reverse = curves[0].T
        x = self.edges.x[rows, reverse]
        following = np.roll(x, -1, axis=0)
        if (x[:, 0] * following[:, 1] - x[:, 1] * following[:, 0]).sum() < 0.0:
            rows, reverse = rows[::-1], 1 - reverse[::-1]
            x = self.edges.x[rows, reverse]
        first = int(np.lexsort((x[:, 0], x[:, 1]))[0])
        self._rows, self._reverse = np.roll(rows, -first), np.roll(reverse, -first)
        self.x = np.roll(x, -first, axis=0)
        ends = self.edges.ends(space.dofmap.list)
        dofs = space.dofmap.index_map.local_to_global(ends.ravel()).reshape(ends.shape)
        self.dofs = self.edges.gathered(dofs)[self._rows, self._reverse]
        self.widths = self.edges.lengths[self._rows]
        self.s = np.concatenate(([0.0], np.cumsum(self.widths)[:-1]))
        self.length = float(self.widths.sum())

    @property
    def corners(self) -> Array:
        """Arc length of the nodes at which the curve changes its direction."""
        edges = np.roll(self.x, -1, axis=0) - self.x
        before = np.roll(edges, 1, axis=0)
        turn = before[:, 0] * edges[:, 1] - before[:, 1] * edges[:, 0]
        return self.s[np.abs(turn) > 1e-8 * (edges**2).sum(axis=1)]

    def values(self, function: fem.Function) -> Array:
        """Return the nodal values of a function of the space along the curve."""
        owned, local = self._owned()
        values = np.zeros(len(self.dofs))
        values[owned] = function.x.array[local]
        return np.asarray(self.space.mesh.comm.allreduce(values))

    def function(self, values: Array) -> fem.Function:
        """Return the function with given values along the curve and 0 at all other nodes."""
        owned, local = self._owned()
        result = fem.Function(self.space)
        result.x.array[local] = values[owned]
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
        values = self.edges.samples(expressions, points)[self._rows]
        reverse = self._reverse == 1
        values[reverse] = values[reverse, ::-1]
        return values

    def gradients(self, function: fem.Function) -> Array:
        """Return the gradient of a function of the space on each edge, shape (n, 2)."""
        grad = ufl.grad(function)
        return self.samples([grad[0], grad[1]], np.array([0.5]))[:, 0]

    def facets_between(self, edges: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
        """Return the owned facets (local indices) of the marked edges."""
        domain, facets = self.space.mesh, self.edges.facets
        offset = sum(domain.comm.allgather(len(facets))[: domain.comm.rank])
        rows = self._rows[edges] - offset
        mine = facets[rows[(rows >= 0) & (rows < len(facets))]]
        connectivity = domain.topology.connectivity(2, 1)
        return np.array(sorted(connectivity.links(c)[k] for c, k in mine), dtype=np.int32)

    def _owned(self) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.int64]]:
        """Whether this rank owns a node, and the local dofs of the owned nodes."""
        first, last = self.space.dofmap.index_map.local_range
        owned = (self.dofs >= first) & (self.dofs < last)
        return owned, self.dofs[owned] - first
