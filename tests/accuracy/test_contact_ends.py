"""Ends of the contact set: where they are, and how fast the solution is approximated there."""

import math

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from known import Known, alone, true_error

from dolfinx_signorini import (
    ObstacleProblem,
    SignoriniProblem,
    bernstein_space,
    christof_haubner,
    dirichlet,
    solve_adaptively,
)
from dolfinx_signorini.accuracy.cells import cell_norms
from dolfinx_signorini.accuracy.contact_ends import (
    cells_at_contact_ends,
    places_of_ends,
    rate_at_ends,
    unknown_ends,
)
from dolfinx_signorini.accuracy.marking import SAFETY
from dolfinx_signorini.accuracy.targets import target
from dolfinx_signorini.meshes.box_meshes import box_mesh, friedrichs_keller
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, owned_cells
from dolfinx_signorini.norms.power_sums import total
from dolfinx_signorini.studies.paper.solution import paper_problem


def error_at_the_origin(comm, n, norm):
    """How far r^{3/2} sin(3t/2) and its linear interpolant are apart on the cells at the origin."""

    def singular(x):
        return np.hypot(x[0], x[1]) ** 1.5 * np.sin(1.5 * np.arctan2(x[1], x[0]))

    domain = friedrichs_keller(comm, n)
    fine = fem.Function(fem.functionspace(domain, ("Lagrange", 4)))
    fine.interpolate(singular)
    coarse = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
    coarse.interpolate(singular)
    again = fem.Function(fine.function_space)
    again.interpolate(coarse)
    fine.x.array[:] -= again.x.array
    x = domain.geometry.x[domain.geometry.dofmap[owned_cells(domain)]]
    at = np.linalg.norm(x, axis=2).min(axis=1) < 1e-12
    return max(comm.allgather(cell_norms(fine, norm)[at].max(initial=0.0)))


@pytest.mark.parametrize("norm", ["Linf", "W1_4", "W1_inf"])
def test_the_rate_is_that_of_the_singularity(comm, norm):
    asked = target(norm)
    # The value adds a smaller part to W^{1,p}, which a small cell makes negligible.
    coarse, fine = (error_at_the_origin(comm, n, asked.norm) for n in (64, 128))
    assert np.log2(coarse / fine) == pytest.approx(rate_at_ends(asked), abs=0.01)


@pytest.mark.parametrize("degree", [1, 2, 4])
@pytest.mark.parametrize("n", [7, 12])
def test_the_cells_are_at_the_end_of_contact(comm, n, degree):
    """The paper's solution touches on the bottom up to x = 1/2, and with a positive force there."""
    sided = SidedMesh(friedrichs_keller(comm, n), {})
    division = refined(sided)
    problem = paper_problem(christof_haubner(division.sided.mesh), degree)
    problem.solve()
    cells = owned_cells(sided.mesh)
    found = cells_at_contact_ends(problem, division.parents, len(cells))
    x = sided.mesh.geometry.x[sided.mesh.geometry.dofmap[cells]]
    near = np.linalg.norm(x - [0.5, 0.0, 0.0], axis=2).min(axis=1) < 1.0 / n
    touching = x[:, :, 1].min(axis=1) < 1e-12
    assert comm.allreduce(np.count_nonzero(found & near & touching)) >= 1
    # Cells inside of the domain have none of it, wherever the solution touches weakly.
    inside = (x[:, :, :2].min(axis=(1, 2)) > 1.01 / n) & (
        x[:, :, :2].max(axis=(1, 2)) < 1 - 1.01 / n
    )
    assert not (found & inside).any()
    # In the middle of the contact set, between weak contact and the end, contact goes on.
    middle = (x[:, :, 0].min(axis=1) > 0.2) & (x[:, :, 0].max(axis=1) < 0.5 - 1.5 / n)
    assert not (found & middle & touching).any()
    problem.destroy()


@pytest.mark.parametrize("degree", [1, 2, 4])
@pytest.mark.parametrize("stretch", [1.0, 1.1, 1.3, 1.4])
@pytest.mark.parametrize("n", [7, 12])
def test_the_place_of_an_end_is_known_better_than_the_cell(comm, n, stretch, degree):
    """The paper's solution is in contact up to x = 1/2 on the bottom, anywhere between nodes."""
    grid = np.linspace(0.0, 1.0, n + 1)
    sided = SidedMesh(box_mesh(comm, [grid**stretch, grid]), {})
    division = refined(sided)
    problem = paper_problem(christof_haubner(division.sided.mesh), degree)
    problem.solve()
    cells = owned_cells(sided.mesh)
    here = cells_at_contact_ends(problem, division.parents, len(cells))
    places = places_of_ends(problem, sided.mesh, here)
    x = sided.mesh.geometry.x[sided.mesh.geometry.dofmap[cells[here]]]
    at_end = np.linalg.norm(x - [0.5, 0.0, 0.0], axis=2).min(axis=1) < 0.7 / n
    assert comm.allreduce(int(at_end.sum())) > 0
    width = np.diff(grid**stretch)[np.searchsorted(grid**stretch, 0.5) - 1]
    assert np.abs(places[at_end] - [0.5, 0.0, 0.0]).max(initial=0.0) < 0.3 * width
    problem.destroy()


