"""Problems with measures whose rules follow the data: also after the data have changed."""

import numpy as np
import pytest
import ufl
from dolfinx import fem

from dolfinx_signorini import SignoriniProblem, boundary_facets, friedrichs_keller
from dolfinx_signorini.data.interfaces.piecewise_forms import BY_DATA


def test_loads_that_jump_are_integrated_again_when_they_change(comm):
    domain = friedrichs_keller(comm, 5)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    factor, dx = fem.Constant(domain, 3.0), ufl.dx(domain, metadata=BY_DATA)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * dx
    L = factor * ufl.conditional(x[0] + x[1] < 0.77, 1.0, 0.0) * v * dx
    problem = SignoriniProblem(a, L, contact=boundary_facets(domain), obstacle=-1.0)
    assert problem.a is a and problem.L is L
    first = problem.solve(rtol=1e-10).x.array.copy()
    assert problem.total_load == pytest.approx(3.0 * 0.77**2 / 2.0, rel=1e-12)
    factor.value = 7.0
    second = problem.solve(rtol=1e-10).x.array
    assert problem.total_load == pytest.approx(7.0 * 0.77**2 / 2.0, rel=1e-12)
    assert np.abs(second - 7.0 / 3.0 * first).max(initial=0.0) < 1e-8  # nothing is in contact
    problem.destroy()
