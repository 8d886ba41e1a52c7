"""Formulas: what they mean, and that no text does harm."""

import math
import time

import numpy as np
import pytest
import ufl
from dolfinx import fem
from hypothesis import given
from hypothesis import strategies as st

from dolfinx_signorini.base import compat
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.data.formulas import number
from dolfinx_signorini.data.operations import OPERATIONS
from dolfinx_signorini.data.parsing import MAX_SIZE, parse
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import owned_cells

numbers = st.floats(0.01, 9.0).map(lambda v: f"{v:.4g}")


def combined(inner):
    return st.one_of(
        st.tuples(inner, st.sampled_from(["+", "-", "*"]), inner).map(
            lambda t: "({}{}{})".format(*t)
        ),
        st.tuples(inner, st.integers(0, 3)).map(lambda t: "(" + t[0] + ")^" + str(t[1])),
        st.tuples(st.sampled_from(["sin", "cos", "atan", "abs", "tanh"]), inner).map(
            lambda t: f"{t[0]}({t[1]})"
        ),
        st.tuples(st.sampled_from(["min", "max", "hypot"]), inner, inner).map(
            lambda t: "{}({}, {})".format(*t)
        ),
        st.tuples(inner, inner).map(lambda t: f"where({t[0]} < {t[1]}, {t[0]}, {t[1]})"),
        inner.map(lambda t: f"-{t}"),
    )


FORMULAS = st.recursive(
    st.one_of(numbers, st.sampled_from(["x", "y", "pi"])), combined, max_leaves=8
)
PYTHON = {
    "sin": math.sin, "cos": math.cos, "atan": math.atan, "abs": abs, "tanh": math.tanh, "min": min,
    "max": max, "hypot": math.hypot, "pi": math.pi, "where": lambda c, a, b: a if c else b,
}  # fmt: skip
POINT = (0.37, 1.83)
NAMES = {"x": POINT[0], "y": POINT[1]}


def evaluate(node, x):
    """The value of a formula's tree at a point, with Python's own functions."""
    if node.op == "number":
        return node.value
    if node.op == "coordinate":
        return x[int(node.value)]
    return OPERATIONS[node.op].value(*(evaluate(a, x) for a in node.args))


@given(FORMULAS)
def test_formulas_mean_what_they_mean_in_python(text):
    wanted = eval(text.replace("^", "**"), {"__builtins__": {}}, PYTHON | NAMES)
    try:
        root = parse(text).root
    except InputError as error:
        assert "no finite value" in str(error)
        return
    assert evaluate(root, POINT) == pytest.approx(wanted, rel=1e-9, abs=1e-12)


def test_every_function_becomes_the_right_ufl(comm):
    texts = [
        "sqrt(x + 1)", "exp(-x)", "log(2 + x)", "sin(x)", "cos(x)", "tan(x)", "asin(x/2)",
        "acos(x/2)", "atan(x)", "sinh(x)", "cosh(x)", "tanh(x)", "abs(x - 0.5)", "sign(x - 0.5)",
        "atan2(y, x - 0.5)", "hypot(x, y)", "min(x, y)", "max(x, y)", "where(x <= y, x, -y)",
        "-x^2",        "2^-2*x", "1 - 2 - x", "x/2/3", "x**2**2/2", "where(x > 0.5, 1, 2)",
    ]  # fmt: skip
    domain = friedrichs_keller(comm, 2)
    point = np.array([[0.3, 0.5]])
    x = ufl.SpatialCoordinate(domain)
    vector = ufl.as_vector([*x, *(parse(text).ufl(x) for text in texts)])
    values = compat.evaluate(fem.Expression(vector, point, comm=comm), domain, owned_cells(domain))
    for row in values.reshape(-1, 2 + len(texts)):
        for text, value in zip(texts, row[2:], strict=True):
            assert value == pytest.approx(evaluate(parse(text).root, row[:2]), rel=1e-12), text


@pytest.mark.parametrize(
    ("text", "value"),
    [("-2^2", -4.0), ("2^3^2", 512.0), ("2**-1", 0.5), ("1 - 2 - 3", -4.0), ("8/4/2", 1.0)],
)
def test_precedence(text, value):
    assert parse(text).constant == value


@pytest.mark.parametrize(
    ("text", "message", "column"),
    [
        ("x^2^2 + foo^2", "unknown name 'foo'", 9),
        ("\n  x +\n y # more", "'#' does not belong in a formula", 11),
        ("x^2 +", "a number, a name or '(' was expected", 6),
        ("1 + x^(y - 1) y", "invalid syntax", 15),
        ("2^(x*x)", "an exponent must be a number", 1),
        ("where(x < y < 1, 1, 2)", "a number, a name or an operation was expected", 7),
        ("sin(*x)", "a number, a name or an operation was expected", 5),
        ("0x1F", "invalid syntax", 2),
        ("1_000", "invalid syntax", 2),
        ("x.real", "'.' does not belong", 2),
        ("lambda", "unknown name 'lambda'", 1),
        ("y + sin(x,)", "',)' does not belong", 10),
    ],
)
def test_messages_name_the_column(text, message, column):
    with pytest.raises(InputError) as caught:
        parse(text)
    assert str(caught.value).startswith(message)
    assert f"(column {column} of " in str(caught.value)


def test_words_of_python_are_names_like_others():
    definitions = {"lambda": parse("2"), "if": parse("x"), "None": parse("3")}
    assert parse("lambda^None", 2, definitions).constant == 8.0
    assert evaluate(parse("if*lambda", 2, definitions).root, POINT) == 2.0 * POINT[0]


def test_definitions_are_written_out_and_limited():
    definitions = {"a": parse("x + 1")}
    assert parse("a*a", 2, definitions).root.size == 7
    definitions = {"a0": parse("x + y")}
    with pytest.raises(InputError, match=f"more than {MAX_SIZE} operations"):
        for k in range(40):
            definitions[f"a{k + 1}"] = parse(f"a{k}*a{k}", 2, definitions)


@pytest.mark.parametrize(
    "text",
    [
        "9^9^9^9", "9**9**9**9**9", "(((((2^64)^64)^64)^64)^64)^64", "x^1000000", "1e400",
        "(" * 1900, "-" * 1900 + "x", "sin(" * 400 + "x" + ")" * 400, "x" * 3000, "x+" * 950 + "x",
        "2^x", "().__class__.__bases__", "__builtins__", "x if x else x", "[x for x in y]", "x@y",
        "x\u0000", "𝟙", "exp(exp(exp(9)))",
    ],
)  # fmt: skip
def test_no_text_takes_long_or_runs_anything(text):
    began = time.perf_counter()
    with pytest.raises(InputError):
        parse(text)
    assert time.perf_counter() - began < 1.0


@given(st.text(max_size=40))
def test_any_text_is_a_formula_or_an_input_error(text):
    try:
        assert parse(text).root.size >= 1
    except InputError:
        return


def test_numbers_keep_their_value():
    assert float(number(0.1).text) == 0.1 == number(0.1).constant
    assert number(4.0).text == "4"


@pytest.mark.parametrize(("value", "text"), [(-0.3, "-0.3"), (2.0, "2"), (1e-20, "1e-20")])
def test_a_number_is_written_as_it_was_read(value, text):
    assert number(value).text == text
    assert float(parse(text).text) == value
