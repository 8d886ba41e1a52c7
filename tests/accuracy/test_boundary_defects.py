"""Errors that the obstacle alone shows, and no comparison of two solutions."""

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
    dirichlet,
    friedrichs_keller,
    solve_adaptively,
)
from dolfinx_signorini.accuracy.boundary_defects import data_defects, forces_over_gaps
from dolfinx_signorini.accuracy.estimates import Estimator
from dolfinx_signorini.accuracy.targets import size, target
from dolfinx_signorini.accuracy.terms import Solution, Solved
from dolfinx_signorini.data.interfaces.piecewise_forms import data_in_pieces
from dolfinx_signorini.meshes.refinement import Transfer, refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, boundary_facets, facet_cells
from dolfinx_signorini.norms.power_sums import total

CELLS = {2: 6, 3: 2}  # on each side of the undivided mesh, by dimension
HEIGHT = 1e-3


def solved(sided, degree, waves):
    """The solution -z on a mesh whose nodes are the zeros of the waves of the obstacle."""
    domain = sided.mesh
    space, dim = fem.functionspace(domain, ("Lagrange", degree)), domain.topology.dim
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    x, data = ufl.SpatialCoordinate(domain), fem.Function(space)
    data.interpolate(lambda x: -x[dim - 1])
    held = np.setdiff1d(boundary_facets(domain), sided.sides["bottom"])
    dofs = fem.locate_dofs_topological(space, dim - 1, held)
    obstacle = HEIGHT * math.prod(ufl.sin(waves * math.pi * x[k]) for k in range(dim - 1))
    problem = SignoriniProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        fem.Constant(domain, 0.0) * v * ufl.dx,
        contact=sided.sides["bottom"],
        obstacle=obstacle,
        bcs=[fem.dirichletbc(data, dofs)],
    )
    problem.solve(rtol=1e-10)
    return problem


def wave_error(norm, dim, waves):
    """The norm of HEIGHT sin(w x) ... exp(-k z) on the cube, without what k z = k leaves."""
    w, rest, p = waves * math.pi, dim - 1, norm.p
    k = w * math.sqrt(rest)
    if norm.boundary:
        values = HEIGHT * 0.5 ** (rest / 2.0)
        return values * (1.0 + k**2) ** (norm.derivatives / 2.0)
    if dim > 2 and norm.derivatives and p == 2.0:
        return HEIGHT * w / math.sqrt(2.0 * k)
    if math.isinf(p):
        return HEIGHT * (k if norm.derivatives else 1.0)
    mean = np.mean(np.sin(np.arange(1000) * math.pi / 1000) ** p)
    parts, size = (2.0, w) if norm.derivatives else (1.0, 1.0)
    return HEIGHT * size * (parts * mean**rest / (p * k)) ** (1.0 / p)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(
    ("dim", "name"),
    [(2, name) for name in ("L1", "L2", "L4", "Linf", "H1", "W1_4", "W1_inf")]
    + [(3, "L2"), (3, "Linf"), (3, "H1")]
    + [(dim, name) for dim in (2, 3) for name in ("L2_boundary", "H1_2_boundary")],
)
def test_waves_of_the_obstacle_between_the_nodes(dim, name, degree, comm):
    """Both solutions are the same; the error is a wave that vanishes at the nodes of both."""
    n, wanted = CELLS[dim], target(name)
    domain = (mesh.create_unit_square if dim == 2 else mesh.create_unit_cube)(comm, *dim * [n])
    bottom = mesh.locate_entities_boundary(domain, dim - 1, lambda x: np.isclose(x[dim - 1], 0.0))
    sided = SidedMesh(domain, {"bottom": bottom})
    division, waves = refined(sided), 2 * n * degree
    coarse, fine = (solved(part, degree, waves) for part in (sided, division.sided))
    estimator = Estimator(coarse.space, wanted)
    solution = Solution(coarse.u, coarse.forces)
    estimator.compare(Solved(solution, fine, division.parents, wanted))
    error, most = wave_error(wanted.norm, dim, waves), {2: 2.4, 3: 4.0}[dim]
    assert estimator.found.difference <= 1e-5 * error <= error <= estimator.estimate <= most * error
    for problem in (coarse, fine):
        problem.destroy()


