"""Discs, fits and interpolations of formulas against complex values, dense lattices and rules."""

import math

import basix
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.data import approximations
from dolfinx_signorini.data.analytic import discs
from dolfinx_signorini.data.approximations import approximated, followed, followed_in_parts
from dolfinx_signorini.data.formulas import evaluated
from dolfinx_signorini.data.interfaces.pieces import divided, inside, relative_sizes
from dolfinx_signorini.data.interpolations import missed_by_interpolation
from dolfinx_signorini.data.matrices import inverse_entries
from dolfinx_signorini.data.parsing import parse
from dolfinx_signorini.meshes.polynomials import polynomials
from dolfinx_signorini.meshes.quadrature import rule
from dolfinx_signorini.meshes.sided_meshes import simplex_sizes

pytestmark = pytest.mark.pure

UNARY = "sqrt exp sin cos tan asin acos atan sinh cosh tanh log".split()  # noqa: SIM905
NUMBERS = st.floats(0.05, 4.0).map(lambda v: f"{v:.3g}")


def combined(inner):
    return st.one_of(
        st.tuples(inner, st.sampled_from("+-*/"), inner).map(lambda t: "({}{}{})".format(*t)),
        st.tuples(inner, st.sampled_from(["2", "3", "1.5", "0.3", "-1", "-2", "-0.5"])).map(
            lambda t: f"({t[0]})^({t[1]})"
        ),
        st.tuples(st.sampled_from(UNARY), inner).map(lambda t: f"{t[0]}({t[1]})"),
    )


ANALYTIC = st.recursive(st.one_of(NUMBERS, st.sampled_from(["x", "y"])), combined, max_leaves=7)
CHOICES = st.tuples(
    ANALYTIC,
    st.sampled_from(["abs({a})", "min({a}, {b})", "max({a}, {b})", "where({a} < {b}, {a}, {b})",
                     "sign({a})*{b}", "where(({a} - 1)*{b} > 0, {a}, {b})",
                     "max(0, {a}*(1 - {b}))", "hypot({a}, {b})", "atan2({a}, {b})"]),
    ANALYTIC,
).map(lambda t: t[1].format(a=t[0], b=t[2]))  # fmt: skip
COMPLEX = {"^": lambda a, b: a**b, "+": lambda a, b: a + b, "-": lambda a, b: a - b}
COMPLEX |= {"*": lambda a, b: a * b, "/": lambda a, b: a / b, "negative": lambda a: -a}


def read(text):
    try:
        return parse(text)
    except InputError:  # a part without a value
        return None


def complex_value(node, point):
    """The value at a complex point, by other functions."""
    if node.op in ("number", "coordinate"):
        return node.value if node.op == "number" else point[int(node.value)]
    args = [complex_value(a, point) for a in node.args]
    return (COMPLEX.get(node.op) or getattr(mpmath, node.op))(*args)


def triangle(x, y, width):
    return np.array([x, y]) + width * np.array([[0.0, 0.0], [1.0, 0.2], [0.3, 0.9]])


@settings(max_examples=150)
@given(ANALYTIC, st.floats(0.1, 1.5), st.floats(0.1, 1.5), st.sampled_from([0.3, 0.05]),
       st.sampled_from([2.5, 8.0]), st.integers(0, 99))  # fmt: skip
def test_discs_contain_all_complex_values(text, x, y, width, reach, seed):
    formula = read(text)
    if formula is None:
        return
    corners = triangle(x, y, width)
    (centre,), (radius,) = discs(formula, corners[None], reach)
    if math.isinf(radius):
        return
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    half = 0.5 * (corners.max(axis=0) - corners.min(axis=0))
    turns = np.exp(2j * math.pi * np.random.default_rng(seed).random((30, 2)))
    for point in middle + reach * half * turns:
        value = complex(complex_value(formula.root, [mpmath.mpc(complex(z)) for z in point]))
        assert abs(value - centre) <= radius * (1 + 1e-9) + 1e-11 * (1 + abs(centre))


def test_discs_are_tight():
    corners = np.array([[[0.0], [2.0]]])
    for text, radius in [("x^3", 63.0), ("exp(x)", math.e * (math.e**3 - 1)), ("1/(5 + x)", 1 / 6)]:
        assert discs(parse(text), corners, 3.0)[1] == pytest.approx(radius)


