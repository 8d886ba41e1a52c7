"""Compiled loops over the rows of matrices, against dense matrices."""

import itertools

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI

from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.solvers.linear.hierarchy import mesh_prolongations
from dolfinx_signorini.solvers.linear.rows import Rows

COMM = MPI.COMM_WORLD


def space(n=40):
    return fem.functionspace(friedrichs_keller(COMM, n), ("Lagrange", 1))


def stiffness(of):
    u, v = ufl.TrialFunction(of), ufl.TestFunction(of)
    A = fem_petsc.assemble_matrix(fem.form((ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx))
    A.assemble()
    return A


def dense(matrix):
    """The rows of this rank."""
    starts, columns, entries = matrix.getValuesCSR()
    found = np.zeros((len(starts) - 1, matrix.getSize()[1]))
    found[np.repeat(np.arange(len(found)), np.diff(starts)), columns] = entries
    return found


@pytest.mark.parametrize("kind", ["forward", "backward"])
def test_a_sweep_solves_one_row_after_the_other_within_bounds(kind):
    fine, rng = space(12), np.random.default_rng(COMM.rank)
    A = stiffness(fine)
    first, last = A.getOwnershipRange()
    block, size = dense(A)[:, first:last], last - first
    rest, step = A.createVecs()
    rest.array_w[:] = rng.standard_normal(size)
    x = rng.standard_normal(size)
    lower, upper = x - 0.05 * rng.random(size), x + 0.05 * rng.random(size)
    lower[::3], upper[::4] = -np.inf, np.inf
    expected = x.copy()
    for i in range(size) if kind == "forward" else reversed(range(size)):
        left = rest.array_r[i] - block[i] @ (expected - x)
        expected[i] = min(max(expected[i] + left / block[i, i], lower[i]), upper[i])
    found = x.copy()
    Rows(A).sweep(kind, rest, lower, upper, found, step)
    assert found == pytest.approx(expected, abs=1e-13)
    assert step.array_r == pytest.approx(found - x, abs=1e-15)
    assert COMM.allreduce(int((found == lower).sum())) and COMM.allreduce(int((found < x).sum()))
    for item in (A, rest, step):
        item.destroy()


def test_many_sweeps_solve_the_bound_constrained_problem_of_a_rank():
    fine = space(6)
    A = stiffness(fine)
    first, last = A.getOwnershipRange()
    block, size = dense(A)[:, first:last], last - first
    rest, step = A.createVecs()
    rest.array_w[:] = np.linspace(-1.0, 1.0, size)
    x, lower, upper = np.zeros(size), np.full(size, -0.1), np.full(size, 0.2)
    Rows(A).sweep("settle", rest, lower, upper, x, step, 400)
    force = block @ x - rest.array_r
    natural = np.maximum(np.minimum(x - lower, force), x - upper)
    assert np.abs(natural).max(initial=0.0) < 1e-10
    for item in (A, rest, step):
        item.destroy()


def test_the_largest_value_of_the_rows_of_a_column_on_all_ranks():
    fine = space()
    (P, *others) = mesh_prolongations(fine)
    rows = P.getOwnershipRange()
    values = np.sin(np.arange(*rows, dtype=np.float64))
    every = np.concatenate(COMM.allgather(dense(P))), np.concatenate(COMM.allgather(values))
    expected = np.where(every[0] != 0.0, every[1][:, None], -np.inf).max(axis=0)
    assert (Rows(P).largest(values) == expected[slice(*P.getOwnershipRangeColumn())]).all()
    for item in (P, *others):
        item.destroy()


def test_nodes_of_a_coarser_mesh_are_nodes_of_the_finer_one():
    fine = space()
    (P, *others) = mesh_prolongations(fine)
    rows, columns = Rows(P).units()
    assert COMM.allreduce(len(rows)) == P.getSize()[1]
    coarse, values = P.createVecs()
    coarse.array_w[:] = np.arange(*P.getOwnershipRangeColumn())
    P.mult(coarse, values)
    assert (values.array_r[rows] == columns).all()
    for item in (P, coarse, values, *others):
        item.destroy()


@pytest.mark.skipif(COMM.size > 1, reason="products are renewed on one rank")
def test_renewed_products_are_those_of_the_matrix_without_held_dofs():
    fine, rng = space(), np.random.default_rng(3)
    A, prolongations = stiffness(fine), mesh_prolongations(fine)
    size = A.getSize()[0]
    masks = [np.zeros(size, dtype=bool), *(rng.random(size) < share for share in (0.4, 0.2, 0.0))]
    products, truncated = [A], A.copy()
    for P in prolongations:
        products.append(products[-1].ptap(P))
    for before, now in itertools.pairwise(masks):
        changes = Rows(A).changes(before, now, 2.0, Rows(truncated))
        free = np.where(now, 0.0, 1.0)
        held = free[:, None] * dense(A) * free
        assert (dense(truncated) == held + 2.0 * np.diag(1.0 - free)).all()
        expected = held
        for matrix, P, product in zip(products, prolongations, products[1:], strict=False):
            changes = Rows(matrix).renew(changes, Rows(P), Rows(product))
            expected = dense(P).T @ expected @ dense(P)
            assert np.abs(dense(product) - expected).max() < 1e-13 * np.abs(dense(A)).max()
    assert len(prolongations) > 1
    for item in (*products, *prolongations, truncated):
        item.destroy()
