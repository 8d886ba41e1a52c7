"""The geometric error of facets in place of curves.

Two solutions on one polygon do not tell how far the solution on a curved domain is. So the problem
is solved on the divided mesh twice: before and after the new vertices of curved sides go onto the
curves. What lies between the facets and a smooth curve falls to a quarter by this, and so does the
error in values; derivatives next to a facet are as wrong as the distance over the length of the
facet. The quarter is measured, for a curve need not be smooth.

Source: Strang and Fix, An Analysis of the Finite Element Method, Prentice-Hall (1973), Section 4.4.
"""

import math

import numpy as np
from dolfinx import fem

from dolfinx_signorini.accuracy.cells import cell_norms, collected, total
from dolfinx_signorini.accuracy.indicators import difference, size
from dolfinx_signorini.accuracy.targets import Target
from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.meshes.curved_sides import CurvedSides
from dolfinx_signorini.meshes.refinement import Refinement, with_nodes_moved
from dolfinx_signorini.meshes.sided_meshes import SidedMesh
from dolfinx_signorini.norms.names import parse_norm

LEAST, MOST = 0.25, 0.9  # of what is between facets and curves: what halved facets leave of that


class MovedSides:
    """A divided mesh whose curved sides are moved, and what a solution makes of that:

        moved = MovedSides(curves, sided, division, problem.u, target)
        if moved:
            ...  # solve again
            value, cells = moved.left(problem.u)

    Args:
        curves: The curved sides.
        sided: The undivided mesh; the call is collective.
        division: The division, whose vertices are moved.
        u: The solution on the division.
        target: What is to be accurate.

    Attributes:
        factor: By how much a division of cells multiplies what their facets leave in the error.
    """

    def __init__(
        self,
        curves: CurvedSides,
        sided: SidedMesh,
        division: Refinement,
        u: fem.Function,
        target: Target,
    ):
        self._target, self._u, self._moved = target, u, False
        self._parents: LocalIndices = division.parents
        if not curves.projections:
            return
        comm = sided.mesh.comm
        self._gaps = curves.gaps(sided)
        whole, halved = (total(g, 1.0, comm) for g in (self._gaps, curves.gaps(sided, 2)))
        share = min(max(halved / whole, LEAST), MOST) if whole > 0.0 else LEAST
        self.factor = share ** (0.5 * self._order())
        self._value = self._functional(u)

        def move() -> None:
            self._moved = curves.fit(division.sided)

        self._before = with_nodes_moved(u, move)

    def __bool__(self) -> bool:
        return self._moved

    def left(self, u: fem.Function) -> tuple[float, Array]:
        """Return what the facets leave in the error, as a whole and for each undivided cell.

        Args:
            u: The solution on the moved mesh; the call is collective.
        """
        target, comm = self._target, u.function_space.mesh.comm
        rest = self.factor / (1.0 - self.factor)
        detail = difference(u, self._before)
        if target.norm is None:
            whole = rest * abs(self._functional(u) - self._value)
        else:
            whole = rest * size(detail, target)
        count = len(self._gaps)
        if not target.weighted and target.norm is not None:
            cells = rest * cell_norms(detail, target.norm)
            return whole, collected(cells, self._parents, count, target.power)
        # Where the sides have moved, the solution tells how much that means.
        slopes = cell_norms(difference(self._u, self._before), parse_norm("W1_1"))
        parts = collected(slopes, self._parents, count, 1.0)
        if total(parts, 1.0, comm) == 0.0:
            parts = self._gaps
        return whole, np.asarray(parts * (whole / (total(parts, 1.0, comm) or 1.0)))

    def _order(self) -> float:
        """The order of convergence of polygons to a curved domain."""
        norm = self._target.norm
        if norm is None:
            return 2.0
        inside = 0.0 if norm.boundary or math.isinf(norm.p) else 1.0 / norm.p
        return 2.0 - norm.derivatives * (1.0 - inside)

    def _functional(self, u: fem.Function) -> float:
        if self._target.functional is None:
            return 0.0
        form = compiled.form(self._target.functional(u))
        return float(u.function_space.mesh.comm.allreduce(fem.assemble_scalar(form)))
