"""Elastic contact without the package: DOLFINx assembles, SciPy solves, each rank for itself.

With Dirichlet data eliminated, minimise u.A u / 2 - b.u over all u with C u <= g, one row of C for
each node of the contact boundary. The multipliers minimise |R m - R^-T q|, m >= 0, with
R^T R = C A^-1 C^T and q = C A^-1 b - g: non-negative least squares. The set of positive multipliers
is then taken as equations, and the conditions of Karush, Kuhn and Tucker are checked.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse as sp
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc
from scipy.optimize import nnls
from scipy.sparse.linalg import splu


def gathered(function):
    """The values of a function at the nodes of all ranks, shape (nodes,) or (nodes, components)."""
    dofmap = function.function_space.dofmap
    owned = function.x.array[: dofmap.index_map.size_local * dofmap.bs]
    values = np.concatenate(function.function_space.mesh.comm.allgather(owned))
    return values if dofmap.bs == 1 else values.reshape(-1, dofmap.bs)


def gathered_numbers(space, nodes):
    """The numbers on all ranks of owned nodes of this rank, sorted."""
    first = space.dofmap.index_map.local_range[0]
    return np.sort(np.concatenate(space.mesh.comm.allgather(np.asarray(nodes) + first)))


def nodes_of(space):
    """The coordinates of the nodes of all ranks, shape (3, nodes)."""
    owned = space.dofmap.index_map.size_local
    parts = space.mesh.comm.allgather(space.tabulate_dof_coordinates()[:owned])
    return np.concatenate(parts).T


def assembled(a, L):
    """The matrix and the load of all ranks, without boundary conditions."""
    A, b = fem_petsc.assemble_matrix(fem.form(a)), fem_petsc.assemble_vector(fem.form(L))
    A.assemble()
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    rows, columns, values = A.getValuesCSR()
    part = sp.csr_matrix((values, columns, rows), shape=(len(rows) - 1, A.getSize()[1]))
    parts = A.comm.tompi4py().allgather((part, b.array_r.copy()))
    for item in (A, b):
        item.destroy()
    matrices, vectors = zip(*parts, strict=True)
    return sp.vstack(matrices).tocsc(), np.concatenate(vectors)


def elastic(space, modulus, poisson, load, traction, spring):
    """Forms of linear elasticity, with a force on cells, one on the boundary, and a spring."""
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    mu = modulus / (2.0 * (1.0 + poisson))
    lame = modulus * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    strain = ufl.sym(ufl.grad(u))
    stress = 2.0 * mu * strain + lame * ufl.tr(strain) * ufl.Identity(len(u))
    a = (ufl.inner(stress, ufl.sym(ufl.grad(v))) + spring * ufl.inner(u, v)) * ufl.dx
    return a, ufl.inner(load, v) * ufl.dx + ufl.inner(traction, v) * ufl.ds


@dataclass
class Solution:
    """What the conditions of Karush, Kuhn and Tucker determine, for the nodes of all ranks.

    Attributes:
        u: The displacement, shape (nodes, components).
        multipliers: The sizes of the contact forces, shape (nodes,); 0 away from the contact.
        forces: The contact forces on the body, shape (nodes, components).
        gap: g - u.d at the nodes with a constraint, elsewhere 0.
        scale: The size of the forces with which errors are compared.
        margin: How far each node with a constraint is from changing sides, as a part of the
            largest multiplier or displacement; the smallest one.
    """

    u: np.ndarray
    multipliers: np.ndarray
    forces: np.ndarray
    gap: np.ndarray
    scale: float
    margin: float


def solve(A, b, held, values, nodes, directions, gaps):
    """Return the solution.

    Args:
        A, b: Matrix and load, without conditions.
        held: Which components have Dirichlet data, shape (nodes, components).
        values: These data, 0 elsewhere, of the same shape.
        nodes: The numbers of the nodes with a constraint.
        directions: Their directions, shape (len(nodes), components).
        gaps: Their gaps.
    """
    count, size = held.shape
    free, data = np.flatnonzero(~held.ravel()), values.ravel()
    rows = np.repeat(np.arange(len(nodes)), size)
    columns = (np.asarray(nodes)[:, None] * size + np.arange(size)).ravel()
    C = sp.csr_matrix((directions.ravel(), (rows, columns)), shape=(len(nodes), A.shape[0]))
    right, room = (b - A @ data)[free], gaps - C @ data
    A_free, C_free = A[free][:, free].tocsc(), C[:, free]
    if (np.abs(C_free).sum(axis=1) == 0.0).any():
        raise ValueError("a node with a constraint is held")
    factor = splu(A_free)
    m = _multipliers(factor, C_free, right, room)
    u = factor.solve(right - C_free.T @ m)
    gap = room - C_free @ u
    scale = np.abs(b).max() + np.abs(A @ data).max() + (abs(C.T) @ m).max()
    assert m.min(initial=0.0) >= 0.0 and gap.min() >= -1e-12 * (
        np.abs(u).max() + np.abs(gaps).max()
    )
    assert np.abs(gap[m > 0.0]).max(initial=0.0) <= 1e-11 * np.abs(u).max()
    forces, data = np.zeros((2, count, size))
    whole, gap_at = np.zeros((2, count))
    forces[nodes], whole[nodes], gap_at[nodes] = -m[:, None] * directions, m, gap
    everything = values.ravel().copy()
    everything[free] += u
    margins = np.maximum(m / max(m.max(initial=0.0), 1e-300), np.abs(gap) / np.abs(u).max())
    return Solution(everything.reshape(count, size), whole, forces, gap_at, scale, margins.min())


def _multipliers(factor, C, right, room):
    """The multipliers: by non-negative least squares, then with the rows of the positive ones."""
    response = factor.solve(C.T.toarray())
    S, q = C @ response, C @ factor.solve(right) - room
    R = scipy.linalg.cholesky(0.5 * (S + S.T))
    m, _ = nnls(R, scipy.linalg.solve_triangular(R, q, trans="T"), maxiter=100 * len(q))
    active = m > 1e-10 * m.max(initial=0.0)
    m = np.zeros_like(m)
    if active.any():
        m[active] = scipy.linalg.solve(S[np.ix_(active, active)], q[active], assume_a="pos")
    return m
