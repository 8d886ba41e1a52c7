"""Orders of convergence: exact for powers, and the paper's own numbers from the paper's own."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dolfinx_signorini.norms.orders import (
    approximation_order,
    eoc,
    expected_order,
    is_finite,
    regression,
)
from dolfinx_signorini.studies.paper.tables import paper_table

pytestmark = pytest.mark.pure

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
        values = [float(row[norm]) for row in errors.values()]
        # Five printed digits of the errors leave three or four of the orders.
        for n, order in zip(list(errors)[1:], eoc(widths, values), strict=True):
            assert order == pytest.approx(float(table[n][norm]), abs=1.5e-3), (n, norm)
        known = float(table["regression"][norm])
        assert regression(widths, values) == pytest.approx(known, abs=2e-4)


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


def infinite_integral(exponent, dimension):
    """Whether r^exponent has no integral over a ball: the sum over ever smaller rings."""
    with np.errstate(over="ignore"):
        rings = np.exp2(-np.arange(1000) * (exponent + dimension))
    return not rings[500:].sum() < 1e-3 * rings[:500].sum()


@given(
    st.sampled_from([-0.75, -0.5, 0.25, 0.5, 2 / 3, 0.75, 1.25, 1.5]),
    st.sampled_from([1.0, 1.5, 2.0, 3.0, 4.0, 7.0, 16.0]),
    st.sampled_from([2, 3]),
    st.booleans(),
)
def test_a_norm_is_finite_where_its_integral_is(exponent, p, dimension, boundary):
    where = "_boundary" if boundary else ""
    for name, derivatives in (("L", 0), ("W1_", 1)):
        power = (exponent - derivatives) * p
        found = is_finite(f"{name}{p!r}{where}", exponent, dimension)
        assert found != infinite_integral(power, dimension - boundary), (name, power)


def test_norms_of_known_singularities():
    # A re-entrant corner of 270 degrees, a change from Dirichlet to Neumann, a detachment point.
    corner = {name: is_finite(name, 2 / 3) for name in ("Linf", "H1", "W1_4", "W1_6", "W1_inf")}
    assert corner == {"Linf": True, "H1": True, "W1_4": True, "W1_6": False, "W1_inf": False}
    assert not is_finite("W1_4", 0.5)  # the integral of r^{-2} in the plane
    assert is_finite("W1_4", 0.5, dimension=3)
    assert is_finite("W1_3.99", 0.5)
    assert is_finite("W1_inf", 1.5) and is_finite("W1_inf", 1.0) and not is_finite("W1_inf", 0.999)
    assert is_finite("Linf", 0.0) and not is_finite("Linf", -0.1)
    # On the boundary of a plane domain: r^{-1} has no finite integral, r^{1/2} is in H^{1/2}.
    assert not is_finite("H1_boundary", 0.5) and not is_finite("H1_2_boundary", 0.5)
    assert is_finite("H1_2_boundary_spectral", 0.5) and is_finite("H1_2_boundary", 0.51)


@given(st.floats(0.1, 3.0), st.floats(1.0, 100.0))
def test_positive_orders_belong_to_finite_norms(exponent, p):
    for name in (f"L{p!r}", f"W1_{p!r}"):
        assert is_finite(name, exponent) == (approximation_order(name, 9, exponent) > 0.0)
