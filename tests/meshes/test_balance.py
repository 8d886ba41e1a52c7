"""Refined meshes whose cells are shared anew: the same mesh, on other ranks."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy.spatial import cKDTree

from dolfinx_signorini import SignoriniProblem
from dolfinx_signorini.accuracy.adaptive import solve_adaptively
from dolfinx_signorini.accuracy.cells import volumes
from dolfinx_signorini.meshes import balance
from dolfinx_signorini.meshes.balance import balanced
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.parents import parent_mesh
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, owned_cells
from dolfinx_signorini.solvers.linear.hierarchy import nodes_of, refinement_prolongation

KINDS = ["square", "cube"]
PLANES = {"low x": (0, 0.0), "high x": (0, 1.0), "low y": (1, 0.0)}


@pytest.fixture
def always(monkeypatch):
    """Share meshes anew in any case, also on one rank."""
    monkeypatch.setattr(balance, "UNEVEN", 0.0)


def sided_mesh(comm, kind, n=6):
    """A square or a cube with sides."""
    domain = (
        friedrichs_keller(comm, n) if kind == "square" else mesh.create_unit_cube(comm, n, n, n)
    )
    dim = domain.topology.dim - 1
    sides = {
        name: mesh.locate_entities_boundary(domain, dim, lambda x, a=a, v=v: np.isclose(x[a], v))
        for name, (a, v) in PLANES.items()
    }
    return SidedMesh(domain, sides)


def near_corner(sided, reach=0.5):
    """Refine the cells near the origin."""
    domain = sided.mesh
    middles = mesh.compute_midpoints(domain, domain.topology.dim, owned_cells(domain))
    near = np.linalg.norm(middles, axis=1) < reach
    return refined(sided, np.flatnonzero(near).astype(np.int32))


def corners(sided):
    domain = sided.mesh
    return domain.geometry.x[domain.geometry.dofmap[owned_cells(domain)]]


def everywhere(space, values):
    """The values of all owned dofs of all ranks, at their places in one order."""
    comm, owned = space.mesh.comm, space.dofmap.index_map.size_local
    x = np.concatenate(comm.allgather(space.tabulate_dof_coordinates()[:owned]))
    return x, np.concatenate(comm.allgather(values[:owned]))


def largest_share(comm, sided):
    """The cells of the rank that has most of them, over the mean."""
    counts = comm.allgather(len(owned_cells(sided.mesh)))
    return max(counts) * comm.size / sum(counts)


@pytest.mark.parametrize("kind", KINDS)
def test_no_rank_has_many_more_cells_than_others(comm, kind):
    sided, reach = sided_mesh(comm, kind), 0.7
    for _ in range(4):
        sided, reach = balanced(near_corner(sided, reach)).sided, 0.6 * reach
        assert largest_share(comm, sided) <= 1.2


def test_meshes_in_balance_stay_as_they_are(comm):
    division = refined(sided_mesh(comm, "square"))
    shared = balanced(division)
    assert shared.sided is division.sided
    first = division.sided.mesh.topology.index_map(2).local_range[0] // 4
    assert np.array_equal(shared.parents.numbers, first + division.parents)


@pytest.mark.parametrize("kind", KINDS)
def test_cells_are_the_same_and_know_their_parents(comm, kind, always):
    sided = sided_mesh(comm, kind)
    local = near_corner(sided)
    shared = balanced(local)
    old, new = (
        np.concatenate(comm.allgather(np.sort(corners(s).mean(axis=1) @ (1.0, np.pi, np.e))))
        for s in (local.sided, shared.sided)
    )
    assert np.sort(new) == pytest.approx(np.sort(old), rel=1e-12)
    around, inside = shared.parents.of(corners(sided)), corners(shared.sided)
    dim = sided.mesh.topology.dim
    edges = (around[:, 1:] - around[:, :1])[:, :, :dim]
    shares = np.linalg.solve(
        edges.transpose(0, 2, 1)[:, None], (inside - around[:, :1])[..., :dim, None]
    )
    assert shares.min(initial=0.0) > -1e-12
    assert shares[..., 0].sum(axis=2).max(initial=0.0) < 1.0 + 1e-12
    parts = shared.parents.sent(volumes(shared.sided.mesh))
    sums = np.bincount(shared.parents.items, parts, shared.parents.count)
    assert sums == pytest.approx(volumes(sided.mesh), rel=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_sides_keep_their_places_and_lengths(comm, kind, always):
    sided = balanced(near_corner(balanced(near_corner(sided_mesh(comm, kind))).sided, 0.3)).sided
    domain, dim = sided.mesh, sided.mesh.topology.dim - 1
    for name, (axis, at) in PLANES.items():
        facets = sided.sides[name]
        middle = mesh.compute_midpoints(domain, dim, facets)
        assert np.abs(middle[:, axis] - at).max(initial=0.0) < 1e-12
        tags = mesh.meshtags(domain, dim, np.sort(facets), np.ones_like(facets))
        on = ufl.Measure("ds", domain, subdomain_data=tags)(1)
        size = fem.assemble_scalar(fem.form(fem.Constant(domain, 1.0) * on))
        assert comm.allreduce(size) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_prolongations_reproduce_linear_functions_and_are_those_of_the_local_mesh(
    comm, kind, always
):
    sided = sided_mesh(comm, kind)
    coarse, found = sided.mesh, []
    local = near_corner(sided)
    for fine in (local.sided.mesh, balanced(local).sided.mesh):
        space = fem.functionspace(fine, ("Lagrange", 1))
        P = refinement_prolongation(fine, nodes_of(space), parent_mesh(fine))
        right, left = P.createVecs()
        x = coarse.geometry.x[: right.getLocalSize()].T
        for values in (x[0] - 2.0 * x[1] + 3.0 * x[2], np.cos(1e4 * (x[0] + 2.0 * x[1]) - x[2])):
            right.array_w[:] = values
            P.mult(right, left)
            found.append(everywhere(space, left.array_r.copy()))
        for item in (P, right, left):
            item.destroy()
    for places, values in found[::2]:
        assert values == pytest.approx(places @ (1.0, -2.0, 3.0), abs=1e-12)
    far, place = cKDTree(found[1][0]).query(found[3][0])
    assert far.max() < 1e-12
    assert found[3][1] == pytest.approx(found[1][1][place], abs=1e-12)


def test_a_mesh_of_which_a_rank_has_no_cell_is_shared_anew(comm, always):
    sided = sided_mesh(comm, "square", 1)
    shared = balanced(near_corner(sided, 0.8))
    assert shared.sided.mesh.topology.index_map(2).size_global > 2
    assert comm.allreduce(volumes(shared.sided.mesh).sum()) == pytest.approx(2.0, rel=1e-12)
    parts = shared.parents.sent(volumes(shared.sided.mesh))
    sums = np.bincount(shared.parents.items, parts, shared.parents.count)
    assert sums == pytest.approx(volumes(sided.mesh), rel=1e-12)


def pose(sided):
    """A load near one corner of a square or a cube, which is in contact at a side."""
    domain = sided.mesh
    space = fem.functionspace(domain, ("Lagrange", 2))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    load = (50.0 * ufl.exp(-300.0 * ufl.inner(x, x)) - 1.0) * v * ufl.dx
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    return SignoriniProblem(a, load, contact=sided.sides["low y"], obstacle=-0.8)


def result(sided, norm, accuracy):
    found = solve_adaptively(pose, sided, norm=norm, accuracy=accuracy)
    form = fem.form(found.problem.u * ufl.dx)
    integral = sided.mesh.comm.allreduce(fem.assemble_scalar(form))
    steps = [(step.unknowns, step.estimate) for step in found.steps]
    found.problem.destroy()
    return found, integral, steps


@pytest.mark.parametrize(
    ("kind", "norm", "accuracy"),
    [("square", "L2", 1e-6), ("square", "Linf", 1e-5), ("cube", "H1", 1e-3)],
)
def test_the_answer_is_that_of_one_rank_and_the_last_mesh_is_in_balance(comm, kind, norm, accuracy):
    n = 4 if kind == "square" else 2
    _, integral, steps = result(sided_mesh(MPI.COMM_SELF, kind, n), norm, accuracy)
    found, same, others = result(sided_mesh(comm, kind, n), norm, accuracy)
    assert len(steps) > 2
    assert same == pytest.approx(integral, rel=1e-6)
    assert np.array(others) == pytest.approx(np.array(steps), rel=1e-3)
    assert largest_share(comm, found.sided) <= 1.2
