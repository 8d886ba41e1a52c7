"""Data that are narrower than the first mesh: loads, obstacles and layers are not overlooked."""

import math
from dataclasses import replace
from pathlib import Path

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from known import SCENES, Known, bump, true_error
from mpi4py import MPI

from dolfinx_signorini.accuracy import first_mesh as first_mesh_module
from dolfinx_signorini.accuracy.first_mesh import resolved_mesh
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.data import sampling
from dolfinx_signorini.data.enclosures import enclosed_on_boxes, enclosed_on_simplices
from dolfinx_signorini.data.formulas import evaluated
from dolfinx_signorini.data.operations import FUNCTIONS
from dolfinx_signorini.data.parsing import parse
from dolfinx_signorini.meshes.elements import control_points, values_at_control_points
from dolfinx_signorini.scenes import solve_scene
from dolfinx_signorini.scenes.files.reading import load_scene, parse_scene
from dolfinx_signorini.scenes.scene_data import data_of

NUMBERS = st.floats(0.01, 9.0).map(lambda v: f"{v:.4g}")
UNARY = [name for name, known in FUNCTIONS.items() if known.arguments == 1]
BINARY = [name for name, known in FUNCTIONS.items() if known.arguments == 2]


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
EXACT = {"sin": mpmath.sin, "exp": mpmath.exp, "hypot": mpmath.hypot}
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


@pytest.mark.pure
@settings(max_examples=200)
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


@pytest.mark.pure
@settings(max_examples=200)
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


@pytest.mark.pure
@pytest.mark.parametrize(
    "text",
    [
        "where(x < 0.3, 0, x)", "where(x <= y, x, 5)", "where(x > 0.3, x, 2)", "sign(x - 0.31)*y",
        "where(x >= y, -y, y)", "atan2(y - 0.4, x - 0.9)", "1/(x - 0.31)", "(x - 0.31)^-2",
        "tan(3*x + y)", "abs(x - 0.31) - abs(y - 0.4)", "hypot(x - 0.31, y - 0.4)", "sin(9*x*y)",
        "min(x, y)*max(x, 0.5)", "where(x > 0.31, sqrt(x - 0.31), 0)", "log(abs(x - 0.31))",
        "x*y - x^2 + y^3", "acos(x - y)", "cosh(x - 0.31)", "asin(x)*tanh(y)", "cos(8*x)^2",
    ],
)  # fmt: skip
@pytest.mark.parametrize("width", [1.0, 0.1, 1e-3])
def test_enclosures_contain_jumps_kinks_and_poles(text, width):
    formula = parse(text)
    corners = np.array([0.31, 0.4]) + width * np.array([[-0.4, -0.3], [0.6, -0.3], [-0.3, 0.6]])
    shares = np.random.default_rng(1).dirichlet(np.ones(3), 200)
    ends = enclosed_on_simplices(formula, corners[None])[:, 0]
    assert_inside(formula, shares @ corners, ends)


@pytest.mark.pure
def test_ends_are_rounded_outwards():
    places = np.random.default_rng(2).uniform(0.0, 3.0, (500, 2))
    for text in ("x*y/3", "x + y/7", "sin(x)*exp(y)", "hypot(x, y)^1.5", "x^3 - 1/(1 + y)"):
        formula = parse(text)
        low, high = enclosed_on_boxes(formula, places, places)
        for place, bottom, top in zip(places, low, high, strict=True):
            with mpmath.workdps(40):
                x, y = map(mpmath.mpf, place.tolist())
                exact = eval(text.replace("^", "**"), EXACT | {"x": x, "y": y})
                assert bottom <= exact <= top
                assert top - bottom < 1e-12


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
        ("0*(1/x)", -1.0, 1.0), ("x^1.5", 0.0, 2.0), ("x^-2", 1.0, 2.0),
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


def highest(u, place, distance):
    """The largest value of a function at the places of its dofs near a point."""
    x = control_points(u.function_space)
    near = np.hypot(x[:, 0] - place[0], x[:, 1] - place[1]) < distance
    top = float(values_at_control_points(u.function_space, u.x.array)[near].max(initial=-np.inf))
    return u.function_space.mesh.comm.allreduce(top, op=MPI.MAX)


def solved(comm, known, norm, accuracy):
    scene = parse_scene(known.text, Path("narrow.toml"), comm)
    result = solve_scene(scene, comm, accuracy=accuracy, norm=norm, max_unknowns=300_000)
    result.destroy()
    assert result.found.reached
    return result.u


