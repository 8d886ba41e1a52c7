"""Values of UFL expressions at points, against what DOLFINx compiles and against closed forms."""

import math

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy import special

from dolfinx_signorini import Reference, error_norms
from dolfinx_signorini.base import compat
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.data.formula_values import FormulaAtPoints, values_at
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, facet_cells, owned_cells

COMM = MPI.COMM_WORLD
INNER = np.array([[0.21, 0.34], [0.5, 0.1], [0.17, 0.62]])


@pytest.fixture(scope="module")
def domain():
    return mesh.create_unit_square(COMM, 4, 3)


def expressions(domain):
    """Expressions with all that may be in them, by name."""
    x, normal = ufl.SpatialCoordinate(domain), ufl.as_vector([0.6, -0.8])
    f = fem.Function(fem.functionspace(domain, ("Lagrange", 3)))
    f.interpolate(lambda x: np.sin(2.0 * x[0]) * np.exp(x[1]))
    w = fem.Function(fem.functionspace(domain, ("Lagrange", 2, (2,))))
    w.interpolate(lambda x: np.array([x[0] * x[1], np.cos(x[0] - x[1])]))
    d = fem.Function(fem.functionspace(domain, ("DG", 0)))
    d.x.array[:] = 1.0 + np.arange(len(d.x.array)) % 5
    c = fem.Constant(domain, np.array([2.0, -3.0]))
    i, j = ufl.indices(2)
    near, low = ufl.lt(x[0], 0.37), ufl.ge(x[1], 0.41)
    return {
        "functions": f * d + ufl.inner(w, ufl.grad(f)) / (2.0 + f),
        "tensors": ufl.sym(ufl.grad(w)) * normal + ufl.dot(ufl.grad(w), w),
        "indices": ufl.as_tensor(w[i] * ufl.grad(w)[j, i], (j,)),
        "determinant": ufl.det(ufl.Identity(2) + ufl.grad(w)) * ufl.tr(ufl.outer(w, w)),
        "constants": c[0] * x[0] ** c[0] + abs(c[1]) ** x[1],
        "choices": ufl.conditional(ufl.And(near, ufl.Not(low)), f, ufl.conditional(low, 2.0, d)),
        "either": ufl.conditional(ufl.Or(near, low), x[0], ufl.conditional(ufl.eq(d, 3.0), 1, d)),
        "elementary": ufl.atan2(f, x[0]) + ufl.tanh(x[1]) * ufl.ln(2.0 + f) + ufl.sign(x[0] - 0.4),
        "extrema": ufl.max_value(f, x[0]) - ufl.min_value(w[0], w[1]) + ufl.sqrt(x[0]) ** 3,
        "special": ufl.erf(f) + ufl.bessel_J(1, 3.0 * x[0]) - ufl.bessel_Y(0, 0.5 + x[1]),
        "variable": ufl.diff(ufl.variable(f) ** 2 * x[0], ufl.variable(f)) + x[0].dx(0),
    }


@pytest.mark.parametrize("name", expressions(mesh.create_unit_square(MPI.COMM_SELF, 1, 1)))
def test_values_in_cells_are_those_that_dolfinx_compiles(domain, name):
    item = expressions(domain)[name]
    cells = owned_cells(domain)
    found = np.stack(FormulaAtPoints(domain, [item])(Points(domain, cells, INNER)), axis=2)
    compiled = compat.evaluate(fem.Expression(item, INNER, comm=COMM), domain, cells)
    expected = compiled.reshape(found.shape)
    assert np.abs(found - expected).max(initial=0.0) <= 1e-13 * (
        1.0 + np.abs(expected).max(initial=0.0)
    )


def test_modified_bessel_functions_which_dolfinx_does_not_compile(domain):
    x = ufl.SpatialCoordinate(domain)
    points = Points(domain, owned_cells(domain), INNER)
    item = ufl.bessel_I(0, x[0]) * ufl.bessel_K(2, 0.5 + x[1])
    expected = special.iv(0, points.x[0]) * special.kv(2, 0.5 + points.x[1])
    assert FormulaAtPoints(domain, [item])(points)[0] == pytest.approx(expected)


