"""Fluxes that carry sources left in cells through the mesh, as far as no reaction takes them up.

Algebraic errors and the quadrature of the discrete problem leave a source in some cells. The source
flows to a facet with Dirichlet data, to cells with a reaction, or to a contact facet with a flux
large enough: as the flux of a potential with one value in each cell, whose energy, with that of
what the reactions take up, is about the least one. The flux is in H(div), so that no constant of
Friedrichs is needed.

Source: Papez, Ruede, Vohralik and Wohlmuth, Comput. Methods Appl. Mech. Engrg. 371 (2020) 113243,
Section 5, carry algebraic errors on a hierarchy of meshes; Eymard, Gallouet and Herbin, Handbook of
Numerical Analysis 7 (2000) 713-1020, have potentials with one value in each cell.
"""

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse.csgraph import connected_components

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.bounds.frames import Frames
from dolfinx_signorini.solvers.linear.algebraic import amg_options
from dolfinx_signorini.solvers.linear.options import options_set

ROUNDS = 4  # of the solver, each of which gains five digits
HIDDEN = 0.02  # of a part of the bound: so much may be known roughly


def transported(
    comm: MPI.Comm, frames: Frames, lowest: Array, wanted: Array, exits: Mask, sinks: Array
) -> tuple[Array, bool]:
    """Return outward fluxes of cells with given sums, but for what the cells take up.

    Args:
        comm: The communicator; the call is collective.
        frames: The cells.
        lowest: The smallest eigenvalue of the diffusion on each cell.
        wanted: The sum of the fluxes of each cell.
        exits: Boundary facets with any flux, shape (cells, d + 1).
        sinks: What each cell takes up for a potential of 1; infinite where that is anything.

    Returns:
        The fluxes, shape (cells, d + 1), and whether nothing is left where nothing is taken up.
        The reactions take up what is left elsewhere, too.
    """
    # Of the way from the middle of a cell to the facet.
    ease = frames.facet_sizes**2 * (lowest / frames.volumes)[:, None]
    parts = comm.gather((frames.facets, wanted, exits, sinks, ease))
    answers = None
    if parts is not None:
        sizes = np.cumsum([len(part[0]) for part in parts])[:-1]
        facets, wanted, exits, sinks, ease = map(np.concatenate, zip(*parts, strict=True))
        fluxes, found = _by_potential(facets, wanted, exits, sinks, ease)
        answers = [(part, found) for part in np.split(fluxes, sizes)]
    answer: tuple[Array, bool] = comm.scatter(answers)
    return answer


def _by_potential(
    facets: Indices, wanted: Array, exits: Mask, sinks: Array, ease: Array
) -> tuple[Array, bool]:
    """Fluxes of a potential that is 0 in infinite sinks and outside of exits, see `transported`."""
    count, columns = facets.shape
    order = np.argsort(facets.ravel(), kind="stable")
    numbers, flat = facets.ravel()[order], ease.ravel()
    first = np.flatnonzero(numbers[1:] == numbers[:-1])
    one, other = order[first], order[first + 1]
    weight = np.zeros(len(flat))
    weight[one] = weight[other] = 1.0 / (1.0 / flat[one] + 1.0 / flat[other])
    weight[exits.ravel()] = flat[exits.ravel()]
    matrix = sp.coo_matrix((-weight[one], (one // columns, other // columns)), (count, count))
    matrix = (matrix + matrix.T + sp.diags(weight.reshape(facets.shape).sum(axis=1))).tocsr()
    ends = np.isinf(sinks)
    inner, fluxes, taken = np.flatnonzero(~ends), np.zeros(facets.shape), np.zeros(count)
    parts, part = connected_components(matrix[inner][:, inner])
    out = exits.any(axis=1) | (matrix @ ends.astype(np.float64) < 0.0) | (sinks > 0.0)
    finite = np.where(ends, 0.0, sinks)
    matrix = (matrix + sp.diags(finite)).tocsr()
    if (np.bincount(part, out[inner], parts) == 0.0).any():
        return fluxes, False
    A, ksp = _solver(matrix[inner][:, inner])
    potential, left, bare = np.zeros(count), wanted, sinks == 0.0
    exact = False
    for _ in range(ROUNDS):
        change = np.zeros(count)
        change[inner] = _solution(ksp, left[inner])
        potential += change
        flow = weight * np.repeat(change, columns)
        flow[one] -= weight[one] * change[other // columns]
        flow[other] -= weight[other] * change[one // columns]
        fluxes += flow.reshape(facets.shape)
        taken += finite * change
        left = np.where(ends, 0.0, wanted - fluxes.sum(axis=1) - taken)
        exact = bool(np.abs(left[bare]).max(initial=0.0) <= SOLVED * np.abs(wanted).max())
        beyond = (left[~bare] ** 2 / sinks[~bare]).sum()  # the square of an energy norm
        if exact and beyond <= HIDDEN**2 * (potential @ wanted):
            break
    destroy(A, ksp)
    return fluxes, exact


def _solver(matrix: sp.csr_matrix) -> tuple[PETSc.Mat, PETSc.KSP]:
    """A system, and its solver to PETSc's usual tolerance, whose set-up serves all rounds."""
    kinds = (matrix.indptr, PETSc.IntType), (matrix.indices, PETSc.IntType)
    csr = (*(values.astype(kind) for values, kind in kinds), matrix.data)
    A = PETSc.Mat().createAIJ(matrix.shape, csr=csr, comm=PETSc.COMM_SELF)
    ksp = PETSc.KSP().create(PETSc.COMM_SELF)
    ksp.setOptionsPrefix("potential_")
    with options_set("potential_", {"ksp_type": "cg"}, amg_options(1, coarsest=True)):
        ksp.setFromOptions()
    ksp.setOperators(A)
    ksp.setTolerances(atol=0.0)
    return A, ksp


def _solution(ksp: PETSc.KSP, right: Array) -> Array:
    """The solution of a system; 0 if none is found."""
    b, x = (
        PETSc.Vec().createWithArray(values, comm=PETSc.COMM_SELF) for values in (right, 0.0 * right)
    )
    ksp.solve(b, x)
    found = x.array.copy() if ksp.is_converged else 0.0 * right
    destroy(b, x)
    return found
