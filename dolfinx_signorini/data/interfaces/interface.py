"""Interfaces: zero sets of functions at whose sign data choose, where data jump or have a kink.

The function is a level set function. Its derivatives are exact, and so are the values of data on
either side of the interface: of each choice that hangs on the function, the chosen part is taken.
"""

import functools
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.optimize.elementwise import find_root

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.tolerances import SIX_DIGITS, SOLVED
from dolfinx_signorini.data.derivatives import Derivative
from dolfinx_signorini.data.formulas import ZERO, Formula, Node, PerNode, evaluated, together
from dolfinx_signorini.data.interfaces.pieces import corners_of_reference, cut, inside
from dolfinx_signorini.data.interfaces.singular_sets import factors, is_even, switches
from dolfinx_signorini.meshes.polynomials import barycentric, equispaced

FLAT = 1e-3  # of the range of the function in a piece: how far from linear the function may be
SAMPLES = 6  # along the edges of cells in which a change of the sign is looked for


class Interface:
    """The zero set of a function:

        interface = Interface(parse("x^2 + y^2 - 0.25").root)
        shares = interface.zeros(start, end)

    Attributes:
        node: The root of the tree of the function.
    """

    def __init__(self, node: Node):
        self.node = node

    def values(self, x: Array) -> Array:
        """Return the values of the function at points, shape (..., dimension)."""
        return evaluated(self.node, x)

    def gradients(self, x: Array) -> Array:
        """Return the gradients of the function at points."""
        return np.stack([evaluated(slope, x) for slope in self._slopes[: x.shape[-1]]], axis=-1)

    @functools.cached_property
    def _slopes(self) -> list[Node]:
        return [Derivative(k)(self.node) for k in range(3)]

    @functools.cached_property
    def sides(self) -> dict[float, "_Side"]:
        """For either sign what makes trees of formulas those of their values on this side."""
        return {side: _Side(self.node, side) for side in (1.0, -1.0)}

    def jump(self, root: Node, x: Array) -> Array:
        """Return the values of a tree next to points, on the positive side less on the other."""
        above, below = together([side(root) for side in self.sides.values()], x)
        return above - below

    def zeros(self, start: Array, end: Array) -> Array:
        """Return where segments cross the interface, as shares of their lengths.

        Args:
            start, end: The ends of the segments, with different signs of the function.
        """
        dimension = start.shape[1]

        def along(share: Array, *ends: Array) -> Array:
            start, end = np.array(ends[:dimension]), np.array(ends[dimension:])
            return self.values((start + share * (end - start)).T)

        both = np.zeros(len(start)), np.ones(len(start))
        return np.asarray(find_root(along, both, args=(*start.T, *end.T)).x)

    def crosses(self, corners: Array) -> Mask:
        """Return whether the zeros may be in cells, shape (cells, vertices, dimension)."""
        return crossed(self._at_middles(corners))[0]

    def depths(self, corners: Array) -> Array:
        """Return how far the function changes its sign inside of cells.

        Args:
            corners: The vertices of the cells, shape (cells, vertices, dimension).

        Returns:
            The largest value of the sign that is less strong, over the largest value; 0 where
            rounding may have made this sign.
        """
        result, near = np.zeros(len(corners)), self.crosses(corners)
        values = self.values(inside(corners[near], inner_lattice(corners.shape[1] - 1)))
        low, high = -values.min(axis=0), values.max(axis=0)
        with np.errstate(all="ignore"):
            shares = np.minimum(low, high) / np.maximum(low, high)
        result[near] = np.where(shares > SOLVED, shares, 0.0)
        return result

    def cut(self, pieces: Array, dimension: int) -> tuple[Array, npt.NDArray[np.int64]]:
        """Cut pieces where the function is zero, as if it were linear in each of them.

        Args:
            pieces: The pieces, whose last coordinates are those in space.
            dimension: The number of coordinates in space.

        Returns:
            The parts, and the numbers of their pieces.
        """
        values, vertices = self._at_middles(pieces[..., -dimension:]), pieces.shape[1]
        apart = _apart(values)
        # The linear functions have the means of the function, as far as that is quadratic.
        shares = 4.0 / (vertices * (vertices + 1))
        at = values[:vertices] + shares * apart.sum(axis=0)
        small = np.abs(at) <= SOLVED * np.abs(at).max(axis=0)
        return cut(pieces, np.where(small | ~np.isfinite(at), 0.0, at).T)

    def matters(
        self, corners: Array, values: Array, formulas: Sequence[Formula], sizes: Sequence[float]
    ) -> Mask:
        """Return whether a flat cut of pieces leaves more than that of a jump that is nearly flat.

        Next to the cut, formulas have the values of the other side. As far away from the zeros as
        the cut may be, these differ by a jump, or by little where there is a kink. Where a jump is
        nearly flat, the mean place of the cut is right, and the square of `FLAT` is left.

        Args:
            corners: The vertices of the pieces, shape (pieces, vertices, dimension).
            values: The values of the function in them, see `crossed`.
            formulas: The formulas.
            sizes: Jumps of these sizes count.
        """
        every, lattice = np.arange(len(corners)), middles(corners.shape[1] - 1)
        ends = [at(axis=0) for at in (values.argmin, values.argmax)]
        (low, high), points = (values[end, every] for end in ends), inside(corners, lattice)
        start, end = (points[end, every] for end in ends)
        off = np.abs(_apart(values)).max(axis=0)
        result = np.zeros(len(corners), dtype=bool)
        with np.errstate(all="ignore"):
            shares = np.clip((np.stack((-off, off)) - low) / (high - low), 0.0, 1.0)
            beside = start + shares[..., None] * (end - start)
            x = np.concatenate((start[None], end[None], beside)).reshape(-1, corners.shape[2])
            for formula, size in zip(formulas, sizes, strict=True):
                trees = [side(formula.root) for side in self.sides.values()]
                sides = np.array(together(trees, x)).reshape(2, 4, -1)
                jump = np.abs(sides[0] - sides[1])[2:].max(axis=0)
                largest = np.maximum(np.abs(sides).max(axis=(0, 1)), size)
                result |= ~(off * jump <= FLAT**2 * (high - low) * largest)
        return result

    def _at_middles(self, corners: Array) -> Array:
        """The values at the vertices and the middles of edges, shape (points, pieces)."""
        return self.values(inside(corners, middles(corners.shape[1] - 1)))


