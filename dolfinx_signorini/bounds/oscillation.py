"""Data oscillation: load, reaction and fluxes beside polynomials, as a part of a bound."""

import math
from dataclasses import dataclass

import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.bounds.cell_values import CellValues
from dolfinx_signorini.bounds.reference_flux import largest
from dolfinx_signorini.bounds.remainders import Remainders


@dataclass(frozen=True)
class Oscillation:
    """Bounds on each cell of what data have beside polynomials.

    The largest possible part that is tested with means of functions over cells:

        math.sqrt((oscillation.stray**2).sum()) * constant_of_friedrichs

    Attributes:
        projected: What polynomials have beside their projections, weighted.
        missed: What data have beside the polynomials that stand for the data, weighted.
        on_facets: What fluxes have beside polynomials on facets, weighted.
        stray: The L2 norm of an unknown constant on each cell, without a weight.
    """

    projected: Array
    missed: Array
    on_facets: Array
    stray: Array


def oscillation(values: CellValues, fluxes: Array, rest: Remainders, degree: int) -> Oscillation:
    """Return what data have beside polynomials.

    Args:
        values: The solution and the coefficients.
        fluxes: The L2 norms on facets of the rest of the given fluxes beside their projections,
            shape (cells, d + 1).
        rest: What data have beside the polynomials that stand for them.
        degree: The degree of the polynomials.
    """
    frames, d, a = values.frames, values.frames.dimension, values.diffusion.lowest
    root, sizes = np.sqrt(frames.volumes), frames.facet_sizes
    weight = np.minimum(values.gradient_weight, values.l2_weight)
    projected = weight * np.sqrt(values.integrals(values.rest(degree) ** 2))
    u = largest(d, degree, values.moments(values.u, degree))
    missed = weight * (rest.load + rest.reaction * u)
    square = sizes / frames.volumes[:, None] * frames.diameters[:, None] ** 2
    square *= (1.0 / math.pi + 2.0 / d) / math.pi / a[:, None]
    on_facets = (np.sqrt(square) * (fluxes + rest.flux)).sum(axis=1)
    # The mean of a flux over a facet goes to the cell, by a field linear in the cell.
    moved = (sizes * rest.flux_mean).sum(axis=1) / root
    on_facets += moved * frames.diameters / (d * np.sqrt(a))
    stray = np.where(values.weak, (rest.load_mean + rest.reaction_mean * u) * root, 0.0) + moved
    return Oscillation(projected, missed, on_facets, stray)
