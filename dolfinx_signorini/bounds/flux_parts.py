"""The parts of a bound: distances of fluxes from the solution, contact energies, oscillation."""

import math
from dataclasses import dataclass

import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.bounds.better_fluxes import BetterFlux
from dolfinx_signorini.bounds.boundary_facets import FacetPoints
from dolfinx_signorini.bounds.cell_pressure import polynomial_residual
from dolfinx_signorini.bounds.cell_scales import dots
from dolfinx_signorini.bounds.cell_values import (
    CellValues,
    cell_values,
    flux_values,
    quadrature_degree,
)
from dolfinx_signorini.bounds.condensation import CellData, coefficients
from dolfinx_signorini.bounds.gaps import contact_energy
from dolfinx_signorini.bounds.reference_flux import ReferenceFlux
from dolfinx_signorini.bounds.remainders import Solved
from dolfinx_signorini.bounds.strong_form import polynomial_degree
from dolfinx_signorini.meshes.polynomials import largest

# Cells of a rank that tell the size of a flux on all cells, and how many of them may have a large
# flux by chance: ten of 500 stand for one to three per cent of all cells.
ENOUGH, CHANCE = 500, 10


@dataclass(frozen=True)
class FluxParts:
    """What a flux y leaves on each cell, for the solution u_h and the feasible function v:

        parts = flux_parts(solved, quadrature, data, moments, reference, contact)
        math.sqrt((parts.flux**2).sum())

    Attributes:
        flux: The norms of A^(1/2) grad v - A^(-1/2) y, or the same with u_h, see `CellValues.aim`.
        middle: The norms of the distance from A grad u_h to the middle of A grad v and y.
        left: The L2 norms of the polynomial f - c u + div y.
        contact: The integrals of contact flux times gap.
    """

    flux: Array
    middle: Array
    left: Array
    contact: Array


def flux_parts(
    solved: Solved,
    quadrature: int,
    data: CellData,
    moments: Array,
    reference: ReferenceFlux,
    contact: tuple[FacetPoints, Array],
) -> FluxParts:
    """Return the distance of a flux from the one of the solution, and the contact energy.

    Args:
        solved: The problem; the call is collective.
        quadrature: The degree of the rule for cells.
        data: The cells.
        moments: The moments of the flux on facets, shape (cells, d + 1, moments).
        reference: The fields.
        contact: Points of contact facets with the gap, see `gaps`.
    """
    degree, count = reference.degree, len(moments)
    flux, middle, left = np.empty((3, count))
    for batch, values in cell_values(solved, quadrature).batches():
        inside = data.some(batch)
        found = _in_cells(values, inside, moments[batch], reference)
        flux[batch], middle[batch], left[batch] = found
    return FluxParts(flux, middle, left, contact_energy(*contact, moments, degree))


