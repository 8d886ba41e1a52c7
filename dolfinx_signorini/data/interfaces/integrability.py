"""Formulas that grow towards poles on curves and surfaces, and how fast."""

import math
from itertools import combinations
from typing import Any

import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.data.formulas import Formula, Node, evaluated
from dolfinx_signorini.data.interfaces.interface import Interface
from dolfinx_signorini.data.interfaces.singular_sets import poles

# Of the way across a simplex: the distances from a point at which values tell a power. Closer by,
# rounding shows, and farther away the smooth part of a formula.
DISTANCES = 1e-4, 1e-6


def fastest_growth(formula: Formula, simplices: Array) -> tuple[float, tuple[float, ...]] | None:
    """Return how fast a formula grows at most towards a point of a curve, or surface.

    A denominator that is 0 at all corners of a simplex but one is taken to be 0 on the side between
    them; one that changes its sign along an edge is 0 at a point of the edge. From there the values
    are followed into the simplex.

    Args:
        formula: The formula.
        simplices: Corners of cells or facets, shape (simplices, corners, dimension).

    Returns:
        The least power of the distance that the formula is like, with two decimals, and the point;
        None where the formula has no pole.
    """
    found: list[tuple[float, tuple[float, ...]]] = []
    for pole in poles(formula):
        places, rays = _zeros(pole, simplices)
        with np.errstate(all="ignore"):
            sizes = [np.abs(evaluated(formula.root, places + r * rays)) for r in DISTANCES]
            power = np.round(power_of(*sizes), 2)
        grows = np.isfinite(power) & (power < 0.0)
        found += [(float(power[k]), tuple(map(float, places[k]))) for k in np.flatnonzero(grows)]
    return min(found, default=None)


def power_of(near: Any, nearest: Any) -> Any:
    """Return the power of the distance that sizes at the two `DISTANCES` from a point tell."""
    return np.log(nearest / near) / math.log(DISTANCES[1] / DISTANCES[0])


def _zeros(pole: Node, simplices: Array) -> tuple[Array, Array]:
    """Points at which a denominator is 0, and rays from them into simplices."""
    values = evaluated(pole, simplices)
    size, count = np.abs(values[np.isfinite(values)]).max(initial=0.0), simplices.shape[1]
    zero = np.abs(values) <= SOLVED * size
    places, rays = [np.empty((0, simplices.shape[2]))], [np.empty((0, simplices.shape[2]))]
    for j in range(count):
        others = [k for k in range(count) if k != j]
        on = zero[:, others].all(axis=1) & ~zero[:, j]
        middles = simplices[on][:, others].mean(axis=1)
        flat = np.abs(evaluated(pole, middles)) <= SOLVED * size
        places.append(middles[flat])
        rays.append((simplices[on][:, j] - middles)[flat])
    for i, j in combinations(range(count), 2):
        on = ~zero[:, i] & ~zero[:, j] & (values[:, i] * values[:, j] < 0.0)
        start, edge = simplices[on, i], simplices[on, j] - simplices[on, i]
        shares = Interface(pole).zeros(start, start + edge)[:, None]
        places.append(start + shares * edge)
        rays.append((1.0 - shares) * edge)
    return np.concatenate(places), np.concatenate(rays)
