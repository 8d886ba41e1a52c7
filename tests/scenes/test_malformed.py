"""Malformed scene files: 500 generated ones, and each kind of problem that has no solution."""

import json
import os
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dolfinx_signorini.commands.main import main

SQUARE = {
    "": {"title": '"t"'},
    "domain": {"shape": '"square"', "cells": "8"},
    "define": {"a": '"x - 0.5"'},
    "equation": {"reaction": "1", "load": '"a*y"', "diffusion": '"1 + x"'},
    "contact": {"sides": '"bottom"', "obstacle": '"-0.1 - 0.1*a"', "bound": '"lower"'},
    "[dirichlet]": {"sides": '["left", "right"]', "value": "0"},
    "[neumann]": {"sides": '"top"', "flux": '"sin(pi*x)"'},
}
POLYGON = SQUARE | {
    "domain": {"shape": '"polygon"', "vertices": "[[0, 0], [1, 0], [0, 1]]", "width": "0.2"},
    "contact": {"sides": "1"},
    "[dirichlet]": {"sides": "2", "value": "0"},
    "[neumann]": {"sides": "3", "flux": '"x"'},
}
IN_DOMAIN = {table: keys for table, keys in SQUARE.items() if table != "contact"}
IN_DOMAIN |= {"obstacle": {"lower": '"-0.5 - 0.1*a"', "upper": "2"}}
KEYS = [(table, key) for table, keys in SQUARE.items() for key in keys]
FORMULAS = [k for k in KEYS if k[1] in ("reaction", "load", "diffusion", "obstacle", "value", "a")]
REQUIRED = [
    ("domain", "shape"),
    ("domain", "cells"),
    ("contact", "sides"),
    ("[dirichlet]", "value"),
    ("[neumann]", "flux"),
]
WORDS = st.text("abcdefghijklmnopqrstuvwz_", min_size=4, max_size=9).filter(
    lambda w: w not in ("title", "outputs", "degree", "accuracy", "solution", "tags")
)
BROKEN_FORMULAS = st.one_of(
    st.sampled_from(
        [
            "", "(", "x +", "* x", "x y", "sin", "sin()", "sin(x, y)", "x ^ y", "x ^ 1e9", "1/0",
            "log(-1)", "1/(0*x)", "2 ** 3 ** 99", "1e999", "z", "where(x, 1, 2)", "x < 1",
            "9" * 400, "__import__('os')", "().__class__", "lambda: 0", "x.real", "x[0]", "open",
            "exp(1e9)", "'x'", "x; y", "x = 1", "f(x)", "max(x)", "atan2(x)", "sqrt(0 - 2)",
            "x if y else 0", "((" * 200 + "x" + "))" * 200, "+".join(["x"] * 3000),
            "-" * 500 + "x", "πx", "x²",
        ]
    ),
    WORDS,
    st.text("#@!&|~%$?;:{}[]\\", min_size=1, max_size=5).map(lambda t: "x" + t),
    st.integers(1, 90).map(lambda k: "(" * k + "x" + ")" * (k - 1)),
)  # fmt: skip
BROKEN_VALUES = st.one_of(
    st.sampled_from(["true", "nan", "inf", "-inf", "1979-05-27", "{}", "{ x = 1 }", "[]", "[[]]"]),
    st.lists(st.booleans(), min_size=1, max_size=3).map(lambda v: str(v).lower()),
)
BROKEN_DOMAINS = st.sampled_from(
    [
        {"shape": '"square"', "cells": value}
        for value in ("0", "-1", "2.5", '"8"', "100000", "9" * 400, "true", "[8]")
    ]
    + [{"shape": value, "cells": "8"} for value in ('"sqare"', '""', "1", "[]", '"Square"')]
    + [{"shape": '"cube"', "cells": "1000"}, {"shape": '"square"'}, {}]
    + [
        {"shape": '"polygon"', "vertices": value, "width": "0.2"}
        for value in (
            "[]", "[[0, 0], [1, 0]]", "[[0, 0], [1, 1], [1, 0], [0, 1]]",
            "[[0, 0], [1, 0], [2, 0]]",
            "[[0, 0], [1, 0], [1]]", "[[0, 0], [0, 0], [1, 1]]", '[["0", 0], [1, 0], [0, 1]]',
            "[[0, 0], [nan, 0], [0, 1]]", "[[0, 0], [1e300, 0], [0, 1]]", "[0, 1, 2]",
            "[[0, 0], [2, 0], [1, 0], [1, 1]]", "[[0, 0], [1e-300, 0], [0, 1e-300]]",
            "[[0, 0], [1e-159, 0], [0, 1e-159]]",
        )
    ]
    + [
        {"shape": '"polygon"', "vertices": "[[0, 0], [1, 0], [0, 1]]", "width": value}
        for value in ("0", "-1", "5", "1e-9", "1e-160", "1e-300", "5e-324", "nan", "true", '"0.1"')
    ]
    + [{"shape": '"file"', "file": v} for v in ('"none.msh"', '"/etc/passwd"', '"."', '""', "1")]
)  # fmt: skip
BROKEN_SIDES = st.sampled_from(
    ['"front"', '["bottom", "top"]', '"all"', '"Bottom"', "3", "[]", '["left", 1.5]', "true", '""']
)
BROKEN_TOP = st.sampled_from(
    [
        "degree = 5", "degree = 0", "degree = 1.0", "rtol = 2", "rtol = 0", "rtol = -1e-8",
        'rtol = "1"', "rtol = nan", "accuracy = 0.1", "accuracy = 5", 'outputs = "fields"',
        'outputs = ["fiels"]', "outputs = [1]", "outputs = [[]]", "title = 1", "title = []",
        "solution = 1", "domain = 3", "contact = []", "dirichlet = 4", "equation = []",
    ]
)  # fmt: skip
BROKEN_SOLUTIONS = st.sampled_from(
    [
        {"manufactured": "true"},
        {"u": '"y"', "manufactured": "1"},
        {"u": '"y"', "manufactured": "true"},  # the load is there as well
        {"u": '"y"', "norms": '"L2"'},
        {"u": '"y"', "norms": '["L0"]'},
        {"u": '"y"', "norms": "[2]"},
        {"norms": '["L2"]'},
        {"u": '"y +"'},
    ]
)
BROKEN_TENSORS = st.sampled_from(
    [
        "[[1, 0], [0, -1]]", "[[1, 2], [2, 1]]", "[[1, 1], [0, 1]]", "[[1, 0]]", "[1, 2]", "-1",
        "0",
        "[[1, 0], [0]]", '[["x +", 0], [0, 1]]', "[[1, 0, 0], [0, 1, 0], [0, 0, 1]]", "[[true, 0], "
        "[0, 1]]",
    ]
)  # fmt: skip


