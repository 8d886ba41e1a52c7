"""The documentation as a reader meets it: recipes that run, commands and formulas as they stand."""

import argparse
import inspect
import re
import shlex
import sys
from dataclasses import replace
from pathlib import Path

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_signorini
from dolfinx_signorini.commands import theory
from dolfinx_signorini.studies.paper.theory.report import Document
from dolfinx_signorini.studies.paper.theory.statements import STATEMENTS

COMM = MPI.COMM_WORLD
ROOT = Path(__file__).parent.parent
sys.path.append(str(ROOT / "docs"))
PAGES = [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("docs/*/*.md")]


def properties():
    """Every public property of the package, by name."""
    for name in dolfinx_signorini.__all__:
        thing = getattr(dolfinx_signorini, name)
        for key, value in vars(thing).items() if isinstance(thing, type) else ():
            if isinstance(value, property) and not key.startswith("_"):
                yield f"{name}.{key}", value


def test_no_property_is_cut_at_its_colon():
    from _site import docstrings

    napoleon = pytest.importorskip("sphinx.ext.napoleon")
    config = napoleon.Config(napoleon_use_ivar=True)
    with_colons = 0
    for name, thing in properties():
        lines = inspect.getdoc(thing).splitlines()
        first = lines[0]
        docstrings.process(None, "property", name, thing, None, lines)
        lines = napoleon.GoogleDocstring(lines, config, what="property", name=name).lines()
        docstrings.shown(None, "property", name, thing, None, lines)
        assert re.sub(r"\\(.)", r"\1", lines[0]).replace("``", "`") == first, name
        assert not any(line.startswith(":type:") for line in lines), name
        with_colons += ":" in first
    assert with_colons >= 6


def test_what_is_returned_is_prose():
    from _site import docstrings

    napoleon = pytest.importorskip("sphinx.ext.napoleon")
    lines = ["Return both.", "", "Returns:", "    On all ranks: a pair.", "", "Raises:"]
    lines += ["    ValueError: There is none."]
    docstrings.process(None, "function", "both", None, None, lines)
    lines = napoleon.GoogleDocstring(lines, napoleon.Config(), what="function").lines()
    docstrings.shown(None, "function", "both", None, None, lines)
    assert ":returns: On all ranks: a pair." in lines
    assert ":raises ValueError: There is none." in lines


def test_underscores_of_formulas_are_letters():
    markdown = pytest.importorskip("markdown_it").MarkdownIt("commonmark").enable("table")
    assert len(PAGES) > 20
    for page in PAGES:
        for block in markdown.parse(page.read_text()):
            marks = {part.markup for part in block.children or ()}
            assert not marks & {"_", "__"}, (page.name, block.content)


def test_commands_are_words_of_a_shell():
    head = ["dolfinx-signorini", "theory"]
    for statement in (replace(s, checks=()) for s in STATEMENTS):
        section = Document([statement], {}).section(statement)
        printed = re.findall("`(dolfinx-signorini[^`]+)`", section)[-1]
        assert shlex.split(printed) == [*head, "--statement", statement.key]
    asked = argparse.Namespace(statement=["(3)", "2.1"], max_n=51)
    both = ["--statement", "(3)", "--statement", "2.1"]
    assert shlex.split(theory._command(asked)) == [*head, *both, "--max-n", "51"]
    for page in PAGES:
        for command in re.findall("`(dolfinx-signorini [^`]+)`", page.read_text()):
            words = list(shlex.shlex(command, posix=True, punctuation_chars=True))
            assert not set(words) & {"(", ")", "&", ";", "<", ">"}, (page.name, command)


def test_a_loop_that_was_stopped_goes_on_as_the_recipe_says(tmp_path, monkeypatch):
    text = (ROOT / "docs/howto/continue.md").read_text()
    recipe = re.findall("```python\n(.*?)```", text, re.DOTALL)[0].replace("% 100", "% 10")
    folder = COMM.bcast(str(tmp_path))

    def run(steps, where):
        """The solution after some steps of the heat equation above a floor that rises."""
        monkeypatch.chdir(where)
        domain = dolfinx.mesh.create_unit_square(COMM, 6, 6)
        space, dt = fem.functionspace(domain, ("Lagrange", 1)), 0.01
        floor = dolfinx.mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
        u, v, old = ufl.TrialFunction(space), ufl.TestFunction(space), fem.Function(space)
        time = fem.Constant(domain, 0.0)
        problem = dolfinx_signorini.SignoriniProblem(
            (u * v + dt * ufl.inner(ufl.grad(u), ufl.grad(v))) * ufl.dx,
            (old - dt) * v * ufl.dx,
            contact=floor,
            obstacle=0.2 * ufl.sin(3.0 * time) - 0.1,
            u=old,
        )
        names = {"problem": problem, "time": time, "dt": dt, "steps": steps}
        exec(recipe, names)
        return problem.u.x.array.copy(), names["first"]

    for name in ("whole", "parts"):
        if COMM.rank == 0:
            (Path(folder) / name).mkdir()
    COMM.barrier()
    whole, _ = run(23, Path(folder) / "whole")
    _, first = run(15, Path(folder) / "parts")
    assert first == 0
    COMM.barrier()
    parts, first = run(23, Path(folder) / "parts")
    assert first == 10
    assert parts == pytest.approx(whole, abs=1e-6)
