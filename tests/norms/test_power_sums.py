"""Sums of powers, beside the formula in long arithmetic, and what is not finite."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dolfinx_signorini.norms.power_sums import collected, joined, p_norm, total

SIZES = st.lists(st.floats(1e-3, 1e3), min_size=1, max_size=6)


@given(SIZES, st.sampled_from([1, 2, 4, 16]), st.sampled_from([-290, 0, 290]))
def test_powers_neither_overflow_nor_underflow(values, p, digits):
    exact = float(sum(Fraction(v) ** p for v in values) / Fraction(max(values)) ** p)
    expected = max(values) * exact ** (1.0 / p)
    found = p_norm(10.0**digits * np.array(values), float(p)) / 10.0**digits
    assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("p", [1.0, 2.0, math.inf])
def test_what_is_infinite_stays_infinite(comm, p):
    """Not NaN, which `max` passes over: an estimate would lose what is infinite."""
    one, other = np.array([math.inf, 1.0, 0.0]), np.array([1.0, 2.0, math.inf])
    assert np.isinf(joined(one, other, p)).tolist() == [True, False, True]
    assert total(one, p, comm) == math.inf
    assert collected(one, np.array([0, 1, 1]), 2, p).tolist() == [math.inf, 1.0]
    assert np.isnan(joined(np.array([math.nan]), other[:1], 2.0))


@pytest.mark.parametrize("p", [1.0, 3.0, math.inf])
def test_values_are_collected_at_their_places(p):
    values, owners = np.array([3.0, 1.0, 2.0, 5.0]), np.array([0, 2, 0, 2])
    places = [p_norm(values[owners == k], p) if k != 1 else 0.0 for k in range(3)]
    assert collected(values, owners, 3, p) == pytest.approx(places)
