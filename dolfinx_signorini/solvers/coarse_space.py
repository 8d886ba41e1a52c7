"""The start of a solve on a mesh without coarser ones: a contact problem on a coarse space.

Some dofs, spread as all dofs are, are the vertices of a Delaunay triangulation. The functions that
are linear on its simplices, interpolated at the dofs, are a coarse space with the prolongation P.
The obstacle holds at the vertices on the contact boundary. The Galerkin system with the matrix P'AP
and the load P'b is small, is solved by active sets on every rank, and predicts the active set as a
solution on a coarser mesh does, see `prediction`.

The triangulation does not know the domain, and couples what a thin hole separates. The start is
then worse, and the solution is the same.

Source: Chan, Smith and Zou, Numer. Math. 73 (1996) 149-167, for coarse spaces by interpolation
between meshes that are not nested.
"""

import numpy as np
import scipy.sparse as sp
from petsc4py import PETSc
from scipy.spatial import Delaunay, QhullError, cKDTree

from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.meshes.elements import control_points
from dolfinx_signorini.solvers.linear.solver import has_few_dofs
from dolfinx_signorini.solvers.patch import solve_small
from dolfinx_signorini.solvers.prediction import presses, settled
from dolfinx_signorini.solvers.system import System

# Between the widths of the meshes, by dimension: a larger one misplaces the ends of contact by more
# than patch problems mend, and a smaller one costs more than the linear solves that it saves.
RATIO = {2: 10, 3: 5}


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
    places = control_points(system.space)[: x.getLocalSize(), : domain.geometry.dim]
    chosen = _vertices(system, places)
    bound = np.full(len(places), -np.inf)
    bound[system.contact_dofs] = system.obstacle
    vertices, lower, start = (
        np.concatenate(comm.allgather(values[chosen])) for values in (places, bound, x.array_r)
    )
    try:
        triangulation = Delaunay(vertices)
    except (QhullError, ValueError):  # too few vertices, or all of them in one line or plane
        return None
    if len(triangulation.coplanar):  # some vertices are left out
        return None
    P = _interpolation(triangulation, places)
    P.data.reshape(len(places), -1)[system.fixed_dofs] = 0.0
    A, load = _galerkin(system, P, len(chosen))
    solution, forces = _solution(A, load, lower, start)
    A.destroy()
    if not np.isfinite(solution).all():
        return None
    x.array_w[:] = P @ solution
    system.project(x)
    return settled(system, x, _predicted(system, x, P, np.isfinite(lower), forces))


def _vertices(system: System, places: Array) -> LocalIndices:
    """Owned dofs, spread as all dofs are: contact dofs, and dofs without any condition."""
    dim = system.space.mesh.topology.dim
    free = np.ones(len(places), dtype=bool)
    free[np.concatenate((system.contact_dofs, system.fixed_dofs))] = False
    chosen = []
    for dofs, step in (
        (system.contact_dofs, RATIO[dim] ** (dim - 1)),
        (np.flatnonzero(free).astype(np.int32), RATIO[dim] ** dim),
    ):
        # The leaves of the tree are groups of neighbours, one after the other.
        tree = cKDTree(places[dofs], leafsize=step, compact_nodes=False)
        chosen.append(dofs[tree.indices[::step]])
    return np.concatenate(chosen)


def _interpolation(triangulation: Delaunay, places: Array) -> sp.csr_matrix:
    """The values at points of the functions that are linear on the simplices.

    A point outside of all simplices has the value of the nearest vertex.
    """
    dim, cells = places.shape[1], triangulation.find_simplex(places)
    outside = np.flatnonzero(cells < 0)
    nearest = cKDTree(triangulation.points).query(places[outside])[1]
    cells[outside] = triangulation.vertex_to_simplex[nearest]
    maps, columns = triangulation.transform[cells], triangulation.simplices[cells]
    weights = np.empty(columns.shape)
    weights[:, :dim] = np.einsum("nij,nj->ni", maps[:, :dim], places - maps[:, dim])
    weights[:, dim] = 1.0 - weights[:, :dim].sum(axis=1)
    weights[outside] = columns[outside] == nearest[:, None]
    starts = np.arange(0, columns.size + 1, dim + 1, dtype=np.int32)
    shape = len(places), len(triangulation.points)
    matrix = sp.csr_matrix((weights.ravel(), columns.ravel(), starts), shape=shape)
    matrix.sort_indices()  # PETSc takes them for sorted
    return matrix


def _galerkin(system: System, P: sp.csr_matrix, owned: int) -> tuple[PETSc.Mat, Array]:
    """The matrix P'AP and the load P'b, whole on each rank.

    Args:
        system: The system.
        P: The interpolation at the owned dofs.
        owned: The number of vertices that this rank has chosen.
    """
    sizes = (P.shape[0], None), (owned, None)
    matrix = PETSc.Mat().createAIJ(sizes, csr=(P.indptr, P.indices, P.data), comm=system.comm)
    product = system.A.ptap(matrix)
    everything = PETSc.IS().createStride(P.shape[1], 0, 1, comm=PETSc.COMM_SELF)
    (whole,) = product.createSubMatrices(everything)
    for item in (matrix, product, everything):
        item.destroy()
    return whole, system.comm.allreduce(P.T @ system.b.array_r)


def _solution(A: PETSc.Mat, load: Array, lower: Array, start: Array) -> tuple[Array, Array]:
    """The solution on the coarse space, and the contact forces."""
    values, residual = A.createVecs()
    values.array_w[:] = start = np.where(np.isfinite(start), start, 0.0)
    A.mult(values, residual)
    active, solution = solve_small(A, residual.array_r - load, lower, start)
    values.array_w[:] = solution
    A.mult(values, residual)
    forces = np.where(active, residual.array_r - load, 0.0)
    for item in (values, residual):
        item.destroy()
    return solution, forces


def _predicted(
    system: System, x: PETSc.Vec, P: sp.csr_matrix, contact: Mask, forces: Array
) -> Mask:
    """The active set by the sign of pressure minus gap.

    Args:
        system: The system.
        x: The solution on the coarse space.
        P: The interpolation at the owned dofs.
        contact: The vertices on the contact boundary.
        forces: The contact forces on the vertices.
    """
    dofs = system.contact_dofs
    on_boundary = P[dofs]
    sizes = system.comm.allreduce(on_boundary.T @ system.layout.weights)
    density = np.divide(forces, sizes, out=np.zeros_like(forces), where=sizes > 0.0)
    # The density is one of the boundary: vertices inside have no part in its interpolation.
    shares = on_boundary @ contact.astype(float)
    density = np.divide(on_boundary @ density, shares, out=np.zeros_like(shares), where=shares > 0)
    return presses(system, density, x.array_r[dofs])
