"""Points at which formulas are like a power of the distance, by differences of their values."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import binom

from dolfinx_signorini.data.formulas import evaluated
from dolfinx_signorini.data.parsing import parse
from dolfinx_signorini.data.powers import singular_points

SQUARE = np.array([[[0, 0], [1, 0], [0, 1]], [[1, 0], [1, 1], [0, 1]]], dtype=float)
# In the distance r, its square q, the angle t, and the coordinates X and Y from the point.
FORMULAS = [
    "{r}^{s}*cos({s}*{t} + 0.3)",
    "sin(3*x + y) - {r}^{s}",
    "(2 + x)/(1 + {r}^{s})",
    "{X}*{r}^{s}",
    "{q}^({s}/2)*exp(y)",
    "exp(sqrt({q})^{s}) + atan(5*{X})",
    "sin({Y})*abs({r})^{s} + {q}^2 + {r}^2",
    "{r}^({s} + 3)/{q} - 1/(2 + {r}^6)",
    "log(2 + {r}^{s}) + asin(0.5*{Y})",
]


def formula(text, point, s=1.0):
    """A formula around a point."""
    X, Y = (f"({name} - {float(at)!r})" for name, at in zip("xy", point, strict=True))
    known = {"X": X, "Y": Y, "q": f"({X}*{X} + {Y}^2)", "r": f"hypot({X}, {Y})"}
    return parse(text.format(t=f"atan2(-{Y}, -{X})", s=repr(s), **known))


def measured(f, point, ray):
    """The exponent by fifth differences along a ray, which leave nothing of what is smooth."""
    sizes = []
    for step in (2e-3, 1e-3):
        x = np.array(point) + step * np.arange(1.0, 7.0)[:, None] * ray
        weights = (-1.0) ** np.arange(6) * binom(5, np.arange(6))
        sizes.append(abs(float(weights @ evaluated(f.root, x))))
    return math.log2(sizes[0] / sizes[1])


@given(
    text=st.sampled_from(FORMULAS),
    point=st.tuples(st.floats(0.1, 0.45), st.floats(0.1, 0.45)),
    whole=st.integers(0, 1),
    part=st.floats(0.4, 0.85),
)
def test_the_exponent_is_that_of_differences(text, point, whole, part):
    f = formula(text, point, whole + part)
    ((place, exponent),) = singular_points(f, SQUARE)
    assert place == pytest.approx(point, abs=1e-12)
    assert exponent == pytest.approx(measured(f, point, np.array([0.6, 0.8])), abs=0.2)


@pytest.mark.parametrize(
    "text", ["{q}", "{q}^2", "{r}^4", "exp({q}) + {X}*{Y}", "x*y", "1", "1/x", "hypot(x, 1)"]
)
def test_smooth_formulas_have_no_singular_point(text):
    assert not list(singular_points(formula(text, (0.3, 0.4)), SQUARE))


@pytest.mark.parametrize(("text", "exponent"), [("log({q})", 0.0), ("{Y}*log({r})", 1.0)])
def test_a_logarithm_is_no_power(text, exponent):
    ((_, found),) = singular_points(formula(text, (0.3, 0.4)), SQUARE)
    assert found == exponent


def test_a_point_is_found_where_the_parts_meet_alone():
    """On the side of a domain, for a point that no end of a facet is; but not of curved parts."""
    facets = np.array([[[1.0, 0.0], [1.0, 0.6]], [[1.0, 0.6], [1.0, 1.0]]])
    f = formula("{r}^0.5", (1.0, 0.512952))
    ((place, _),) = singular_points(f, facets)
    assert place == pytest.approx((1.0, 0.512952))
    assert not list(singular_points(f, facets[1:]))
    assert not list(singular_points(f, facets - [[[1e-3, 0.0]]]))
    bent = formula("hypot({X} + {Y}^2, {Y})^0.5", (0.3, 0.1))
    assert not list(singular_points(bent, SQUARE))


@pytest.mark.parametrize(
    ("text", "exponent"),
    [
        ("where({X} < 0, 1, x)", 0.0),
        ("sign({X})*exp(x)", 0.0),
        ("abs({X})*cos(y)", 1.0),
        ("max({X}, 0) + 1e3*x^2", 1.0),
        ("where({X} < 0, {X}, {X}^2)", 1.0),
        ("max({X}, 0)^2", None),
        ("where({X} < 0, {X}*x, {X}*x)", None),
        ("where({Y} < 1, x, abs(x))", None),  # the same on all of the side
    ],
)
def test_jumps_and_kinks_on_a_side_are_points(text, exponent):
    side = np.array([[[0.0, 0.0], [0.4, 0.0]], [[0.4, 0.0], [1.0, 0.0]]])
    point = (0.712952, 0.0)
    found = list(singular_points(formula(text, point), side))
    assert len(found) == (exponent is not None)
    for place, s in found:
        assert place == pytest.approx(point, abs=1e-12) and s == exponent
    assert not list(singular_points(formula(text, point), SQUARE))  # along a line in cells


def test_the_cells_around_a_point():
    for point, around in (((0.5, 0.5), []), ((0.0, 1.0), [0, 1]), ((1.0, 1.0), [1])):
        (found,) = singular_points(formula("{r}^0.5", point), SQUARE)
        assert np.flatnonzero(found.is_vertex_of(SQUARE)).tolist() == around
