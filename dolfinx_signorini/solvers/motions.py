"""Rigid motions of a body: the functions on which a form without springs vanishes.

Of one component these are the constants; of vectors the translations and the infinitesimal turns.
Algebraic multigrid takes them for the functions that a cycle has to leave to the coarse levels.
"""

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.base.ranks import anywhere
from dolfinx_signorini.base.tolerances import ROUNDING, SOLVED
from dolfinx_signorini.meshes.elements import control_points
from dolfinx_signorini.meshes.sided_meshes import box
from dolfinx_signorini.solvers.system import Layout, System


def rigid_motions(comm: MPI.Comm, places: Array, size: int) -> Array:
    """Return the rigid motions at the dofs of nodes, shape (dofs, motions): translations first.

    Args:
        comm: The communicator; the call is collective.
        places: The nodes of this rank, shape (nodes, 3).
        size: The number of components.
    """
    x = places[:, :size]
    low, high = box(comm, x)
    x = (x - 0.5 * (low + high)) / (high - low).max()
    motions = [np.tile(unit, (len(x), 1)) for unit in np.eye(size)]
    for i in range(size):
        for j in range(i):
            turn = np.zeros((len(x), size))
            turn[:, i], turn[:, j] = x[:, j], -x[:, i]
            motions.append(turn)
    return np.stack(motions, axis=2).reshape(-1, len(motions))


def motions_of(layout: Layout) -> Array:
    """Return the rigid motions at the owned dofs of a problem, turned as its unknowns are.

    Args:
        layout: The dofs of the problem; the call is collective.

    Returns:
        Shape (dofs, motions).
    """
    places = owned_places(layout.nodal)
    columns = rigid_motions(layout.space.mesh.comm, places, layout.block)
    return np.stack([layout.turned(column) for column in columns.T], axis=1)


def owned_places(nodal: fem.FunctionSpace) -> Array:
    """Return the places of the owned dofs of a scalar space, shape (dofs, 3)."""
    return control_points(nodal)[: nodal.dofmap.index_map.size_local]


def at_rest(system: System) -> tuple[Array, Array]:
    """Return a rigid motion r, and the load b - A r on a body that rests there; collective.

    r is the motion nearest to the Dirichlet data, if that makes the load smaller, and else 0; each
    part of a mesh that is not connected has its own. b has the data times entries of the matrix: a
    constant that is added to all data and obstacles moves nothing, but makes b larger.

    Args:
        system: The system.

    Returns:
        The values of the owned dofs, and the load, 0 at the fixed dofs.
    """
    comm, fixed, data = system.comm, system.fixed_dofs, system.fixed_values
    load = system.b.array_r.copy()
    load[fixed] = 0.0
    motion: Array = np.zeros(len(load))
    if not anywhere(comm, data != 0.0):
        return motion, load
    motions, parts = motions_of(system.layout), system.layout.components
    numbers = np.repeat(parts.numbers, system.layout.block)
    for k in range(parts.count):
        own = motions[fixed] * (numbers[fixed] == k)[:, None]
        products, known = comm.allreduce(own.T @ own), comm.allreduce(own.T @ data)
        nearest = motions @ (np.linalg.pinv(products, ROUNDING, hermitian=True) @ known)
        motion = np.where(numbers == k, nearest, motion)
    rest, forces = system.A.createVecs()
    rest.array_w[:] = motion
    system.A.mult(rest, forces)
    other = load - forces.array_r
    other[fixed] = 0.0
    destroy(rest, forces)
    sizes = [np.bincount(numbers, np.abs(each), parts.count) for each in (other, load)]
    smaller = np.less(*comm.allreduce(np.array(sizes)))[numbers]
    return np.where(smaller, motion, 0.0), np.where(smaller, other, load)


def attach_motions(matrix: PETSc.Mat, motions: Array, held: LocalIndices) -> None:
    """Tell a matrix its near null space, for algebraic multigrid; nothing for one component.

    Constants are what algebraic multigrid knows by itself.

    Args:
        matrix: The matrix; the call is collective.
        motions: The motions at the owned dofs, shape (dofs, motions).
        held: Owned dofs at which the motions are zero.
    """
    if matrix.getBlockSize() == 1:
        return
    columns = motions.copy()
    columns[held] = 0.0
    # Orthonormal columns, by the eigenvectors of their products.
    products = matrix.comm.tompi4py().allreduce(columns.T @ columns)
    sizes = np.sqrt(np.maximum(np.diag(products), np.finfo(np.float64).tiny))
    values, parts = np.linalg.eigh(products / np.outer(sizes, sizes))
    kept = values > SOLVED * values[-1]
    columns = columns @ (parts[:, kept] / (sizes[:, None] * np.sqrt(values[kept])))
    vectors = []
    for column in columns.T:
        vector = matrix.createVecRight()
        vector.array_w[:] = column
        vectors.append(vector)
    space = PETSc.NullSpace().create(vectors=vectors, comm=matrix.comm)
    matrix.setNearNullSpace(space)
    destroy(space, *vectors)