def least_flux(
    solved: Solved, quadrature: int, data: CellData, moments: Array, reference: ReferenceFlux
) -> float:
    """Return what the distance of a flux from the one of the solution is at least, about.

    The k largest squares on cells add up to k times the smallest one of them, or more. A sample of
    the cells of each rank tells the k for which this is most.

    Args:
        solved, quadrature, data, moments, reference: See `flux_parts`.
    """
    cells = np.arange(0, len(moments), max(len(moments) // ENOUGH, 1))
    values = cell_values(solved.some(cells), quadrature)
    flux = _in_cells(values, data.some(cells), moments[cells], reference)[0]
    sums = np.sort(flux**2)[::-1] * np.arange(1, len(cells) + 1)
    least = float(sums[CHANCE - 1 :].max(initial=0.0)) * len(moments) / max(len(cells), 1)
    return math.sqrt(solved.comm.allreduce(least))


def with_better(parts: FluxParts, solved: Solved, better: BetterFlux, moments: Array) -> FluxParts:
    """Return the parts with those of the better flux in the cells around the ends of contact.

    Args:
        parts: The parts on all cells.
        solved: The problem; the call is collective.
        better: The cells around the ends of contact.
        moments: The moments of the flux on all cells, whose first ones are those of the better one.
    """
    data, reference, own = better.data, better.reference, better.moments.copy()
    own[..., 0] = moments[better.cells, :, 0]
    some = solved.some(better.cells)
    values = cell_values(some, quadrature_degree(some, reference.degree)[0])
    found = (*_in_cells(values, data, own, reference), better.energy)
    for part, more in zip(vars(parts).values(), found, strict=True):
        part[better.cells] = more
    return parts


def _in_cells(
    values: CellValues, data: CellData, moments: Array, reference: ReferenceFlux
) -> tuple[Array, Array, Array]:
    """The parts of the bound that the flux has inside of cells."""
    field = coefficients(data, reference, moments)
    y, rest = flux_values(values, field, reference), polynomial_residual(data, field, reference)
    flux = _distance(values, values.aim, y, reference.degree)
    left = np.sqrt(np.square(rest).sum(axis=1) * data.sizes[:, 0])
    if values.aim is values.gradient:
        return flux, 0.5 * flux, left
    slope = values.gradient - 0.5 * values.aim
    return flux, _distance(values, slope, 0.5 * y, reference.degree), left


def _distance(values: CellValues, slope: Array, y: Array, degree: int) -> Array:
    """The norm of A^(1/2) s - A^(-1/2) y on each cell, with a gradient s and y of a degree + 1."""
    apart, rest = values.diffusion.times(slope) - y, values.rest
    square = values.integrals(dots(apart, values.diffusion.divided(apart)))
    square += rest.inverse * values.integrals(dots(apart, apart))
    if rest.thin is not None:
        share, least, largest = rest.thin
        most = np.sqrt(largest) * values.largest(slope, values.solved.order)
        most += values.largest(y, degree + 1) / np.sqrt(least)
        square += share * values.frames.volumes * most**2
    size = np.sqrt(values.integrals(dots(slope, slope)))
    missed = rest.diffusion * size / np.sqrt(values.diffusion.lowest)
    return np.asarray(np.sqrt(np.maximum(square, 0.0)) + missed)


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


def oscillation(values: CellValues, fluxes: Array, source: Array, degree: int) -> Oscillation:
    """Return what data have beside polynomials.

    Args:
        values: The solution and the coefficients.
        fluxes: The L2 norms on facets of the rest of the given fluxes beside their projections,
            shape (cells, d + 1).
        source: The moments of f - c u, see `CellData`.
        degree: The degree of the polynomials.
    """
    frames, rest, scales, a = values.frames, values.rest, values.scales, values.scales.lowest
    d, root, sizes = frames.dimension, np.sqrt(scales.volumes), frames.facet_sizes
    weight = np.minimum(scales.gradient_weight, scales.l2_weight)
    beside = values.beside(source, degree)
    norm = np.sqrt(values.integrals(beside**2))
    projected = weight * norm
    u = largest(d, degree, values.moments(values.u, degree))
    missed = weight * (_missed(values, beside, norm) + rest.reaction * u)
    square = sizes / scales.volumes[:, None] * scales.diameters[:, None] ** 2
    square *= (1.0 / math.pi + 2.0 / d) / math.pi / a[:, None]
    on_facets = (np.sqrt(square) * (fluxes + rest.flux)).sum(axis=1)
    # The mean of a flux over a facet goes to the cell, by a field linear in the cell.
    moved = (sizes * rest.flux_mean).sum(axis=1) / root
    on_facets += moved * scales.diameters / (d * np.sqrt(a))
    stray = np.where(scales.weak, (rest.load_mean + rest.reaction_mean * u) * root, 0.0) + moved
    return Oscillation(projected, missed, on_facets, stray)


def _missed(values: CellValues, beside: Array, norm: Array) -> Array:
    """What the load misses adds to the norm of what polynomials have beside their projections.

    The load misses what is orthogonal to polynomials of the degree n of those in its place, but for
    its means, so that the squares of both norms add up but for what is beside polynomials of degree
    n. Where the reaction is strong, the rest of a flux comes on top, and the norms add up.
    """
    rest, frames = values.rest, values.frames
    degree = polynomial_degree(values.solved.terms.load) or 0
    own = values.moments(beside, degree)
    beyond = np.sqrt(np.maximum(norm**2 - frames.volumes * np.square(own).sum(axis=1), 0.0))
    products = rest.load_mean * largest(frames.dimension, degree, own) * frames.volumes
    products += beyond * rest.load
    more = np.sqrt(norm**2 + np.square(rest.load) + 2.0 * products) - norm
    return np.where(values.scales.weak, np.minimum(more, rest.load), rest.load)