@pytest.mark.parametrize("name", ["L2_boundary", "H1_2_boundary"])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("share", [0.004, 0.01, 0.2, 0.5, 0.51, 0.993])
def test_a_kink_of_dirichlet_data_counts_wherever_it_is_on_a_facet(share, degree, name, comm):
    """The error is the distance of the data from their polynomial through the nodes."""
    domain, n = friedrichs_keller(comm, 6), 6
    space, place = fem.functionspace(domain, ("Lagrange", degree)), (2.0 + share) / n
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    top = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 1.0))
    problem = SignoriniProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        fem.Constant(domain, 0.0) * v * ufl.dx,
        contact=top,
        obstacle=-10.0,
        bcs=[dirichlet(space, bottom, abs(x[0] - place))],
    )
    problem.solve()
    wanted = target(name)
    found = total(data_defects(alone(problem, wanted), None)[1], wanted.power, comm)
    t, nodes = np.linspace(0.0, 1.0, 100_001), np.linspace(0.0, 1.0, degree + 1)
    through = np.polyfit(nodes, np.abs(nodes - share), degree)
    off = (np.abs(t - share) - np.polyval(through, t)) / n
    values, slopes = np.sqrt(np.mean(off**2) / n), np.sqrt(np.sum(np.diff(off) ** 2) / 1e-5 * n)
    exact = values if name == "L2_boundary" else np.sqrt(values * np.hypot(values, slopes))
    assert 0.85 * exact <= found <= 1.15 * exact
    problem.destroy()


def on_a_pin(sided, place, height):
    """A membrane that sags onto a floor with a pin, which large cells do not see."""
    space = fem.functionspace(sided.mesh, ("Lagrange", 2))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    top = fem.locate_dofs_topological(space, 1, sided.sides["top"])
    problem = SignoriniProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        -0.6 * v * ufl.dx,
        contact=sided.sides["bottom"],
        obstacle=lambda x: height * np.exp(-(((x[0] - place) / 0.01) ** 2)) - 0.3,
        bcs=[fem.dirichletbc(0.0, top, space)],
    )
    problem.solve(rtol=1e-10)
    return problem


@pytest.mark.parametrize("name", ["L1", "L2", "mean"])
@pytest.mark.parametrize("place", [0.29, 0.83])
def test_a_pin_between_the_nodes_lifts_the_whole_membrane(comm, place, name):
    """The error is the distance to the solution on a mesh whose cells are as small as the pin."""
    domain, sides = friedrichs_keller(comm, 4), {}
    for side, y in (("bottom", 0.0), ("top", 1.0)):
        there = mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y))
        sides[side] = there
    division = refined(SidedMesh(domain, sides))
    coarse, fine = (
        on_a_pin(part, place, 0.05) for part in (SidedMesh(domain, sides), division.sided)
    )
    error, sided = fine.u, division.sided
    for _ in range(4):
        step = refined(sided)
        space = fem.functionspace(step.sided.mesh, ("Lagrange", 2))
        error = Transfer(error.function_space, space, step.parents).prolong(error)
        sided = step.sided
    exact = on_a_pin(sided, place, 0.05)
    error.x.array[:] -= exact.u.x.array
    wanted = target(lambda v: v * ufl.dx) if name == "mean" else target(name)
    estimator = Estimator(coarse.space, wanted)
    solution = Solution(coarse.u, coarse.forces)
    estimator.compare(Solved(solution, fine, division.parents, wanted))
    assert 0.8 * size(error, wanted) <= estimator.estimate <= 1.3 * size(error, wanted)
    for problem in (coarse, fine, exact):
        problem.destroy()


