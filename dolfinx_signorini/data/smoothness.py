"""Solutions whose load is a function: the flux A grad u is continuous but at singular points.

Where u has a kink or A jumps, -div(A grad u) has a part on a curve, which no formula for the load
has. Poles and the cut of an angle do the same. A power of a distance to a point does not.
"""

from collections.abc import Sequence

import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.data.enclosures import Enclosures
from dolfinx_signorini.data.formulas import Formula, Node, PerNode
from dolfinx_signorini.data.intervals import Interval
from dolfinx_signorini.data.matrices import least_stretch

ANY, CONTINUOUS, SMOOTH = range(3)  # what a formula is known to be: nothing, continuous, or C^1


def load_is_a_function(solution: Formula, diffusion: Sequence[Formula], corners: Array) -> bool:
    """Return whether the load of a solution is known to be what its formula says.

    Args:
        solution: u.
        diffusion: The entries of A.
        corners: The vertices of cells, shape (cells, vertices, dimension).
    """
    known = _Smoothness(corners)
    entries = min((known(entry.root) for entry in diffusion), default=SMOOTH)
    return known(solution.root) == SMOOTH and entries >= CONTINUOUS


class _Smoothness(PerNode[int]):
    """How smooth the nodes of a formula are known to be on all cells and across their sides."""

    def __init__(self, corners: Array):
        super().__init__()
        self.corners = corners
        self.enclosures = Enclosures(corners.min(axis=1), corners.max(axis=1))

    def find(self, node: Node) -> int:
        with np.errstate(all="ignore"):
            if not np.isfinite(self.ends(node)).all():
                return ANY
            operands = node.args[1:] if node.op == "where" else node.args
            if node.op == "^" and node.args[1].value > 1.0:
                operands = _unfolded(node.args[0])
            return min((self._own(node), *map(self, operands)), default=SMOOTH)

    def ends(self, node: Node) -> Array:
        """The values on the cells, shape (2, cells)."""
        value = self.enclosures(node).ends[:, 0]
        return np.broadcast_to(value, (2, len(self.corners)))

    def _own(self, node: Node) -> int:
        """What an operation leaves of operands that are smooth."""
        if not node.args:
            return SMOOTH
        if node.switch is not None:
            low, high = self.ends(node.switch)
            rough = CONTINUOUS if node.operation.breaks is None else ANY
            return SMOOTH if (low > 0.0).all() or (high < 0.0).all() else rough
        if node.operation.jumps(*(Interval(self.ends(a)) for a in node.operands)).any():
            return ANY
        if node.op == "hypot":
            # Both arguments vanish at points only, or on lines in space.
            near = self.corners[self.ends(node)[0] <= 0.0]
            return SMOOTH if (least_stretch(node.args, near) > 0.0).all() else CONTINUOUS
        if node.op == "^" and node.args[1].value > 1.0:
            return SMOOTH
        (first, last), (low, high) = node.limits, self.ends(node.args[0])
        inside = (low > first).all() and (high < last).all()
        root = node.op in ("sqrt", "^") and node.args[0].op == "hypot"
        return SMOOTH if inside or root or first == -np.inf else CONTINUOUS


def _unfolded(base: Node) -> tuple[Node, ...]:
    """The operands of |a|, or of the positive or negative part of a, whose powers are smooth."""
    zero = any(a.op == "number" and a.value == 0.0 for a in base.args)
    return base.args if base.op == "abs" or (zero and base.op in ("min", "max")) else (base,)
