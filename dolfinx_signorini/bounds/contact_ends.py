"""Better fluxes where contact ends, in the plane.

The flux of the solution is like a root there, and shapes that are given are far from the flux. On
the cells around the end of a contact set, the flux of least energy among those that are nowhere
negative on contact facets is a quadratic program with linear inequalities: a flux is not negative
where its Bernstein coefficients on parts of a facet are not. Few cells are concerned, where
polynomials may be of higher degree than elsewhere.

Source: Lawson and Hanson, Solving Least Squares Problems, SIAM, 1995, Section 23.4.
"""

import numpy as np
from mpi4py import MPI
from scipy.linalg import cholesky, null_space, solve_triangular
from scipy.optimize import nnls
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dolfinx_signorini.base.arrays import Array, Indices
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.bounds.condensation import (
    DIRICHLET,
    OPEN,
    PARTLY,
    CellData,
    forces_of,
    shapes_of,
)
from dolfinx_signorini.bounds.reference_flux import (
    MOST_NUMBERS,
    PARTS,
    ReferenceFlux,
    on_parts,
    others,
)

RAISED = 2  # by how much polynomials are of higher degree than elsewhere


def near_ends(comm: MPI.Comm, data: CellData) -> Indices:
    """Return the cells of this rank at vertices of contact facets that touch in part.

    Args:
        comm: The communicator; the call is collective.
        data: The cells of this rank.
    """
    at = others(data.kinds.shape[1] - 1)
    touching = data.touching[:, at].any(axis=2)
    partly = (data.kinds == PARTLY) | ((data.kinds == OPEN) & touching)
    cells, facets = np.nonzero(partly)
    ends = np.concatenate(comm.allgather(data.vertices[cells[:, None], at[facets]].ravel()))
    return np.flatnonzero(np.isin(data.vertices, ends).any(axis=1) & (data.strength == 0.0))


def better_fluxes(comm: MPI.Comm, data: CellData, start: Array, reference: ReferenceFlux) -> Array:
    """Return fluxes of less energy with the same divergence, nowhere negative on contact facets.

    Args:
        comm: The communicator; the call is collective.
        data: The cells of this rank around the ends of contact sets.
        start: The moments of a flux on the facets of these cells, shape (cells, d + 1, moments).
        reference: The fields.
    """
    rows, moments = comm.allgather(data.packed()), comm.allgather(start)
    everything = data.some(np.arange(0)).with_rows(np.concatenate(rows))
    found = np.concatenate(moments)
    for members in clusters(everything.facets):
        size = len(members) * reference.fluxes  # about twice the number of unknowns
        if size**2 <= MOST_NUMBERS and (everything.kinds[members] >= OPEN).any():
            part = everything.some(members)
            found[members] += _change(part, found[members], reference)
    first = sum(map(len, moments[: comm.rank]))
    return np.asarray(found[first : first + len(start)])


def clusters(facets: Indices) -> list[Indices]:
    """Return the rows of cells that are connected by facets.

    Args:
        facets: The facets of the cells, shape (cells, d + 1).
    """
    if not len(facets):
        return []
    _, numbers = np.unique(facets.ravel(), return_inverse=True)
    cells = np.repeat(np.arange(len(facets)), facets.shape[1])
    incidence = coo_array((np.ones(len(cells)), (cells, numbers.ravel()))).tocsr()
    count, cluster = connected_components(incidence @ incidence.T)
    return [np.flatnonzero(cluster == k) for k in range(count)]


class Unknowns:
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


def _change(data: CellData, start: Array, reference: ReferenceFlux) -> Array:
    """What is to be added to the moments of some connected cells."""
    per, cells = reference.per_facet, np.arange(len(start))
    unknowns = Unknowns(data, per)
    places, signs, size = unknowns.places, unknowns.signs, unknowns.count
    shapes = shapes_of(data, reference)
    energies = shapes.matrices[shapes.number]
    # The force of each vertex has the gap.
    forces = forces_of(data, reference, shapes)[0].sum(
        axis=1
    ) + reference.dimension * data.gaps.reshape(places.shape)
    forces -= np.einsum("nij,nj->ni", energies, start.reshape(places.shape))
    K, b = np.zeros((size + 1, size + 1)), np.zeros(size + 1)
    scaled = energies * signs[:, :, None] * signs[:, None, :]
    np.add.at(K, (places[:, :, None], places[:, None, :]), scaled)
    np.add.at(b, places, forces * signs)
    sums = np.zeros((len(start), size + 1))  # of the fluxes out of each cell
    sums[cells[:, None], places[:, ::per]] = signs[:, ::per]
    limits, least = _limits(data, start, reference, unknowns)
    change = _least(K[:size, :size], b[:size], sums[:, :size], limits, least)
    return np.asarray((np.append(change, 0.0)[places] * signs).reshape(start.shape))


def _limits(
    data: CellData, start: Array, reference: ReferenceFlux, unknowns: Unknowns
) -> tuple[Array, Array]:
    """The Bernstein coefficients of contact fluxes by unknowns, and the least change of each."""
    per, (cells, facets) = reference.per_facet, np.nonzero(data.kinds >= OPEN)
    table = on_parts(reference.degree, PARTS).transpose(0, 2, 1).reshape(-1, per)
    limits = np.zeros((len(cells), unknowns.count, len(table)))
    own = unknowns.places.reshape(start.shape)[cells, facets]
    limits[np.arange(len(cells))[:, None], own] = table.T
    pressure = start[cells, facets] @ table.T
    least = SOLVED * np.abs(pressure).max(initial=0.0) - pressure
    return limits.transpose(0, 2, 1).reshape(-1, unknowns.count), least.ravel()


def _least(K: Array, b: Array, sums: Array, limits: Array, least: Array) -> Array:
    """The x of least energy x.K x / 2 - b.x with sums x = 0 and limits x >= least; 0 if none is."""
    basis = null_space(sums)
    try:
        root = cholesky(basis.T @ K @ basis, lower=True)
    except np.linalg.LinAlgError:  # coefficients of too many sizes
        return 0.0 * b
    y = solve_triangular(root, basis.T @ b, lower=True)  # the energy is |y|^2 / 2
    sides = solve_triangular(root, (limits @ basis).T, lower=True).T
    lengths, lack = np.linalg.norm(sides, axis=1), least - sides @ y
    used = lengths > 0.0
    sides, lack = sides[used] / lengths[used, None], lack[used] / lengths[used]
    far = lack.max(initial=0.0)
    if far > 0.0:
        system, last = np.vstack((sides.T, lack / far)), np.append(0.0 * y, 1.0)
        try:
            rest = system @ nnls(system, last)[0] - last
        except RuntimeError:  # too many steps
            return 0.0 * b
        with np.errstate(all="ignore"):
            y -= far * rest[:-1] / rest[-1]
    x = np.asarray(basis @ solve_triangular(root.T, y))
    rounding = 0.5 * SOLVED * np.abs(least).max(initial=0.0)
    good = np.isfinite(x).all() and (limits @ x >= least - rounding).all()
    return x if good else 0.0 * b
