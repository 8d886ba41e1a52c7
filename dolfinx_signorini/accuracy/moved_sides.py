"""The geometric error of facets in place of curves.

Two solutions on one polygon do not tell how far the solution on a curved domain is. So the problem
is solved on the divided mesh twice: before and after the new vertices of curved sides go onto the
curves. What lies between the facets and a smooth curve falls to a quarter by this, and so does the
error in values; derivatives next to a facet are as wrong as the distance over the length of the
facet. The quarter is measured, for a curve need not be smooth.

Source: Strang and Fix, An Analysis of the Finite Element Method, Prentice-Hall (1973), Section 4.4.
"""

import numpy as np
from dolfinx import fem

from dolfinx_signorini.accuracy.cells import cell_norms
from dolfinx_signorini.accuracy.rates import SLOWEST
from dolfinx_signorini.accuracy.targets import Target, size
from dolfinx_signorini.accuracy.terms import Solved, difference
from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.meshes.curved_sides import CurvedSides
from dolfinx_signorini.meshes.refinement import Refinement, with_nodes_moved
from dolfinx_signorini.meshes.sided_meshes import SidedMesh
from dolfinx_signorini.norms.names import parse_norm
from dolfinx_signorini.norms.power_sums import total


class MovedSides:
    """A divided mesh whose curved sides are moved, and what a solution makes of that:

        moved = MovedSides(curves, sided, division, problem.u, target)
        if moved:
            ...  # solve again
            parts = moved.parts(solved)

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
        if not curves.projections:
            return
        comm = sided.mesh.comm
        self._gaps = curves.gaps(sided)
        whole, halved = (total(g, 1.0, comm) for g in (self._gaps, curves.gaps(sided, 2)))
        smooth = 2.0**-2.0  # what halved facets leave of the distance to a smooth curve
        share = max(halved / whole, smooth) if whole > 0.0 else smooth
        self.factor = min(share, 2.0**-SLOWEST) ** (0.5 * self._order())
        self._value = self._functional(u)

        def move() -> None:
            self._moved = curves.fit(division.sided)

        self._before = with_nodes_moved(u, move)

    def __bool__(self) -> bool:
        return self._moved

    def parts(self, solved: Solved) -> Array:
        """Return what the facets leave in the error on each cell; the parts have no sign.

        Args:
            solved: The solution on the moved mesh as the finer one; the call is collective.
        """
        target, u, comm = self._target, solved.fine.u, solved.fine.comm
        rest = self.factor / (1.0 - self.factor)
        detail = difference(u, self._before)
        if not target.weighted and target.norm is not None:
            return rest * solved.norms(detail)
        if target.norm is None:
            whole = rest * abs(self._functional(u) - self._value)
        else:
            whole = rest * size(detail, target)
        # Where the sides have moved, the solution tells how much that means.
        slopes = cell_norms(difference(self._u, self._before), parse_norm("W1_1"))
        (parts,) = solved.on_parents(slopes[None])
        if total(parts, 1.0, comm) == 0.0:
            parts = self._gaps
        return np.asarray(parts * (whole / (total(parts, 1.0, comm) or 1.0)))

    def _order(self) -> float:
        """The order of convergence of polygons to a curved domain."""
        norm = self._target.norm
        if norm is None:
            return 2.0
        inside = 0.0 if norm.boundary else 1.0 / norm.p
        return 2.0 - norm.derivatives * (1.0 - inside)

    def _functional(self, u: fem.Function) -> float:
        if self._target.functional is None:
            return 0.0
        return compiled.integral(self._target.functional(u))
