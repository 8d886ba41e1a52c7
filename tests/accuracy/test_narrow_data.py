"""Data that are narrower than the first mesh: loads, obstacles and layers are not overlooked."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from known import SCENES, bump, true_error
from mpi4py import MPI

from dolfinx_signorini.errors import InputError
from dolfinx_signorini.scenes import solve_scene
from dolfinx_signorini.scenes.enclosures import enclosed_on_boxes, enclosed_on_simplices
from dolfinx_signorini.scenes.formulas import FUNCTIONS
from dolfinx_signorini.scenes.looking import resolved_mesh
from dolfinx_signorini.scenes.parsing import parse
from dolfinx_signorini.scenes.reading import parse_scene

NUMBERS = st.floats(0.01, 9.0).map(lambda v: f"{v:.4g}")
UNARY = [name for name, (count, *_) in FUNCTIONS.items() if count == 1]
BINARY = [name for name, (count, *_) in FUNCTIONS.items() if count == 2]


def combined(inner):
    return st.one_of(
        st.tuples(inner, st.sampled_from("+-*/"), inner).map(lambda t: "({}{}{})".format(*t)),
        st.tuples(inner, st.sampled_from(["2", "3", "0", "1.5", "0.3", "-1", "-2", "-0.5"])).map(
            lambda t: f"({t[0]})^({t[1]})"
        ),
        st.tuples(st.sampled_from([*UNARY, "-"]), inner).map(lambda t: f"{t[0]}({t[1]})"),
        st.tuples(st.sampled_from(BINARY), inner, inner).map(lambda t: "{}({}, {})".format(*t)),
        st.tuples(inner, st.sampled_from(["<", "<=", ">", ">="]), inner, inner, inner).map(
            lambda t: "where({}{}{}, {}, {})".format(*t)
        ),
    )


FORMULAS = st.recursive(st.one_of(NUMBERS, st.sampled_from(["x", "y"])), combined, max_leaves=8)
PLACES = st.integers(-8, 8).map(lambda k: k / 4.0)


def read(text):
    try:
        return parse(text)
    except InputError:  # a part without a value
        return None


def assert_inside(formula, points, ends):
    """Python's own functions have the value of the formula at points inside of an interval."""
    for point in points.tolist():
        value = formula.value(point)
        assert math.isnan(value) or ends[0] <= value <= ends[1], (formula.text, point, value, ends)


@given(FORMULAS, PLACES, PLACES, st.sampled_from([0.0, 1e-3, 0.25, 3.0]), st.integers(0, 99))
def test_enclosures_contain_all_values(text, x, y, width, seed):
    formula = read(text)
    if formula is None:
        return
    low, high = np.array([[x, y]]), np.array([[x + width, y + 0.5 * width]])
    shares = np.random.default_rng(seed).random((40, 2))
    shares[:4] = [(0, 0), (1, 0), (0, 1), (1, 1)]
    points = low + shares * (high - low)
    assert_inside(formula, points, enclosed_on_boxes(formula, low, high)[:, 0])


@given(FORMULAS, st.lists(PLACES, min_size=6, max_size=6), st.booleans(), st.integers(0, 99))
def test_enclosures_contain_all_values_on_triangles_and_segments(text, places, plane, seed):
    formula = read(text)
    if formula is None:
        return
    corners = np.array(places).reshape(3, 2)[: 3 if plane else 2]
    shares = np.random.default_rng(seed).dirichlet(np.full(len(corners), 0.5), 40)
    shares[: len(corners)] = np.eye(len(corners))
    ends = enclosed_on_simplices(formula, corners[None])[:, 0]
    assert_inside(formula, np.clip(shares @ corners, corners.min(0), corners.max(0)), ends)


