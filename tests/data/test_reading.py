"""UFL expressions as formulas, against the formulas that they were made from and by hand."""

import math

import numpy as np
import pytest
import ufl
from dolfinx import fem
from hypothesis import given
from mpi4py import MPI
from test_expressions import FORMULAS

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.data.enclosures import enclosed_on_simplices
from dolfinx_signorini.data.parsing import parse
from dolfinx_signorini.data.reading import formula_of
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller

DOMAIN = friedrichs_keller(MPI.COMM_SELF, 2)
POINTS = np.random.default_rng(4).uniform(0.05, 0.95, (20, 2)).tolist()


@pytest.fixture(scope="module")
def domain():
    return friedrichs_keller(MPI.COMM_WORLD, 4)


@given(FORMULAS)
def test_formulas_written_in_ufl_are_read_as_they_were(text):
    formula = parse(text)
    try:
        expression = formula.ufl(ufl.SpatialCoordinate(DOMAIN))
    except InputError:  # a part without a value
        return
    found = formula_of(expression)
    assert found is not None
    for point in POINTS:
        value = formula.value(point)
        if math.isfinite(value):
            assert found.value(point) == pytest.approx(value, rel=1e-9, abs=1e-9)


def test_vectors_matrices_constants_and_derivatives(domain):
    x = ufl.SpatialCoordinate(domain)
    c = fem.Constant(domain, 2.5)
    d = x - fem.Constant(domain, (0.3, 0.4))
    A = ufl.as_matrix([[2, x[0]], [x[0], 3]])
    w = ufl.sin(3 * x[0]) * x[1] ** 2
    i, j = ufl.indices(2)

    def at(p, q):
        square = (p - 0.3) ** 2 + (q - 0.4) ** 2
        mixed = 2 * p * (p - 0.3) * (q - 0.4)
        return [
            (ufl.inner(d, d), square),
            (c * ufl.sqrt(ufl.dot(d, d)), 2.5 * math.sqrt(square)),
            (ufl.dot(d, d) ** 0.75, square**0.75),
            (ufl.det(A) + ufl.tr(A), 11.0 - p**2),
            (ufl.inner(A * d, d), 2 * square + (q - 0.4) ** 2 + mixed),
            (A[i, j] * A[i, j], 13.0 + 2.0 * p**2),
            (-ufl.div(c * ufl.grad(w)), 2.5 * math.sin(3 * p) * (9 * q**2 - 2)),
            (2 ** x[0] + ufl.ln(1 + x[1]), 2**p + math.log(1 + q)),
            (ufl.atan2(x[1], x[0]) - ufl.cosh(x[0]), math.atan2(q, p) - math.cosh(p)),
            (ufl.variable(x[0]) * ufl.sign(x[0] - 0.5), p * math.copysign(1.0, p - 0.5)),
        ]

    for point in POINTS:
        for expression, value in at(*point):
            assert formula_of(expression).value(point) == pytest.approx(value, rel=1e-12), (
                expression
            )


def test_conditions(domain):
    x = ufl.SpatialCoordinate(domain)
    left, low = ufl.lt(x[0], 0.5), ufl.le(x[1], 0.5)

    def at(x, y):
        a, b = x < 0.5, y <= 0.5
        return [(ufl.And(left, low), a and b), (ufl.Or(left, low), a or b), (ufl.Not(left), not a)]

    for x_, y_ in [(0.5, 0.5), (0.2, 0.2), (0.2, 0.7), (0.7, 0.2), (0.7, 0.7)]:
        for condition, value in at(x_, y_):
            found = formula_of(ufl.conditional(condition, x[0], -x[1]))
            assert found.value((x_, y_)) == (x_ if value else -y_)
        equal = formula_of(ufl.conditional(ufl.eq(x[0], x[1]), 1.0, 2.0))
        other = formula_of(ufl.conditional(ufl.ne(x[0], x[1]), 1.0, 2.0))
        assert equal.value((x_, y_)) == (1.0 if x_ == y_ else 2.0)
        assert other.value((x_, y_)) == (2.0 if x_ == y_ else 1.0)


def test_distances_are_known_to_vanish_at_points_only(domain):
    x = ufl.SpatialCoordinate(domain)
    distance = formula_of(ufl.sqrt((x[0] - 0.3) ** 2 + (x[1] - 0.4) * (x[1] - 0.4)))
    assert distance.root.op == "hypot"
    corners = np.array([[[0.2, 0.3], [0.4, 0.3], [0.3, 0.5]]])
    low, high = enclosed_on_simplices(distance, corners)[:, 0]
    assert low >= 0.0 and high == pytest.approx(math.hypot(0.1, 0.1), rel=0.2)


def test_a_distance_that_is_scaled_for_tiny_arguments_is_that_distance(domain):
    x = ufl.SpatialCoordinate(domain)
    a, b = x[0] - 0.3, x[1] - 0.4
    largest = ufl.max_value(abs(a), abs(b))
    for scale, known in (
        (ufl.conditional(ufl.gt(largest, 0.0), largest, 1.0), True),
        (abs(a) + 1.0, True),
        (a - b, False),
    ):
        scaled = scale * ufl.sqrt((a / scale) ** 2 + (b / scale) * (b / scale))
        found = formula_of(scaled)
        assert (found.root.op == "hypot") is known
        for p, q in POINTS:
            sign = 1.0 if known else math.copysign(1.0, p - q + 0.1)
            assert found.value((p, q)) == pytest.approx(sign * math.hypot(p - 0.3, q - 0.4))
    mixed = formula_of((abs(b) + 1.0) * ufl.sqrt((a / (abs(a) + 1.0)) ** 2 + b * b))
    p, q = 0.7, 0.1
    expected = (abs(q - 0.4) + 1.0) * math.hypot((p - 0.3) / (abs(p - 0.3) + 1.0), q - 0.4)
    assert mixed.value((p, q)) == pytest.approx(expected)


def test_what_is_no_formula_of_the_coordinates_is_not_read(domain):
    x = ufl.SpatialCoordinate(domain)
    f = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
    for expression in (f, f * x[0], ufl.erf(x[0]), ufl.CellDiameter(domain), x, ufl.grad(f)[0]):
        assert formula_of(expression) is None
    assert formula_of(ufl.as_ufl(3.0)).constant == 3.0
    assert formula_of(0 * x[0]).constant == 0.0
