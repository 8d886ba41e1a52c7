"""Forms that are sums of squares as they are written: no matrix of theirs needs a check."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc

from dolfinx_signorini.base.sums_of_squares import is_sum_of_squares
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller

grad, inner, dot = ufl.grad, ufl.inner, ufl.dot

# Each form with the words "known" (a sum of squares), "hidden" (one that is not seen) or "none".
FORMS = {
    "inner(grad(u), grad(v)) + u * v": "known",
    "dot(grad(u), grad(v)) + 2.0 * inner(u, v)": "known",
    "3 * inner(grad(v), grad(u))": "known",
    "inner(grad(grad(u)), grad(grad(v))) + u * v": "known",
    "2.0 * (inner(grad(u), grad(v)) + u * v)": "hidden",
    "u.dx(0) * v.dx(0) + u * v": "hidden",
    "c * u * v": "hidden",
    "inner(grad(u), grad(v)) - 9.0 * u * v": "none",
    "-1.0 * (-1.0) * u * v - 2 * u * v": "none",
    "x * u * v": "none",
    "u.dx(0) * v + u * v": "none",
    "dot(grad(u), ufl.as_vector((1.0, 0.0))) * v": "none",
    "ufl.div(grad(u)) * v": "none",
}


@pytest.mark.parametrize(("text", "kind"), FORMS.items())
def test_only_sums_of_squares_are_known_as_such(comm, text, kind):
    domain = friedrichs_keller(comm, 3)
    space = fem.functionspace(domain, ("Lagrange", 2))
    names = {
        "u": ufl.TrialFunction(space),
        "v": ufl.TestFunction(space),
        "c": fem.Constant(domain, 2.0),
        "x": ufl.SpatialCoordinate(domain)[0] - 0.5,
    }
    form = eval(text, {**globals(), **names}) * ufl.dx
    assert is_sum_of_squares(form) == (kind == "known")
    matrix = fem_petsc.assemble_matrix(fem.form(form))
    matrix.assemble()
    rows, columns, values = matrix.getValuesCSR()
    first, last = matrix.getOwnershipRange()
    dense = np.zeros(matrix.getSize())
    dense[np.repeat(np.arange(first, last), np.diff(rows)), columns] = values
    dense = comm.allreduce(dense)
    size = np.abs(dense).max()
    symmetric = np.abs(dense - dense.T).max() < 1e-12 * size
    semidefinite = np.linalg.eigvalsh(dense + dense.T).min() > -1e-12 * size
    assert (symmetric and semidefinite) == (kind != "none")


def test_a_chosen_rule_of_quadrature_is_no_proof(comm):
    domain = friedrichs_keller(comm, 2)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    assert is_sum_of_squares(u * v * ufl.dx(domain) + u * v * ufl.ds)
    assert not is_sum_of_squares(u * v * ufl.dx(domain, metadata={"quadrature_degree": 1}))