@pytest.mark.parametrize("width", [0.003, 0.001, 0.0003])
@pytest.mark.parametrize(("norm", "accuracy"), [("Linf", 1e-2), ("H1", 1e-1)])
def test_a_narrow_bump_is_not_overlooked(comm, width, norm, accuracy):
    known = bump(width, {})
    u = solved(comm, known, norm, accuracy)
    assert true_error(u, known, norm) <= accuracy
    assert highest(u, (0.37, 0.61), width) == pytest.approx(1.0, abs=0.1)


def spike(width):
    """Contact everywhere below a harmonic function whose trace is a narrow spike."""
    text = f"""
degree = 2
[domain]
shape = "square"
cells = 8
[define]
X = "x - 0.4713"
Y = "y + {width!r}"
w = "{width!r}*Y/(X^2 + Y^2) - y/{8.0 * width!r}"
[contact]
sides = "bottom"
obstacle = "{width**2!r}/(X^2 + {width**2!r})"
[[dirichlet]]
sides = ["left", "right", "top"]
value = "w"
"""

    def u(x, y):
        X, Y = x - 0.4713, y + width
        return width * Y / (X**2 + Y**2) - y / (8.0 * width)

    def gradient(x, y):
        X, Y = x - 0.4713, y + width
        square = (X**2 + Y**2) ** 2
        return -2.0 * width * X * Y / square, width * (X**2 - Y**2) / square - 1.0 / (8.0 * width)

    return Known(text, u, gradient, {})


@pytest.mark.parametrize("width", [1e-3, 1e-4])
@pytest.mark.parametrize(("norm", "accuracy"), [("Linf", 1e-2), ("H1", 1e-1)])
def test_a_narrow_spike_of_the_obstacle_is_not_overlooked(comm, width, norm, accuracy):
    known = spike(width)
    u = solved(comm, known, norm, accuracy)
    assert true_error(u, known, norm) <= accuracy
    assert highest(u, (0.4713, 0.0), width) == pytest.approx(1.0, abs=0.05)


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
    u = solved(comm, Known(PIN, None, None, {}), "Linf", 2e-2)
    assert highest(u, (0.4713, 0.0), 5e-3) == pytest.approx(0.2, abs=5e-3)


def first_mesh(comm, text):
    scene = parse_scene(text, Path("scene.toml"), comm)
    scene = replace(scene, domain=scene.domain.first(), degree=2)
    sided = scene.domain.make(comm)
    return scene, sided, resolved_mesh(list(data_of(scene, sided)), sided)


def cells(sided):
    return sided.mesh.topology.index_map(sided.mesh.topology.dim).size_global


@pytest.mark.parametrize(
    "name", ["corner of 240 degrees", "layer", "kink of the obstacle", "edge of a cube"]
)
def test_the_mesh_of_a_scene_without_narrow_data_stays(comm, name):
    _, sided, found = first_mesh(comm, SCENES[name].text)
    assert found.sided is sided
    assert found.notes == ()


def middles(domain):
    """The midpoints of all cells of all ranks, in order."""
    count = domain.topology.index_map(domain.topology.dim).size_local
    x = domain.geometry.x[domain.geometry.dofmap[:count]].mean(axis=1)
    x = np.round(np.concatenate(domain.comm.allgather(x)), 12)
    return x[np.lexsort(x.T)]


@pytest.mark.parametrize("text", [bump(0.003, {}).text, PIN], ids=["bump", "pin"])
def test_the_ranks_refine_like_one(comm, text):
    shared = middles(first_mesh(comm, text)[2].sided.mesh)
    alone = middles(first_mesh(MPI.COMM_SELF, text)[2].sided.mesh)
    assert np.array_equal(shared, alone)
    assert 50 < len(alone) < 300


def diameters(sided, place):
    """The diameter of the smallest cell around a point, and of the largest cell of all."""
    domain = sided.mesh
    dim = domain.topology.dim
    x = domain.geometry.x[domain.geometry.dofmap][:, :, :dim]
    edges = x[:, 1:] - x[:, :1]
    widths = np.linalg.norm(edges, axis=2).max(axis=1)
    inner = np.linalg.solve(edges.transpose(0, 2, 1), (place - x[:, 0])[:, :, None])[:, :, 0]
    around = (inner.min(axis=1) > -1e-9) & (inner.sum(axis=1) < 1.0 + 1e-9)
    smallest = domain.comm.allreduce(float(widths[around].min(initial=np.inf)), op=MPI.MIN)
    return smallest, domain.comm.allreduce(float(widths.max(initial=0.0)), op=MPI.MAX)


