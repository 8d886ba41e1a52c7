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
from petsc4py import PETSc
from scipy import optimize

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
        for key in dir(thing) if isinstance(thing, type) else ():
            value = inspect.getattr_static(thing, key)
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
    markdown.use(pytest.importorskip("mdit_py_plugins.dollarmath").dollarmath_plugin)
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


def test_snippets_and_demos_load_the_mpi_of_pypi_before_dolfinx():
    """The DOLFINx of PyPI needs an MPI that the import of this package loads."""
    texts = [path.read_text() for path in sorted((ROOT / "demos").glob("*.py"))]
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        texts += re.findall(
            r"```(?:python|\{code-cell\} ipython3)\n(.*?)```", path.read_text(), re.DOTALL
        )
    both = 0
    for text in texts:
        ours = re.search(r"^(?:import|from) dolfinx_signorini\b", text, re.MULTILINE)
        theirs = re.search(r"^(?:import|from) dolfinx\b", text, re.MULTILINE)
        if ours and theirs:
            both += 1
            assert ours.start() < theirs.start(), text[:200]
    assert both > 30


def test_links_of_pages_lead_to_files_of_the_checkout():
    """So they work where the site is not built, and links.py looks at those of the site."""
    made = {ROOT / "docs" / name for name in ("tutorials", "gallery", "reference")}
    count = 0
    for page in (page for page in PAGES if page.parent not in made):
        text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
        for link in re.findall(r"\]\(([^)\s]+)\)", text):
            target = link.partition("#")[0]
            if target and "://" not in link:
                count += 1
                assert (page.parent / target).exists(), (page, link)
    assert count > 100


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


@pytest.mark.parametrize(
    "page",
    [
        "index.md",
        "scope.md",
        "howto/arrays.md",
        "howto/continue.md",
        "howto/curved.md",
        "howto/derivatives.md",
        "howto/elastic.md",
        "howto/elastic_accuracy.md",
        "howto/functional.md",
        "howto/hysteresis.md",
        "howto/jumps.md",
        "howto/which_problem.md",
    ],
)
def test_the_snippets_of_a_page_run_as_printed(page, tmp_path, monkeypatch):
    """Blocks from the first one that imports something on, in one namespace, on coarser meshes."""
    text = (ROOT / "docs" / page).read_text().replace("256, 256", "32, 32")
    if not PETSc.Sys.hasExternalPackage("hypre"):
        text = text.replace('"hypre"', '"gamg"')
    blocks = re.findall("```python\n(.*?)```", text, re.DOTALL)
    first = next(n for n, block in enumerate(blocks) if "from mpi4py" in block)
    monkeypatch.chdir(COMM.bcast(str(tmp_path)))
    names = {}
    for block in blocks[first:]:
        if not block.startswith(("state = coarse", "shown")):
            exec(compile(block, page, "exec"), names)
    EXPECTED.get(page, lambda names: None)(names)


def same_with_snes(names):
    count = names["V"].dofmap.index_map.size_local
    values = names["values"].array_r
    assert names["u_h"].x.array[:count] == pytest.approx(values, abs=1e-6)
    assert COMM.allreduce(float(values.max(initial=0.0)), MPI.MAX) > 0.0


def outside_by_snes(names):
    """The exact solution in one dimension touches the obstacle on an interval; 10 u' - u'' = -2."""
    gap = names["carried"].x.array - names["lower"].x.array
    assert gap.min(initial=0.0) >= -1e-12
    assert COMM.allreduce(int((np.abs(gap) < 1e-12).sum())) > 0
    # Before contact u = -x/5 + C (exp(10 x) - 1) with u = -0.05 and u' = 0 at the end of it.
    end = optimize.brentq(lambda t: -t / 5 + (1.0 - np.exp(-10 * t)) / 50 + 0.05, 0.1, 1.0)
    x, values = names["V"].tabulate_dof_coordinates()[:, 0], names["carried"].x.array
    before = x < end
    exact = -x / 5 + np.exp(-10 * end) / 50 * (np.exp(10 * x) - 1.0)
    assert values[before] == pytest.approx(exact[before], abs=1e-3)
    assert np.abs(gap[(x > end + 0.1) & (x < 0.8)]).max(initial=0.0) < 1e-12


def each_bound_holds_where_it_acts(names):
    """All solutions of the page keep their bounds, touch them, and are free elsewhere."""
    x, y = names["V"].tabulate_dof_coordinates()[:, :2].T
    inside, far = y < 1.0 - 1e-9, np.full(len(x), np.inf)  # the bounds are for dofs without data
    hill = -0.3 - (x - 0.5) ** 2
    at = np.isclose
    for name, lower, upper in (
        ("wall", np.where(at(y, 0.0), -0.5, -far), far),
        ("membrane", hill, far),
        ("between", hill, 0.4 + 0.0 * x),
        ("half", np.where(x < 0.5 + 1e-9, -0.3, -far), far),
        ("carried", np.where(at(x, 0.5), -0.3, -far), far),
        ("moving", -0.2 - x**2, far),
    ):
        u = names[name].u.x.array
        assert (lower - 1e-12 <= u)[inside].all() and (u <= upper + 1e-12)[inside].all(), name
        for bound in (lower, upper):
            touching = COMM.allreduce(int((inside & (np.abs(u - bound) < 1e-12)).sum()))
            assert (touching > 0) == COMM.allreduce(bool(np.isfinite(bound).any()), MPI.LOR), name
        assert COMM.allreduce(int((inside & (lower < u) & (u < upper)).sum())) > 0, name
    for name in ("half", "carried"):  # where there is no bound, the membrane hangs lower
        lowest = COMM.allreduce(names[name].u.x.array.min(initial=0.0), MPI.MIN)
        assert lowest < -0.4, name
    assert 0.0 < names["carried"].force < 2.0
    assert COMM.allreduce(len(names["below"])) > 0 and COMM.allreduce(len(names["above"])) > 0


