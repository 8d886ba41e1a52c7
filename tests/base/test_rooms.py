"""The rooms of the package: imports point one way, and the paper stays in its own room."""

import ast
import re
from pathlib import Path

import pytest

import dolfinx_signorini
from dolfinx_signorini.commands.main import JOBS

pytestmark = pytest.mark.pure

ROOT = Path(dolfinx_signorini.__file__).parent
TESTS = ROOT.parent / "tests"
# What a problem needs; accuracy, bounds and scenes would take as long to load again.
OF_A_PROBLEM = {"base", "meshes", "data", "solvers", "problem"}
# Whoever imports the paper: its own room, and the command line.
PAPER = "dolfinx_signorini.studies.paper."
OF_THE_PAPER = {"studies", "commands"}


def modules():
    return {
        ".".join(("dolfinx_signorini", *path.relative_to(ROOT).with_suffix("").parts)): path
        for path in ROOT.rglob("*.py")
    }


def imports(path, names, nodes=lambda tree: tree.body):
    """The modules of the package that a module imports: when it is imported itself, by default."""
    found = set()
    for node in nodes(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("dolfinx_signorini"):
            parts = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {part if part in names else node.module for part in parts}
    return {name if name in names else f"{name}.__init__" for name in found}


def import_graph():
    """For each module of the package the modules that it imports when it is imported itself."""
    names = modules()
    return {name: imports(path, names) for name, path in names.items()}


def test_imports_make_no_circle():
    graph = import_graph()
    done, order = set(), []

    def visit(name, above):
        assert name not in above, " -> ".join((*above, name))
        if name not in done:
            for other in sorted(graph[name]):
                visit(other, (*above, name))
            done.add(name)
            order.append(name)

    for name in graph:
        visit(name, ())
    assert len(order) == len(graph) > 50


def test_what_is_general_knows_nothing_of_the_paper():
    knowing = {
        name
        for name, others in import_graph().items()
        if any(other.startswith("dolfinx_signorini.studies.paper") for other in others)
    }
    rooms = {name.split(".")[1] for name in knowing}
    assert rooms == OF_THE_PAPER


def test_a_problem_loads_no_more_rooms_than_it_needs():
    graph = import_graph()
    package = "dolfinx_signorini.__init__"
    reached, ahead = set(), {package, "dolfinx_signorini.problem.signorini"}
    while ahead:
        reached |= ahead
        ahead = set().union(*(graph[name] for name in ahead)) - reached
    assert {name.split(".")[1] for name in reached - {package}} == OF_A_PROBLEM
    jobs = {f"dolfinx_signorini.commands.{name}" for name in JOBS}
    assert jobs < graph.keys() and not jobs & graph["dolfinx_signorini.commands.main"]


def test_the_stub_exports_what_the_package_has():
    tree = ast.parse((ROOT / "__init__.pyi").read_text())
    (exported,) = (ast.literal_eval(n.value) for n in tree.body if isinstance(n, ast.Assign))
    assert sorted(exported) == sorted(dolfinx_signorini.__all__)
    assert set(exported) <= set(dir(dolfinx_signorini))
    assert all(hasattr(dolfinx_signorini, name) for name in exported)
    assert (ROOT / "py.typed").exists()  # else type checkers look at nothing


def rooms_of_the_map():
    text = (ROOT.parent / "CONTRIBUTING.md").read_text()
    return re.findall(r"^\| `([a-z_/]+)/` \|", text, flags=re.MULTILINE)


def test_the_map_for_contributors_has_every_room():
    rooms = {path.parent.relative_to(ROOT).as_posix() for path in ROOT.rglob("*/__init__.py")}
    listed = rooms_of_the_map()
    assert set(listed) == rooms and len(listed) == len(rooms)
    assert {path.name for path in ROOT.glob("*.py")} == {"__init__.py", "__main__.py"}
    text = (ROOT.parent / "CONTRIBUTING.md").read_text()
    files = {path.name for path in ROOT.rglob("*.py")}
    for file in re.findall(r"`([A-Za-z_/]+\.(?:py|md|json))`", text):
        inside = (ROOT / file).exists() or ("/" not in file and file in files)
        assert inside or (ROOT.parent / file).exists(), file


WANTED = {
    "a norm",
    "a boundary condition",
    "a domain",
    "a preconditioner of PETSc",
    "a preconditioner of your own",
    "a term of the estimate",
    "an operation of formulas",
}


def test_what_is_new_has_a_place_in_two_files_at_most():
    """Each row of the table names a file, and what stands there at the top or in a class."""
    text = (ROOT.parent / "CONTRIBUTING.md").read_text()
    places, new = {}, ""
    for first, file, what in re.findall(r"^\| ?(.*?) ?\| `([a-z_/]+\.py)` \| (.*) \|$", text, re.M):
        new = first or new
        places.setdefault(new, []).append(file)
        tree = ast.parse((ROOT / file).read_text())
        inside = {getattr(node, "id", getattr(node, "name", "")) for node in ast.walk(tree)}
        words = set(re.findall(r"`([A-Za-z_]+)`", what))
        assert words and words <= inside, (file, words - inside)
    assert set(places) == WANTED
    assert all(len(files) <= 2 for files in places.values())


def test_rooms_import_what_the_map_lists_above_them():
    order = [room for room in rooms_of_the_map() if "/" not in room]
    names = modules()
    for name, path in names.items():
        room = name.split(".")[1]
        if room in order:
            every = imports(path, names, ast.walk)  # those inside of functions, too
            others = {other.split(".")[1] for other in every} & set(order)
            assert all(order.index(other) <= order.index(room) for other in others), (name, others)


def test_the_tests_have_the_rooms_of_the_package():
    tests = {path.parent.relative_to(TESTS).as_posix() for path in TESTS.rglob("test_*.py")}
    assert tests - set(rooms_of_the_map()) <= {".", "extremes"}
