"""The start of a solve on a mesh without coarser ones: a contact problem on a coarse space.

Some dofs, spread as all dofs are, are the vertices of a Delaunay triangulation. The functions that
are linear on its simplices, interpolated at the dofs, are a coarse space with the prolongation P.
The obstacle holds at the vertices on the contact boundary. The Galerkin system with the matrix P'AP
and the load P'b is small, is solved by active sets on every rank, and predicts the active set as a
solution on a coarser mesh does, see `prediction`.

The triangulation does not know the domain, and couples what a thin hole separates. The start is
then worse, and the solution is the same.

The coarsest space of all has the constants alone. Where an obstacle is so far below a constant that
the load does not bend the solution down to the obstacle, no other space is needed.

Source: Chan, Smith and Zou, Numer. Math. 73 (1996) 149-167, for coarse spaces by interpolation
between meshes that are not nested.
"""

import numpy as np
import scipy.sparse as sp
from petsc4py import PETSc
from scipy.spatial import Delaunay, QhullError, cKDTree

from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.lookups import Lookup
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.base.ranks import anywhere, highest
from dolfinx_signorini.base.tolerances import HALF_OF_THE_DIGITS
from dolfinx_signorini.solvers.cascade import RATIO
from dolfinx_signorini.solvers.linear.solver import has_few_dofs
from dolfinx_signorini.solvers.motions import owned_places
from dolfinx_signorini.solvers.patch import solve_small
from dolfinx_signorini.solvers.prediction import presses, settled
from dolfinx_signorini.solvers.system import System

NEAR = 1e-5  # barycentric coordinates: so far outside of a simplex counts as inside, for the shifts


def coarse_start(system: System, x: PETSc.Vec) -> Mask | None:
    """Set x to the solution on a coarse space, and return the active set that x predicts.

    Args:
        system: The system; the call is collective.
        x: A feasible vector, overwritten.

    Returns:
        One entry per contact dof of this rank; None, with x as it was, where there are few dofs, or
        where they have no triangulation, as on a line or on a surface in space.
    """
    domain, comm = system.space.mesh, system.comm
    if domain.topology.dim < max(domain.geometry.dim, min(RATIO)) or has_few_dofs(system):
        return None
    if system.layout.block > 1:  # linear functions alone are too stiff for bodies that bend
        return None
    places = owned_places(system.space)[:, : domain.geometry.dim]
    chosen, order = _vertices(system, places)
    vertices, lower, upper, start = (
        np.concatenate(comm.allgather(part[chosen])) for part in (places, *system.bounds, x.array_r)
    )
    width = np.ptp(vertices, axis=0).max(initial=0.0)
    try:
        triangulation = Delaunay(vertices + HALF_OF_THE_DIGITS * width * _unequal(vertices.shape))
    except (QhullError, ValueError):  # too few vertices, or all of them at one point
        return None
    if len(triangulation.coplanar):  # some vertices are left out
        return None
    first = sum(comm.allgather(len(chosen))[: comm.rank])
    P = _interpolation(triangulation, places, order, chosen, first)
    P.data.reshape(-1, domain.geometry.dim + 1)[system.fixed_dofs] = 0.0
    solution, forces = _solution(*_galerkin(system, P), lower, upper, start)
    if not np.isfinite(solution).all():
        return None
    x.array_w[:] = P @ solution
    system.project(x)
    contact: Mask = np.isfinite(lower) | np.isfinite(upper)
    return settled(system, x, _predicted(system, x, P, contact, forces))


def out_of_reach(system: System, x: PETSc.Vec) -> bool:
    """Return whether no contact is likely, with x then the constant that balances the load.

    With the residual r of the constant, a solution without contact differs from the constant by at
    most the largest r_i over the sum of row i, by the maximum principle. Where a row has hardly
    such a sum, the scale is the coupling to one of two neighbours along each axis, over the square
    of the number of dofs in a line: n of them that are held at an end give way up to n^2 times as
    far as one. In the plane and in space all dofs are taken for this square.
    Vectors, and forms that vanish on constants, have no such principle: contact is likely then.
    """
    if system.layout.block > 1 or system.singular:
        return False
    free = np.ones(x.getLocalSize())
    free[system.fixed_dofs] = 0.0
    ones, sums = system.A.createVecs()
    ones.array_w[:] = free
    system.A.mult(ones, sums)
    rows, load = free * sums.array_r, free * system.b.array_r
    destroy(ones, sums)
    reaction, total = system.comm.allreduce(np.array([rows.sum(), load.sum()]))
    if not reaction > 0.0:
        return False
    constant = total / reaction
    beyond = system.signs * (system.obstacle - constant)
    if anywhere(system.comm, beyond > 0.0):
        return False
    diagonal, dim = system.A.getDiagonal(), system.space.mesh.topology.dim
    couplings = 2.0 * dim * float(system.unknowns) ** max(1.0, 2.0 / dim)
    scales = np.maximum(rows, diagonal.array_r / couplings)
    diagonal.destroy()
    reach = highest(system.comm, np.abs(load - constant * rows) / scales)
    if anywhere(system.comm, reach + beyond > 0.0):
        return False
    x.array_w[:] = constant
    system.project(x)
    return True


