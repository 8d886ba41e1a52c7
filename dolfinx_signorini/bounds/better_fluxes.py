"""Better fluxes where contact ends: on facets in the plane, and in cells.

Where contact ends on a facet the flux of the solution is like a root, and where contact ends in the
domain its divergence jumps: shapes that are given, and fluxes that are made vertex by vertex, are
far from this flux. In the cells around the ends of a contact set, flux and pressure minimise

    ||A^(1/2) grad v - A^(-1/2) y||^2 + 2 (integral of contact flux times gap)
                                      + 4 (integral of pressure times gap)

together, with the pressure + f - c u + div y = 0 where an obstacle presses on cells. Bernstein
coefficients are not negative: those of contact fluxes on parts of facets, and those of pressures.
This is a convex quadratic program, which an interior point method solves. Few cells are concerned,
where polynomials may be of higher degree than elsewhere.

Source: Nocedal and Wright, Numerical Optimization, 2006, Section 16.6.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI
from scipy.sparse.csgraph import connected_components

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.ranks import anywhere
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.bounds.boundary_facets import FacetPoints
from dolfinx_signorini.bounds.cell_pressure import free_pressure, without_pressure
from dolfinx_signorini.bounds.cell_values import (
    cell_data,
    cell_values,
    quadrature_degree,
)
from dolfinx_signorini.bounds.condensation import (
    DIRICHLET,
    OPEN,
    PARTLY,
    CellData,
    gradient_products,
    joined,
    vertices_of,
)
from dolfinx_signorini.bounds.frames import cells_around
from dolfinx_signorini.bounds.gaps import contact_energy, gap_means
from dolfinx_signorini.bounds.interior_point import MOST_ENTRIES, QuadraticProgram, assembled
from dolfinx_signorini.bounds.reference_flux import PARTS, ReferenceFlux, reference_flux
from dolfinx_signorini.bounds.remainders import Solved
from dolfinx_signorini.meshes.polynomials import from_bernstein, lowest, on_parts, others

# By dimension: by how much the better fluxes are of higher degree. For P3 on the square with 32
# cells per side the bound is 1.80 times the error with 0, 1.74 with 1, 1.71 with 2.
RAISED = {2: 2, 3: 0}


@dataclass(frozen=True)
class BetterFlux:
    """Cells around the ends of contact, with a better flux and pressure of a higher degree.

    Attributes:
        cells: The cells, by their rows among the cells of this rank.
        data: What is known of these cells, with the pressure in the source.
        moments: The moments of the flux on the facets of these cells.
        energy: The integrals of contact flux or pressure times gap.
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


def better_fluxes(
    solved: Solved,
    data: CellData,
    moments: Array,
    reference: ReferenceFlux,
    rises: Array,
    contact: tuple[FacetPoints, Array],
    outlet: bool,
) -> BetterFlux | None:
    """Return better fluxes and pressures around the ends of contact; None where none is found.

    Args:
        solved: The problem; the call is collective.
        data: The cells of this rank.
        moments: The moments of a flux on facets.
        reference: The fields.
        rises: Those of the cells up to the higher degree, see `cell_data`.
        contact: Points of contact facets with the gap, see `gaps`.
        outlet: Whether a residual has a way out without the pressure of these cells.
    """
    comm, d = solved.comm, solved.dimension
    ends = vertices_of(_partly(data)) | _pulled(data, moments, reference)[:, None]
    near = cells_around(comm, data.vertices, ends)
    cells = np.flatnonzero(near & ((data.strength == 0.0) | np.isinf(data.strength)))
    if not comm.allreduce(len(cells)):
        return None
    finer, (points, gap) = reference_flux(d, reference.degree + RAISED[d]), contact
    start = np.zeros((len(cells), d + 1, finer.per_facet))  # where the basis goes on
    start[..., : reference.per_facet] = moments[cells]
    some, used = solved.some(cells), np.isin(points.cells, cells)
    points, gap = points.some(used, some.frames, cells), gap[used]
    means = gap_means(points, gap, finer.degree)
    part = _finer(some, data.some(cells), finer, rises[cells], means)
    found, loads, kept = improved(comm, part, start, finer)
    rest = data.sides != 0
    rest[cells[kept]] = False
    if solved.problem.in_domain and not (outlet or anywhere(comm, rest)):
        return None
    energy = np.maximum((loads * part.rises).sum(axis=1), 0.0)
    energy += contact_energy(points, gap, found, finer.degree)
    nothing = np.zeros(len(cells))
    part = replace(
        part, source=part.source + loads, sides=nothing.astype(np.int64), strength=nothing
    )
    return BetterFlux(
        cells[kept], part.some(np.flatnonzero(kept)), found[kept], energy[kept], finer
    )