def test_discs_of_a_product_next_to_its_zeros():
    """At the ends of the first three segments factors vanish; the last one has a kink inside."""
    product = "(x - 0.3)*(0.4 - x)"
    corners = np.array([[[0.3], [0.4]], [[0.4], [0.5]], [[0.2], [0.3]], [[0.35], [0.45]]])
    for reach in (2.5, 8.0, 20.0):
        radii = discs(parse(f"max(0, {product})"), corners, reach)[1]
        assert radii[0] == discs(parse(product), corners, reach)[1][0]
        assert radii[1] == radii[2] == 0.0 and math.isinf(radii[3])


def composite(formula, corners, divisions):
    """A fine rule on a triangle: points of the reference triangle, weights, and values."""
    unit = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    pieces = np.concatenate((unit, corners), axis=1)[None]
    for _ in range(divisions):
        pieces, _ = divided(pieces, np.zeros(len(pieces), dtype=int))
    points, weights = rule(2, 9)
    places = inside(pieces, points).reshape(-1, 4)
    values = evaluated(formula.root, places[:, 2:])
    return places[:, :2], np.repeat(weights, len(pieces)) / len(pieces), values


@settings(max_examples=60)
@given(st.one_of(ANALYTIC, CHOICES), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0),
       st.sampled_from([1.0, 0.2, 0.02]), st.sampled_from([1e-1, 1e-3, 1e-6]))  # fmt: skip
def test_approximations_miss_no_more_than_they_say(text, x, y, width, tolerance):
    formula = read(text)
    if formula is None:
        return
    corners = triangle(x, y, width)
    found = approximated(formula, MPI.COMM_SELF, corners[None], 3, np.ones((2, 1)), tolerance)
    if not np.isfinite(found.missed[0]):
        return
    measured = []
    for divisions in (3, 4, 5):
        places, weights, values = composite(formula, corners, divisions)
        if not np.isfinite(values).all():
            return
        table = polynomials(2, 3, places)
        rest = values - found.coefficients[0] @ table
        moments = np.abs(table @ (weights * rest)) / np.abs(table).max(axis=1)
        measured.append((math.sqrt(weights @ rest**2), moments))
    norms, moments = (np.array(values) for values in zip(*measured, strict=True))
    rounding = 1e-11 * (1.0 + np.abs(values).max())
    # Next to poles, kinks and jumps the fine rule is wrong, and rougher ones are more so.
    assert norms[-1] - np.ptp(norms) <= found.missed[0] * 1.001 + rounding
    least = (moments[-1] - np.ptp(moments, axis=0)).max()
    assert least <= found.mean[0] + 1e-6 * found.missed[0] + rounding


@pytest.mark.parametrize(
    ("text", "most"),
    [("exp(x)*sin(2*y)", 4e-3), ("where(x < 0.5, 1, 3)", 1e-6), ("abs(x - 0.4)", 2e-2),
     ("hypot(x, y)^1.5", 5e-3), ("where(x + y < 0.7, 0, 1)", 0.2),
     ("exp(-((x - 0.3)^2 + (y - 0.4)^2)/1e-6)", 0.1)],
)  # fmt: skip
def test_approximations_are_close(text, most):
    """At a jump along a side rounding decides which value is taken, on a share of 1e-15."""
    corners = np.array([[[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]], [[0.5, 0.0], [1.0, 0.0], [0.5, 0.9]]])
    found = approximated(parse(text), MPI.COMM_SELF, corners, 3, np.ones((2, 2)), 1e-3)
    assert found.missed.max() < most and found.mean.max() < 2e-2 and found.hidden < 2e-3


def test_ranks_with_different_formulas_stop_at_the_same_level(comm, monkeypatch):
    # Longer formulas are divided into fewer pieces, and a rank that stopped by itself left the
    # others waiting.
    monkeypatch.setattr(approximations, "MOST_WORK", 200)
    bump = "exp(-((x - 0.3137)^2 + (y - 0.4111)^2)/1e-6)"
    longer = " + ".join(f"{bump}*sin({k}*x)" for k in range(1, 20))
    corners = np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])
    text = longer if comm.rank == 0 else bump
    found = approximated(parse(text), comm, corners, 2, np.ones((2, 1)), 1e-8)
    assert len(set(comm.allgather(found.hidden))) == 1


