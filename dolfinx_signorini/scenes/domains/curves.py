"""Curves and curved surfaces that sides stand for, given by formulas that are zero there."""

from collections.abc import Mapping

import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.tolerances import HALVINGS, ROUNDING
from dolfinx_signorini.data.derivatives import Derivative
from dolfinx_signorini.data.formulas import Formula, evaluated
from dolfinx_signorini.meshes.curved_sides import Projection


def projections(curves: Mapping[str, Formula], dimension: int) -> dict[str, Projection]:
    """Return functions that move points onto the zeros of formulas, for `CurvedSides`.

    Args:
        curves: For sides by name a formula whose zeros are the side.
        dimension: The dimension of space.
    """
    return {name: _projection(formula, dimension) for name, formula in curves.items()}


def _projection(formula: Formula, dimension: int) -> Projection:
    """Newton's method along the gradient of a formula."""
    slopes = [Derivative(k)(formula.root) for k in range(dimension)]

    def onto(points: Array) -> Array:
        x: Array = points[:dimension].T.copy()
        for _ in range(HALVINGS):
            values = evaluated(formula.root, x)
            slope = np.stack([evaluated(node, x) for node in slopes], axis=1)
            with np.errstate(all="ignore"):
                step = np.where(values, values / (slope**2).sum(axis=1), 0.0)[:, None] * slope
            x -= step
            if np.abs(step).max() <= ROUNDING * np.abs(points).max():
                return np.concatenate((x.T, points[dimension:]))
        raise ValueError(f"no zeros of {formula.text} are found near the side")

    return onto