def _vertices(system: System, places: Array) -> tuple[LocalIndices, LocalIndices]:
    """Owned dofs, spread as all dofs are: contact dofs, and dofs without any condition.

    Returns:
        These dofs, and all owned dofs in an order in which neighbours follow one another.
    """
    dim = system.space.mesh.topology.dim
    free = np.ones(len(places), dtype=bool)
    free[np.concatenate((system.contact_dofs, system.fixed_dofs))] = False
    chosen, order = [], [system.fixed_dofs]
    for dofs, step in (
        (system.layout.free_dofs, RATIO[dim] ** system.layout.dim),
        (np.flatnonzero(free).astype(np.int32), RATIO[dim] ** dim),
    ):
        # The leaves of the tree are groups of neighbours, one after the other.
        tree = cKDTree(places[dofs], leafsize=step, compact_nodes=False)
        order.append(dofs[tree.indices])
        chosen.append(order[-1][::step])
    return np.concatenate(chosen), np.concatenate(order)


def _unequal(shape: tuple[int, ...]) -> Array:
    """Random numbers below 1 in size, the same in each call.

    Many vertices are in one plane or on one sphere. Shifts by a little bring them to general
    position, where their triangulation takes a quarter of the time.
    """
    return np.random.default_rng(0).uniform(-1.0, 1.0, shape)


def _interpolation(
    triangulation: Delaunay, places: Array, order: LocalIndices, chosen: LocalIndices, first: int
) -> sp.csr_matrix:
    """The values at points of the functions that are linear on the simplices.

    A point outside of all simplices has the value of the nearest vertex, and a vertex its own.

    Args:
        triangulation: The simplices.
        places: The points.
        order: All points in the order in which they are looked for, each search starting from the
            last: three times as fast for neighbours.
        chosen: The points that are vertices.
        first: The number of the first of these vertices in the triangulation.
    """
    dim, cells = places.shape[1], np.empty(len(places), dtype=np.int32)
    cells[order] = triangulation.find_simplex(places[order], tol=NEAR)
    cells[chosen] = 0
    outside = np.flatnonzero(cells < 0)
    nearest = cKDTree(triangulation.points).query(places[outside])[1]
    own = np.concatenate((chosen, outside))
    vertex = np.concatenate((first + np.arange(len(chosen)), nearest))
    cells[own] = triangulation.vertex_to_simplex[vertex]
    maps, columns = triangulation.transform[cells], triangulation.simplices[cells]
    weights = np.empty(columns.shape)
    weights[:, :dim] = np.einsum("nij,nj->ni", maps[:, :dim], places - maps[:, dim])
    weights[:, dim] = 1.0 - weights[:, :dim].sum(axis=1)
    weights[own] = columns[own] == vertex[:, None]
    starts = np.arange(0, columns.size + 1, dim + 1, dtype=np.int32)
    shape = len(places), len(triangulation.points)
    return sp.csr_matrix((weights.ravel(), columns.ravel(), starts), shape=shape)


def _galerkin(system: System, P: sp.csr_matrix) -> tuple[sp.csr_matrix, Array]:
    """The matrix P'AP and the load P'b, whole on each rank.

    Args:
        system: The system.
        P: The interpolation at the owned dofs.
    """
    first, last = system.A.getOwnershipRange()
    starts, columns, values = system.A.getValuesCSR()
    foreign = (columns < first) | (columns >= last)
    numbers, places = np.unique(columns[foreign], return_inverse=True)
    columns -= first
    columns[foreign] = last - first + places
    A = sp.csr_matrix((values, columns, starts), shape=(last - first, last - first + len(numbers)))
    # Rows of other ranks, each with as many entries as a simplex has vertices.
    lookup, width = Lookup(system.comm, last - first, numbers), system.space.mesh.geometry.dim + 1
    entries = [lookup.of(part.reshape(-1, width)).ravel() for part in (P.data, P.indices)]
    ends = np.arange(0, width * len(numbers) + 1, width)
    others = sp.csr_matrix((*entries, ends), shape=(len(numbers), P.shape[1]))
    everywhere = sp.vstack((P, others), format="csr")
    parts = system.comm.allgather((P.T @ (A @ everywhere), P.T @ system.b.array_r))
    return sum(matrix for matrix, _ in parts), sum(load for _, load in parts)


def _solution(
    A: sp.csr_matrix, load: Array, lower: Array, upper: Array, start: Array
) -> tuple[Array, Array]:
    """The solution on the coarse space, and the contact forces on u."""
    start = np.where(np.isfinite(start), start, 0.0)
    matrix = PETSc.Mat().createAIJ(A.shape, csr=(A.indptr, A.indices, A.data), comm=PETSc.COMM_SELF)
    sides, solution = solve_small(matrix, A @ start - load, lower, upper, start)
    matrix.destroy()
    return solution, np.where(sides != 0.0, A @ solution - load, 0.0)


def _predicted(
    system: System, x: PETSc.Vec, P: sp.csr_matrix, contact: Mask, forces: Array
) -> Mask:
    """The active set by the sign of pressure minus gap.

    Args:
        system: The system.
        x: The solution on the coarse space.
        P: The interpolation at the owned dofs.
        contact: The vertices with an obstacle.
        forces: The contact forces on u at the vertices.
    """
    dofs, first = system.contact_dofs, slice(len(system.layout.free_dofs))
    rows = P[dofs]
    sizes = system.comm.allreduce(rows[first].T @ system.layout.weights[first])
    density = np.divide(forces, sizes, out=np.zeros_like(forces), where=sizes > 0.0)
    # The density is one of the boundary: vertices inside have no part in its interpolation.
    shares = rows @ contact.astype(float)
    density = np.divide(rows @ density, shares, out=np.zeros_like(shares), where=shares > 0)
    return presses(system, density, x.array_r[dofs])
