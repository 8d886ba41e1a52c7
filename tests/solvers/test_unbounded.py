"""Energies without a lower bound: functions without energy on which the load does work."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.solvers.active_set import solve_active_set
from dolfinx_signorini.solvers.linear.iterative import IterativeSolver
from dolfinx_signorini.solvers.residual import NaturalResidual
from dolfinx_signorini.solvers.unbounded import falls_for_ever


@pytest.mark.parametrize(("direction", "falls"), [(1.0, True), (-1.0, False)])
def test_a_fall_that_the_obstacle_stops_has_an_end(direction, falls):
    """A form that vanishes on constants: up they fall for ever, and down to the obstacle."""
    domain = friedrichs_keller(MPI.COMM_WORLD, 4)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    a, L = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, -fem.Constant(domain, 1.0) * v * ufl.dx
    problem = SignoriniProblem(a, L, contact=boundary_facets(domain))
    constant = problem.system.start()
    constant.set(direction)
    diagonal = problem.A.getDiagonal()
    assert falls_for_ever(problem.system, constant, 0.0, 1.0, diagonal.array_r) == falls
    for item in (constant, diagonal, problem):
        item.destroy()


def test_active_sets_do_not_begin_anew_on_an_energy_without_a_bound():
    """A rule of one point leaves functions of degree 2 without energy: iterates grow and grow."""
    domain = friedrichs_keller(MPI.COMM_WORLD, 30)
    space = fem.functionspace(domain, ("Lagrange", 2))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx(degree=0)
    load = -fem.Constant(domain, 1.0) * v * ufl.dx
    problem = SignoriniProblem(a, load, contact=bottom, obstacle=-0.1)
    system, rtol = problem.system, 1e-7
    solver, measure = IterativeSolver(system), NaturalResidual(system, rtol)
    x, held = system.start(), np.full(len(system.contact_dofs), True)
    with pytest.raises(InputError, match="unbounded below"):
        solve_active_set(system, solver, measure, x, held, rtol)
    for item in (x, solver, measure, problem):
        item.destroy()