def crossed(values: Array) -> tuple[Mask, Mask]:
    """Return whether the zeros of a function may be in pieces, and whether these are curved there.

    The function changes its sign, or may do so between the vertices and the middles of edges.
    Where it is not nearly linear, the zeros are curved.

    Args:
        values: The values at the vertices of the pieces and at the middles of their edges, shape
            (points, pieces).
    """
    low, high = values.min(axis=0), values.max(axis=0)
    deviation, sizes = np.abs(_apart(values)).max(axis=0), np.abs(values)
    rounding = SOLVED * sizes.max(axis=0)
    changes = (low < -rounding) & (high > rounding)
    changes |= (deviation > rounding) & (sizes.min(axis=0) <= deviation)
    with np.errstate(invalid="ignore"):
        return changes, changes & ~(deviation <= FLAT * (high - low))


def _apart(values: Array) -> Array:
    """How far from linear values at the vertices and the middles of edges are."""
    lattice = middles({3: 1, 6: 2, 10: 3}[len(values)])
    with np.errstate(invalid="ignore"):
        return np.asarray(values - barycentric(lattice) @ values[: lattice.shape[1] + 1])


@functools.cache
def middles(dimension: int) -> Array:
    """Return the vertices of the reference simplex, and behind them the middles of its edges."""
    unit = corners_of_reference(dimension)
    first, second = np.triu_indices(dimension + 1, 1)
    return np.concatenate((unit, 0.5 * (unit[first] + unit[second])))


@functools.cache
def inner_lattice(dimension: int) -> Array:
    """Return points everywhere in the reference simplex, and not on its boundary."""
    lattice = equispaced(dimension, SAMPLES)  # facets have no known sign
    return np.asarray(lattice + SIX_DIGITS * (lattice.mean(axis=0) - lattice))


@functools.lru_cache
def interfaces(*formulas: Formula) -> list[Interface]:
    """Return where formulas may jump or have a kink; see `singular_sets.switches` for the order."""
    return [Interface(node) for node in switches(*formulas)]


class _Side(PerNode[Node]):
    """The nodes of formulas with the branches that are chosen on a side of the zeros of a node."""

    def __init__(self, node: Node, side: float):
        super().__init__()
        self.node, self.side = node, Node("number", value=side)

    def find(self, node: Node) -> Node:
        margin = node.switch
        if margin is None or self.node not in factors(margin, True):
            return Node(node.op, tuple(map(self, node.args)), node.value)
        sign = self._sign(margin)
        if sign.op == "number":
            return self(node.chosen(sign.value > 0.0))
        both = self(node.chosen(True)), self(node.chosen(False))
        return Node("where", (sign > ZERO, *both))

    def _sign(self, node: Node) -> Node:
        """The sign of a product that the function is a factor of."""
        if node is self.node:
            return self.side
        if node.op in ("*", "/"):
            return self._sign(node.args[0]) * self._sign(node.args[1])
        if node.args and node.operation.vanishes == "with" and not is_even(node):
            sign = self._sign(node.args[0])
            return -sign if node.op == "negative" else sign
        return Node.made("sign", self(node))
