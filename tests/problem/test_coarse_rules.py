"""Forms whose users name a quadrature rule that sees too little of the functions of the space."""

import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.signorini import SignoriniProblem

TRIANGLE, QUADRILATERAL = mesh.CellType.triangle, mesh.CellType.quadrilateral


def told(caplog, comm, form, degree=2, cell=TRIANGLE):
    """What posing a problem says about quadrature, on rank 0."""
    domain = mesh.create_unit_square(comm, 4, 4, cell)
    space = fem.functionspace(domain, ("Lagrange", degree))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    caplog.clear()
    problem = SignoriniProblem(
        form(u, v) + u * v * ufl.ds, -v * ufl.dx, contact=boundary_facets(domain), obstacle=-0.1
    )
    problem.destroy()
    return [message for message in caplog.messages if "quadrature rule" in message]


def stiffness(**named):
    return lambda u, v: ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx(**named)


@pytest.mark.parametrize(
    ("degree", "cell", "named", "needed"),
    [
        (2, TRIANGLE, 0, 2),
        (2, TRIANGLE, 1, 2),
        (3, TRIANGLE, 2, 4),
        (4, TRIANGLE, 3, 6),
        (2, QUADRILATERAL, 3, 4),
    ],
)
def test_a_rule_that_leaves_functions_without_energy_is_named(
    degree, cell, named, needed, comm, caplog
):
    found = told(caplog, comm, stiffness(degree=named), degree, cell)
    if comm.rank == 0:
        assert len(found) == 1
        assert f"rule of degree {named}" in found[0] and f"name degree {needed}" in found[0]
    assert told(caplog, comm, stiffness(degree=needed), degree, cell) == []


def test_other_forms_are_not_blamed(comm, caplog):
    """A rule for a reaction alone, or for the gradients of data, and a rule of vertices."""
    x = ufl.SpatialCoordinate
    forms = (
        lambda u, v: stiffness()(u, v) + u * v * ufl.dx(degree=0),
        lambda u, v: (
            stiffness()(u, v)
            + ufl.grad(x(u.ufl_function_space().mesh)[0] ** 2)[0] * u * v * ufl.dx(degree=1)
        ),
    )
    for form in forms:
        assert told(caplog, comm, form) == []
    found = told(caplog, comm, stiffness(scheme="vertex", degree=1))
    assert len(found) == (comm.rank == 0)


def test_the_energy_of_such_a_form_is_found_to_be_unbounded():
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4)
    space = fem.functionspace(domain, ("Lagrange", 2))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    bottom = mesh.locate_entities_boundary(domain, 1, lambda x: abs(x[1]) < 1e-12)
    a = stiffness(degree=0)(u, v)
    with pytest.raises(InputError, match="unbounded below"):
        SignoriniProblem(a, -v * ufl.dx, contact=bottom, obstacle=-0.1).solve()