def test_a_constant_has_its_present_value(domain):
    c, x = fem.Constant(domain, 2.0), ufl.SpatialCoordinate(domain)
    points = Points(domain, owned_cells(domain), INNER)
    formula = FormulaAtPoints(domain, [c * x[0] ** c])
    for value in (2.0, 3.0, 0.5):
        c.value = value
        assert formula(points)[0] == pytest.approx(value * points.x[0] ** value)


def test_a_series_has_a_thousand_terms(domain):
    x = ufl.SpatialCoordinate(domain)
    series = sum(ufl.sin(k * math.pi * x[0]) / k**3 for k in range(1, 800))
    points = Points(domain, owned_cells(domain), INNER)
    value, slope = FormulaAtPoints(domain, [series, series.dx(0)])(points)
    x0 = points.x[0]
    assert value == pytest.approx(sum(np.sin(k * math.pi * x0) / k**3 for k in range(1, 800)))
    terms = (math.pi * np.cos(k * math.pi * x0) / k**2 for k in range(1, 800))
    assert slope == pytest.approx(sum(terms))


@pytest.mark.parametrize("sign", [True, False])
def test_where_data_jump_a_cell_has_its_own_value(domain, sign):
    x = ufl.SpatialCoordinate(domain)
    item = 1.5 + 0.5 * ufl.sign(x[0] - 0.5) if sign else ufl.conditional(x[0] < 0.5, 1.0, 2.0)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    points = Points(domain, owned_cells(domain), corners)
    (own,), (there,) = (FormulaAtPoints(domain, [item], k)(points) for k in (True, False))
    right = np.stack(points.x)[0].mean(axis=1) > 0.5
    assert (own == np.where(right, 2.0, 1.0)[:, None]).all()
    on_line = 1.5 if sign else 2.0
    assert (there == np.select([points.x[0] < 0.5, points.x[0] > 0.5], [1.0, 2.0], on_line)).all()


def test_what_is_no_formula_is_compiled_or_refused(domain):
    size = ufl.CellDiameter(domain) * ufl.SpatialCoordinate(domain)[1]
    with pytest.raises(InputError, match=r"not on|coordinates and functions"):
        FormulaAtPoints(domain, [size])
    cells = owned_cells(domain)
    (found,) = values_at(domain, [size])(Points(domain, cells, INNER))
    x = domain.geometry.x[domain.geometry.dofmap[: len(cells)]]
    diameters = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    assert found == pytest.approx(diameters[:, None] * Points(domain, cells, INNER).x[1])
    facets = facet_cells(domain, boundary_facets(domain))
    (found,) = values_at(domain, [size])(Points(domain, facets, np.array([[0.5]])))
    x = domain.geometry.x[domain.geometry.dofmap[facets[:, 0]]]
    diameters = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    middles = Points(domain, facets, np.array([[0.5]])).x[1]
    assert found == pytest.approx(diameters[:, None] * middles)


def test_errors_against_a_bessel_function(domain):
    """I_0(r) is the radial solution of -Laplace u + u = 0."""
    x = ufl.SpatialCoordinate(domain)
    r = ufl.sqrt(1.0 + x[0] ** 2 + x[1] ** 2)
    u = ufl.bessel_I(0, r)
    u_h = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
    exact = Reference(domain, u, tuple(ufl.grad(u)))
    s, w = np.polynomial.legendre.leggauss(30)
    a, b = np.meshgrid(0.5 + 0.5 * s, 0.5 + 0.5 * s)
    square = np.outer(w, w) / 4.0 * special.iv(0, np.sqrt(1.0 + a**2 + b**2)) ** 2
    assert error_norms(u_h, exact, ["L2"])["L2"] == pytest.approx(math.sqrt(square.sum()), rel=1e-8)
