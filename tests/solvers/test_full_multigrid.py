"""Starts from all coarser meshes, and the rough steps that follow in the domain."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini import (
    ContactProblem,
    ObstacleProblem,
    SignoriniProblem,
    bernstein_space,
    elasticity,
)
from dolfinx_signorini.meshes.box_meshes import box_mesh, friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.dirichlet import dirichlet
from dolfinx_signorini.solvers.full_multigrid import full_multigrid, levels_of
from dolfinx_signorini.solvers.linear.iterative import IterativeSolver
from dolfinx_signorini.solvers.residual import NaturalResidual
from dolfinx_signorini.solvers.rough_steps import Sweep, swept

COMM = MPI.COMM_WORLD
RTOL = 1e-9


def lower(x):
    return 0.1 * np.cos(9.0 * x[0]) * np.sin(7.0 * x[1] + 1.0) - 0.12


def upper(x):
    return 0.05 + 0.05 * x[0]


def posed(space, two_sided=False, load=-2.0):
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(space.mesh)
    stiffness = (1.0 + x[0]) * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    f = load * (10.0 - 30.0 * x[1] if two_sided else 1.0)
    return ObstacleProblem(
        stiffness,
        f * v * ufl.dx,
        lower=lower,
        upper=upper if two_sided else None,
        bcs=[dirichlet(space, boundary_facets(space.mesh), 0.0)],
    )


def squares(n):
    return mesh.create_rectangle(
        COMM, [[0.0, 0.0], [1.0, 1.0]], [n, n], mesh.CellType.quadrilateral
    )


def cubes(n, kind=mesh.CellType.tetrahedron):
    return mesh.create_unit_cube(COMM, n, n, n, kind)


def energy(system, x):
    force = x.duplicate()
    system.A.mult(x, force)
    value = 0.5 * x.dot(force) - x.dot(system.b)
    force.destroy()
    return value


def linear(domain):
    return fem.functionspace(domain, ("Lagrange", 1))


def block(dimension, degree, axis, side, cells):
    """A block that lies with one side on a paraboloid, and whose opposite side is moved there."""
    domain = box_mesh(COMM, [np.linspace(0.0, 1.0, cells + 1)] * dimension)
    space = fem.functionspace(domain, ("Lagrange", degree, (dimension,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    fixed, contact = (
        mesh.locate_entities_boundary(domain, dimension - 1, lambda x, z=z: np.isclose(x[axis], z))
        for z in (1.0 - side, side)
    )
    down = np.zeros(dimension)
    down[axis] = 0.02 * np.sign(side - 0.5)
    others = [k for k in range(dimension) if k != axis]
    bc = fem.dirichletbc(down, fem.locate_dofs_topological(space, dimension - 1, fixed), space)
    return ContactProblem(
        elasticity(u, v, young=200.0, poisson=0.3),
        ufl.inner(fem.Constant(domain, 10.0 * down), v) * ufl.dx,
        contact=contact,
        gap=lambda x: 0.2 * ((x[others] - 0.45) ** 2).sum(axis=0),
        bcs=[bc],
    )


@pytest.mark.parametrize("kind", ["one-sided", "two-sided", "body"])
def test_cycles_lower_the_energy_within_the_bounds(kind):
    if kind == "body":
        problem = block(2, 1, 1, 0.0, 48)
    else:
        problem = posed(linear(friedrichs_keller(COMM, 72)), kind == "two-sided")
    system = problem.system
    solver, measure = IterativeSolver(system, "cycles_", {}), NaturalResidual(system)
    x = system.start()
    residuals, energies = [measure(x)], [energy(system, x)]
    assert full_multigrid(system, solver.multigrid, x) is not None
    levels = levels_of(system, solver.multigrid)
    for step in range(12):
        for _ in range(2 if step else 0):
            levels[0].cycle(x, levels[1:])
        below, above = (
            np.sign(k) * (x.array_r - b) for k, b in zip((1, -1), system.bounds, strict=True)
        )
        assert min(below.min(initial=0.0), above.min(initial=0.0)) >= 0.0
        residuals.append(measure(x))
        energies.append(energy(system, x))
    assert (np.diff(energies) <= 1e-12 * abs(energies[-1])).all()
    assert residuals[1] < 0.2 * residuals[0] and residuals[-1] < 0.2 * residuals[1]
    for level in levels:
        level.free()
    for item in (solver, measure, x, problem):
        item.destroy()


def test_a_sweep_never_raises_the_energy_and_holds_what_is_at_the_bounds():
    problem = posed(linear(friedrichs_keller(COMM, 60)))
    system = problem.system
    measure, x = NaturalResidual(system), system.start()
    before = energy(system, x)
    for kind in ("forward", "backward") * 3:
        measure(x)
        held = swept(system, kind, x, measure.multiplier)
        assert (held == (x.array_r[system.contact_dofs] <= system.obstacle)).all()
        after = energy(system, x)
        assert after < before
        before = after
    for item in (measure, x, problem):
        item.destroy()


@pytest.mark.parametrize("wrong", [False, True])
def test_a_sweep_ends_the_linear_solve_of_a_wrong_set_alone(wrong):
    problem = posed(linear(friedrichs_keller(COMM, 60)))
    problem.solve(rtol=1e-12)
    system, x = problem.system, problem.system.vector_of(problem.u)
    solver, measure = IterativeSolver(system, "sweep_", {}), NaturalResidual(system)
    right = system.touching_once(x)
    held = right & (not wrong)
    x.array_w[~np.isin(np.arange(len(x.array_r)), system.contact_dofs[right])] += 1e-6
    system.project(x)
    atol = 1e-9 * measure.scale
    sweep = Sweep(measure, x, held, "backward")
    solver.solve(system, x, held, atol, check=sweep.enough)
    assert sweep.changed == wrong
    found, residual = sweep.take(), x.duplicate()
    system.set_forces(x, residual)
    residual.array_w[system.known_dofs(held)] = 0.0
    if wrong:
        assert solver.iterations == 1 and residual.norm() > atol
        assert COMM.allreduce(int((found != held).sum())) > 0
    else:
        assert solver.iterations > 1 and residual.norm() <= atol
        assert (found == held).all()
    for item in (solver, measure, x, residual, problem):
        item.destroy()


SPACES = {
    "triangles": lambda: linear(friedrichs_keller(COMM, 80)),
    "squares": lambda: linear(squares(80)),
    "tetrahedra": lambda: linear(cubes(17)),
    "cubes": lambda: linear(cubes(17, mesh.CellType.hexahedron)),
    "degree 2": lambda: fem.functionspace(friedrichs_keller(COMM, 40), ("Lagrange", 2)),
    "degree 3": lambda: fem.functionspace(friedrichs_keller(COMM, 27), ("Lagrange", 3)),
    "degree 4": lambda: fem.functionspace(friedrichs_keller(COMM, 20), ("Lagrange", 4)),
    "Bernstein 2": lambda: bernstein_space(friedrichs_keller(COMM, 40), 2),
    "Bernstein 3": lambda: bernstein_space(friedrichs_keller(COMM, 27), 3),
    "Bernstein 4": lambda: bernstein_space(friedrichs_keller(COMM, 20), 4),
}


@pytest.mark.parametrize("two_sided", [False, True])
@pytest.mark.parametrize("name", SPACES)
def test_from_nothing_to_the_solution_in_few_iterations(name, two_sided):
    problem = posed(SPACES[name](), two_sided)
    problem.solve(rtol=RTOL)
    system, result = problem.system, problem.result
    x = system.vector_of(problem.u)
    force = x.duplicate()
    system.A.mult(x, force)
    force.axpy(-1.0, system.b)
    low, high = system.bounds
    values, forces = x.array_r, force.array_r
    free = np.ones(len(values), dtype=bool)
    free[system.fixed_dofs] = False
    assert (low <= values).all() and (values <= high).all()
    inside = free & (low < values) & (values < high)
    pulled = np.where(values <= low, np.minimum(forces, 0.0), np.maximum(forces, 0.0))
    wrong = np.where(inside, forces, np.where(free & (low < high), pulled, 0.0))
    load = system.b.array_r[free]
    scale = np.sqrt(COMM.allreduce(float(load @ load) + float(forces[free] @ forces[free])))
    assert np.sqrt(COMM.allreduce(float(wrong @ wrong))) <= 2.0 * RTOL * scale
    assert "multigrid" in result.preconditioner and result.iterations == 0
    assert 0 < COMM.allreduce(len(problem.active)) < problem.unknowns
    assert result.linear_iterations <= 40 and result.linear_solves <= 3
    for item in (x, force, problem):
        item.destroy()


@pytest.mark.parametrize("n, degree", [(300, 1), (1000, 1), (4001, 1), (300, 2), (2000, 2)])
@pytest.mark.parametrize("growth", [0.01, 3.0])
def test_a_string_on_a_flat_obstacle_takes_no_more_solves_with_more_dofs(n, degree, growth):
    """A parabola from each end to the obstacle: u = load (x - a)^2 / 2 - depth below a."""
    load, depth = 8.0, 0.1
    domain = mesh.create_interval(COMM, n, (0.0, 1.0))
    domain.geometry.x[:, 0] = np.expm1(growth * domain.geometry.x[:, 0]) / np.expm1(growth)
    space = fem.functionspace(domain, ("Lagrange", degree))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    a, L = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, -load * v * ufl.dx
    ends = [dirichlet(space, boundary_facets(domain), 0.0)]
    problem = ObstacleProblem(a, L, lower=-depth, bcs=ends)
    found, x = problem.solve().x.array, space.tabulate_dof_coordinates()[:, 0]
    last = np.sqrt(2.0 * depth / load)
    from_end = np.minimum(x, 1.0 - x)
    exact = 0.5 * load * np.minimum(from_end - last, 0.0) ** 2 - depth
    h = growth * (1.0 / np.expm1(growth) + 1.0) / n  # of the widest cell
    assert np.abs(found - exact).max(initial=0.0) <= load * h**2
    contact = from_end[problem.active]
    assert abs(COMM.allreduce(contact.min(initial=1.0), MPI.MIN) - last) <= h
    assert problem.result.linear_solves <= 4
    problem.destroy()


def test_the_next_step_of_a_loop_starts_from_the_last_ones():
    problem = posed(linear(friedrichs_keller(COMM, 80)))
    problem.solve(rtol=RTOL)
    first = problem.result.linear_iterations
    problem.solve(rtol=RTOL)
    assert problem.result.linear_iterations == 0 < first
    problem.destroy()


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("basis", ["Lagrange", "Bernstein"])
def test_contact_on_the_boundary_starts_near_its_set_in_every_degree(degree, basis):
    """The set is that of Newton's method, which starts from nothing, and few dofs are wrong."""
    domain = friedrichs_keller(COMM, 96 // degree + 24)
    space = (
        bernstein_space(domain, degree)
        if basis == "Bernstein"
        else fem.functionspace(domain, ("Lagrange", degree))
    )
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    form = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    load = (50.0 * ufl.sin(20.0 * x[0]) * ufl.cos(17.0 * x[1]) - 1.0) * v * ufl.dx
    problem = SignoriniProblem(form, load, contact=boundary_facets(domain), obstacle=0.0)
    solution = problem.solve(rtol=RTOL).x.array.copy()
    assert problem.result.linear_solves <= 4 and problem.result.linear_iterations <= 18
    newton = problem.solve("bntr", rtol=RTOL, warm_start=False).x.array
    assert solution == pytest.approx(newton, abs=1e-6 * abs(newton).max())
    problem.destroy()


@pytest.mark.parametrize(
    ("dimension", "degree", "axis", "side"),
    [
        (2, 1, 1, 0.0),
        (2, 1, 0, 1.0),
        (2, 2, 1, 1.0),
        (3, 1, 2, 0.0),
        (3, 1, 1, 1.0),
        (3, 2, 0, 0.0),
    ],
)
def test_a_body_on_a_side_of_a_box_starts_near_its_set(dimension, degree, axis, side):
    """Whatever the sign and the component of the direction are, also where weights are zero.

    With all dofs held at first, six or seven linear solves are needed.
    """
    cells = {2: 64, 3: 10}[dimension] // degree
    problem = block(dimension, degree, axis, side, cells)
    solution = problem.solve(rtol=RTOL).x.array.copy()
    assert problem.result.linear_solves <= 4
    assert 0 < problem.result.active_dofs < COMM.allreduce(len(problem.system.contact_dofs))
    newton = problem.solve("bntr", rtol=RTOL, warm_start=False).x.array
    assert solution == pytest.approx(newton, abs=1e-6 * abs(newton).max())
    problem.destroy()


@pytest.mark.parametrize(
    ("kind", "c", "width", "size", "weight", "upper", "keeps", "speed"),
    [
        ("triangle", 1.49, 79.0, 12.5, 0.198, None, False, 0.0174),
        ("quadrilateral", 0.0212, 4.94, 1.14, 0.104, 1.0, True, 0.00892),
    ],
)
def test_sets_that_move_far_take_no_more_iterations_than_others(
    kind, c, width, size, weight, upper, keeps, speed, comm
):
    """Active sets that shrink by one layer of dofs in a solve would take 46 iterations, or 80."""
    domain = mesh.create_unit_square(comm, 128, 128, mesh.CellType[kind])
    V = fem.functionspace(domain, ("Lagrange", 1))
    u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(domain)
    strength, place = fem.Constant(domain, 0.0), fem.Constant(domain, (0.5, 0.5))
    load = strength * ufl.exp(-width * ufl.inner(x - place, x - place)) - weight
    lower = fem.Function(V)
    more = {} if upper is None else {"upper": upper}
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + c * u * v) * ufl.dx
    problem = ObstacleProblem(a, load * v * ufl.dx, lower=lower, **more)
    for step in range(6):
        strength.value = size * np.sin(3.0 * speed * (step + 1) + 0.3)
        place.value[:] = 0.5 + 0.3 * np.cos(speed * step * np.array([1.0, 2.0]))
        if keeps:
            lower.x.array[:] = np.minimum(problem.u.x.array, 0.9)
        problem.solve()
        assert problem.result.linear_iterations <= 30
    problem.destroy()
