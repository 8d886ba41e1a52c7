"""A feasible function that is nearer to the solution where contact ends in the domain.

The discrete solution, changed so that it is feasible, is farther from the solution than need be,
and the bound pays for this. In the cells around those that touch in part, the feasible function is
the solution of the same obstacle problem with given values around these cells, in the space of
higher degree with Bernstein coefficients not beyond those of the obstacles. Any feasible function
gives a bound, so that coefficients may be taken as their means over cells.
"""

from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from dolfinx import fem
from scipy.sparse.linalg import splu

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.ranks import marked
from dolfinx_signorini.bounds.cell_scales import mean_matrices, means
from dolfinx_signorini.bounds.cell_values import cell_values, quadrature_degree
from dolfinx_signorini.bounds.interior_point import MOST_ENTRIES, QuadraticProgram, assembled
from dolfinx_signorini.bounds.remainders import Solved
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.assembly import dofs_on_facets
from dolfinx_signorini.solvers.linear.projected import SYMMETRIC

# Times the largest change without limits, or that limits ask for: limits farther away do nothing.
OUT_OF_REACH = 10.0


def nearer(
    solved: Solved,
    space: fem.FunctionSpace,
    around: Indices,
    start: Array,
    limits: tuple[Array, Array],
) -> tuple[Array, Mask]:
    """Return the coefficients of a function, feasible where they have changed, and where that is.

    Args:
        solved: The problem; the call is collective.
        space: The space of the function, in the Bernstein basis.
        around: The cells of this rank in which the function may change.
        start: The coefficients of the solution, with the signs of a lower obstacle.
        limits: The least and the largest coefficients; infinite where there is no obstacle.
    """
    comm, index_map = solved.comm, space.dofmap.index_map
    free = _inner(solved, space, around)
    dofs = space.dofmap.list[solved.frames.cells[around]]
    size = dofs.shape[1]
    count = comm.allreduce(len(around))
    if not count or count * size**2 > MOST_ENTRIES[solved.dimension]:
        return start, np.zeros(len(start), dtype=bool)
    stiffness, load = _system(solved, space, around)
    numbers = index_map.local_to_global(dofs.ravel().astype(np.int32)).reshape(dofs.shape)
    numbers = np.where(free[dofs], numbers, -1)
    parts = numbers, stiffness, load, *(each[dofs] - start[dofs] for each in limits)
    everything = [np.concatenate(comm.allgather(part)) for part in parts]
    names, change = _solved(*everything)
    own = index_map.local_to_global(np.arange(len(start), dtype=np.int32))
    _, here, there = np.intersect1d(own, names, assume_unique=True, return_indices=True)
    result = start.copy()
    result[here] += change[there]
    return np.where(free, np.clip(result, *limits), start), free


def _inner(solved: Solved, space: fem.FunctionSpace, around: Indices) -> Mask:
    """Whether all cells of a dof are among some cells, and the dof is in the domain."""
    cells = solved.frames.cells
    outside = np.ones(len(cells), dtype=bool)
    outside[around] = False
    fixed = marked(space, space.dofmap.list[cells[outside]])
    fixed |= marked(space, dofs_on_facets(space, boundary_facets(space.mesh)))
    return ~fixed & marked(space, space.dofmap.list[cells[around]])


def _system(solved: Solved, space: fem.FunctionSpace, around: Indices) -> tuple[Array, Array]:
    """The matrices of the energy on cells, and what the solution leaves of the load."""
    element = space.element.basix_element
    part = solved.some(around)
    quadrature = max(2 * (element.degree - 1), quadrature_degree(part, solved.degree)[0])
    values = cell_values(replace(part, change=None), quadrature)
    table = element.tabulate(1, values.points)[..., 0]
    pairs = np.einsum("q,aqi,bqj->abij", values.weights, table[1:], table[1:])
    inverse = np.linalg.inv(values.at.jacobian[:, 0])
    d, size = solved.dimension, values.frames.volumes
    A = mean_matrices(values.diffusion.values, values.weights, d)
    metric = inverse @ A @ inverse.transpose(0, 2, 1) * size[:, None, None]
    stiffness = np.tensordot(metric, pairs, 2)
    c = means(values.reaction, values.weights)[:, None, None] * size[:, None, None]
    stiffness += c * np.einsum("q,qi,qj->ij", values.weights, table[0], table[0])
    weighted = np.broadcast_to(values.residual, (len(size), len(values.weights)))
    load = (weighted * values.weights) @ table[0]
    current = np.broadcast_to(values.current, (*weighted.shape, d)) @ inverse.transpose(0, 2, 1)
    load -= np.einsum("q,nqa,aqi->ni", values.weights, current, table[1:])
    return np.asarray(stiffness), np.asarray(load * size[:, None])


def _solved(
    numbers: Indices, stiffness: Array, load: Array, low: Array, high: Array
) -> tuple[Indices, Array]:
    """The change of least energy within limits, with the numbers of its dofs."""
    names, first, places = np.unique(numbers, return_index=True, return_inverse=True)
    places, skip = places.reshape(numbers.shape), int(bool(len(names)) and names[0] < 0)
    names, first, places = names[skip:], first[skip:], places - skip
    size = len(names)
    if not size:
        return names, np.zeros(0)
    H, h = assembled(np.where(places < 0, size, places), stiffness, load, size)
    low, high = low.ravel()[first], high.ravel()[first]
    try:
        factor = splu(H, **SYMMETRIC)
    except RuntimeError:  # a singular matrix
        return names[:0], np.zeros(0)
    # The change goes about as far as without limits, or as limits push: no others are met.
    reach = np.abs(factor.solve(h)).max(initial=0.0)
    reach = OUT_OF_REACH * (reach + max(low.max(initial=0.0), -high.min(initial=0.0)))
    lower, upper = np.flatnonzero(low >= -reach), np.flatnonzero(high <= reach)
    if not len(lower) + len(upper):
        return names[:0], np.zeros(0)
    eye = sp.eye(size, format="csr")
    E = sp.vstack((eye[lower], -eye[upper])).tocsr()
    e = np.concatenate((low[lower], -high[upper]))
    none = sp.csc_matrix((0, size)), np.zeros(0)
    guess = np.maximum(-e, 0.1 * np.abs(e).mean())
    change = QuadraticProgram(H, h, *none, E, e).solution(guess)
    return (names, change) if change is not None else (names[:0], np.zeros(0))
