"""Formulas of complex coordinates: discs around all values, and what polynomials miss of a formula.

Let x be in a cell with the centre x0, and f(x0 + s (x - x0)) be analytic for complex |s| <= R, with
values that are at most M away from f(x0). Then the Taylor polynomial of degree n at x0 misses at
most M R^-n / (R - 1) of f in the cell, and f itself is at most M / R away from f(x0): by Cauchy's
and Schwarz's inequalities. One enclosure by discs in the plane of complex numbers bounds all
derivatives at once.

Where a formula chooses (where, min, max, abs, sign) and the choice is the same all over the cell,
the chosen part is continued analytically. A choice is taken to be the same where that holds in the
cell without its outermost part of relative width `SOLVED`: jumps along sides of cells are none.

Source: Ahlfors, Complex Analysis (1979), Sections 4.2 and 4.3.
"""

from collections.abc import Callable
from functools import reduce

import numpy as np
import numpy.typing as npt

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.data.discs import Disc
from dolfinx_signorini.data.formulas import Formula, Node, Values
from dolfinx_signorini.data.interfaces.singular_sets import factors
from dolfinx_signorini.data.intervals import Interval

REACHES = (20.0, 8.0, 4.0, 2.5)  # of the neighbourhoods that are tried


def missed_by_discs(
    formula: Formula, corners: Array, missed: Callable[[float], npt.ArrayLike]
) -> Array:
    """Return the best bound of what polynomials miss that neighbourhoods of simplices tell.

    Args:
        formula, corners: See `discs`.
        missed: Returns by R what polynomials miss at most where M = 1, a number or several.

    Returns:
        The bounds, shape (numbers, simplices) or (simplices,).
    """
    radii = [(reach, discs(formula, corners, reach)[1]) for reach in REACHES]
    return np.min([np.multiply.outer(missed(reach), radius) for reach, radius in radii], axis=0)


def discs(formula: Formula, corners: Array, reach: float) -> tuple[Array, Array]:
    """Return discs around the values of a formula at complex points around simplices.

    Args:
        formula: The formula.
        corners: The vertices of the simplices, shape (simplices, vertices, dimension).
        reach: R, the size of the complex neighbourhoods as a multiple of the simplices.

    Returns:
        The centres and the radii, shape (simplices,); infinite radii where a formula is not
        analytic, or not found to be so.
    """
    low, high = corners.min(axis=1).T, corners.max(axis=1).T
    with np.errstate(all="ignore"):
        found = _Discs(0.5 * (low + high), 0.5 * (high - low), reach)(formula.root)
        both = np.broadcast_arrays(found.centre, found.radius, np.empty(len(corners)))
        unknown = ~(np.isfinite(both[0]) & np.isfinite(both[1]))
    return np.where(unknown, 0.0, both[0]), np.where(unknown, np.inf, both[1])


class _Discs(Values[Disc]):
    """Discs around the values of the nodes of a formula, by boxes around the simplices."""

    def __init__(self, centres: Array, widths: Array, reach: float):
        coordinates = [Disc(centres[k], reach * widths[k]) for k in range(len(centres))]
        super().__init__("disc", coordinates, coordinates[0].like)
        self.inner = (1.0 - SOLVED) / reach  # of a disc: the values in the simplex

    def find(self, node: Node) -> Disc:
        if node.switch is not None:
            return self._choice(node.switch, self(node.chosen(True)), self(node.chosen(False)))
        if node.op in ("number", "coordinate") or node.operation.disc is not None:
            return super().find(node)
        return self._by_slope(node, *map(self, node.operands))

    def _choice(self, margin: Node, a: Disc, b: Disc) -> Disc:
        """a where the margin is positive in the whole simplex, b where negative.

        An analytic product without a zero of its factors has one sign, that at the centre.
        """
        decides = self(margin)
        clear = self._nonzero(decides)
        if len(parts := factors(margin)) > 1:
            known = reduce(np.logical_and, map(self._nonzero, map(self, parts)))
            clear = clear | (known & np.isfinite(decides.radius))
        yes, no = clear & (decides.centre > 0.0), clear & (decides.centre < 0.0)
        radius = np.where(yes, a.radius, np.where(no, b.radius, np.inf))
        return Disc(np.where(yes, a.centre, b.centre), radius)

    def _nonzero(self, a: Disc) -> Mask:
        """Whether a function has no zero in the whole simplex."""
        return np.asarray(np.abs(a.centre) > self.inner * a.radius)

    def _by_slope(self, node: Node, *args: Disc) -> Disc:
        """A function that changes by at most its largest derivative times the radius."""
        reals = [a.centre + self.inner * a.radius * np.array([[-1.0], [1.0]]) for a in args]
        jumps = node.operation.jumps(*map(Interval, reals))
        changes = (Disc(np.array(0.0), a.radius) for a in args)
        change = node.operation.slope(None, *args, *changes).size
        return Disc(node.operation.of("numpy")(*(a.centre for a in args)), change).where(~jumps)