@pytest.mark.parametrize("degree", [1, 2])
def test_waves_of_an_obstacle_in_the_domain_are_in_a_functional(comm, degree):
    """Where a membrane lies on its obstacle the error is the wave that the nodes do not see."""
    waves = 8 * degree
    sided = SidedMesh(friedrichs_keller(comm, 4), {})
    division = refined(sided)

    def wave(x):
        return HEIGHT * (np.sin(waves * np.pi * x[0]) * np.sin(waves * np.pi * x[1])) ** 2

    problems = []
    for domain in (sided.mesh, division.sided.mesh):
        space = fem.functionspace(domain, ("Lagrange", degree))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
        problem = ObstacleProblem(a + u * v * ufl.dx, -2.0 * v * ufl.dx, lower=wave)
        problem.solve(rtol=1e-10)
        problems.append(problem)
    coarse, fine = problems
    wanted = target(lambda v: v * ufl.dx)
    estimator = Estimator(coarse.space, wanted)
    solution = Solution(coarse.u, coarse.forces)
    estimator.compare(Solved(solution, fine, division.parents, wanted))
    assert 0.5 * HEIGHT / 4.0 <= estimator.estimate <= 4.0 * HEIGHT / 4.0
    for problem in problems:
        problem.destroy()


def pressed_window(sided, degree, place, width):
    """The solution x (1 - x) + y^2, held by the pressure 1 on a window of the lower side.

    Beside the window the obstacle falls like a roof, so that its kinks and the jumps of the
    pressure are where the window ends. Elements of degree 2 have the solution.
    """
    domain = sided.mesh
    space, x = bernstein_space(domain, degree), ufl.SpatialCoordinate(domain)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    low = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    others = np.setdiff1d(boundary_facets(domain), low).astype(np.int32)
    outside = abs(x[0] - place) - width
    pressure = ufl.conditional(outside < 0.0, 1.0, 0.0)
    roof = x[0] * (1.0 - x[0]) - ufl.conditional(outside < 0.0, 0.0, outside)
    ds = ufl.Measure("ds", domain, subdomain_data=[(1, facet_cells(domain, low).flatten())])
    return SignoriniProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        fem.Constant(domain, 0.0) * v * ufl.dx - pressure * v * ds(1),
        contact=low,
        obstacle=roof,
        bcs=[dirichlet(space, others, lambda x: x[0] * (1.0 - x[0]) + x[1] ** 2)],
    )


WINDOW = Known("", lambda x, y: x * (1.0 - x) + y**2, lambda x, y: (1.0 - 2.0 * x, 2.0 * y), {})


@pytest.mark.parametrize("norm", ["L1", "L2", "Linf", "H1"])
@pytest.mark.parametrize("place", [0.43, 0.4871])
def test_forces_over_gaps_are_the_error_where_nothing_else_is(comm, norm, place):
    """The solution is of degree 2: what is wrong is which coefficients are in contact."""
    domain = mesh.create_unit_square(comm, 20, 20)
    with data_in_pieces():  # the load jumps in facets
        problem = pressed_window(SidedMesh(domain, {}), 2, place, 0.11)
    problem.solve(rtol=1e-10)
    wanted = target(norm)
    parts = forces_over_gaps(alone(problem, wanted), None)[1]
    found = total(parts, wanted.power, comm)
    true = true_error(problem.u, WINDOW, norm)
    assert 0.5 * true <= found <= 8.0 * true  # some of the force is right
    problem.destroy()


@pytest.mark.parametrize("norm", ["L1", "L4"])
def test_a_window_that_ends_inside_of_facets(comm, norm):
    found = solve_adaptively(
        lambda sided: pressed_window(sided, 2, 0.4871, 0.11),
        SidedMesh(mesh.create_unit_square(comm, 5, 5), {}),
        norm=norm,
        accuracy=2e-6,
    )
    assert found.reached
    assert true_error(found.problem.u, WINDOW, norm) <= 2e-6
    found.problem.destroy()
