"""Counts the collective calls of the package: import this module before the package.

Each module of the package is changed while Python imports it: a call such as `comm.allgather(x)`
becomes one of `noted(comm, "allgather", place, x)`. Collective calls inside of DOLFINx and PETSc
are not seen.
"""

import ast
import builtins
import pickle
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Any

PACKAGE = "dolfinx_signorini"
COUNTED = {"allgather", "alltoall", "bcast", "gather", "scatter", "allreduce"}

# By place and call: how often, and the most bytes that a rank gave and had after one call.
calls: dict[str, dict[str, int]] = {}


def noted(comm: Any, name: str, place: str, *args: Any, **keywords: Any) -> Any:
    """Make a collective call, and note the bytes of what it returns."""
    value = getattr(comm, name)(*args, **keywords)
    entry = calls.setdefault(f"{place} {name}", {"calls": 0, "bytes": 0})
    entry["calls"] += 1
    entry["bytes"] = max(entry["bytes"], len(pickle.dumps(value)))
    return value


class _Calls(ast.NodeTransformer):
    """Puts `noted` in the place of collective calls."""

    def __init__(self, path: str):
        self.place = str(Path(path).relative_to(Path(__file__).resolve().parents[1] / PACKAGE))

    def visit_Call(self, node: ast.Call) -> ast.Call:
        self.generic_visit(node)
        if not isinstance(node.func, ast.Attribute) or node.func.attr not in COUNTED:
            return node
        told = [node.func.value, ast.Constant(node.func.attr)]
        told.append(ast.Constant(f"{self.place}:{node.lineno}"))
        return ast.copy_location(
            ast.Call(ast.Name("__noted__", ast.Load()), [*told, *node.args], node.keywords), node
        )


class _Loader(SourceFileLoader):
    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        tree = _Calls(path).visit(ast.parse(self.get_data(path)))
        return compile(ast.fix_missing_locations(tree), path, "exec")


class _Finder(PathFinder):
    @classmethod
    def find_spec(
        cls, fullname: str, path: Sequence[str] | None = None, target: Any = None
    ) -> ModuleSpec | None:
        if fullname.partition(".")[0] != PACKAGE:
            return None
        spec = super().find_spec(fullname, path, target)
        if spec is not None and isinstance(spec.loader, SourceFileLoader) and spec.origin:
            spec.loader = _Loader(fullname, spec.origin)
        return spec


builtins.__noted__ = noted  # type: ignore[attr-defined]
sys.meta_path.insert(0, _Finder)