def write(tables, extra=""):
    text = [extra]
    for name, keys in tables.items():
        text.append(f"[{name}]" if name else "")
        text += [f"{key} = {value}" for key, value in keys.items()]
    return "\n".join(text)


def changed(base, table, key, value):
    """The text of a scene with one key added or changed; None removes it."""
    keys = {k: v for k, v in base[table].items() if k != key}
    return write(base | {table: keys if value is None else keys | {key: value}})


@st.composite
def malformed(draw):
    """The text of a scene file that is no scene."""
    kind = draw(st.integers(0, 12))
    base = draw(st.sampled_from([SQUARE, POLYGON]))
    if kind == 0:
        table, key = draw(st.sampled_from(REQUIRED[:1] + REQUIRED[2:]))
        return changed(base, table, key, None)
    if kind == 1:
        table = draw(st.sampled_from(sorted(set(base) - {"define"})))
        return changed(base, table, draw(WORDS), draw(st.sampled_from(["1", '"x"', "[]", "true"])))
    if kind == 2:
        return changed(SQUARE, *draw(st.sampled_from(KEYS)), draw(BROKEN_VALUES))
    if kind == 3:
        formula = draw(BROKEN_FORMULAS)
        return changed(SQUARE, *draw(st.sampled_from(FORMULAS)), '"""' + _escaped(formula) + '"""')
    if kind == 4:
        return write(SQUARE | {"domain": draw(BROKEN_DOMAINS)})
    if kind == 5:
        table = draw(st.sampled_from(["contact", "[dirichlet]", "[neumann]"]))
        return changed(SQUARE, table, "sides", draw(BROKEN_SIDES.filter(lambda s: s != '"top"')))
    if kind == 6:
        top = draw(BROKEN_TOP)
        tables = {k: v for k, v in SQUARE.items() if k.strip("[]") != top.split()[0]}
        return write({k: v for k, v in tables.items() if k}, top)
    if kind == 7:
        return write(SQUARE | {"solution": draw(BROKEN_SOLUTIONS)})
    if kind == 8:
        return changed(SQUARE, "equation", "diffusion", draw(BROKEN_TENSORS))
    if kind == 9:  # cut in the middle of a table's header, a string or an assignment
        text = write(base)
        places = [i for i, c in enumerate(text) if c in "=[" or (c == '"' and text[i - 1] in " [")]
        return text[: draw(st.sampled_from(places)) + 1]
    if kind == 10:
        key = draw(st.sampled_from(["sin", "x", "pi", "where", "a-b", "1a", '"b c"']))
        return changed(SQUARE, "define", key, '"1"')
    if kind == 11:
        formulas = BROKEN_FORMULAS.map(lambda f: f'"""{_escaped(f)}"""')
        obstacle = draw(st.sampled_from(["lower", "upper"])), draw(formulas | BROKEN_VALUES)
        return changed(IN_DOMAIN, "obstacle", *obstacle)
    return draw(
        st.one_of(
            st.text(min_size=1, max_size=60).map(lambda t: "\x00" + t),
            st.just(""),
            st.just("# nothing\n" * 9000),
            st.just("a = " + "[" * 5000 + "]" * 5000),
            st.just('x = "' + "y" * 70_000 + '"'),
        )
    )


