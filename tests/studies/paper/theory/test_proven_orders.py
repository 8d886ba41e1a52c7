"""The orders that the paper proves: its own tables of them, their limits, and what is refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dolfinx_signorini.norms.orders import expected_order
from dolfinx_signorini.studies.paper.theory.proven import (
    allowed_order,
    proven_order,
    supercloseness_order,
)

pytestmark = pytest.mark.pure

BELOW = st.floats(2.01, 3.99)
ABOVE = st.floats(4.01, 1000.0)


@given(BELOW)
def test_corollary_4_1(p):
    for norm, order in (
        ("W1_inf", 0.5 - 1.0 / p),
        ("L2", 1.5 - 1.0 / p),
        ("L40", 1.5 - 1.0 / p),
        ("Linf", 1.5 - 1.0 / p),
        ("H1_2_boundary", 1.5 - 1.0 / p),
    ):
        found = proven_order(p, norm)
        assert found.value == pytest.approx(order, abs=1e-12)
        assert found.open == (norm == "Linf")  # |ln h|^{1/2}
    assert proven_order(p, f"W1_{4.0 * p / (p + 2.0) - 1e-9!r}").value == 1.0
    assert supercloseness_order(p).value == pytest.approx(1.5 - 1.0 / p)


@given(ABOVE)
def test_corollary_4_2_or_the_limit_of_4_1(p):
    for norm, order in (
        ("W1_inf", max(0.5 - 2.0 / p, 0.25)),
        ("Linf", max(1.5 - 2.0 / p, 1.25)),
        ("H1_2_boundary", max(1.5 - 2.0 / p, 1.25)),
    ):
        found = proven_order(p, norm)
        assert found.value == pytest.approx(order, abs=1e-12)
        assert found.open
    critical = max(4.0 * p / (p + 4.0), 8.0 / 3.0)
    assert proven_order(p, f"W1_{critical - 1e-9!r}").value == pytest.approx(1.0, abs=1e-8)
    assert proven_order(p, f"W1_{critical + 0.1!r}").value < 1.0


@pytest.mark.parametrize("norm", ["L4", "L16", "Linf", "W1_4", "W1_16", "W1_inf", "H1_2_boundary"])
def test_table_2(norm):
    # The row "theo." of the paper, which the package's rates hold as well.
    found = proven_order(math.inf, norm, contact_sets=True).value
    assert found == pytest.approx(expected_order(norm))


def test_duality_needs_the_contact_sets():
    assert proven_order(math.inf, "L4").value == 1.5
    assert proven_order(math.inf, "L4", contact_sets=True).value == 2.0


def test_order_1_without_epsilon_below_eight_thirds():
    assert str(proven_order(math.inf, "W1_2.6")) == "1"
    assert str(proven_order(math.inf, "W1_4")) == "1 - eps"


@given(st.floats(2.01, 1000.0).filter(lambda p: abs(p - 4.0) > 0.01), st.floats(1.0, 50.0))
def test_a_stronger_norm_never_has_a_higher_order(p, q):
    for family in ("W1_", "L"):
        weaker = proven_order(p, f"{family}{q!r}").value
        assert proven_order(p, f"{family}{q + 1.0!r}").value <= weaker + 1e-12
    assert proven_order(p, f"W1_{q!r}").value <= proven_order(p, f"L{q!r}").value


@given(BELOW)
def test_the_singularity_allows_what_is_proven(p):
    for norm in ("W1_inf", "W1_4", "L2", "L16", "Linf", "H1_2_boundary"):
        proven = proven_order(p, norm).value
        assert allowed_order(p, norm) >= proven - 1e-12


def test_the_singularity_of_the_paper():
    assert allowed_order(math.inf, "W1_16") == pytest.approx(0.625)
    assert allowed_order(math.inf, "L16") == pytest.approx(1.625)
    assert allowed_order(math.inf, "L4") == 2.0
    assert allowed_order(math.inf, "L3_boundary") == pytest.approx(1.5 + 1.0 / 3.0)


@pytest.mark.parametrize("p", [2.0, 4.0, 1.0, math.nan])
def test_exponents_that_no_statement_covers(p):
    with pytest.raises(ValueError, match="p: the statements hold"):
        supercloseness_order(p)
    with pytest.raises(ValueError, match="p: the statements hold"):
        proven_order(p, "L4")


def test_norms_that_no_statement_covers():
    with pytest.raises(ValueError, match="on the boundary"):
        proven_order(3.0, "L2_boundary")
    with pytest.raises(ValueError, match="unknown norm"):
        proven_order(3.0, "V4")
