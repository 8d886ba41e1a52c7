"""Contact sets as intervals of a closed curve, and condition (A_h)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.studies.paper.theory.boundary import (
    ContactSet,
    condition_a_h,
    contact_set_of_nodes,
)

CORNERS = (0.0, 1.0, 2.0, 3.0)


class Circle:
    """A closed curve of length 4 with n equal edges, as far as contact sets need one."""

    length = 4.0

    def __init__(self, n):
        self.s = np.arange(n) * self.length / n
        self.widths = np.full(n, self.length / n)


def test_contact_set_of_nodes():
    #           0    1    2    3    4    5    6    7
    gap = [0.0, 0.0, 1.0, 2.0, 0.0, 1.0, 0.5, 0.0]
    pressure = [1.0, 3.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.5]
    found = contact_set_of_nodes(Circle(8), np.array(gap), np.array(pressure))
    assert found.intervals == ((2.0, 2.0), (3.5, 4.5))
    assert found.singletons == (2.0,)
    # gap - pressure vanishes: once per singleton, at both ends of an interval.
    want = [2.0 - 0.5 * 0.5 / 2.5, 3.5 - 0.5 * 0.5 / 1.0, 0.5 + 0.5 * 3.0 / 4.0]
    assert found.detachments == pytest.approx(want)


@given(st.integers(0, 20), st.integers(1, 9))
def test_contact_sets_turn_with_the_curve(shift, count):
    n = 20
    gap, pressure = np.ones(n), np.zeros(n)
    gap[:count], pressure[:count] = 0.0, 1.0
    found = contact_set_of_nodes(Circle(n), np.roll(gap, shift), np.roll(pressure, shift))
    ((a, b),) = found.intervals
    assert a == pytest.approx((shift % n) * 0.2)
    assert b - a == pytest.approx((count - 1) * 0.2)


def test_all_or_nothing_in_contact():
    circle = Circle(5)
    assert contact_set_of_nodes(circle, np.zeros(5), np.ones(5)).intervals == ((0.0, 4.0),)
    assert contact_set_of_nodes(circle, np.ones(5), np.zeros(5)).intervals == ()


@pytest.mark.parametrize("n", [25, 31, 75])
def test_detachment_point_of_the_paper(discretisation, n):
    # In the middle of an edge; found to a twentieth of it.
    found = discretisation("paper", n).contact_set
    assert min(abs(s - 0.5) for s in found.detachments) < 0.05 / n
    assert min(abs(s - 0.5) for s in found.boundary) == pytest.approx(0.5 / n)


def test_nothing_in_contact(discretisation):
    assert discretisation("smooth", 25).contact_set.intervals == ()


def levels(*ends):
    return [ContactSet(4.0, (pair,), pair) for pair in ends]


def test_condition_a_h():
    verdict = condition_a_h(levels((0.45, 1.3), (0.5, 1.25), (0.48, 1.28)), CORNERS)
    assert verdict.holds
    assert verdict.points == pytest.approx((0.475, 1.275))
    balls = list(zip(verdict.points, verdict.radii, strict=True))
    # Definition 5.5: disjoint, away from the corners, one point of every level each.
    (d, r), (e, s) = balls
    assert d + r < e - s
    assert all(abs(p - c) > q for p, q in balls for c in (*CORNERS, 4.0))
    for a, b in ((0.45, 1.3), (0.5, 1.25), (0.48, 1.28)):
        assert abs(a - d) < r < abs(b - d)
        assert abs(b - e) < s < abs(a - e)


def test_condition_a_h_across_the_start_of_the_curve():
    verdict = condition_a_h(levels((3.9, 4.3), (3.85, 4.35), (3.95, 4.25)), (1.0, 2.0, 3.0))
    assert verdict.holds
    assert sorted(verdict.points) == pytest.approx([0.3, 3.9])


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (levels((0.5, 0.9), (0.5, 0.95), (0.5, 1.05)), "cannot avoid"),
        (levels((0.5, 0.9), (0.5, 0.5)), "single point"),
        ([*levels((0.5, 0.9)), ContactSet(4.0, ((0.5, 0.6), (0.7, 0.9)), ())], "2, 4"),
        (levels((0.1, 0.5), (0.5, 0.9)), "cannot avoid"),
    ],
)
def test_violations_of_condition_a_h(sets, message):
    verdict = condition_a_h(sets, CORNERS)
    assert not verdict.holds
    assert any(message in violation for violation in verdict.violations)


def test_condition_a_h_of_the_paper(discretisation):
    fine = [discretisation("paper", n).contact_set for n in (31, 51, 75)]
    assert condition_a_h(fine, CORNERS).holds
    # On a coarse mesh u_h lifts off at the corner (1, 0).
    coarse = discretisation("paper", 15).contact_set
    assert not condition_a_h([coarse, *fine], CORNERS).holds


def test_condition_a_h_without_levels_or_boundary():
    with pytest.raises(InputError, match="levels"):
        condition_a_h([], CORNERS)
    assert condition_a_h(levels((0.0, 4.0)), CORNERS).holds