def improved(
    comm: MPI.Comm, data: CellData, start: Array, reference: ReferenceFlux
) -> tuple[Array, Array, Mask]:
    """Return fluxes of less energy, nowhere negative on contact facets, with their pressures.

    Args:
        comm: The communicator; the call is collective.
        data: The cells of this rank around the ends of contact sets.
        start: The moments of a flux on the facets of these cells, shape (cells, d + 1, moments).
        reference: The fields.

    Returns:
        The moments, the moments of the pressures, with their signs, shape (cells, polynomials),
        and in which cells better ones are found.
    """
    parts = comm.allgather(data)
    everything = joined(parts)
    found = np.concatenate(comm.allgather(start))
    loads, solvable = np.zeros_like(everything.source), np.zeros(len(found), dtype=bool)
    for members in _clusters(everything.facets):
        some = everything.some(members)
        entries = len(members) * (reference.fluxes + loads.shape[1]) ** 2
        contact = some.sides.any() or (some.kinds >= OPEN).any()
        fits = contact and entries <= MOST_ENTRIES[reference.dimension]
        answer = _better(some, found[members], reference) if fits else None
        if answer is not None:
            found[members], loads[members] = answer
            solvable[members] = True
    first = sum(len(part.vertices) for part in parts[: comm.rank])
    own = slice(first, first + len(start))
    return found[own], loads[own], solvable[own]


def _clusters(facets: Indices) -> list[Indices]:
    """The rows of cells that are connected by facets."""
    if not len(facets):
        return []
    _, numbers = np.unique(facets.ravel(), return_inverse=True)
    cells = np.repeat(np.arange(len(facets)), facets.shape[1])
    incidence = sp.coo_array((np.ones(len(cells)), (cells, numbers.ravel()))).tocsr()
    count, cluster = connected_components(incidence @ incidence.T)
    return [np.flatnonzero(cluster == k) for k in range(count)]


def _partly(data: CellData) -> Mask:
    """Whether facets of cells in the plane touch an obstacle in part, or at a vertex."""
    touching = data.touching[:, others(data.kinds.shape[1] - 1)].any(axis=2)
    partly = (data.kinds == PARTLY) | ((data.kinds == OPEN) & touching)
    return np.asarray(partly & (data.kinds.shape[1] == 3))


def _pulled(data: CellData, moments: Array, reference: ReferenceFlux) -> Mask:
    """Whether the pressure that takes up all of the residual is negative somewhere in a cell."""
    pulled = data.sides != 0
    pressed = np.flatnonzero(pulled)
    if len(pressed):
        m = free_pressure(data.some(pressed), moments[pressed], reference)
        pulled[pressed] = lowest(reference.dimension, reference.degree, m) < 0.0
    return pulled


def _finer(
    solved: Solved, data: CellData, reference: ReferenceFlux, rises: Array, gaps: Array
) -> CellData:
    """Cells for fields of a higher degree; their source is of the lower one."""
    values = cell_values(solved, quadrature_degree(solved, reference.degree)[0])
    given = data.kinds, data.touching, np.zeros_like(gaps), gaps, data.sides, rises
    found = cell_data(values, reference.degree, *given)
    source = np.zeros_like(found.source)
    source[:, : data.source.shape[1]] = data.source
    return replace(found, source=source)


class _Unknowns:
    """The moments on facets of cells that may change: inside, on contact and Dirichlet facets.

    Args:
        data: The cells.
        per_facet: The number of moments on a facet.

    Attributes:
        count: The number of moments.
        places: The place of each moment of the cells, shape (cells, moments); `count` for none.
        signs: The signs of the moments: a flux leaves one cell and enters another one.
    """

    def __init__(self, data: CellData, per_facet: int):
        names, first, inverse, sides = np.unique(
            data.facets, return_index=True, return_inverse=True, return_counts=True
        )
        inverse = inverse.reshape(data.facets.shape)
        free = (sides[inverse] == 2) | (data.kinds == DIRICHLET) | (data.kinds >= OPEN)
        numbers = np.full(len(names), -1)
        chosen = np.unique(inverse[free])
        numbers[chosen] = np.arange(len(chosen))
        self.count = per_facet * len(chosen)
        places = numbers[inverse][..., None] * per_facet + np.arange(per_facet)
        places = np.where(free[..., None], places, self.count)
        self.places: Indices = places.reshape(len(inverse), -1)
        own = first[inverse] == np.arange(inverse.size).reshape(inverse.shape)
        self.signs = np.repeat(np.where(own, 1.0, -1.0), per_facet, axis=1)


def _better(data: CellData, start: Array, reference: ReferenceFlux) -> tuple[Array, Array] | None:
    """The moments of some connected cells and the loads of their pressures; or None."""
    unknowns = _Unknowns(data, reference.per_facet)
    program, pressed, guess = _program(data, start, reference, unknowns)
    loads = np.zeros_like(data.source)
    found = program.solution(guess) if (guess > 0.0).all() else None
    if found is None:
        return None
    change, coefficients = np.split(found, [unknowns.count])
    coefficients, more = np.maximum(coefficients, 0.0), np.append(change, 0.0)[unknowns.places]
    series = from_bernstein(reference.dimension, reference.degree)
    loads[pressed] = data.sides[pressed, None] * (coefficients.reshape(-1, len(series)) @ series)
    moments = start + (more * unknowns.signs).reshape(start.shape)
    flux = moments[data.kinds >= OPEN]
    if len(flux) and (flux @ on_parts(reference.degree, PARTS)).min() < 0.0:
        return None
    return moments, loads


