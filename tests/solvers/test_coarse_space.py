"""Starts from a coarse space: right predictions, and one set-up on meshes without coarser ones."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy.spatial import Delaunay

from dolfinx_signorini import SignoriniProblem, bernstein_space, boundary_facets
from dolfinx_signorini.base.tolerances import HALF_OF_THE_DIGITS
from dolfinx_signorini.solvers.coarse_space import (
    _interpolation,
    _unequal,
    coarse_start,
    out_of_reach,
)


def shaken(comm, dim, cells, seed=3):
    """A mesh of a square or cube that is no lattice: nodes inside are moved at random."""
    if dim == 2:
        domain = mesh.create_unit_square(comm, cells, cells)
    else:
        domain = mesh.create_unit_cube(comm, cells, cells, cells)
    x = domain.geometry.x
    inside = np.all((x[:, :dim] > 1e-9) & (x[:, :dim] < 1.0 - 1e-9), axis=1)
    # The same node moves in the same way on all ranks.
    waves = np.sin(seed * 1e3 * x[:, :dim] @ np.arange(1.0, dim * dim + 1.0).reshape(dim, dim))
    x[inside, :dim] += 0.15 / cells * waves[inside]
    return domain


def posed(domain, degree=1, reaction=1.0, obstacle=None):
    """A load of both signs over an obstacle with waves, on the whole boundary."""
    space = bernstein_space(domain, degree)
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    load = 12.0 * ufl.sin(3.0 * x[0] + 1.0) * ufl.cos(4.0 * x[1])
    waves = 0.05 * ufl.sin(7.0 * x[0]) * ufl.cos(5.0 * x[1] + 1.0) + 0.1
    return SignoriniProblem(
        (ufl.inner(ufl.grad(u), ufl.grad(v)) + reaction * u * v) * ufl.dx,
        load * v * ufl.dx(metadata={"quadrature_degree": 4}),
        contact=boundary_facets(domain),
        obstacle=waves if obstacle is None else obstacle,
    )


@pytest.mark.parametrize("dim", [2, 3])
def test_linear_functions_are_interpolated_exactly(dim):
    rng = np.random.default_rng(dim)
    vertices, slope = rng.uniform(size=(60, dim)), rng.normal(size=dim)
    centres = vertices[Delaunay(vertices).simplices].mean(axis=1)
    places = np.vstack((centres, vertices))
    chosen = len(centres) + np.arange(len(vertices))
    P = _interpolation(Delaunay(vertices), places, rng.permutation(len(places)), chosen, 0)
    expected = np.concatenate((centres @ slope, vertices @ slope))
    assert P @ (vertices @ slope) == pytest.approx(expected, abs=1e-12)
    assert np.asarray(P.sum(axis=1)).ravel() == pytest.approx(1.0)


@pytest.mark.parametrize("dim", [2, 3])
def test_each_vertex_has_its_own_function_however_near_the_next(dim):
    """A lattice with many planes, graded towards a corner: steps smaller than what is near."""
    ticks = [np.concatenate(([0.0], np.geomspace(1e-6, 1.0, 7)))] * dim
    vertices = np.stack(np.meshgrid(*ticks), axis=-1).reshape(-1, dim)
    shifted = Delaunay(vertices + HALF_OF_THE_DIGITS * _unequal(vertices.shape))
    chosen = np.arange(len(vertices))
    P = _interpolation(shifted, vertices, chosen, chosen, 0)
    assert P.toarray() == pytest.approx(np.eye(len(vertices)))


def test_outside_of_the_triangulation_the_nearest_vertex_counts():
    square = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    places, none = np.array([[1.2, 1.1], [-0.5, 0.1]]), np.array([], dtype=np.int32)
    P = _interpolation(Delaunay(square), places, np.arange(2), none, 0)
    assert P.toarray() == pytest.approx(np.array([[0, 0, 0, 1.0], [1.0, 0, 0, 0]]))


@pytest.mark.parametrize(
    ("dim", "degree", "cells"), [(2, 1, 90), (2, 2, 50), (3, 1, 14), (3, 2, 11)]
)
def test_the_set_is_predicted(comm, dim, degree, cells):
    problem = posed(shaken(comm, dim, cells), degree)
    problem.solve(rtol=1e-10)
    right = np.isin(problem.contact_dofs, problem.active)
    x = problem.system.start()
    held = coarse_start(problem.system, x)
    touching, wrong = (comm.allreduce(int(s.sum())) for s in (right, held != right))
    gap = x.array_r[problem.contact_dofs] - problem.system.obstacle
    assert comm.allreduce(float(gap.min(initial=0.0))) >= 0.0
    x.destroy()
    problem.destroy()
    assert 0 < touching < comm.allreduce(len(right))
    assert wrong <= 0.15 * touching


@pytest.mark.parametrize(("dim", "cells"), [(2, 100), (3, 16)])
def test_one_set_up_serves_all_sets_of_a_cold_solve(comm, dim, cells, solve_with_scipy):
    problem = posed(shaken(comm, dim, cells))
    u = problem.solve(rtol=1e-9)
    assert problem.result.setups == 1
    assert problem.result.preconditioner in ("boomeramg", "gamg")
    expected = solve_with_scipy(problem)
    assert u.x.array[: len(expected)] == pytest.approx(expected, abs=1e-7)
    problem.destroy()


def test_a_slit_that_the_triangulation_does_not_know(comm, solve_with_scipy):
    """Two halves of a square that are not connected, with loads of different signs."""
    whole = mesh.create_unit_square(comm, 90, 90)
    halves = mesh.locate_entities(
        whole, 2, lambda x: np.logical_or(x[0] <= 0.5 + 1e-9, x[0] >= 0.5 + 1.0 / 90 - 1e-9)
    )
    domain = mesh.create_submesh(whole, 2, halves)[0]
    x = domain.geometry.x
    x[x[:, 0] > 0.505, 0] -= 0.9 / 90
    problem = posed(domain)
    u = problem.solve(rtol=1e-9)
    expected = solve_with_scipy(problem)
    assert u.x.array[: len(expected)] == pytest.approx(expected, abs=1e-7)
    problem.destroy()


def test_only_contact_holds_the_body(comm, solve_with_scipy):
    """The form vanishes on constants: without contact the coarse matrix is singular."""
    problem = posed(shaken(comm, 2, 80), reaction=0.0, obstacle=-3.0)
    total = problem.total_load
    u = problem.solve(rtol=1e-9)
    assert problem.result.setups == 1
    assert problem.force == pytest.approx(-total, rel=1e-6)
    expected = solve_with_scipy(problem)
    assert u.x.array[: len(expected)] == pytest.approx(expected, abs=1e-6)
    problem.destroy()


def test_an_obstacle_out_of_reach_costs_nothing(comm):
    problem = posed(shaken(comm, 2, 80), obstacle=-1e250)
    problem.solve()
    assert problem.result.active_dofs == 0
    assert problem.result.linear_solves == 1
    problem.destroy()


@pytest.mark.parametrize("ghosts", [mesh.GhostMode.none, mesh.GhostMode.shared_facet])
def test_rows_of_dofs_whose_cells_another_rank_has(comm, ghosts):
    """The row of an owned vertex refers to dofs of cells that are not even ghosts here."""
    domain = mesh.create_unit_square(comm, 61, 61, ghost_mode=ghosts)
    problem = posed(domain)
    x = problem.system.start()
    held = coarse_start(problem.system, x)
    assert held is not None
    assert comm.allreduce(int(held.sum())) > 0
    u = problem.solve().x.array.copy()
    assert problem.solve("bntr", rtol=1e-9, warm_start=False).x.array == pytest.approx(u, abs=1e-6)


@pytest.mark.parametrize("reaction", [1e-3, 1.0, 100.0])
@pytest.mark.parametrize("dirichlet", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_what_is_out_of_reach_is_not_touched(comm, dim, reaction, dirichlet):
    """The obstacle is a little above the lowest value without contact, or far below all values."""
    domain = shaken(comm, dim, {2: 60, 3: 11}[dim])
    space = bernstein_space(domain, 1)
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    form = (ufl.inner(ufl.grad(u), ufl.grad(v)) + reaction * u * v) * ufl.dx
    load = (12.0 * ufl.sin(3.0 * x[0] + 1.0) * ufl.cos(9.0 * x[1]) - 40.0) * v * ufl.dx
    left = mesh.locate_entities_boundary(domain, dim - 1, lambda x: np.isclose(x[0], 0.0))
    value = fem.Function(space)
    value.interpolate(lambda x: 1.0 + np.sin(4.0 * x[1]))
    dofs = fem.locate_dofs_topological(space, dim - 1, left)
    bcs = [fem.dirichletbc(value, dofs)] if dirichlet else []

    def reached(level):
        contact = np.setdiff1d(boundary_facets(domain), left) if bcs else boundary_facets(domain)
        problem = SignoriniProblem(form, load, contact=contact, obstacle=level, bcs=bcs)
        start = problem.system.start()
        far = out_of_reach(problem.system, start)
        values = problem.solve(rtol=1e-8).x.array[problem.contact_dofs]
        lowest = comm.allreduce(float(values.min(initial=np.inf)), op=MPI.MIN)
        start.destroy()
        problem.destroy()
        return not far, lowest

    near, lowest = reached(-1e6)
    assert not near
    assert reached(lowest + 1e-3)[0]