def _escaped(text):
    return text.replace("\\", "\\\\").replace('"', '\\"')


def solve(comm, folder, capsys, text):
    """Solve a scene file that is to be refused, and return the message."""
    path, out = folder / "malformed.toml", folder / "results"
    if comm.rank == 0:
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
    comm.barrier()
    began = time.perf_counter()
    code = main(["solve", str(path), "--out", str(out), "--report"])
    seconds = time.perf_counter() - began
    captured = capsys.readouterr()
    comm.barrier()
    left = sorted(p.name for p in folder.iterdir())
    comm.barrier()
    assert code == 2, (text, captured)
    assert left == ["malformed.toml"], text
    assert seconds < 20.0, text
    if comm.rank == 0:
        assert captured.err.startswith("error: ") and "Traceback" not in captured.err, text
        assert captured.out == "", text
    else:
        assert captured.err == "", text
    return captured.err


@pytest.mark.parametrize("tables", [SQUARE, POLYGON, IN_DOMAIN])
def test_the_files_that_are_spoilt_are_good_ones(tables, comm, folder):
    if tables is POLYGON:
        pytest.importorskip("gmsh")
    if comm.rank == 0:
        (folder / "good.toml").write_text(write(tables))
    comm.barrier()
    assert main(["solve", str(folder / "good.toml")]) == 0


def test_500_malformed_files_are_refused(comm, folder, capsys):
    @settings(max_examples=500 if comm.size == 1 else 25)
    @given(malformed())
    def check(text):
        message = solve(comm, folder, capsys, text)
        assert comm.rank or "malformed.toml" in message, text

    check()


# Problems that are well written and have no solution, or not one: what is wrong, and its line.
POSED_WRONG = {
    "the energy is unbounded": (12, "[equation]\nload = 1", ""),
    "the solution is not unique": (12, "[equation]\nload = 0", ""),
    "lies above the Dirichlet data": (7, "", '[[dirichlet]]\nsides = "left"\nvalue = -5'),
    "not finite": (
        12,
        '[equation]\nload = "log(-1 - x)"',
        '[[dirichlet]]\nsides = "top"\nvalue = 0',
    ),
    "choose other units": (
        12,
        "[equation]\nload = 1e300",
        '[[dirichlet]]\nsides = "top"\nvalue = 0',
    ),
    "not positive definite": (
        11,
        '[equation]\ndiffusion = "x - 2"',
        '[[dirichlet]]\nsides = "top"\nvalue = 0',
    ),
    "has no finite value at some point where its error is measured": (
        12,
        '[solution]\nu = "log(x)"',
        '[[dirichlet]]\nsides = "top"\nvalue = 0',
    ),
    "must be positive": (
        12,
        '[equation]\ndiffusion = "0*x"',
        '[[dirichlet]]\nsides = "top"\nvalue = 0',
    ),
    "the tensor is not positive definite": (
        12,
        '[equation]\ndiffusion = [["0*x", 0], [0, "0*y"]]',
        '[[dirichlet]]\nsides = "top"\nvalue = 0',
    ),
    "the tensor is not symmetric": (
        12,
        '[equation]\ndiffusion = [[1, 0.3], ["0.1 + 0.2 + 1e-9", 1]]',
        '[[dirichlet]]\nsides = "top"\nvalue = 0',
    ),
    "0 lies above the Dirichlet data -1e-09": (
        7,
        "[equation]\nload = -1",
        '[[dirichlet]]\nsides = "left"\nvalue = -1e-9',
    ),
    "not symmetric, so": (
        11,
        '[equation]\ndiffusion = [[2, "x"], [0, 1]]',
        '[[dirichlet]]\nsides = "top"\nvalue = 0',
    ),
    "the boundary may push and not pull": (
        12,
        '[solution]\nu = "1 + y"\nmanufactured = true',
        '[[dirichlet]]\nsides = "top"',
    ),
    "does not touch g": (
        12,
        '[solution]\nu = "1 - y"\nmanufactured = true',
        '[[dirichlet]]\nsides = "top"',
    ),
    "no penetration": (
        12,
        '[solution]\nu = "-1 - y"\nmanufactured = true',
        '[[dirichlet]]\nsides = "top"',
    ),
}


