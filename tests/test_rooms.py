"""The rooms of the package: imports point one way, and the paper stays in its own room."""

import ast
import re
from pathlib import Path

import dolfinx_signorini

ROOT = Path(dolfinx_signorini.__file__).parent
# Whoever imports the paper: its own room, the command line, and what compares with it.
OF_THE_PAPER = {"paper", "commands"}


def modules():
    return {
        ".".join(("dolfinx_signorini", *path.relative_to(ROOT).with_suffix("").parts)): path
        for path in ROOT.rglob("*.py")
    }


def imports(path, names):
    """The modules of the package that a module imports when it is imported itself."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("dolfinx_signorini"):
            parts = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {part if part in names else node.module for part in parts}
    return {name if name in names else f"{name}.__init__" for name in found}


def test_imports_make_no_circle():
    names = modules()
    graph = {name: imports(path, names) for name, path in names.items()}
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
    assert len(order) == len(names) > 50


def test_what_is_general_knows_nothing_of_the_paper():
    names = modules()
    knowing = {
        name
        for name, path in names.items()
        if any(other.startswith("dolfinx_signorini.paper") for other in imports(path, names))
    }
    rooms = {name.split(".")[1] for name in knowing}
    assert rooms - OF_THE_PAPER <= {"__init__"}


def test_the_map_for_contributors_has_every_room():
    text = (ROOT.parent / "CONTRIBUTING.md").read_text()
    rooms = {path.name for path in ROOT.glob("[a-z]*.py")}
    rooms |= {f"{path.parent.name}/" for path in ROOT.glob("[a-z]*/__init__.py")}
    assert {room for room in rooms if f"`{room}`" not in text} == set()
    files = {path.name for path in ROOT.rglob("*.py")}
    for listed in re.findall(r"`([A-Za-z_/]+\.(?:py|md|json))`", text):
        assert listed.split("/")[-1] in files or (ROOT.parent / listed).exists(), listed
