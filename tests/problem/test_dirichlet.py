"""Dirichlet conditions: the last one wins, and their rows have the unit of the form."""

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.problem.signorini import SignoriniProblem

COMM = MPI.COMM_WORLD


def make(factor=1.0, order=(0, 1)):
    """Contact at the bottom; 2 on the left and 3 at the top, both at the upper left corner."""
    domain = friedrichs_keller(COMM, 6)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)

    def on(axis, place):
        return dolfinx.mesh.locate_entities_boundary(
            domain, 1, lambda x: np.isclose(x[axis], place)
        )

    bcs = [
        fem.dirichletbc(value, fem.locate_dofs_topological(space, 1, facets), space)
        for value, facets in ((2.0, on(0, 0.0)), (3.0, on(1, 1.0)))
    ]
    form = factor * (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    L = fem.Constant(domain, -factor) * v * ufl.dx
    return SignoriniProblem(form, L, contact=on(1, 0.0), bcs=[bcs[i] for i in order])


@pytest.mark.parametrize(("order", "value"), [((0, 1), 3.0), ((1, 0), 2.0)])
def test_where_two_conditions_meet_the_last_one_wins(order, value):
    problem = make(order=order)
    u = problem.solve()
    x = problem.space.tabulate_dof_coordinates()
    corner = np.isclose(x[:, 0], 0.0) & np.isclose(x[:, 1], 1.0)
    assert (u.x.array[corner] == value).all()
    assert COMM.allreduce(int(corner.sum())) >= 1
    problem.destroy()


@pytest.mark.parametrize("k", [-40, 3, 60])
def test_a_form_in_another_unit_has_its_matrix_and_load_in_that_unit(k):
    problems = make(), make(2.0**k)
    (one, other), (load, scaled) = (
        [getattr(problem, name) for problem in problems] for name in ("A", "b")
    )
    assert np.array_equal(other.getValuesCSR()[2], 2.0**k * one.getValuesCSR()[2])
    assert np.array_equal(scaled.array_r, 2.0**k * load.array_r)
    # A Dirichlet row says d u = d data, with a d of the size of the other rows.
    diagonal, system = one.getDiagonal(), problems[0].system
    fixed = diagonal.array_r[system.fixed_dofs]
    assert fixed == pytest.approx(diagonal.norm(PETSc.NormType.INFINITY), rel=1e-12)
    assert load.array_r[system.fixed_dofs] == pytest.approx(fixed * system.fixed_values)
    diagonal.destroy()
    for problem in problems:
        problem.destroy()