@pytest.mark.parametrize("reason", POSED_WRONG)
def test_a_problem_without_a_solution_is_refused_with_its_line(reason, comm, folder, capsys):
    line, tables, parts = POSED_WRONG[reason]
    text = f"""title = "t"

[domain]
shape = "square"
cells = 8
[contact]
obstacle = 0
sides = "bottom"


{tables}
{parts}
"""
    message = solve(comm, folder, capsys, text)
    if comm.rank == 0:
        assert reason in message
        assert f"malformed.toml, line {line}: " in message


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        (
            "[domain]\nshape = 'sqare'",
            "line 2: domain.shape: unknown 'sqare'; did you mean 'square'",
        ),
        (
            "[domain]\nshape = 'square'\ncels = 8\ncells = 8",
            "line 3: domain.cels: unknown key; did you mean 'cells'",
        ),
        (
            "[domain]\nshape = 'square'\ncell = 8",
            "line 3: domain.cell: unknown key; did you mean 'cells'",
        ),
        (
            "[domain]\nshape = 'square'\ncells = 8\n[contact]\nsides = ['all', 'bottom']",
            "line 5: contact.sides: 'all' stands for every side, and goes with no other name",
        ),
        (
            "[domain]\nshape = 'square'\ncells = 8\n[contact]\nsides = 'top'\n"
            "[dirichlet]\nsides = 'left'\nvalue = 1",
            "line 6: dirichlet: must be tables, each written as [[dirichlet]]",
        ),
        (
            "[domain]\nshape = 'square'\ncells = 8\n[[contact]]\nsides = 'top'",
            "line 4: contact: must be one table, written as [contact]",
        ),
        (
            "[domain]\nshape = 'square'\ncells = 8\n[contact]\nsides = 'botom'",
            "line 5: contact.sides: unknown side 'botom'; did you mean 'bottom'",
        ),
        (
            "[domain]\nshape = 'square'\ncells = 8\n[contact]\nsides = 'top'\n"
            "[[neumann]]\nsides = 'left'\nflux = 1\n[[neumann]]\nsides = 'right'\nflux = 'sinn(x)'",
            "line 11: neumann.2.flux: unknown name 'sinn'; did you mean 'sin'? (column 1 of",
        ),
        (
            "[domain]\nshape = 'polygon'\nvertices = [\n[0, 0],\n[1, 0],\n[0, 1]\n]\nwidth = -1",
            "line 8: domain.width: must lie between 0",
        ),
    ],
)
def test_messages_name_file_line_key_and_the_nearest_name(text, wanted, comm, folder, capsys):
    message = solve(comm, folder, capsys, text)
    assert comm.rank or f"error: malformed.toml, {wanted}" in message


GOOD = """
[domain]
shape = "square"
cells = 8
[contact]
sides = "bottom"
{contact}
[[dirichlet]]
sides = "{side}"
value = {value}
[equation]
{equation}
"""


