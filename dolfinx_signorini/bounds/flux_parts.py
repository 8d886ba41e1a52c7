"""The parts of a bound: distances of fluxes from the solution, contact energies, oscillation."""

import math
from dataclasses import dataclass, replace

import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.bounds.boundary_facets import FacetPoints
from dolfinx_signorini.bounds.cell_values import (
    CellValues,
    cell_data,
    cell_values,
    flux_values,
    quadrature_degree,
)
from dolfinx_signorini.bounds.condensation import CellData, coefficients
from dolfinx_signorini.bounds.contact_ends import RAISED, better_fluxes, near_ends
from dolfinx_signorini.bounds.lifting import gap_means
from dolfinx_signorini.bounds.reference_flux import ReferenceFlux, largest, reference_flux
from dolfinx_signorini.bounds.remainders import Remainders, Solved


def flux_parts(
    solved: Solved,
    values: CellValues,
    data: CellData,
    coefficients_: Array,
    reference: ReferenceFlux,
    contact: tuple[FacetPoints, Array],
) -> tuple[Array, Array]:
    """Return the distance of a flux from the one of the solution, and the contact energy.

    In the plane, the flux is a better one in the cells around the ends of contact sets.

    Args:
        solved: The problem; the call is collective.
        values: The solution and the coefficients.
        data: The cells.
        coefficients_: The coefficients of the flux, shape (cells, fields).
        reference: The fields.
        contact: Points of contact facets with the gap, see `gaps`.

    Returns:
        The norms on cells, and the integrals of contact flux times gap.
    """
    degree, frames, rest, comm = reference.degree, values.frames, solved.rest, solved.comm
    shape = *frames.order.shape, reference.per_facet
    moments = coefficients_[:, : reference.fluxes].reshape(shape)
    flux = _distance(values, flux_values(values, coefficients_, reference), rest, degree)
    energy = _contact_energy(*contact, moments, degree)
    cells = near_ends(comm, data) if frames.dimension == 2 else np.empty(0, dtype=np.int64)
    if not any(comm.allgather(len(cells))):
        return flux, energy
    finer = reference_flux(2, degree + RAISED)
    some = replace(solved, frames=frames.some(cells), rest=rest.some(cells))
    own = cell_values(some, quadrature_degree(solved, finer.degree)[0])
    start = np.zeros((*shape[:2], finer.per_facet))  # where the basis goes on
    start[..., : shape[2]] = moments
    means = gap_means(*contact, finer.degree)[cells]
    near = cell_data(own, data.kinds[cells], data.touching[cells], 0.0 * start[cells], means, finer)
    source = np.zeros_like(near.source)
    source[:, : data.source.shape[1]] = data.source[cells]
    near = replace(near, source=source)
    start[cells] = better_fluxes(comm, near, start[cells], finer)
    y = flux_values(own, coefficients(near, finer, start[cells]), finer)
    flux[cells] = _distance(own, y, some.rest, finer.degree)
    energy[cells] = _contact_energy(*contact, start, finer.degree)[cells]
    return flux, energy


def _contact_energy(points: FacetPoints, gap: Array, moments: Array, degree: int) -> Array:
    """The integrals of contact flux times gap over the contact facets of each cell."""
    own = moments[points.cells, points.facets]
    flux = np.einsum("nj,njq->nq", own, points.polynomials(degree))
    sums = np.maximum(flux, 0.0) * gap @ points.weights
    return np.asarray(np.bincount(points.cells, sums, len(moments)), dtype=np.float64)


def _distance(values: CellValues, y: Array, rest: Remainders, degree: int) -> Array:
    """The norm of A^(1/2) grad u_h - A^(-1/2) y on each cell; u_h is of a degree, y of one more."""
    apart = values.current - y
    square = values.integrals((apart * values.diffusion.divided(apart)).sum(axis=2))
    square += rest.inverse * values.integrals(np.square(apart).sum(axis=2))
    if rest.thin is not None:
        share, least, largest = rest.thin
        most = np.sqrt(largest) * values.largest(values.gradient, degree)
        most += values.largest(y, degree + 1) / np.sqrt(least)
        square += share * values.frames.volumes * most**2
    slope = np.sqrt(values.integrals(np.square(values.gradient).sum(axis=2)))
    missed = rest.diffusion * slope / np.sqrt(values.diffusion.lowest)
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
