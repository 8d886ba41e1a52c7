"""Scene files of elastic bodies that are refused, each with exit code 2 and the key by name."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI

from dolfinx_signorini.commands.main import main

COMM = MPI.COMM_WORLD
GOOD = {
    "": {"title": '"t"'},
    "domain": {"shape": '"square"', "cells": "4"},
    "define": {"a": '"x - 0.5"'},
    "elasticity": {
        "young": '"100 + a"', "poisson": "0.3", "plane": '"strain"', "force": '[0, "-a"]',
    },
    "contact": {"sides": '"bottom"', "gap": '"0.1 + a^2"', "direction": '["0.1*a", -1]'},
    "[dirichlet]": {"sides": '"top"', "components": '["x", "y"]', "value": '[0, "-0.1*a"]'},
    "[traction]": {"sides": '"left"', "force": '["a", 1]'},
}  # fmt: skip
VECTORS = [
    ("elasticity", "force"), ("contact", "direction"), ("[dirichlet]", "value"),
    ("[traction]", "force"),
]  # fmt: skip
FORMULAS = [("elasticity", "young"), ("elasticity", "poisson"), ("contact", "gap")]
SPOILT = st.sampled_from(
    ["true", "nan", "[]", "{}", '""', '"x +"', '"z"', '"__import__(1)"', '"x if y else 0"', "[[0]]"]
)
SPOILT_VECTORS = st.sampled_from(
    ["1", '"x"', "[]", "[1]", "[1, 2, 3]", '[1, "x +"]', '["z", 0]', "[true, 0]", "[nan, 0]",
     "[[1], 0]", '[0, ""]', "{ x = 1 }", "true"]
)  # fmt: skip


def write(tables, extra=""):
    text = [extra]
    for name, keys in tables.items():
        text.append(f"[{name}]" if name else "")
        text += [f"{key} = {value}" for key, value in keys.items()]
    return "\n".join(text)


def changed(table, key, value):
    """The good file with one key added, changed, or, for None, left out."""
    keys = {k: v for k, v in GOOD.get(table, {}).items() if k != key}
    return write(GOOD | {table: keys if value is None else keys | {key: value}})


def without(*tables):
    return {name: keys for name, keys in GOOD.items() if name not in tables}


def refused(folder, capsys, text, *arguments, job="solve"):
    """Run a job that is to be refused, and return the message of rank 0, "" on the others."""
    if COMM.rank == 0:
        (folder / "scene.toml").write_text(text)
    COMM.barrier()
    code = main([job, str(folder / "scene.toml"), *arguments])
    captured = capsys.readouterr()
    COMM.barrier()
    assert code == 2, (text, captured)
    assert "Traceback" not in captured.err
    assert captured.out == ""
    before, error, message = captured.err.rpartition("error: ")
    assert COMM.rank or error
    assert "error" not in before  # a busy machine may tell how far the job is
    return error + message


def test_the_file_that_is_spoilt_is_a_good_one(folder):
    if COMM.rank == 0:
        (folder / "scene.toml").write_text(write(GOOD))
    COMM.barrier()
    assert main(["solve", str(folder / "scene.toml")]) == 0
    assert main(["check", str(folder / "scene.toml")]) == 0


def test_malformed_values_are_refused_by_name(folder, capsys):
    keys = st.one_of(
        st.tuples(st.sampled_from(FORMULAS), SPOILT),
        st.tuples(st.sampled_from(VECTORS), SPOILT_VECTORS),
    )

    @settings(max_examples=120 if COMM.size == 1 else 20)
    @given(keys)
    def check(changes):
        (table, key), value = changes
        message = refused(folder, capsys, changed(table, key, value))
        path = f"{table}.{key}" if table[0] != "[" else f"{table.strip('[]')}.1.{key}"
        assert COMM.rank or path in message

    check()


CASES = {
    "not with equation": (
        write(GOOD | {"equation": {"load": "1"}}),
        "equation: not with [elasticity], which has the equation: young, poisson and force",
    ),
    "not with an obstacle in the domain": (
        write(GOOD | {"obstacle": {"lower": "0"}}),
        "obstacle: not with [elasticity]: a body meets its obstacle on the boundary, [contact]",
    ),
    "not with a flux": (
        write(GOOD | {"[neumann]": {"sides": '"right"', "flux": "1"}}),
        "neumann: not with [elasticity], where the load on sides is [[traction]]",
    ),
    "not with a solution": (write(GOOD | {"solution": {"u": "1"}}), "solution: not with"),
    "tractions of scalars": (
        write(without("elasticity", "[dirichlet]")),
        "traction: goes with [elasticity]",
    ),
    "a gap of scalars": (
        write(without("elasticity", "[dirichlet]", "[traction]")),
        "contact.gap: unknown key",
    ),
    "no contact": (write(without("contact")), "there is no [contact]"),
    "an obstacle in place of a gap": (
        changed("contact", "obstacle", "0"),
        "contact.obstacle: unknown key",
    ),
    "no modulus": (changed("elasticity", "young", None), "elasticity: 'young' is missing"),
    "no ratio": (changed("elasticity", "poisson", None), "elasticity: 'poisson' is missing"),
    "a negative modulus": (changed("elasticity", "young", "-1"), "young: must be positive, not -1"),
    "incompressible": (
        changed("elasticity", "poisson", "0.5"),
        "poisson: must lie between -1 and 1/2, not 0.5",
    ),
    "a modulus that is negative somewhere": (
        changed("elasticity", "young", '"a"'),
        "line 13: elasticity.young: must be positive, is -0.",
    ),
    "a ratio that is too large somewhere": (
        changed("elasticity", "poisson", '"0.6*x"'),
        "elasticity.poisson: must lie between -1 and 1/2, is 0.5",
    ),
    "no such plane": (changed("elasticity", "plane", '"stres"'), "did you mean 'stress'"),
    "a zero direction": (
        changed("contact", "direction", "[0, 0]"),
        "contact.direction: [0.0, 0.0] at",
    ),
    "normals at a corner": (
        write(GOOD | {"contact": {"sides": '["bottom", "right"]'}}),
        "contact.direction: facets with normals far apart meet at (1, 0",
    ),
    "data beyond the obstacle": (
        write(
            GOOD | {"contact": {"sides": '["bottom", "right"]', "direction": "[1, 1]", "gap": "-1"}}
        ),
        "contact.gap: -1 lies below the Dirichlet data at (1, 1",
    ),
    "no component": (
        changed("[dirichlet]", "components", '"z"'),
        "dirichlet.1.components: unknown component 'z'",
    ),
    "fewer values than components": (
        changed("[dirichlet]", "value", "[0]"),
        "dirichlet.1.value: must be a list of 2 formulas, not of 1",
    ),
    "more values than components": (
        changed("[dirichlet]", "components", '"x"'),
        "dirichlet.1.value: must be a list of 1 formulas, not of 2",
    ),
    "a component twice": (
        write(GOOD) + '\n[[dirichlet]]\nsides = "top"\ncomponents = "y"\nvalue = 0',
        "side 'top' belongs to dirichlet already",
    ),
    "a traction on a held side": (
        changed("[traction]", "sides", '"top"'),
        "side 'top' belongs to dirichlet already",
    ),
    "a force and a pressure": (
        changed("[traction]", "pressure", "1"),
        "traction.1.pressure: beside 'force'; give one of the two",
    ),
    "no force": (changed("[traction]", "force", None), "traction.1: 'force' is missing"),
    "a body that slides": (
        write(
            without("define", "[traction]")
            | {
                "elasticity": {"young": "1", "poisson": "0.3"},
                "contact": {"sides": '"bottom"'},
                "[dirichlet]": {"sides": '"top"', "components": '"y"', "value": "0"},
            }
        ),
        "dirichlet: a translation along (1, 0) is free",
    ),
    "a force that is not finite": (
        changed("elasticity", "force", '[0, "log(-1 - x)"]'),
        "elasticity.force: ",
    ),
    "a plane in space": (
        write(
            {
                "domain": {"shape": '"cube"', "cells": "2"},
                "elasticity": {"young": "1", "poisson": "0", "plane": '"strain"'},
                "contact": {"sides": '"bottom"'},
            }
        ),
        "elasticity.plane: for bodies in the plane",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_makes_no_sense_is_refused_by_name(case, folder, capsys):
    text, wanted = CASES[case]
    message = refused(folder, capsys, text)
    assert COMM.rank or wanted in message


def test_a_bound_is_not_known_for_displacements(folder, capsys):
    message = refused(folder, capsys, write(GOOD), "--bound")
    assert COMM.rank or message.startswith("error: --bound: not with [elasticity]")


def test_errors_are_not_compared(folder, capsys):
    out = folder / "out"
    message = refused(folder, capsys, write(GOOD), "--out", str(out), job="tradeoff")
    assert COMM.rank or "a scene with [elasticity] has no errors" in message
    assert not out.exists()
