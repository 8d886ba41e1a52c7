"""The primal-dual active set method: its short cuts, and what holds without them."""

from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.contact import ContactProblem
from dolfinx_signorini.problem.elasticity import elasticity
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.solvers import active_set
from dolfinx_signorini.solvers.active_set import solve_active_set
from dolfinx_signorini.solvers.linear.iterative import IterativeSolver
from dolfinx_signorini.solvers.residual import NaturalResidual
from dolfinx_signorini.studies.paper.solution import christof_haubner, paper_problem

COMM = MPI.COMM_WORLD
RTOL = 1e-9


def make(n, reaction, load, obstacle):
    """A problem on the unit square with contact everywhere; load and obstacle of (3, n)."""
    domain = friedrichs_keller(COMM, n)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + reaction * u * v) * ufl.dx
    L = load(x) * v * ufl.dx(metadata={"quadrature_degree": 3})
    return SignoriniProblem(a, L, contact=boundary_facets(domain), obstacle=obstacle)


@pytest.fixture
def pressed():
    problem = make(60, 1.0, lambda x: 40.0 * (0.35 - x[0] + 0.2 * x[1]), 0.0)
    yield problem
    problem.destroy()


def solution(problem):
    """The active set and the owned values of the solution, by TAO alone."""
    values = problem.solve("bntr", rtol=1e-12).x.array[: problem.b.getLocalSize()].copy()
    dofs = problem.contact_dofs
    return values[dofs] == problem.obstacle, values


def run(problem, held, predicted):
    """Run the method from a guess; return solver, values, and the residual that it reached."""
    system = problem.system
    solver, measure = IterativeSolver(system), NaturalResidual(system, RTOL)
    x = system.start()
    residual = solve_active_set(system, solver, measure, x, held, RTOL, predicted)
    values = x.array_r.copy()
    for item in (solver, measure, x):
        item.destroy()
    return solver, values, residual


def largest(values):
    return COMM.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX)


def test_the_right_set_takes_one_solve_and_one_off_by_a_dof_few_iterations_more(pressed):
    held, values = solution(pressed)
    solver, found, residual = run(pressed, held, True)
    assert residual <= RTOL
    assert largest(found - values) <= 1e-7 * largest(values)
    assert (solver.solves, solver.setups) == (1, 1)
    once = solver.iterations
    assert once > 5
    # Release the dof that is pressed most.
    x = pressed.system.start(values)
    measure = NaturalResidual(pressed.system)
    measure(x)
    pressure = measure.multiplier.array_r[pressed.contact_dofs]
    wrong = held & (pressure != COMM.allreduce(float(pressure.max(initial=0.0)), op=MPI.MAX))
    measure.destroy()
    x.destroy()
    assert COMM.allreduce(int((wrong != held).sum())) == 1
    solver, found, residual = run(pressed, wrong, True)
    assert residual <= RTOL
    assert largest(found - values) <= 1e-7 * largest(values)
    assert ((found[pressed.contact_dofs] == pressed.obstacle) == held).all()
    assert (solver.solves, solver.setups) == (2, 2)
    assert solver.iterations < 1.4 * once  # the set was mended before the end of a solve


def test_ends_that_reach_too_far_are_released_together(pressed):
    """Each linear solve without a local correction releases a dof or two at an end."""
    held, values = solution(pressed)
    gap = values[pressed.contact_dofs] - pressed.obstacle
    gaps = np.sort(np.concatenate(COMM.allgather(gap[~held])))
    wrong = held | (gap <= gaps[11])
    assert COMM.allreduce(int((wrong != held).sum())) == 12
    solver, found, residual = run(pressed, wrong, True)
    assert residual <= RTOL
    assert ((found[pressed.contact_dofs] == pressed.obstacle) == held).all()
    assert solver.solves <= 4


def test_what_a_solve_to_few_digits_leaves_is_no_news_of_the_set(monkeypatch):
    """On most of the paper's boundary u and its flux vanish: any error changes signs there."""
    problem = paper_problem(christof_haubner(friedrichs_keller(COMM, 60)))
    held, values = solution(problem)
    enough, checked = active_set.Probe.enough, []

    def rough(probe, correction, iteration, norm, unit):
        """The iterate with an error as large as the residual of the linear solve allows."""
        sign = correction.copy()
        sign.array_w[:] = (-1.0) ** np.arange(correction.getLocalSize())
        sign.array_w[problem.contact_dofs[held]] = 0.0
        sign.scale(norm / 8.0 / sign.norm())
        sign.axpy(1.0, correction)
        checked.append(iteration)
        ended = enough(probe, sign, iteration, norm, unit)
        sign.destroy()
        return ended

    monkeypatch.setattr(active_set.Probe, "enough", rough)
    solver, found, residual = run(problem, held, True)
    problem.destroy()
    assert len(checked) > 5 and residual <= RTOL
    assert solver.solves == 1
    assert largest(found - values) <= 1e-6 * largest(values)


