"""Better fluxes and pressures where contact ends in the domain.

The divergence of the flux of the solution jumps at the free boundary, and fluxes that are made
vertex by vertex for a pressure of any sign are far from this flux. In the cells around those where
the pressure would have to pull, flux and pressure minimise

    ||A^(1/2) grad v - A^(-1/2) y||^2 + 2 (integral of pressure times gap)

together, with the pressure + f - c u + div y = 0 and Bernstein coefficients of the pressure >= 0: a
convex quadratic program, which an interior point method solves.

Source: Nocedal and Wright, Numerical Optimization, 2006, Section 16.6.
"""

from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.bounds.cell_pressure import free_pressure
from dolfinx_signorini.bounds.condensation import CellData, gradient_products
from dolfinx_signorini.bounds.contact_ends import Unknowns, clusters
from dolfinx_signorini.bounds.frames import cells_around
from dolfinx_signorini.bounds.interior_point import QuadraticProgram
from dolfinx_signorini.bounds.reference_flux import ReferenceFlux, from_bernstein, lowest


def better_pressures(
    comm: MPI.Comm, data: CellData, moments: Array, reference: ReferenceFlux
) -> tuple[CellData, Array, Array]:
    """Return cells with better fluxes and pressures around the free boundary.

    Args:
        comm: The communicator; the call is collective.
        data: The cells of this rank.
        moments: The moments of a flux on facets.
        reference: The fields.

    Returns:
        The cells, with the new pressures in their sources, the moments of the new flux, and the
        integrals of these pressures times gaps.
    """
    near = cells_around(comm, data.vertices, _pulled(data, moments, reference))
    cells = np.flatnonzero(near & ((data.strength == 0.0) | np.isinf(data.strength)))
    energy, loads = np.zeros(len(moments)), np.zeros_like(data.source)
    rows = comm.allgather(data.some(cells).packed())
    everything = data.some(np.arange(0)).with_rows(np.concatenate(rows))
    found = np.concatenate(comm.allgather(moments[cells]))
    more = np.zeros_like(everything.source)
    for members in clusters(everything.facets):
        part = everything.some(members)
        if part.sides.any():
            found[members], more[members] = _better(part, found[members], reference)
    first = sum(map(len, rows[: comm.rank]))
    own = slice(first, first + len(cells))
    moments, settled = moments.copy(), np.zeros(len(moments), dtype=bool)
    moments[cells], loads[cells] = found[own], more[own]
    settled[cells] = more[own].any(axis=1)
    energy = (loads * data.rises).sum(axis=1)
    data = replace(
        data,
        source=data.source + loads,
        sides=np.where(settled, 0, data.sides),
        strength=np.where(settled, 0.0, data.strength),
        rises=np.where(settled[:, None], 0.0, data.rises),
    )
    return data, moments, np.maximum(energy, 0.0)


def _pulled(data: CellData, moments: Array, reference: ReferenceFlux) -> Mask:
    """Whether the pressure that takes up all of the residual is negative somewhere in a cell."""
    pulled = data.sides != 0
    pressed = np.flatnonzero(pulled)
    if len(pressed):
        m = free_pressure(data.some(pressed), moments[pressed], reference)
        pulled[pressed] = lowest(reference.dimension, reference.degree, m) < 0.0
    return pulled


def _better(data: CellData, start: Array, reference: ReferenceFlux) -> tuple[Array, Array]:
    """The moments of some connected cells and the loads of their pressures."""
    unknowns = Unknowns(data, reference.per_facet)
    program, pressed, guess = _program(data, start, reference, unknowns)
    loads, found = np.zeros_like(data.source), program.solution(guess)
    if found is None:
        return start, loads
    change, coefficients = np.split(found, [unknowns.count])
    coefficients, more = np.maximum(coefficients, 0.0), np.append(change, 0.0)[unknowns.places]
    series = from_bernstein(reference.dimension, reference.degree)
    loads[pressed] = data.sides[pressed, None] * (coefficients.reshape(len(pressed), -1) @ series)
    return start + (more * unknowns.signs).reshape(start.shape), loads


def _program(
    data: CellData, start: Array, reference: ReferenceFlux, unknowns: Unknowns
) -> tuple[QuadraticProgram, Indices, Array]:
    n, given, per = reference.fluxes, reference.given, reference.per_facet
    count = len(start)
    mass = np.asarray(np.tensordot(data.metric, reference.mass, 2))
    force = gradient_products(data.gradient, reference.targets.sum(axis=0, keepdims=True))[:, 0]
    free = np.linalg.solve(mass[:, given:, given:], mass[:, given:, :given])
    force = force[:, :given] - np.einsum("nfz,nf->nz", free, force[:, given:])
    S = mass[:, :given, :given] - mass[:, :given, given:] @ free
    pressed = np.flatnonzero(data.sides)
    series = from_bernstein(reference.dimension, reference.degree)
    side = data.sides[:, None]
    now = np.concatenate((start.reshape(count, -1), -data.source[:, 1:]), axis=1)
    force -= np.einsum("nij,nj->ni", S, now)
    # By fluxes and by the Bernstein coefficients of pressure times size.
    Z = np.zeros((count, given, n + len(series)))
    Z[:, np.arange(n), np.arange(n)] = unknowns.signs
    Z[:, n:, n:] = -side[..., None] * series.T[1:]
    H = Z.transpose(0, 2, 1) @ S @ Z
    h = np.einsum("nij,ni->nj", Z, force)
    h[:, n:] -= side * (data.rises @ series.T)
    sums = np.zeros((count, n + len(series)))
    sums[:, :n:per] = unknowns.signs[:, ::per]
    sums[:, n:] = side * series[:, 0]
    size = unknowns.count
    last = size + len(pressed) * len(series)
    own = np.full((count, len(series)), last)
    own[pressed] = size + np.arange(len(pressed) * len(series)).reshape(len(pressed), -1)
    places = np.concatenate((np.where(unknowns.places < size, unknowns.places, last), own), axis=1)
    rows = np.broadcast_to(places[:, :, None], H.shape)
    columns = np.broadcast_to(places[:, None, :], H.shape)
    used = (rows < last) & (columns < last)
    matrix = sp.coo_matrix((H[used], (rows[used], columns[used])), (last, last)).tocsc()
    right = np.bincount(places.ravel(), h.ravel(), last + 1)[:last]
    used = places < last
    cell = np.broadcast_to(np.arange(count)[:, None], places.shape)
    C = sp.coo_matrix((sums[used], (cell[used], places[used])), (count, last)).tocsc()
    m = free_pressure(data.some(pressed), start[pressed], reference) * data.sizes[pressed, :1]
    c = np.zeros(count)
    c[pressed] = -data.source[pressed, 0] - start[pressed][:, :, 0].sum(axis=1)
    guess = (m @ np.linalg.inv(series)).ravel()
    guess = np.maximum(guess, 0.1 * np.abs(guess).mean())
    E = sp.eye(last, format="csr")[size:]
    return QuadraticProgram(matrix, right, C, c, E, np.zeros(last - size)), pressed, guess