@pytest.mark.parametrize("held", [True, False])
def test_a_side_that_is_in_contact_as_a_whole_has_no_end(comm, held):
    division = refined(SidedMesh(friedrichs_keller(comm, 4), {}))
    domain = division.sided.mesh
    bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    space = bernstein_space(domain, 2)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    sides = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(np.abs(x[0] - 0.5), 0.5))
    dofs = fem.locate_dofs_topological(space, 1, sides)
    problem = SignoriniProblem(
        (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx,
        -5.0 * v * ufl.dx,
        contact=bottom,
        bcs=[fem.dirichletbc(fem.Function(space), dofs)] if held else [],
    )
    problem.solve()
    assert comm.allreduce(len(problem.active)) > 0
    cells = 1 + division.parents.max(initial=-1)
    assert not cells_at_contact_ends(problem, division.parents, cells).any()
    problem.destroy()


def shaken(comm, seed):
    """Triangles of the unit square whose vertices inside have been moved, but for the middle."""
    domain, rng = mesh.create_unit_square(comm, 6, 5), np.random.default_rng(seed)
    moves = rng.uniform(-0.15, 0.15, (42, 2)) / [6, 5]
    x = domain.geometry.x
    column, row = np.rint(x[:, :2].T * [[6], [5]]).astype(int)
    inner = (column % 6 > 0) & (row % 5 > 0)
    move = moves[7 * row + column] * inner[:, None]
    move[column == 3, 0] = 0.0
    x[:, :2] += move
    return domain


@pytest.mark.parametrize("norm", ["L2", "L4"])
@pytest.mark.parametrize("seed", [0, 5, 9])
def test_ends_that_have_stayed_in_coarse_cells_count(seed, norm, comm):
    """Contact ends along a column of vertices, in cells of which few move with a division."""
    end = math.sqrt(1.6) / 8.0

    def posed(sided):
        V = fem.functionspace(sided.mesh, ("Lagrange", 2))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        a, L = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, -8.0 * v * ufl.dx
        return ObstacleProblem(a, L, lower=-0.1, bcs=[dirichlet(V, sided.sides["walls"], 0.0)])

    domain = shaken(comm, seed)
    walls = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(np.abs(x[0] - 0.5), 0.5))
    sided = SidedMesh(domain, {"walls": walls})
    found = solve_adaptively(posed, sided, norm=norm, accuracy=1e-4)
    x = ufl.SpatialCoordinate(found.problem.space.mesh)
    t, p = ufl.min_value(x[0], 1.0 - x[0]), int(norm[1])
    exact = ufl.conditional(t < end, 4.0 * t**2 - 8.0 * end * t, -0.1)
    rule = ufl.dx(metadata={"quadrature_degree": 20})
    error = abs(found.problem.u - exact) ** p * rule
    assert found.reached
    assert comm.allreduce(fem.assemble_scalar(fem.form(error))) ** (1.0 / p) <= 1e-4


@pytest.mark.parametrize("name", ["Linf", "W1_inf"])
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_an_end_in_the_domain_is_not_known_wherever_it_is_in_a_cell(degree, name, comm):
    """Along a line of the mesh the gap across the cells with the end may be 0, and the end off."""
    n, wanted, found, true = 8, target(name), [], []
    for place in np.linspace(3.05, 3.95, 10) / n:

        def u(x, y, place=place):
            return 0.5 * np.maximum(x - place, 0.0) ** 2

        def gradient(x, y, place=place):
            return np.maximum(x - place, 0.0), 0.0 * x

        corners = [[0.0, 0.0], [1.0, 2.0 / n]]
        domain = mesh.create_rectangle(comm, corners, [n, 2])
        space = bernstein_space(domain, degree)
        w, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        ends = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(abs(x[0] - 0.5), 0.5))
        problem = ObstacleProblem(
            ufl.inner(ufl.grad(w), ufl.grad(v)) * ufl.dx,
            fem.Constant(domain, -1.0) * v * ufl.dx,
            lower=0.0,
            bcs=[dirichlet(space, ends, lambda x, u=u: u(x[0], x[1]))],
        )
        problem.solve(rtol=1e-10)
        parts = unknown_ends(alone(problem, wanted), None)[1]
        found.append(SAFETY * total(parts, wanted.power, comm))
        true.append(true_error(problem.u, Known("", u, gradient, {}), name))
        problem.destroy()
    assert (np.array(found) >= 0.9 * np.array(true)).all()
    assert np.median(np.array(found) / true) <= 6.0