def test_a_narrow_bump_is_found():
    corners = np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])
    text = "exp(-((x - 0.3137)^2 + (y - 0.4111)^2)/1e-6)"
    found = approximated(parse(text), MPI.COMM_SELF, corners, 2, np.ones((2, 1)), 1e-8)
    assert found.missed[0] == pytest.approx(math.sqrt(math.pi * 1e-6), rel=1e-2)
    assert found.coefficients[0, 0] == pytest.approx(2.0 * math.pi * 1e-6, rel=1e-6)


@settings(max_examples=60)
@given(st.one_of(ANALYTIC, CHOICES), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0),
       st.sampled_from([1.0, 0.2, 0.02]))  # fmt: skip
def test_polynomials_that_follow_a_formula_at_every_point(text, x, y, width):
    formula = read(text)
    if formula is None:
        return
    corners = triangle(x, y, width)
    coefficients, bounds = followed(formula, corners[None], 3)
    if math.isinf(bounds[0]):
        return
    lattice = basix.create_lattice(basix.CellType.triangle, 40, basix.LatticeType.equispaced, True)
    values = evaluated(formula.root, inside(corners[None], lattice)[:, 0])
    rest = values - coefficients[0] @ polynomials(2, 3, lattice)
    rest = rest[np.isfinite(rest)]
    assert np.abs(rest).max(initial=0.0) <= bounds[0] + 1e-11 * (1.0 + np.nanmax(np.abs(values)))


@settings(max_examples=100)
@given(st.one_of(ANALYTIC, CHOICES), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0),
       st.sampled_from([1.0, 0.2, 0.02]), st.sampled_from([4, 7, 10]))  # fmt: skip
def test_interpolations_miss_no_more_than_they_say(text, x, y, width, degree):
    formula = read(text)
    if formula is None:
        return
    corners = triangle(x, y, width)[:2]
    value, slope, root = missed_by_interpolation(formula, corners[None], degree)[:, 0]
    nodes = np.polynomial.legendre.Legendre.basis(degree).deriv().roots()  # of Gauss and Lobatto
    nodes = np.concatenate(([0.0], 0.5 * (1.0 + nodes), [1.0]))
    t = np.linspace(0.0, 1.0, 20_001)

    def f(t):
        return evaluated(formula.root, corners[0] + t[:, None] * (corners[1] - corners[0]))

    if not (np.isfinite(root) and np.isfinite(f(t)).all()):
        return
    near = np.polynomial.Polynomial.fit(nodes, f(nodes), degree, domain=[0.0, 1.0])
    rest = f(t) - near(t)
    rounding = 1e-10 * (1.0 + np.abs(f(t)).max())
    assert np.abs(rest).max() <= value * 1.001 + rounding
    changes = np.diff(rest) / np.diff(t)
    assert np.abs(changes).max() <= slope * 1.001 + 2e4 * rounding
    assert math.sqrt(np.mean(changes**2)) <= root * 1.001 + 2e4 * rounding


def test_interpolations_of_smooth_formulas_miss_little():
    corners = np.array([[[0.1, 0.0], [0.2, 0.0]], [[0.4, 0.0], [0.5, 0.0]]])
    smooth = missed_by_interpolation(parse("sin(3*x)"), corners, 7)
    assert smooth.max() < 1e-6
    kink = missed_by_interpolation(parse("max(x - 0.46, 0)"), corners, 7)
    assert kink[:, 0].max() < 1e-12 and 0.01 < kink[2, 1] < 0.1


@pytest.mark.parametrize("part", [1, 3, 8, 16])
@pytest.mark.parametrize("start", [0.0, 10.42])
@pytest.mark.parametrize("text", ["where(x < {m!r}, 1, 2)", "atan2(x - {m!r}, y)"])
def test_derivatives_of_data_that_jump_have_no_bound(text, start, part):
    width = 1e-6 if start else 0.5
    ends = start, start + width
    corners = np.array([[[ends[0], -1.0], [ends[1], -1.0]]])
    jump = ends[1] if part == 16 else start + part / 16 * (ends[1] - start)
    _, slope, root = missed_by_interpolation(parse(text.format(m=jump)), corners, 7)[:, 0]
    assert math.isinf(slope) and math.isinf(root)


@pytest.mark.parametrize("text", ["1/(0.5 - x)", "1/(x - x)", "1/(0.25 - x)"])
def test_derivatives_of_data_with_poles_have_no_bound(text):
    corners = np.array([[[0.0, 0.0], [0.5, 0.0]], [[0.0, 0.0], [1.0, 0.0]]])
    assert np.isinf(missed_by_interpolation(parse(text), corners, 4)[1:]).all()


