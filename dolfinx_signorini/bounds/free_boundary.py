"""Better fluxes and pressures where contact ends in the domain.

The divergence of the flux of the solution jumps at the free boundary, and fluxes that are made
vertex by vertex for a pressure of any sign are far from this flux. In the cells around those where
the pressure would have to pull, flux and pressure minimise

    ||A^(1/2) grad v - A^(-1/2) y||^2 + 4 (integral of pressure times gap)

together, with the pressure + f - c u + div y = 0 and Bernstein coefficients of the pressure >= 0: a
convex quadratic program, which an interior point method solves.

Source: Nocedal and Wright, Numerical Optimization, 2006, Section 16.6.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.bounds.cell_pressure import Pressing, free_pressure, without_pressure
from dolfinx_signorini.bounds.cell_values import (
    cell_data,
    cell_moments,
    cell_values,
    quadrature_degree,
)
from dolfinx_signorini.bounds.condensation import CellData, gradient_products
from dolfinx_signorini.bounds.contact_ends import Unknowns, clusters
from dolfinx_signorini.bounds.frames import cells_around
from dolfinx_signorini.bounds.interior_point import MOST_ENTRIES, QuadraticProgram
from dolfinx_signorini.bounds.reference_flux import (
    ReferenceFlux,
    from_bernstein,
    lowest,
    reference_flux,
)
from dolfinx_signorini.bounds.remainders import Solved

# By dimension: by how much the better fluxes are of higher degree. For P3 on the square with 32
# cells per side the bound is 1.80 times the error with 0, 1.74 with 1, 1.71 with 2.
RAISED = {2: 2, 3: 0}


@dataclass(frozen=True)
class FreeBoundary:
    """Cells around the free boundary, with a better flux and pressure of a higher degree.

    Attributes:
        cells: The cells, by their rows among the cells of this rank.
        data: What is known of these cells, with the pressure in the source.
        moments: The moments of the flux on the facets of these cells.
        energy: The integrals of pressure times gap.
        reference: The fields.
    """

    cells: Indices
    data: CellData
    moments: Array
    energy: Array
    reference: ReferenceFlux

    def into(self, data: CellData, moments: Array) -> tuple[CellData, Array]:
        """Return all cells with what these cells have of the lower degree, and the moments."""
        moments, source, mine = moments.copy(), data.source.copy(), np.zeros(len(moments), bool)
        moments[self.cells] = self.moments[..., : moments.shape[2]]
        source[self.cells] = self.data.source[:, : source.shape[1]]
        mine[self.cells] = True
        return without_pressure(replace(data, source=source), mine), moments


def better_pressures(
    solved: Solved,
    data: CellData,
    moments: Array,
    reference: ReferenceFlux,
    pressing: Pressing,
    outlet: bool,
) -> FreeBoundary | None:
    """Return better fluxes and pressures around the free boundary; None where none is found.

    Args:
        solved: The problem; the call is collective.
        data: The cells of this rank.
        moments: The moments of a flux on facets.
        reference: The fields.
        pressing: The pressure in the cells.
        outlet: Whether a residual has a way out without the pressure of these cells.
    """
    comm, d = solved.comm, solved.dimension
    near = cells_around(comm, data.vertices, _pulled(data, moments, reference))
    cells = np.flatnonzero(near & ((data.strength == 0.0) | np.isinf(data.strength)))
    if not comm.allreduce(len(cells)):
        return None
    finer = reference_flux(d, reference.degree + RAISED[d])
    start = np.zeros((len(cells), d + 1, finer.per_facet))  # where the basis goes on
    start[..., : reference.per_facet] = moments[cells]
    part = _finer(solved.some(cells), data.some(cells), finer, pressing.some(cells))
    rows = comm.allgather(part.packed())
    everything = part.some(np.arange(0)).with_rows(np.concatenate(rows))
    found = np.concatenate(comm.allgather(start))
    loads, solvable = np.zeros_like(everything.source), np.zeros(len(found), dtype=bool)
    for members in clusters(everything.facets):
        some = everything.some(members)
        entries = len(members) * (finer.fluxes + loads.shape[1]) ** 2
        fits = some.sides.any() and entries <= MOST_ENTRIES[d]
        answer = _better(some, found[members], finer) if fits else None
        if answer is not None:
            found[members], loads[members] = answer
            solvable[members] = True
    first = sum(map(len, rows[: comm.rank]))
    own = np.arange(first, first + len(cells))
    kept, rest = solvable[own], data.sides != 0
    rest[cells[kept]] = False
    if not (outlet or comm.allreduce(bool(rest.any()), op=MPI.LOR)):
        return None
    part, own = part.some(kept), own[kept]
    energy = np.maximum((loads[own] * part.rises).sum(axis=1), 0.0)
    nothing = np.zeros(len(own))
    part = replace(
        part, source=part.source + loads[own], sides=nothing.astype(np.int64), strength=nothing
    )
    return FreeBoundary(cells[kept], part, found[own], energy, finer)


def _finer(
    solved: Solved, data: CellData, reference: ReferenceFlux, pressing: Pressing
) -> CellData:
    """Cells for fields of a higher degree; their source is of the lower one."""
    values = cell_values(solved, quadrature_degree(solved, reference.degree)[0])
    found = cell_moments(values, reference.degree)
    source = np.zeros_like(found.source)
    source[:, : data.source.shape[1]] = data.source
    none = np.zeros((*data.kinds.shape, reference.per_facet))
    found = replace(found, source=source)
    return cell_data(solved.frames, data.kinds, data.touching, none, none, found, pressing)


def _pulled(data: CellData, moments: Array, reference: ReferenceFlux) -> Mask:
    """Whether the pressure that takes up all of the residual is negative somewhere in a cell."""
    pulled = data.sides != 0
    pressed = np.flatnonzero(pulled)
    if len(pressed):
        m = free_pressure(data.some(pressed), moments[pressed], reference)
        pulled[pressed] = lowest(reference.dimension, reference.degree, m) < 0.0
    return pulled


def _better(data: CellData, start: Array, reference: ReferenceFlux) -> tuple[Array, Array] | None:
    """The moments of some connected cells and the loads of their pressures; or None."""
    unknowns = Unknowns(data, reference.per_facet)
    program, pressed, guess = _program(data, start, reference, unknowns)
    loads, found = np.zeros_like(data.source), program.solution(guess)
    if found is None:
        return None
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
    h[:, n:] -= 2.0 * side * (data.rises @ series.T)
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
    right: Array = np.asarray(np.bincount(places.ravel(), h.ravel(), last + 1)[:last], float)
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
