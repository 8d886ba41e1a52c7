"""TAO accepts without a step what the active set method ends with, wherever that starts."""

import numpy as np
import pytest
from mpi4py import MPI

from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.solvers.active_set import solve_active_set
from dolfinx_signorini.solvers.linear.iterative import IterativeSolver
from dolfinx_signorini.solvers.patch import MAX_STEPS
from dolfinx_signorini.solvers.residual import NaturalResidual
from dolfinx_signorini.studies.paper.solution import christof_haubner, paper_problem

COMM = MPI.COMM_WORLD


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("n", [11, 30])
def test_each_tightening_is_done_by_linear_solves_alone(n, degree):
    problem = paper_problem(christof_haubner(friedrichs_keller(COMM, n)), degree)
    rtol, solves = 1e-3, 0
    while rtol > 1e-11:
        problem.solve(rtol=rtol)
        result = problem.result
        assert result.natural_residual <= rtol
        assert result.iterations == 0  # of TAO
        solves += result.linear_solves
        rtol = 0.5 * result.natural_residual  # the start is off by a factor of two
    problem.destroy()
    assert solves > 4


@pytest.mark.parametrize("n", [11, 30])
def test_a_solution_is_not_solved_for_again(n):
    problem = paper_problem(christof_haubner(friedrichs_keller(COMM, n)))
    first = problem.solve(rtol=1e-8).x.array.copy()
    again = problem.solve(rtol=1e-8)
    result = problem.result
    assert (result.iterations, result.linear_solves, result.linear_iterations) == (0, 0, 0)
    assert (again.x.array == first).all()
    problem.destroy()


@pytest.mark.parametrize("n", [11, 30])
def test_a_residual_below_rounding_ends_the_iteration_when_a_set_comes_back(n):
    problem = paper_problem(christof_haubner(friedrichs_keller(COMM, n)))
    system, rtol = problem.system, 1e-19
    solver, measure, x = IterativeSolver(system), NaturalResidual(system, rtol), system.start()
    held = np.full(len(system.contact_dofs), True)
    residual = solve_active_set(system, solver, measure, x, held, rtol)
    assert rtol < residual <= 1e-13
    assert solver.solves <= MAX_STEPS // 2
    for item in (solver, measure, x):
        item.destroy()
    problem.destroy()
