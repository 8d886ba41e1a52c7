"""Formulas that grow too fast towards a pole to have an integral."""

from itertools import combinations

import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.data.formulas import Formula, Node, evaluated
from dolfinx_signorini.data.interfaces.interface import Interface
from dolfinx_signorini.data.interfaces.singular_sets import poles

NEAR = 2.0**-10, 2.0**-20  # of the way across a simplex: distances from a pole
GROWS = 0.9  # 1 for the power -1 of the distance, and 0.7 for the power -0.95


def infinite_integrals(formula: Formula, simplices: Array) -> Array:
    """Return points of a curve, or surface, towards which a formula grows like 1/distance or more.

    A denominator that is 0 at all corners of a simplex but one is taken to be 0 on the side between
    them; one that changes its sign along an edge is 0 at a point of the edge. From there the
    product of values and distance is followed into the simplex.

    Args:
        formula: The formula.
        simplices: Corners of cells or facets, shape (simplices, corners, dimension).
    """
    found: list[Array] = [np.empty((0, simplices.shape[2]))]
    for pole in poles(formula):
        places, rays = _zeros(pole, simplices)
        with np.errstate(all="ignore"):
            near, nearest = (
                np.abs(evaluated(formula.root, places + share * rays)) * share for share in NEAR
            )
            found.append(places[np.isfinite(nearest) & (nearest > GROWS * near) & (near > 0.0)])
    return np.concatenate(found)


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