def _program(
    data: CellData, start: Array, reference: ReferenceFlux, unknowns: _Unknowns
) -> tuple[QuadraticProgram, Indices, Array]:
    """The program for fluxes and Bernstein coefficients of pressures times size."""
    n, per, count = reference.fluxes, reference.per_facet, len(start)
    series = from_bernstein(reference.dimension, reference.degree)
    pressed, side, size = np.flatnonzero(data.sides), data.sides[:, None], unknowns.count
    last = size + len(pressed) * len(series)
    own = np.full((count, len(series)), last)
    own[pressed] = np.arange(size, last).reshape(-1, len(series))
    places = np.concatenate((np.where(unknowns.places < size, unknowns.places, last), own), axis=1)
    H, h = assembled(places, *_energy(data, start, reference, unknowns.signs), last)
    sums = np.zeros((count, n + len(series)))
    sums[:, :n:per] = unknowns.signs[:, ::per]
    sums[:, n:] = side * series[:, 0]
    used = places < last
    cell = np.broadcast_to(np.arange(count)[:, None], places.shape)
    C = sp.coo_matrix((sums[used], (cell[used], places[used])), (count, last)).tocsc()
    c = np.zeros(count)
    c[pressed] = -data.source[pressed, 0] - start[pressed][:, :, 0].sum(axis=1)
    m = free_pressure(data.some(pressed), start[pressed], reference) * data.sizes[pressed, :1]
    guess = (m @ np.linalg.inv(series)).ravel()
    limits, flux = _contact_fluxes(data, start, reference, unknowns, last)
    E = sp.vstack((sp.eye(last, format="csr")[size:], limits)).tocsr()
    # Rounding does not make a contact flux negative.
    e = np.concatenate((0.0 * guess, SOLVED * np.abs(flux).max(initial=0.0) - flux))
    slack = np.concatenate([np.maximum(g, 0.1 * np.abs(g).mean()) for g in (guess, flux) if len(g)])
    return QuadraticProgram(H, h, C, c, E, e), pressed, slack


def _energy(
    data: CellData, start: Array, reference: ReferenceFlux, signs: Array
) -> tuple[Array, Array]:
    """The matrices and vectors of cells for the changes of fluxes and the pressures."""
    n, given, count = reference.fluxes, reference.given, len(start)
    mass = np.asarray(np.tensordot(data.metric, reference.mass, 2))
    force = gradient_products(data.gradient, reference.targets.sum(axis=0, keepdims=True))[:, 0]
    free = np.linalg.solve(mass[:, given:, given:], mass[:, given:, :given])
    force = force[:, :given] - np.einsum("nfz,nf->nz", free, force[:, given:])
    S = mass[:, :given, :given] - mass[:, :given, given:] @ free
    now = np.concatenate((start.reshape(count, -1), -data.source[:, 1:]), axis=1)
    force -= np.einsum("nij,nj->ni", S, now)
    force[:, :n] -= data.gaps.reshape(count, n)
    series, side = from_bernstein(reference.dimension, reference.degree), data.sides[:, None]
    Z = np.zeros((count, given, n + len(series)))
    Z[:, np.arange(n), np.arange(n)] = signs
    Z[:, n:, n:] = -side[..., None] * series.T[1:]
    h = np.einsum("nij,ni->nj", Z, force)
    h[:, n:] -= 2.0 * side * (data.rises @ series.T)
    return Z.transpose(0, 2, 1) @ S @ Z, h


def _contact_fluxes(
    data: CellData, start: Array, reference: ReferenceFlux, unknowns: _Unknowns, size: int
) -> tuple[sp.csr_matrix, Array]:
    """The Bernstein coefficients of contact fluxes on parts by unknowns, and those at the start."""
    cells, facets = np.nonzero(data.kinds >= OPEN)
    if not len(cells):
        return sp.csr_matrix((0, size)), np.zeros(0)
    table = on_parts(reference.degree, PARTS).transpose(0, 2, 1).reshape(-1, reference.per_facet)
    own = unknowns.places.reshape(start.shape)[cells, facets]
    shape = (len(cells), *table.shape)
    rows = np.broadcast_to(np.arange(len(cells) * len(table)).reshape(*shape[:2], 1), shape)
    columns, entries = np.broadcast_to(own[:, None], shape), np.broadcast_to(table, shape)
    limits = sp.coo_matrix(
        (entries.ravel(), (rows.ravel(), columns.ravel())), (rows.max() + 1, size)
    )
    return limits.tocsr(), (start[cells, facets] @ table.T).ravel()