def test_corrections_that_lead_nowhere_are_given_up(pressed, monkeypatch):
    """A local correction that always turns the set around would go on for ever."""
    monkeypatch.setattr(
        active_set,
        "_correct_locally",
        lambda measure, x, held: ~held,
    )
    held, values = solution(pressed)
    _, found, residual = run(pressed, ~held, False)
    assert residual <= RTOL
    assert largest(found - values) <= 1e-7 * largest(values)


@pytest.mark.parametrize("size", [1.0, 1e-18])
def test_without_reaction_some_dof_is_always_held(size, monkeypatch):
    """However small a load is: it is borne where the body, flat by then, touches the obstacle."""
    summit, counts = 2.0, []
    solve = IterativeSolver.solve

    def counted(solver, system, x, held, *target):
        counts.append(COMM.allreduce(int(held.sum())))
        solve(solver, system, x, held, *target)

    monkeypatch.setattr(IterativeSolver, "solve", counted)

    def obstacle(x):
        return summit - (x[0] - 0.5) ** 2 - (x[1] - 1.0) ** 2  # a node is at the summit

    problem = make(20, 0.0, lambda x: -size + 0.0 * x[0], obstacle)
    _, values, residual = run(problem, np.zeros(len(problem.contact_dofs), dtype=bool), False)
    touching = values[problem.contact_dofs] <= problem.obstacle
    problem.destroy()
    assert residual <= RTOL
    assert COMM.allreduce(int(touching.sum())) >= 1
    assert counts[0] == min(counts) == 1  # the summit alone, to begin with
    if size < 1e-10:
        assert largest(values - summit) <= 1e-12


@pytest.mark.parametrize("offset", [-1e-12, 1e-12])
def test_what_is_accepted_at_once_gets_its_contact_exactly(offset, comm):
    """The start has the residual already, and is off the obstacle by rounding."""
    domain = friedrichs_keller(comm, 8)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    load = -fem.Constant(domain, 1.0) * v * ufl.dx
    problem = SignoriniProblem(a, load, contact=boundary_facets(domain), obstacle=-0.1)
    problem.solve(rtol=1e-12)
    system = problem.system
    x, solver = system.vector_of(problem.u), IterativeSolver(system)
    held, measure = system.touching(x), NaturalResidual(system, 1e-7)
    x.shift(offset)
    assert solve_active_set(system, solver, measure, x, held, 1e-7) <= 1e-7
    assert solver.solves == 0 and comm.allreduce(int(held.sum())) > 0
    assert np.array_equal(x.array_r[system.contact_dofs[held]], system.obstacle[held])
    for item in (x, solver, measure, problem):
        item.destroy()


def two_sided():
    """Two obstacles on the boundary, and Dirichlet data on a side."""
    domain = friedrichs_keller(COMM, 60)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    top = fem.locate_dofs_geometrical(space, lambda x: np.isclose(x[1], 1.0))
    return SignoriniProblem(
        (1.0 + x[0]) * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        40.0 * (x[0] - 0.5) * v * ufl.dx,
        contact=boundary_facets(domain),
        lower=-0.01,
        upper=0.01,
        bcs=[fem.dirichletbc(0.005, top, space)],
    )


def body():
    """A block that is held above and pressed against a curved obstacle."""
    domain = friedrichs_keller(COMM, 48)
    space = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    top = fem.locate_dofs_geometrical(space, lambda x: np.isclose(x[1], 1.0))
    below = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    return ContactProblem(
        elasticity(u, v, 100.0, 0.3),
        ufl.inner(fem.Constant(domain, (0.0, -1.0)), v) * ufl.dx,
        contact=below,
        gap=lambda x: 0.1 * (x[0] - 0.4) ** 2 - 0.02,
        direction=(0.1, -1.0),
        bcs=[fem.dirichletbc(np.zeros(2), top, space)],
    )


@pytest.mark.parametrize("make", [two_sided, body])
def test_the_forces_at_iterates_are_those_of_the_whole_matrix(make):
    """What a solve knows away from the contact dofs, and rows at these dofs: A x - b."""
    problem = make()
    problem.solve()
    system, seen = problem.system, []
    solver, x = IterativeSolver(system), system.start()
    held = np.arange(len(system.contact_dofs)) % 3 == 0
    held[len(system.layout.free_dofs) :] = False
    found, wanted = system.A.createVecLeft(), system.A.createVecLeft()

    def check(correction, number, norm, unit):
        iterate = x.copy()
        iterate.axpy(unit, correction)
        solver.multiply(system, iterate, found)
        system.A.mult(iterate, wanted)
        wanted.axpy(-1.0, system.b)
        size = wanted.norm(PETSc.NormType.INFINITY)
        wanted.axpy(-1.0, found)
        seen.append(wanted.norm(PETSc.NormType.INFINITY) / size)
        iterate.destroy()
        return False

    for _ in range(2):
        solver.solve(system, x, held, 1e-9, check=check)
        system.A.scale(2.0)  # another matrix, as after an assembly
        system.b.scale(2.0)
        system = replace(system, assembled=system.assembled + 1)
        x.set(0.0)
        system.project(x)
    assert len(seen) > 10 and max(seen) <= 1e-12, seen
    for item in (solver, x, found, wanted, problem):
        item.destroy()
