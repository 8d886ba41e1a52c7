"""Direct solves of small problems, against dense linear algebra."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.solvers.linear.direct import DirectSolver, is_small, linear_solver
from dolfinx_signorini.solvers.linear.iterative import IterativeSolver

COMM = MPI.COMM_SELF  # small problems are direct on one rank; here each rank has its own


def make(n=6, domain=None, **options):
    """A square with Dirichlet data on the left, above an obstacle, and a coefficient to change."""
    domain = friedrichs_keller(COMM, n) if domain is None else domain
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    c = fem.Constant(domain, 1.0)
    left = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], 0.0))
    bc = fem.dirichletbc(0.4, fem.locate_dofs_topological(space, 1, left), space)
    a = (c * ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    L = (x[1] - 30.0 * x[0]) * v * ufl.dx
    sides = dict(contact=boundary_facets(domain), obstacle=-0.25, bcs=[bc])
    return SignoriniProblem(a, L, **sides, **options), c


def dense(system, held):
    """The solution with some dofs held, by NumPy."""
    size = system.A.getSize()
    A, b = system.A.getValues(range(size[0]), range(size[1])), system.b.array_r
    x, free = np.zeros(size[0]), np.full(size[0], True)
    dofs = system.contact_dofs[held]
    x[dofs], free[dofs] = system.obstacle[held], False
    x[free] = np.linalg.solve(A[np.ix_(free, free)], (b - A @ x)[free])
    return x


def test_a_solve_is_exact_for_each_set_and_each_matrix():
    problem, c = make()
    solver, x = DirectSolver(problem.system), problem.system.start()
    every = np.arange(len(problem.system.contact_dofs))
    setups = []
    for held, stiffness in ((every % 2 > 0, 1.0), (every % 3 > 0, 1.0), (every % 3 > 0, 7.0)):
        c.value = stiffness
        problem.update()
        for _ in range(2):
            solver.solve(problem.system, x, held, 1e-3)
            assert x.array_r == pytest.approx(dense(problem.system, held), abs=1e-13)
            setups.append(solver.setups)
    assert setups == [1, 1, 2, 2, 3, 3]
    for item in (solver, x, problem):
        item.destroy()


def test_who_sets_options_of_the_linear_solver_gets_the_solver_that_takes_them():
    problem, _ = make(4)
    for options, kind in (({}, DirectSolver), ({"tao_max_it": 3}, DirectSolver)):
        assert type(linear_solver(problem.system, "p_", options)) is kind
    assert type(linear_solver(problem.system, "p_", {"ksp_rtol": 1e-3})) is IterativeSolver
    shared, _ = make(domain=friedrichs_keller(MPI.COMM_WORLD, 4))
    large, _ = make(60)
    assert is_small(shared.system) == (MPI.COMM_WORLD.size == 1)
    assert is_small(problem.system) and not is_small(large.system)
    for item in (problem, shared, large):
        item.destroy()


def test_a_small_problem_takes_no_step_of_tao_and_has_the_solution_of_the_iterative_solver():
    problem, _ = make(20)
    other, _ = make(20, petsc_options={"ksp_type": "cg"})
    u = problem.solve(rtol=1e-12)
    assert problem.result.iterations == 0
    assert u.x.array == pytest.approx(other.solve(rtol=1e-12).x.array, abs=1e-11)
    for item in (problem, other):
        item.destroy()
