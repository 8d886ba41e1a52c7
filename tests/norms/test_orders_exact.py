"""Expected orders, digit by digit, beyond the paper's table: all degrees and exponents."""

import math

import pytest

from dolfinx_signorini.norms.orders import (
    SMOOTH,
    approximation_order,
    eoc,
    expected_order,
    expected_orders,
    grading_exponent,
)

pytestmark = pytest.mark.pure

# min(k + 1, a + 2/p), and not more than the twice 1 or a that the dual solution allows.
L_P = {
    ("L1", 1, 1.5): 2.0,
    ("L1", 2, 1.5): 2.0,
    ("L2", 2, 1.5): 2.0,
    ("L4", 2, 1.5): 2.0,
    ("Linf", 2, 1.5): 1.5,
    ("L2", 2, 2.5): 2.0,
    ("L2", 3, 1.1): 2.0,
    ("L2", 1, 2 / 3): 4 / 3,
    ("L2", 2, 2 / 3): 4 / 3,
    ("Linf", 1, 2 / 3): 2 / 3,
    ("L1", 1, 0.5): 1.0,
    ("L16", 1, 0.5): 0.5 + 2 / 16,
}
# min(k, a - 1 + 2/p).
W_P = {
    ("H1", 1, 1.5): 1.0,
    ("H1", 2, 1.5): 1.5,
    ("W1_4", 1, 1.5): 1.0,
    ("W1_4", 2, 1.5): 1.0,
    ("W1_16", 2, 1.5): 0.5 + 2 / 16,
    ("W1_inf", 1, 1.5): 0.5,
    ("H1", 1, 2 / 3): 2 / 3,
    ("H1", 2, 2.5): 2.0,
    ("W1_inf", 2, 2.5): 1.5,
}


@pytest.mark.parametrize(("case", "order"), [*L_P.items(), *W_P.items()])
def test_orders_on_uniform_meshes(case, order):
    assert expected_order(*case) == pytest.approx(order, rel=1e-14)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("exponent", [1.0, 1.2, 1.5, 1.9, 3.0])
def test_no_degree_and_no_smoothness_raises_an_order_in_l_p_beyond_two(degree, exponent):
    for p in ("1", "2", "4", "inf"):
        assert expected_order(f"L{p}", degree, exponent) <= 2.0


def test_a_boundary_has_one_dimension_less():
    # r^{3/2} along a curve: derivatives like r^{1/2}, whose error in L^p of the end is h^{1/2+1/p}.
    assert approximation_order("W1_4_boundary", 2) == 0.75
    assert approximation_order("H1_boundary", 2) == 1.0
    assert approximation_order("L4_boundary", 2) == 1.75
    assert expected_order("H1_2_boundary", 1) == 1.5
    assert expected_order("H1_2_boundary", 2) == 1.5


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_smooth_functions_have_the_full_order(degree):
    for name, derivatives in (("L1", 0), ("Linf", 0), ("H1", 1), ("W1_inf", 1)):
        assert approximation_order(name, degree, SMOOTH) == degree + 1 - derivatives


def test_gradings_never_coarsen_and_are_strongest_for_the_largest_slope():
    for degree in (1, 2, 3, 4):
        assert grading_exponent(degree) == 0.5 / degree
        for name in ("L1", "L2", "L4", "Linf", "H1", "W1_4"):
            assert grading_exponent(degree) <= grading_exponent(degree, name) <= 1.0
    assert grading_exponent(1, "L2") == 1.0  # h^{5/2} is more than P1 can use
    assert grading_exponent(2, "L2") == pytest.approx(2.5 / 3.0)


def test_the_orders_listed_of_a_scene():
    orders = expected_orders(2, 1.5)
    assert orders == {name: expected_order(name, 2, 1.5) for name in orders}
    assert {"L2", "Linf", "H1", "W1_inf"} <= set(orders)


def test_orders_from_widths_that_are_not_halved():
    widths = [1.0, 0.7, 0.1]
    assert eoc(widths, [h**1.75 for h in widths]) == pytest.approx([1.75, 1.75])
    assert math.isclose(eoc([0.5, 0.1], [1.0, 5.0])[0], -1.0)