NARROW = """
[domain]
shape = "{shape}"
cells = 8
[define]
d = "{distance}"
peak = "exp(-d/1e-6)"
[equation]
reaction = "{reaction}"
diffusion = "{diffusion}"
load = "{load}"
[contact]
sides = "bottom"
[[dirichlet]]
sides = "top"
value = "{value}"
[[neumann]]
sides = "right"
flux = "{flux}"
"""
PLANE = {
    "shape": "square", "distance": "(x - 0.3719)^2 + (y - 0.6113)^2", "reaction": "1",
    "diffusion": "1", "load": "1", "value": "0", "flux": "0",
}  # fmt: skip


@pytest.mark.parametrize(
    ("data", "place"),
    [
        ({"load": "1 + 1e6*peak"}, (0.3719, 0.6113)),
        ({"load": "1 + where(d < 1e-6, 1e6, 0)"}, (0.3719, 0.6113)),
        ({"reaction": "1 + 1e6*peak"}, (0.3719, 0.6113)),
        ({"diffusion": "1 + 1e6*peak"}, (0.3719, 0.6113)),
        ({"value": "x + exp(-((x - 0.7123)/0.0001)^2)"}, (0.7123, 1.0)),
        ({"flux": "1 + 1e4*exp(-((y - 0.7123)/0.0001)^2)"}, (1.0, 0.7123)),
    ],
    ids=["load", "jump", "reaction", "diffusion", "Dirichlet", "flux"],
)
def test_every_datum_is_looked_at(comm, data, place):
    _, _, found = first_mesh(comm, NARROW.format(**PLANE | data))
    smallest, largest = diameters(found.sided, np.array(place))
    assert smallest < 0.01
    assert largest > 0.3
    assert found.notes == ()


def test_a_narrow_load_inside_a_cube_is_seen(comm):
    data = PLANE | {"shape": "cube", "load": "1 + 1e9*peak"}
    data["distance"] += " + (z - 0.2819)^2"
    _, _, found = first_mesh(comm, NARROW.format(**data))
    assert diameters(found.sided, np.array([0.3719, 0.6113, 0.2819]))[0] < 0.02


def test_a_thin_layer_that_lets_nothing_through_is_seen(comm):
    layer = {"diffusion": "1/(1 + 1e4*exp(-((x - 0.3719)/1e-3)^2))"}
    _, _, found = first_mesh(comm, NARROW.format(**PLANE | layer))
    for y in (0.1, 0.5, 0.9):
        assert diameters(found.sided, np.array([0.3719, y]))[0] < 0.1


def test_what_is_not_resolved_or_not_known_is_said(comm):
    scene = parse_scene(bump(0.001, {}).text, Path("scene.toml"), comm)
    sided = scene.domain.first().make(comm)
    found = resolved_mesh(list(data_of(scene, sided)), sided, max_cells=50)
    assert cells(found.sided) <= 50
    assert [note for note in found.notes if "the load" in note and "first mesh" in note]
    result = solve_scene(scene, comm, accuracy=1e-3, norm="L2", max_unknowns=800)
    result.destroy()
    assert max(step.unknowns for step in result.found.steps) <= 800
    assert set(found.notes) <= set(result.expectation.notes)
    line = PLANE | {"load": "abs(x - y)^-0.9"}  # without a bound on a line
    _, _, found = first_mesh(comm, NARROW.format(**line))
    assert [note for note in found.notes if "may have" in note]


@pytest.mark.parametrize("name", ["obstacle", "mixed", "polygon", "plate"])
def test_the_look_takes_few_values(comm, name, monkeypatch):
    path = Path(__file__).parents[2] / "demos" / "scenes" / f"{name}.toml"
    scene = load_scene(path, comm)
    sided, counts = scene.domain.first().make(comm), []

    def counted(root, x):
        counts.append(x[..., 0].size)
        return evaluated(root, x)

    for module in (sampling, first_mesh_module):
        monkeypatch.setattr(module, "evaluated", counted)
    found = resolved_mesh(list(data_of(scene, sided)), sided)
    assert comm.allreduce(sum(counts)) < 500 * cells(found.sided)
