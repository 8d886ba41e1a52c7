"""Formulas without choices against the formulas themselves, at the points of a dense lattice."""

import basix
import numpy as np
import pytest

from dolfinx_signorini.data.branches import decided
from dolfinx_signorini.data.formulas import evaluated
from dolfinx_signorini.data.interfaces.pieces import inside
from dolfinx_signorini.data.parsing import parse

pytestmark = pytest.mark.pure

FORMULAS = {
    "line": "where(x + 0.4*y < 0.51, 1 + x, 7*y)",
    "the other way round": "where(0.51 >= x + 0.4*y, 1 + x, 7*y)",
    "greater": "where(x > 0.3, x, 2)*where(y >= 0.7, 3, y)",
    "circle": "where((x - 0.5)^2 + (y - 0.4)^2 < 0.09, 1, 1000)",
    "kinks": "max(x - y, 0.1) + min(x, 0.6) + abs(y - 0.3)",
    "sign": "sign(sin(7*x) - y)*exp(x)",
    "sums": "abs(x - 2) + 3*abs(y - 3) + 5*abs(x - 4) + sign(y - 5) + 7*abs(y - 9)",
    "product": "max(0, (x - 0.3)*(0.7 - x)) + where(y*(x - 0.5)/(2 - x)^2 > 0, 1, 2)",
    "product of roots": "where(-(0.9 - x)*(y - 0.5)^3*(x*y - 0.2) >= 0, 1, 2)",
    "no value": "where(sqrt(x - 0.4) < 9, 1, 100)",
    "inside of each other": "abs(abs(x - 0.5) - 0.2) + where(max(x, y) > 0.6, 1, 2)",
}


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("text", FORMULAS.values(), ids=FORMULAS)
def test_shares_and_values_of_other_choices(text, dimension):
    formula = parse(text, dimension)
    rng = np.random.default_rng(5)
    start = rng.random((60, 1, dimension))
    corners = start + 0.3 * (rng.random((60, dimension + 1, dimension)) - 0.5)
    kind = {2: basix.CellType.triangle, 3: basix.CellType.tetrahedron}[dimension]
    steps = {2: 90, 3: 30}[dimension]
    lattice = basix.create_lattice(kind, steps, basix.LatticeType.equispaced, False)
    parts = decided([formula], corners)
    assert sorted(np.concatenate([part.cells for part in parts])) == list(range(60))
    for part in parts:
        points = inside(corners[part.cells], lattice)
        truth, own = evaluated(formula.root, points), evaluated(part.formulas[0].root, points)
        apart = np.abs(truth - own) > 1e-12
        assert (apart.mean(axis=0) <= part.shares + 0.02).all()
        slack = 0.6 if "abs(abs" in text else (1.0 if "sqrt" in text else 0.1)
        assert (part.shares <= 6.0 * apart.mean(axis=0) + slack).all()
        others = np.array([evaluated(f.root, points) for (f,) in part.others])
        if len(part.others) > 1:
            assert (np.abs(others - truth).min(axis=0)[apart] < 1e-12).all()


def test_a_line_along_an_edge_up_to_rounding_leaves_next_to_nothing():
    ends = [[0.0, 0.67], [0.67, 0.0]]
    corners = np.array([[*ends, [1.0, 0.9]], [*ends, [0.0, 0.0]]])
    parts = decided([parse("where(x + y < 0.1 + 0.57, 1, 2)")], corners)
    found = {int(part.cells[0]): part for part in parts}
    for cell, value in ((0, 2.0), (1, 1.0)):
        assert found[cell].shares[0] < 1e-13
        assert evaluated(found[cell].formulas[0].root, corners[0, 0]) == value


def test_a_product_is_as_clear_next_to_its_zeros_as_its_factors():
    """The product's own derivatives change their signs on wide cells between both lines."""
    corners = np.array([[[0.3, 0.0], [0.7, 0.0], [0.3, 1.0]], [[0.3, 0.0], [0.0, 0.0], [0.3, 1.0]]])
    parts = decided([parse("max(0, (x - 0.3)*(0.7 - x))")], corners)
    found = {int(part.cells[0]): part for part in parts}
    inside_, outside = np.array([0.5, 0.2]), np.array([0.2, 0.2])
    for cell, place, value in ((0, inside_, 0.04), (1, outside, 0.0)):
        assert found[cell].shares[0] < 1e-13
        assert evaluated(found[cell].formulas[0].root, place) == pytest.approx(value)


def test_many_choices_keep_the_formula():
    text = " + ".join(f"abs(x - {0.1 * k:.1f})*sign(y - {0.1 * k:.1f})" for k in range(1, 10))
    rng = np.random.default_rng(2)
    corners = rng.random((200, 1, 2)) + 0.05 * rng.random((200, 3, 2))
    (part,) = decided([parse(text)], corners)
    assert part.formulas[0].root is not None and not part.others and not part.shares.any()


@pytest.mark.parametrize("signs", [(-1, 1, 1), (-1, -1, 1), (-1, 1, 1, 1), (-1, -1, -1, 1)])
def test_shares_next_to_lines_and_planes(signs):
    d = len(signs) - 1
    rng = np.random.default_rng(3)
    corners = rng.random((40, d + 1, d))
    for simplex in corners:  # a linear function with these signs at the vertices
        values = np.array(signs) * (0.1 + rng.random(d + 1))
        slopes = np.linalg.solve(np.column_stack((simplex, np.ones(d + 1))), values)
        names = "xyz"[:d]
        line = " + ".join(f"({float(s)!r})*{n}" for s, n in zip(slopes, names, strict=False))
        formula = parse(f"where({line} + ({float(slopes[-1])!r}) > 0, 1, 2)", d)
        (part,) = decided([formula], simplex[None])
        shares = rng.dirichlet(np.ones(d + 1), 40_000)
        negative = (shares @ values < 0.0).mean()
        truth = min(negative, 1.0 - negative)
        assert truth - 0.01 <= part.shares[0] <= truth + {2: 0.01, 3: 0.06}[d]


def test_a_quotient_changes_its_sign_with_its_denominator():
    formula = parse("where((2 - x)*(2 - y)/(x - 0.43) > 0, 1, 2)")
    (part,) = decided([formula], np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]]))
    negative = 0.5 - 0.57**2 / 2.0  # the area with x < 0.43
    assert part.shares[0] >= min(2.0 * negative, 1.0 - 2.0 * negative)