@pytest.mark.parametrize("n", [1, 2, 3])
def test_inverses_of_matrices(n):
    matrix = np.random.default_rng(n).random((n, n)) + 4.0 * np.eye(n)
    entries = inverse_entries([parse(repr(float(v)), 3) for v in matrix.ravel()])
    values = [entry.value((0.0, 0.0, 0.0)) for entry in entries]
    assert np.array(values).reshape(n, n) == pytest.approx(np.linalg.inv(matrix))


@pytest.mark.parametrize(
    ("text", "most"),
    [
        ("where(x + y < 0.7, sin(x), sin(x) + (x + y - 0.7)^2)", 0.02),
        ("sqrt(max(x - 0.3, 0)^3 + 0.1)", 0.02),
        ("abs(x - y + 0.1)", 0.15),
        ("where(x < 0.4, 1, 2)*y", 1.0),
        ("where(hypot(x - 0.4, y - 0.3) < 0.012, 1, 0)", 1.1),
    ],
)
def test_what_follows_a_formula_with_branches_is_near_at_every_point(text, most):
    formula, corners = parse(text), np.array([[[0.0, 0.0], [1.0, 0.1], [0.2, 0.9]]])
    places = np.random.default_rng(1).dirichlet(np.ones(3), 4000)
    coefficients, missed = followed_in_parts(formula, corners, 4)
    own = coefficients[0] @ polynomials(2, 4, places[:, 1:])
    apart = np.abs(evaluated(formula.root, places @ corners[0]) - own).max()
    assert 0.0 < apart <= missed[0] <= most


@pytest.mark.parametrize(
    "load",
    [
        "where(x + 0.3*y < 0.52, 1, 40)",
        "abs(x - 0.4)*sin(3*y) + where(x*y < 0.2, exp(x), 0)",
        "max(x + y - 0.7, 0)^2 - min(y - 0.3, x^2)*where(y < 0.62, 1, -3)",
        "where(x^2 + y^2 < 0.3, 1, 40)",
        "where(x^2 + y^2 + z^2 < 0.3, 1 + x, 40)",
        "where((x - 0.5)*(y - 0.45) > 0, 3, z)",
    ],
)
@pytest.mark.parametrize("cut", [True, False])
def test_data_on_the_other_side_of_a_cut_count(load, cut, monkeypatch):
    """With all that is left taken for slivers: the mean square of the difference, on a lattice."""
    monkeypatch.setattr(approximations, "SOLVED", 1.0)
    if not cut:
        unchanged = lambda self, pieces, d: (pieces, np.arange(len(pieces)))  # noqa: E731
        monkeypatch.setattr(approximations.Interface, "cut", unchanged)
    d = 3 if "z" in load else 2
    formula = parse(load, d)
    corners = np.concatenate((np.zeros((1, d)), np.eye(d)))[None]
    for _ in range(3):
        corners, _ = divided(corners, np.zeros(len(corners)))
    limits = approximations._Limits(
        MPI.COMM_SELF, simplex_sizes(corners), np.ones((2, len(corners))), 1e-9
    )
    lattice = np.random.default_rng(1).dirichlet(np.ones(d + 1), 4000)
    covered, larger = np.zeros(len(corners)), 0
    for branch in approximations._branches(formula, corners, limits):
        points = np.tensordot(lattice, branch.pieces[..., d:], (1, 1))
        values, own = (evaluated(f.root, points) for f in (formula, branch.formula))
        square, size = ((values - own) ** 2).mean(axis=0), np.abs(values - own).mean(axis=0)
        root, mean = branch.apart
        with np.errstate(invalid="ignore"):
            share, far = np.nan_to_num((mean / root) ** 2), np.nan_to_num(root**2 / mean)
        chance = 4.0 * np.sqrt(share / len(lattice))  # deviations of the share of points at random
        assert (square <= root**2 + far**2 * chance + 1e-30).all()
        assert (size <= mean + far * chance + 1e-30).all()
        shares = relative_sizes(branch.pieces)
        covered += np.bincount(branch.owners, shares, len(corners))
        larger += int((square > 0.0).sum())
    assert covered == pytest.approx(np.ones(len(corners)), rel=1e-12)
    assert cut or larger > 5
