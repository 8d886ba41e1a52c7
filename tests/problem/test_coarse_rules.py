"""Forms whose users name a quadrature rule that sees too little of the functions of the space."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from dolfinx_signorini.base.errors import InputError, NotConvergedError
from dolfinx_signorini.problem.coarse_rules import coarse_rule
from dolfinx_signorini.problem.signorini import SignoriniProblem


def square(comm, cell=mesh.CellType.triangle, n=4):
    return mesh.create_unit_square(comm, n, n, cell)


def posed(domain, degree, dx):
    """-Laplace u = -1 with contact below, where the gradients are integrated by dx."""
    space = fem.functionspace(domain, ("Lagrange", degree))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    return ufl.inner(ufl.grad(u), ufl.grad(v)) * dx, -v * ufl.dx, bottom


def failure(a, L, contact, **options):
    with pytest.raises((InputError, NotConvergedError)) as caught:
        SignoriniProblem(a, L, contact=contact, obstacle=-0.1).solve(**options)
    return caught


@pytest.mark.parametrize(
    ("degree", "named", "needed"), [(2, 0, 2), (3, 0, 4), (3, 2, 4), (4, 3, 6)]
)
def test_the_rule_is_named_where_a_form_is_found_to_be_indefinite(degree, named, needed, comm):
    """With the other sign it is rounding that tells whether the form is indefinite or singular."""
    a, L, contact = posed(square(comm), degree, ufl.dx(degree=named))
    caught = failure(-a, L, contact)
    assert caught.type is InputError and caught.value.subject == "form a"
    assert "not positive definite" in caught.value.message
    assert f"rule of degree {named}" in caught.value.message
    assert f"name degree {needed}" in caught.value.message
    assert coarse_rule(posed(square(comm), degree, ufl.dx(degree=needed))[0]) == ""


def test_and_where_a_solver_does_not_converge(comm):
    limits = {"method": "bncg", "max_iterations": 5}
    caught = failure(*posed(square(comm), 2, ufl.dx(degree=0)), **limits)
    assert caught.type is NotConvergedError and caught.value.residual > 1e-8
    assert "rule of degree 0" in str(caught.value) and "loosen" not in str(caught.value)
    caught = failure(*posed(square(comm), 2, ufl.dx(degree=2)), **limits)
    assert "rule" not in str(caught.value) and "loosen" in str(caught.value)


@pytest.mark.parametrize("n", [4, 50])
def test_and_where_the_energy_is_found_to_be_unbounded(comm, n):
    """By a factorization, or by multigrid, on which the method of active sets would go on."""
    caught = failure(*posed(square(comm, n=n), 2, ufl.dx(degree=0)))
    assert caught.type is InputError and "unbounded below" in caught.value.message
    assert "rule of degree 0" in caught.value.message


def test_other_forms_are_not_blamed(comm):
    """A rule for a reaction alone, one that is fine enough, none, and one on quadrilaterals."""
    domain = square(comm)
    space = fem.functionspace(domain, ("Lagrange", 2))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    energy = ufl.inner(ufl.grad(u), ufl.grad(v))
    assert coarse_rule(energy * ufl.dx + u * v * ufl.dx(degree=0)) == ""
    assert coarse_rule(energy * ufl.dx(degree=2)) == ""
    slope = ufl.SpatialCoordinate(domain)[0] ** 2
    assert coarse_rule(energy * ufl.dx + ufl.grad(slope)[0] * u * v * ufl.dx(degree=1)) == ""
    assert coarse_rule(u.dx(0) * v.dx(0) * ufl.dx(degree=1)) != ""
    assert coarse_rule(energy * ufl.dx(scheme="vertex", degree=1)) != ""
    _, L, contact = posed(domain, 2, ufl.dx)
    indefinite = failure(-energy * ufl.dx, L, contact)
    assert "rule" not in str(indefinite.value)
    space = fem.functionspace(square(comm, mesh.CellType.quadrilateral), ("Lagrange", 2))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    energy = ufl.inner(ufl.grad(u), ufl.grad(v))
    assert coarse_rule(energy * ufl.dx(degree=3)) != "" == coarse_rule(energy * ufl.dx(degree=4))
