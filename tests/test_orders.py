"""Orders of convergence: exact for powers, and the paper's own numbers from the paper's own."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dolfinx_signorini.orders import eoc, expected_order, regression
from dolfinx_signorini.paper.tables import paper_table

orders = st.floats(0.1, 4.0)
factors = st.floats(1e-100, 1e100)


@given(orders, factors, st.integers(2, 6))
def test_powers_of_h_have_their_exponent(order, factor, count):
    widths = [0.5**i for i in range(count)]
    errors = [factor * h**order for h in widths]
    assert eoc(widths, errors) == pytest.approx([order] * (count - 1), rel=1e-9, abs=1e-9)
    assert regression(widths, errors) == pytest.approx(order, rel=1e-9, abs=1e-9)


def test_orders_between_uneven_widths():
    assert eoc([1 / 10, 1 / 30], [9.0, 1.0]) == pytest.approx([2.0])
    assert eoc([1.0], [3.0]) == []


def test_the_papers_errors_give_the_papers_orders_and_regression():
    errors, table = paper_table(1), paper_table(2)
    widths = [1.0 / int(n) for n in errors]
    for norm in ("L4", "Linf", "W1_4", "W1_inf", "H1_2_boundary"):
        values = [row[norm] for row in errors.values()]
        # Five printed digits of the errors leave three or four of the orders.
        for n, order in zip(list(errors)[1:], eoc(widths, values), strict=True):
            assert order == pytest.approx(table[n][norm], abs=1.5e-3), (n, norm)
        assert regression(widths, values) == pytest.approx(table["regression"][norm], abs=2e-4)


def test_the_theorys_row_is_the_papers():
    for name, order in paper_table(2)["theory"].items():
        assert expected_order(name) == order


@given(st.floats(1.0, 1000.0), st.floats(1.0, 1000.0))
def test_orders_fall_with_p_and_lose_one_for_a_derivative(p, q):
    low, high = sorted((p, q))
    first, second = (
        expected_order(f"L{low!r}"),
        expected_order(f"L{high!r}"),
    )
    assert 1.5 <= second <= first <= 2.0
    assert expected_order(f"W1_{low!r}") == pytest.approx(first - 1.0)


def test_no_theorem_no_order():
    assert expected_order("L2_boundary") is None
    assert expected_order("H1_2_boundary_spectral") == 1.5
    assert np.isfinite(expected_order("Linf"))