def derivatives_agree(names):
    direct, indirect = (COMM.allreduce(names[key]) for key in ("direct", "indirect"))
    assert direct == pytest.approx(indirect, rel=1e-8)
    assert names["problem"].force == pytest.approx(0.3, abs=1e-8)
    # The slope of the present stair, by a difference quotient within the stair.
    scale, problem = names["s"], names["problem"]
    forces = []
    for value in (1.5, 1.5 + 1e-3):
        scale.value = value
        forces.append(problem.solve(rtol=1e-12) and problem.force)
    _, changes = problem.solve_linearised(names["unit_load"], rtol=1e-10)
    slope = COMM.allreduce(float(changes.x.array[problem.contact_dofs].sum()))
    assert slope == pytest.approx((forces[1] - forces[0]) / 1e-3, rel=1e-6)
    # The force changes by the integral of its derivative, here with 50 values.
    k, force, change = np.array(names["table"]).T
    integral = ((change[1:] + change[:-1]) / 2 * np.diff(k)).sum()
    assert integral == pytest.approx(force[-1] - force[0], rel=1e-2)
    assert force[-1] < 0.9 * force[0]


def slope_on_the_ring(names):
    """u = r^2/4 - 1/4 + B log r with full contact at r = 1/2."""
    B = (-0.02 + 3 / 16) / np.log(0.5)
    exact = -(7 / 48 + B / 2) * np.pi / 2
    assert abs(names["value"](names["found"]) - exact) <= names["found"].estimate <= 1e-3
    assert abs(names["value"](names["polygon"]) - exact) > 10.0 * names["polygon"].estimate


def bodies_rest_on_their_obstacles(names):
    """The forces are in balance, and no body is inside of its obstacle."""
    x = names["V"].tabulate_dof_coordinates().T
    for name, gap, towards in (
        ("problem", 0.2 * x[0] ** 2, np.stack([0.0 * x[0], 0.0 * x[0] - 1.0])),
        ("down", 0.1 + 0.0 * x[0], np.stack([0.0 * x[0], 0.0 * x[0] - 1.0])),
        ("radial", names["distance"](x), names["towards_a_disc"](x)),
    ):
        problem, at = names[name], names[name].contact_nodes
        left = (gap - (problem.u.x.array.reshape(-1, 2).T * towards).sum(axis=0))[at]
        assert left.min(initial=0.0) >= -1e-12, name
        assert problem.gap.x.array[at] == pytest.approx(left, abs=1e-12), name
        touching = COMM.allreduce(len(problem.active))
        assert (touching > 0) == (name != "down"), name
        assert (problem.force[1] > 0.0) == (touching > 0), name


def contact_of_the_block_is_symmetric(names):
    """Like the block and its support; the last loop ends below its accuracy."""
    first, last = sorted(position[0] for position in names["ends"])
    assert abs(first + last) < 0.02 and 0.1 < last - first < 1.0
    assert names["found"].reached and names["found"].problem.force[1] > 0.0


def a_jump_inside_cells_costs_an_order(names):
    fitted, crossed = names["errors"]
    assert abs(fitted) < 1e-8 and 1e-3 < abs(crossed) < 1e-2


EXPECTED = {
    "index.md": same_with_snes,
    "scope.md": outside_by_snes,
    "howto/curved.md": slope_on_the_ring,
    "howto/derivatives.md": derivatives_agree,
    "howto/elastic.md": bodies_rest_on_their_obstacles,
    "howto/elastic_accuracy.md": contact_of_the_block_is_symmetric,
    "howto/jumps.md": a_jump_inside_cells_costs_an_order,
    "howto/which_problem.md": each_bound_holds_where_it_acts,
}


def test_pyvista_gets_the_solution_as_the_page_says(monkeypatch):
    """The integral of a linear function over a cube, by PyVista; the display is left out."""
    pyvista = pytest.importorskip("pyvista")
    if COMM.size > 1:
        pytest.skip("the page is about one rank")
    text = (ROOT / "docs/howto/results.md").read_text()
    (block,) = re.findall("```python\n(import pyvista\n.*?)```", text, re.DOTALL)
    monkeypatch.setattr(pyvista.UnstructuredGrid, "plot", lambda self, scalars: None)
    domain = dolfinx.mesh.create_unit_cube(COMM, 2, 3, 4)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
    u.interpolate(lambda x: x[0] + 2.0 * x[1] - x[2])
    names = {"problem": argparse.Namespace(u=u, space=u.function_space)}
    exec(block, names)
    assert names["grid"].volume == pytest.approx(1.0)
    assert names["grid"].integrate_data()["u"] == pytest.approx(1.0)
