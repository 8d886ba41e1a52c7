"""Interfaces: where they cross segments, and the data on both sides, against closed forms."""

import numpy as np
import pytest

from dolfinx_signorini.data.derivatives import Derivative
from dolfinx_signorini.data.formulas import evaluated
from dolfinx_signorini.data.interfaces.interface import interfaces
from dolfinx_signorini.data.interfaces.pieces import subdivide
from dolfinx_signorini.data.parsing import parse

pytestmark = pytest.mark.pure


def on_circle(count):
    angles = np.random.default_rng(2).uniform(0.0, 2.0 * np.pi, count)
    return np.stack((np.cos(angles), np.sin(angles)), axis=1)


def test_zeros_along_rays_are_on_the_circle():
    (circle,) = interfaces(parse("where(x^2 + y^2 < 0.36, 1, 2)"))
    ends = on_circle(500)
    shares = circle.zeros(np.zeros_like(ends), ends)
    assert np.abs(shares - 0.6).max() < 1e-15
    assert circle.gradients(ends) == pytest.approx(2.0 * ends)


@pytest.mark.parametrize(
    ("text", "zero"),
    [
        ("x^5 - 1e-10", 1e-2),  # flat: Newton's steps are long
        ("where(x < 0.3, -1, 1)", 0.3),  # a jump: no slope
        ("atan(1e9*(x - 0.7))", 0.7),  # steep: Newton's steps leave the segment
        ("abs(x - 0.2) - 0.1*x", 0.2 / 1.1),  # a kink beside
        ("exp(40*x) - exp(2)", 0.05),
    ],
)
def test_zeros_of_functions_that_mislead(text, zero):
    interface = interfaces(parse(f"abs({text})"))[0]
    start, end = np.array([[0.0, 0.0]]), np.array([[0.21, 0.0]])
    if zero > 0.2:
        start, end = np.array([[0.1, 0.0]]), np.array([[1.0, 0.0]])
    (share,) = interface.zeros(start, end)
    assert (start + share * (end - start))[0, 0] == pytest.approx(zero, abs=1e-13)


@pytest.mark.parametrize(
    "text",
    [
        "where(x < 0.5, {a}, {b})",
        "where(2*(0.5 - x) > 0, {a}, {b})",
        "where((x - 0.5)^3*(3 + y) <= 0, {a}, {b})",
        "where((0.5 - x)/(y + 1) >= 0, {a}, {b})",
        "{a} + ({b} - ({a}))*(1 + sign(x - 0.5))/2",
    ],
)
def test_data_on_both_sides_are_the_chosen_branches(text):
    a, b = "sin(x)*y", "3 + x^2"
    formula = parse(text.format(a=a, b=b))
    x = np.stack((np.full(9, 0.5), np.linspace(0.1, 0.9, 9)), axis=1)
    # One of the factors of what decides is zero at the points: its sign names the sides.
    (own,) = [i for i in interfaces(formula) if (np.abs(i.values(x)) < 1e-12).all()]
    way = np.sign(own.values(x + np.array([1e-3, 0.0])))[0]
    for side, wanted, slope in (
        (-way, np.sin(0.5) * x[:, 1], np.cos(0.5) * x[:, 1]),
        (way, 3.25 + 0.0 * x[:, 1], 1.0 + 0.0 * x[:, 1]),
    ):
        of_side = own.sides[side]
        assert evaluated(of_side(formula.root), x) == pytest.approx(wanted, rel=1e-12)
        along_x = of_side(Derivative(0)(formula.root))
        assert evaluated(along_x, x) == pytest.approx(slope, rel=1e-12)


def test_subdivision_finds_the_area_of_a_disc_and_stops_at_its_limits():
    square = np.array([[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], [[0.0, 0.0], [0.0, 1.0], [1.0, 1.0]]])
    seen = []

    def look(pieces, owners, level):
        far = np.linalg.norm(pieces, axis=2)
        seen.append((level, len(pieces)))
        return (far.min(axis=1) < 0.8) & (far.max(axis=1) > 0.8), [far.max(axis=1) <= 0.8]

    def area(**limits):
        total, whole = 0.0, 0.0
        for parts, _, level, (inner,) in subdivide(square, np.arange(2), look, **limits):
            sizes = 0.5 * np.abs(np.linalg.det(parts[:, 1:] - parts[:, :1]))
            assert sizes == pytest.approx(0.5 * 0.25**level)
            total, whole = total + sizes[inner].sum(), whole + sizes.sum()
        assert whole == pytest.approx(1.0)
        return total

    exact = 0.16 * np.pi
    assert 0.0 < exact - area(deepest=8) < 0.01
    assert max(level for level, _ in seen) == 8
    seen.clear()
    assert area(most=10, deepest=8) < exact - 0.01
    assert max(level for level, _ in seen) < 8