@pytest.mark.parametrize(
    ("text", "low", "high"),
    [
        ("sqrt(x)", 0.5, 2.0), ("exp(x)", -1.0, 2.0), ("sin(x)", -1.5, 1.5), ("cos(x)", 0.1, 3.1),
        ("tan(x)", -1.5, 1.5), ("asin(x)", -1.0, 1.0), ("acos(x)", -1.0, 1.0), ("atan(x)", -9, 9),
        ("sinh(x)", -2.0, 1.0), ("cosh(x)", 0.5, 2.0), ("tanh(x)", -2.0, 1.0), ("log(x)", 0.1, 4),
        ("abs(x)", -3.0, -1.0), ("sign(x)", 0.5, 2.0), ("atan2(1, x)", -2.0, 2.0),
        ("hypot(1, x)", 0.0, 2.0), ("min(x, 5)", 1.0, 2.0), ("max(x, 1.5)", 1.0, 2.0),
        ("where(x < 3, x, 9)", 1.0, 2.0), ("-x", 1.0, 2.0), ("x + 1", 1.0, 2.0),
        ("2 - x", 1.0, 2.0), ("3*x", -1.0, 2.0), ("1/x", 0.5, 2.0), ("x^3", -1.0, 2.0),
        ("x^1.5", 0.0, 2.0), ("x^-2", 1.0, 2.0),
    ],
)  # fmt: skip
def test_enclosures_of_monotone_functions_are_tight(text, low, high):
    formula = parse(text)
    values = sorted(formula.value((x, 0.0)) for x in (low, high))
    box = np.array([[low, 0.0]]), np.array([[high, 1.0]])
    assert enclosed_on_boxes(formula, *box)[:, 0] == pytest.approx(values, rel=1e-14, abs=1e-14)


def test_enclosures_on_simplices_are_too_wide_by_the_square_of_the_width_only():
    formula = parse("sin(3*x)*exp(y) - x*y/(1 + x^2) + x")
    excess = []
    for h in (0.1, 0.01):
        corners = np.array([[0.3, 0.4], [0.3 + h, 0.4], [0.3, 0.4 + h]])
        i, j = np.meshgrid(*2 * [np.linspace(0.0, 1.0, 60)])
        shares = np.column_stack((i.ravel(), ((1 - i) * j).ravel()))
        values = [formula.value(corners[0] + h * s) for s in shares]
        low, high = enclosed_on_simplices(formula, corners[None])[:, 0]
        excess.append(max(min(values) - low, high - max(values)))
    assert excess[1] < 0.02 * excess[0]


@pytest.mark.parametrize("width", [0.003, 0.001])
@pytest.mark.parametrize(("norm", "accuracy"), [("Linf", 1e-2), ("H1", 1e-1)])
def test_a_narrow_bump_is_not_overlooked(comm, width, norm, accuracy):
    known = bump(width, {})
    scene = parse_scene(known.text, Path("bump.toml"), comm)
    result = solve_scene(scene, comm, accuracy=accuracy, norm=norm, max_unknowns=300_000)
    assert result.found.reached
    assert true_error(result.u, known, norm) <= accuracy
    result.destroy()


PIN = """
[domain]
shape = "square"
cells = 8
[contact]
sides = "bottom"
obstacle = "-0.2 + 0.4*exp(-((x - 0.4713)/0.001)^2)"
[[dirichlet]]
sides = "top"
value = 0
"""


def test_a_pin_is_not_overlooked(comm):
    scene = parse_scene(PIN, Path("pin.toml"), comm)
    result = solve_scene(scene, comm, accuracy=2e-2, norm="Linf", max_unknowns=100_000)
    x = result.u.function_space.tabulate_dof_coordinates()
    near = np.hypot(x[:, 0] - 0.4713, x[:, 1]) < 5e-3
    highest = comm.allreduce(float(result.u.x.array[near].max(initial=0.0)), op=MPI.MAX)
    assert result.found.reached
    assert highest == pytest.approx(0.2, abs=5e-3)
    result.destroy()


def first_mesh(comm, text, degree=2):
    scene = parse_scene(text, Path("scene.toml"), comm)
    scene = replace(scene, domain=scene.domain.first(), degree=degree)
    sided = scene.domain.make(comm)
    return scene, sided, resolved_mesh(scene, sided)


def cells(sided):
    return sided.mesh.topology.index_map(sided.mesh.topology.dim).size_global


@pytest.mark.parametrize(
    "name", ["corner of 240 degrees", "layer", "kink of the obstacle", "edge of a cube"]
)
def test_the_mesh_of_a_scene_without_narrow_data_stays(comm, name):
    _, sided, found = first_mesh(comm, SCENES[name].text)
    assert found.sided is sided
    assert found.notes == ()
