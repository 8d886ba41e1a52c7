"""Linear solves with held dofs: indefinite forms are found, direct methods are set up anew."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.contact import ContactProblem
from dolfinx_signorini.problem.elasticity import elasticity
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.solvers.linear.direct import DirectSolver
from dolfinx_signorini.solvers.linear.iterative import IterativeSolver

COMM = MPI.COMM_WORLD
DIRECT = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
PLAIN = {"pc_type": "jacobi"}


def make(n=16, comm=COMM, **options):
    """A loaded square over an obstacle on its whole boundary, with a coefficient to change."""
    domain = friedrichs_keller(comm, n)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    stiffness, weight = (fem.Constant(domain, 1.0) for _ in range(2))
    a = (stiffness * ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    L = weight * 40.0 * (0.35 - x[0] + 0.2 * x[1]) * v * ufl.dx
    problem = SignoriniProblem(a, L, contact=boundary_facets(domain), **options)
    return problem, stiffness, weight


@pytest.mark.parametrize(
    ("kind", "options", "comm"),
    [
        (IterativeSolver, {}, COMM),
        (IterativeSolver, PLAIN, COMM),
        (DirectSolver, {}, MPI.COMM_SELF),
    ],
    ids=["multigrid", "Jacobi", "Cholesky"],
)
def test_an_indefinite_form_is_found_by_conjugate_gradients(kind, options, comm):
    # All dofs at the boundary are held: between the eigenvalues 19.7 and 49.3 of -Laplace. Where
    # Cholesky factorizations fail, conjugate gradients take over.
    problem, _, _ = make(comm=comm)
    system = problem.system
    u, v = ufl.TrialFunction(problem.space), ufl.TestFunction(problem.space)
    shift = fem_petsc.assemble_matrix(fem.form(u * v * ufl.dx))
    shift.assemble()
    system.A.axpy(-36.0, shift)
    shift.destroy()
    solver, x = kind(system, options=options), system.start()
    with pytest.raises(InputError, match="form a: not positive definite, found by conjugate"):
        solver.solve(system, x, np.full(len(system.contact_dofs), True), 1e-12)
    for item in (solver, x, problem):
        item.destroy()


@pytest.mark.parametrize("size", [1.0, 1e5])
def test_a_linear_solve_reaches_the_residual_that_was_asked_for(size):
    problem, stiffness, _ = make(40)
    stiffness.value = size
    problem.update()
    system = problem.system
    held = np.arange(len(system.contact_dofs)) % 3 > 0
    for atol in (1e-3, 1e-6, 1e-10):
        solver, x = IterativeSolver(system), system.start()
        solver.solve(system, x, held, atol)
        residual = x.duplicate()
        system.A.mult(x, residual)
        residual.axpy(-1.0, system.b)
        residual.array_w[system.contact_dofs[held]] = 0.0
        assert residual.norm() <= atol * (1.0 + 1e-6)
        assert (x.array_r[system.contact_dofs[held]] == system.obstacle[held]).all()
        for item in (solver, x, residual):
            item.destroy()
    problem.destroy()


def test_held_dofs_are_at_the_obstacle_wherever_the_start_was():
    problem, _, _ = make(obstacle=0.25)
    system = problem.system
    solver, x = IterativeSolver(system), system.A.createVecRight()
    x.set(9.0)
    solver.solve(system, x, np.full(len(system.contact_dofs), True), 1e-9)
    assert (x.array_r[system.contact_dofs] == 0.25).all()
    for item in (solver, x):
        item.destroy()
    problem.destroy()


@pytest.mark.parametrize("change", ["nothing", "load", "stiffness"])
def test_a_direct_method_is_set_up_for_the_present_matrix_and_set(change):
    problem, stiffness, weight = make(petsc_options=DIRECT)
    problem.solve(rtol=1e-10)
    if change == "load":
        weight.value = 0.9
    if change == "stiffness":
        stiffness.value = 3.0
    u = problem.solve(rtol=1e-10).x.array.copy()
    # TAO has nothing to mend: each linear solve was exact.
    assert problem.result.iterations == 0
    assert problem.result.linear_solves <= 6
    fresh, other, load = make()
    other.value, load.value = stiffness.value, weight.value
    assert u == pytest.approx(fresh.solve(rtol=1e-10).x.array, abs=1e-8)
    for item in (problem, fresh):
        item.destroy()


@pytest.mark.parametrize("options", [{}, {"pc_type": "gamg"}])
def test_a_set_that_differs_a_little_costs_hardly_an_iteration_more(options):
    """Geometric multigrid is set up again, and algebraic multigrid serves both sets."""
    problem, _, _ = make(60)
    system, counts = problem.system, []
    held = np.full(len(system.contact_dofs), True)
    released = held.copy()
    released[:: max(len(held) // (8 // COMM.size), 1)] = False
    for first in (held, released):
        solver, x = IterativeSolver(system, options=options), system.start()
        solver.solve(system, x, first, 1e-8)
        before, _ = solver.iterations, x.set(0.0)
        solver.solve(system, x, released, 1e-8)
        assert solver.setups == (1 if options or first is released else 2)
        counts.append(solver.iterations - before)
        for item in (solver, x):
            item.destroy()
    problem.destroy()
    assert counts[0] <= counts[1] + 2


@pytest.mark.parametrize(
    "options",
    [
        {"pc_type": "gamg", "mg_levels_ksp_type": "richardson"},
        {"mg_levels_ksp_max_it": 4},  # of the multigrid on coarser meshes
    ],
)
def test_every_set_up_reads_the_options(options, caplog):
    """Levels that are made anew, with other held dofs, have the options, too."""
    problem, _, _ = make(48)
    system, counts = problem.system, []
    held = np.full(len(system.contact_dofs), True)
    for chosen in ({}, options):
        solver, before = IterativeSolver(system, "levels_", chosen), 0
        for _ in range(2):
            x = system.start()
            solver.solve(system, x, held, 1e-9)
            counts.append(solver.iterations - before)
            before = solver.iterations
            solver.free()
            x.destroy()
        assert solver.setups == 2
        solver.destroy()
    problem.destroy()
    assert counts[0] == counts[1] != counts[2] == counts[3]
    assert caplog.messages == []


@pytest.mark.parametrize("dimension,degree,vectors", [(2, 3, False), (2, 3, True), (3, 1, True)])
def test_iterations_do_not_feel_the_unit_of_the_form(dimension, degree, vectors):
    """PETSc's sweeps over nodes of several dofs take entries below 2e-14 for zeros."""
    cells = [(17, 17), (4, 4, 4)][dimension - 2]
    create = [mesh.create_unit_square, mesh.create_unit_cube][dimension - 2]
    domain = create(COMM, *cells)
    shape = ((dimension,),) if vectors else ()
    space = fem.functionspace(domain, ("Lagrange", degree, *shape))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    last = dimension - 1
    below = mesh.locate_entities_boundary(domain, last, lambda x: np.isclose(x[last], 0.0))
    above = mesh.locate_entities_boundary(domain, last, lambda x: np.isclose(x[last], 1.0))
    held = fem.locate_dofs_topological(space, last, above)
    counts = []
    for unit in (1.0, 2.0**-50, 2.0**-100):
        young = fem.Constant(domain, unit)
        if vectors:
            a = elasticity(u, v, young=young, poisson=0.3)
            L = ufl.inner(young * ufl.as_vector([0.0] * last + [-1.0]), v) * ufl.dx
            bc = fem.dirichletbc(np.zeros(dimension), held, space)
            problem = ContactProblem(a, L, contact=below, gap=0.1, bcs=[bc])
        else:
            a = young * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
            bc = fem.dirichletbc(0.0, held, space)
            problem = SignoriniProblem(
                a, -young * v * ufl.dx, contact=below, obstacle=-0.1, bcs=[bc]
            )
        system = problem.system
        solver, x = IterativeSolver(system), system.start()
        solver.solve(
            system, x, np.zeros(len(system.contact_dofs), dtype=bool), 1e-9 * system.b.norm()
        )
        counts.append(solver.iterations)
        for item in (solver, x):
            item.destroy()
        problem.destroy()
    assert counts[0] < 40 and counts == [counts[0]] * 3
