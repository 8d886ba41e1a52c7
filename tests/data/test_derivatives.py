"""Derivatives, cancelled terms, and means next to singular points, against other ways to them."""

import math

import numpy as np
import pytest

from dolfinx_signorini.data.derivatives import Derivative, load_and_current, simplified
from dolfinx_signorini.data.formulas import Formula, evaluated
from dolfinx_signorini.data.interfaces.pieces import divided
from dolfinx_signorini.data.parsing import parse
from dolfinx_signorini.data.singular import root_mean_squares

pytestmark = pytest.mark.pure

W = "hypot(x - 0.3, y)^1.5*sin(1.5*atan2(y, x - 0.3))"
FORMULAS = [
    "sqrt(1 + x) + exp(x*y) + log(2 + y) + sin(x - y)*cos(x*y)",
    "tan(0.3*x) + asin(0.4*x) + acos(0.3*y) + atan(x*y)",
    "sinh(x) + cosh(y*x) + tanh(x - y) - (x + 1)/(y + 2)",
    "abs(x - 0.31) + max(x, y)*min(y, 0.4) + sign(x - 0.2)*y",
    "where(x + y < 0.9, x^3*y, y^-0.5) + (1 + x)^2.5 + x^0 + y^1",
    f"{W} + y*log(hypot(x - 0.3, y))",
]


@pytest.mark.parametrize("text", FORMULAS)
def test_derivatives_are_limits_of_differences(text):
    formula, x, h = parse(text), np.random.default_rng(1).random((50, 2)) + 0.01, 1e-6
    for k, step in enumerate(h * np.eye(2)):
        slope = Formula("", Derivative(k)(formula.root))
        by_differences = (evaluated(formula.root, x + step) - evaluated(formula.root, x - step)) / h
        for found in (slope, simplified(slope)):
            assert evaluated(found.root, x) == pytest.approx(
                0.5 * by_differences, rel=1e-6, abs=1e-7
            )


def test_a_load_and_a_flux_with_a_matrix():
    rows = (parse("2 + x"), parse("y")), (parse("y"), parse("3"))
    load, (first, second) = load_and_current(parse("x^2*y"), rows, parse("x"), 2)
    x, y = (points := np.random.default_rng(2).random((40, 2))).T
    assert evaluated(first.root, points) == pytest.approx((2 + x) * 2 * x * y + y * x**2)
    assert evaluated(second.root, points) == pytest.approx(2 * x * y**2 + 3 * x**2)
    exact = -(4 * y + 4 * x * y + 2 * x * y + 4 * x * y) + x**3 * y
    assert evaluated(load.root, points) == pytest.approx(exact)


def test_a_harmonic_solution_has_no_load():
    for rows in ((), ((parse("7"),),)):
        assert load_and_current(parse(W), rows, None, 2)[0].constant == 0.0
    assert load_and_current(parse(f"{W} + x^2"), (), None, 2)[0].constant == -2.0


@pytest.mark.parametrize("power", [2, 3, 6, 20])
def test_powers_of_sums_cancel_with_their_binomials(power):
    """(x + y)^n is the sum of its binomial terms, whatever n is."""
    terms = (f"{math.comb(power, k)}*x^{k}*y^{power - k}" for k in range(power + 1))
    root = simplified(parse(f"(x + y)^{power} - ({' + '.join(terms)})")).root
    assert root.op == "number" and root.value == 0.0


def test_a_power_of_too_many_products_is_left_as_it_stands():
    """400 products at most: the rest of the formula cancels all the same."""
    power = "(x + y + x*y)^40"
    formula = parse(f"{power} + x*y*x - y*x^2 - x + x")
    found = simplified(formula)
    assert found.root.size < formula.root.size
    assert evaluated(found.root, np.array([[0.3, 0.2]])) == pytest.approx(0.56**40)


def test_a_coefficient_that_overflows_does_not_cancel():
    formula, x = parse("1e200*x*(1e200*y)"), np.array([[1e-200, 3e-190]])
    assert evaluated(simplified(formula).root, x) == pytest.approx(3e10)


@pytest.mark.parametrize("n", [-0.5, -0.9, 0.5])
def test_means_around_a_singular_point(n):
    corners = np.array(
        [[[0.0, 0.0], [0.2, 0.0], [0.1, 0.3]], [[-0.1, -0.1], [0.1, 0.0], [0.0, 0.2]]]
    )
    pieces = corners
    for _ in range(8):
        pieces, _ = divided(pieces, np.arange(len(pieces)))
    r = np.linalg.norm(pieces.mean(axis=1), axis=1).reshape(-1, 2) ** (2 * n)
    truth = np.sqrt(r.mean(axis=0))
    found = root_mean_squares(parse(f"2*x/hypot(x, y)*hypot(x, y)^{n}"), corners)
    assert (truth <= found).all() and (found <= 2.5 * 2.0 * truth).all()


def test_a_pole_that_is_too_strong_has_no_bound():
    corners = np.array([[[0.0, 0.0], [0.2, 0.0], [0.1, 0.3]]])
    assert math.isinf(root_mean_squares(parse("1/hypot(x, y)"), corners)[0])
