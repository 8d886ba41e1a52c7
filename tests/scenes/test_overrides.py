"""Keys of a scene file with other values: the same checks and messages as for the file."""

import re
from pathlib import Path

import pytest
from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.scenes.files.reading import naming_the_file, parse_scene

COMM = MPI.COMM_WORLD
TEXT = """
[domain]
shape = "square"
cells = 8

[contact]
sides = "bottom"
obstacle = "-0.1"

[[dirichlet]]
sides = "top"
value = 0

[[dirichlet]]
sides = "left"
value = "x"
"""


def scene(*overrides):
    return parse_scene(TEXT, Path("scene.toml"), COMM, overrides)


def test_values_stand_in_place_of_those_of_the_file():
    found = scene("domain.cells=12", "equation.load = -1 - 2*y", "dirichlet.2.value=3", "degree=2")
    assert found.domain.cells == 12
    assert found.degree == 2
    assert found.load.text == "-1 - 2*y"  # a table that the file does not have, and no quotes
    assert [c.value.constant for c in found.conditions if c.key == "dirichlet"] == [0.0, 3.0]
    assert scene("contact.sides=[\"bottom\", 'right']").contact.sides == ("bottom", "right")
    assert scene("domain.cells=12", "domain.cells=13").domain.cells == 13
    assert found.text == TEXT
    assert found.overrides[0] == "domain.cells=12"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("domain.cells", "--set: must be KEY=VALUE"),
        ("=3", "--set: must be KEY=VALUE"),
        ("domain..cells=3", "--set: must be KEY=VALUE"),
        ("domain.cells=many", "--set domain.cells: must be an integer"),
        ("domain.cells=0", "--set domain.cells: must lie between"),
        ("domain.cels=3", "--set domain.cels: unknown key; did you mean 'cells'?"),
        ("domain=3", "--set domain: must be one table"),
        ("domain.cells.x=3", "--set domain.cells.x: 'domain.cells' is no table"),
        ("dirichlet.3.value=1", "--set dirichlet.3.value: the items of 'dirichlet'"),
        ("dirichlet.0.value=1", "--set dirichlet.0.value: the items of 'dirichlet'"),
        ("dirichlet.value=1", "--set dirichlet.value: the items of 'dirichlet'"),
        ("dirichlet.1.value=x^", "--set dirichlet.1.value: a number, a name"),
        ("contact.sides=floor", "--set contact.sides: unknown side 'floor'"),
        ("equation.reaction=-1", "--set equation.reaction: must not be negative"),
        (f"dirichlet.{'9' * 5000}.value=1", f"--set dirichlet.{'9' * 5000}.value: the items of"),
        (f"domain.cells={'[' * 20000}", "--set: is nested too deeply"),
        (f"contact.sides=0x{'f' * 5000}", "--set contact.sides: must be names or numbers"),
        ('domain={shape="file",file="a\\u0000.msh"}', "--set domain.file: "),
        (f'domain={{shape="file",file="{"a" * 300}.msh"}}', "--set domain.file: "),
    ],
)
def test_a_wrong_value_is_refused_with_its_key(override, message):
    with pytest.raises(InputError, match=re.escape(message)):
        scene(override)


def test_other_keys_keep_the_line_of_the_file():
    with pytest.raises(InputError, match=r"scene.toml, line 4: domain.cells: unknown key"):
        scene("domain.shape=polygon", "domain.vertices=[[0,0],[1,0],[0,1]]", "domain.width=0.5")


def test_an_error_of_the_problem_names_the_option():
    with (
        pytest.raises(InputError, match=r"--set equation.load: no solution"),
        naming_the_file(Path("scene.toml"), scene("equation.load=1")),
    ):
        raise InputError("no solution", "load")


def test_an_error_of_a_table_names_the_options_in_the_table():
    changed = scene("equation.reaction=2", "domain.cells=4")
    with (
        pytest.raises(InputError, match=r"equation with --set equation\.reaction: not definite$"),
        naming_the_file(Path("scene.toml"), changed),
    ):
        raise InputError("not definite", "form a")


def test_a_mesh_that_will_be_adapted_needs_no_width():
    text = TEXT.replace("cells = 8\n", "")
    with pytest.raises(InputError, match="'cells' is missing"):
        parse_scene(text, Path("scene.toml"), COMM)
    assert parse_scene(text, Path("scene.toml"), COMM, adapted=True).domain.cells == 20
    assert parse_scene(TEXT, Path("scene.toml"), COMM, adapted=True).domain.cells == 8