def solved(comm, folder, text, *arguments):
    """Solve a scene file that is to be solved, and return the summary of its record."""
    if comm.rank == 0:
        (folder / "good.toml").write_text(text, encoding="utf-8")
    comm.barrier()
    out = folder / "results"
    assert main(["solve", str(folder / "good.toml"), "--out", str(out), *arguments]) == 0
    comm.barrier()
    return json.loads((out / "record.json").read_text())["summary"]


def good(contact="", side="top", value="0", equation="load = -1"):
    return GOOD.format(contact=contact, side=side, value=value, equation=equation)


@pytest.mark.parametrize(
    "equation",
    [
        "load = -1\nreaction = 0",
        "reaction = 0\n[solution]\nu = 0",
        'reaction = "0*x"\nload = "0*y"\n[solution]\nu = "0*x + 1"',
        'load = 0\n[[neumann]]\nsides = "left"\nflux = "0*x"',
        'load = -1\ndiffusion = "0*x + 1"',
        'load = -1\ndiffusion = [["1 + 0*x", "0*x"], [0, "x^0"]]',
        '[solution]\nu = "abs(x) - x"',
    ],
)
def test_constants_and_zeros_are_data_like_others(equation, comm, folder):
    summary = solved(comm, folder, good(equation=equation), "--report")
    assert summary["imbalance"] <= 1e-8


def test_a_manufactured_constant(comm, folder):
    text = good(equation="[solution]\nu = 5\nmanufactured = true").replace("value = 0\n", "")
    summary = solved(comm, folder, text, "--outputs", "boundary")
    assert max(summary["errors"].values()) <= 1e-12


@pytest.mark.parametrize(
    "scene",
    [
        good(side="left", value='"-4e-17"'),
        good(side="left", value='"0.3 - 0.1 - 0.2"'),
        good(side="right", value='"-sin(pi*x)"'),
        good('bound = "upper"', "right", '"sin(pi*x)"', "load = 1"),
        good("obstacle = 0.3", "right", '"0.1 + 0.2 - 1e-16"'),
        good(equation='load = -1\ndiffusion = [[1, 0.3], ["0.1 + 0.2", 1]]'),
    ],
)
def test_rounding_is_no_contradiction(scene, comm, folder):
    summary = solved(comm, folder, scene, "--outputs", "boundary")
    assert summary["imbalance"] <= 1e-8
    gaps = [row.split(",")[3] for row in (folder / "results" / "boundary.csv").read_text().split()]
    assert min(map(float, gaps[1:])) >= 0.0


@pytest.mark.parametrize(
    "title",
    [
        "costs $5, and $x_{",
        "$\\\\frac{$",
        "a\\nb\\u0000",
        "x" * 5000,
        "",
        "\u65e5\u672c \U0001f600",
    ],
)
@pytest.mark.filterwarnings("ignore:Glyph")
def test_any_title_is_drawn(title, comm, folder):
    solved(comm, folder, f'title = "{title}"\n{good()}', "--report")


def test_a_byte_order_mark_is_no_part_of_the_scene(comm, folder):
    solved(comm, folder, "\ufeff" + good(), "--outputs", "boundary")


def test_a_file_is_read_to_its_end_or_refused(comm, folder, capsys):
    """Its size is that of its bytes: a character may have several."""
    message = solve(comm, folder, capsys, good() + "# " + 600_000 * "ä" + "\n[equation")
    assert comm.rank or "has at most 1000000 bytes" in message


def test_a_pipe_is_no_scene_file(comm, folder, capsys):
    if comm.rank == 0:
        os.mkfifo(folder / "pipe.toml")
    comm.barrier()
    for job in ("solve", "check"):
        assert main([job, str(folder / "pipe.toml")]) == 2
    assert comm.rank or "pipe.toml: not a regular file" in capsys.readouterr().err


def test_an_accuracy_beyond_all_numbers_is_not_reached(comm, folder, capsys):
    text = good(equation='load = "-exp(x)"').replace("cells = 8\n", "")
    solve_text = f"accuracy = 1e-300\n{text}"
    if comm.rank == 0:
        (folder / "scene.toml").write_text(solve_text)
    comm.barrier()
    assert main(["solve", str(folder / "scene.toml"), "--max-unknowns", "3000"]) == 3
    assert comm.rank or "a finer mesh has more than 3000 unknowns" in capsys.readouterr().out


def test_a_solution_without_finite_values_is_refused_before_a_search(comm, folder, capsys):
    text = good(equation='[solution]\nu = "log(x)"')
    if comm.rank == 0:
        (folder / "scene.toml").write_text(text)
    comm.barrier()
    assert main(["solve", str(folder / "scene.toml"), "--accuracy", "1e-3"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert comm.rank or "solution.u: has no finite value" in printed.err


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["--accuracy", "0"], "error: --accuracy: must be a positive number, not 0.0"),
        (["--norm", "W3"], "error: --norm: unknown norm 'W3'"),
        (["--max-unknowns", "10"], "error: --max-unknowns: the coarsest meshes need"),
    ],
)
def test_values_of_the_command_line_are_not_said_to_be_in_the_file(
    arguments, wanted, comm, folder, capsys
):
    if comm.rank == 0:
        text = good().replace("cells = 8\n", "")
        (folder / "scene.toml").write_text(f"accuracy = 1e-3\nnorm = 'L2'\n{text}")
    comm.barrier()
    assert main(["solve", str(folder / "scene.toml"), *arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert comm.rank or printed.err.startswith(wanted)


MIXED = """
[domain]
shape = "polygon"
vertices = [[0, 0], [0.5, 0], [1, 0], [1, 1], [0, 1]]
width = 0.2
[contact]
sides = 4
[[dirichlet]]
sides = 1
value = {value}
{solution}
"""
ROOT = '"hypot(x - 0.5, y)^0.5 * cos(0.5*atan2(y, x - 0.5))"'  # 0 on the first side


@pytest.mark.parametrize(
    ("value", "solution", "top", "arguments", "wanted"),
    [
        ("0", f"[solution]\nu = {ROOT}\nnorms = ['L2', 'W1_4']", "", [], "solution.norms: W1_4 of"),
        ("0", f"[solution]\nu = {ROOT}\nnorms = ['W1_inf']", "", [], "solution.norms: W1_inf of"),
        ("0", "", "", ["--accuracy", "1", "--norm", "W1_4"], "norm: W1_4 of the solution is inf"),
        ("0", "", "accuracy = 1\nnorm = 'W1_inf'", [], "norm: W1_inf of the solution is infinite"),
    ],
)
def test_infinite_norms_are_refused(value, solution, top, arguments, wanted, comm, folder, capsys):
    pytest.importorskip("gmsh")
    text = f"{top}\n{MIXED.format(value=value, solution=solution)}"
    if top:
        text = text.replace("width = 0.2\n", "")
    if comm.rank == 0:
        (folder / "scene.toml").write_text(text)
    comm.barrier()
    jobs = [["solve", str(folder / "scene.toml"), *arguments]]
    if not arguments:
        jobs.append(["check", str(folder / "scene.toml")])
    for job in jobs:
        assert main(job) == 2
        printed = capsys.readouterr()
        assert printed.out == ""
        if comm.rank == 0:
            assert wanted in printed.err
            assert (
                "near (0.5, 0), angle 180 degrees, Dirichlet meets Neumann: u ~ r^0.5"
                in printed.err
            )


def test_finite_norms_are_measured(comm, folder, capsys):
    pytest.importorskip("gmsh")
    for formula, norms in ((ROOT, "['L2', 'W1_3', 'H1']"), ('"1 - y + x^2"', "['W1_inf', 'W1_4']")):
        solution = f"[solution]\nu = {formula}\nnorms = {norms}"
        value = 0 if formula == ROOT else '"1 + x^2"'
        if comm.rank == 0:
            (folder / "scene.toml").write_text(MIXED.format(value=value, solution=solution))
        comm.barrier()
        assert main(["check", str(folder / "scene.toml")]) == 0
        infinite = "W1_4, W1_inf of the solution infinite" in capsys.readouterr().out
        assert infinite == (formula == ROOT and comm.rank == 0)


def test_infinite_norms_are_not_compared(comm, folder, capsys):
    pytest.importorskip("gmsh")
    if comm.rank == 0:
        (folder / "scene.toml").write_text(MIXED.format(value=0, solution=""))
    comm.barrier()
    arguments = ["--norms", "L4,W1_4", "--out", str(folder / "out")]
    assert main(["tradeoff", str(folder / "scene.toml"), *arguments]) == 2
    assert comm.rank or "--norms: W1_4 of the solution is infinite" in capsys.readouterr().err
    assert not (folder / "out").exists()
