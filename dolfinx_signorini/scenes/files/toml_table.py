"""The tables of a scene file, read key by key, with errors that name file, line and key."""

import difflib
import math
import re
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import basix.ufl
import ufl
from ufl.constantvalue import ScalarValue, Zero

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.data.formulas import Formula, number
from dolfinx_signorini.data.parsing import parse, suggestion
from dolfinx_signorini.scenes.files.overrides import apply_override

Key = tuple[str | int, ...]

MAX_BYTES = 1_000_000  # of a text that is parsed
MAX_ITEMS = 2_000  # of a list
ALL = ("all",)  # the names that stand for all sides
_HEADER = re.compile(r"\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(#.*)?")
_ASSIGNMENT = re.compile(r"\s*([\w\"'.-]+(?:\s+[\w\"'.-]+)*)\s*=")


class TomlTable:
    """A table of a scene file, whose keys are asked for one by one.

    A key that nobody has asked for is an unknown one:

        table = TomlFile("scene.toml", text, ()).load()
        degree = table.integer("degree", 1, 2)
        table.finish()

    Args:
        data: The table as the TOML parser returned it.
        file: The file that the table comes from.
        key: Where in the file the table is.
    """

    def __init__(self, data: Mapping[str, Any], file: "TomlFile", key: Key = ()):
        self.data, self.file, self.key = data, file, key
        self.asked: set[str] = set()

    def error(self, key: str | None, message: str) -> InputError:
        """Return an error about a key, or about the table itself for None."""
        return self.file.error(self.key if key is None else (*self.key, key), message)

    def has(self, key: str) -> bool:
        """Return whether the table has a key, which is a known one from now on."""
        self.asked.add(key)
        return key in self.data

    @contextmanager
    def naming(self, key: str) -> Iterator[None]:
        """Give the errors of a block the place of a key."""
        try:
            yield
        except InputError as error:
            raise self.error(key, error.message) from None

    def value(
        self, key: str, kind: type | tuple[type, ...], wanted: str, default: Any = None
    ) -> Any:
        """Return the value of a key.

        Args:
            key: The key.
            kind: The type, or types, that the value must have; true and false are no numbers.
            wanted: The type in words, for the message.
            default: The value where the table does not have the key; None if the table must.
        """
        if not self.has(key) and default is not None:
            return default
        if not self.has(key):
            others = [other for other in self.data if other not in self.asked]
            for near in difflib.get_close_matches(key, others, n=1):
                raise self.error(near, f"unknown key; did you mean {key!r}?")
            raise self.error(None, f"{key!r} is missing")
        value = self.data[key]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise self.error(key, f"must be {wanted}")
        return value

    def text(self, key: str, default: str | None = None) -> str:
        """Return a text; for defaults see `value`."""
        return str(self.value(key, str, "a text in quotes", default))

    def choice(self, key: str, choices: tuple[str, ...], default: str | None = None) -> str:
        """Return one of some texts."""
        text = self.text(key, default)
        if text not in choices:
            raise self.error(key, f"unknown {text!r}{suggestion(text, choices)}")
        return text

    def flag(self, key: str) -> bool:
        """Return true or false; false where the table does not have the key."""
        return bool(self.value(key, bool, "true or false", False))

    def integer(self, key: str, low: int, high: int, default: int | None = None) -> int:
        """Return an integer between two bounds, both of them allowed."""
        value = int(self.value(key, int, "an integer", default))
        if not low <= value <= high:
            raise self.error(key, f"must lie between {low} and {high}")
        return value

    def real(self, key: str) -> float:
        """Return a finite number."""
        return self.finite(key, self.value(key, (int, float), "a number"))

    def finite(self, key: str, value: Any) -> float:
        """Return the value of a key, or an item of its list, as a finite float."""
        if isinstance(value, int | float) and not isinstance(value, bool):
            try:
                result = float(value)
            except OverflowError:
                result = math.inf
            if math.isfinite(result):
                return result
        raise self.error(key, "must be a finite number")

    def items(self, key: str, default: Sequence[Any] | None = None) -> list[Any]:
        """Return a list."""
        values = self.value(key, list, "a list", default)
        if len(values) > MAX_ITEMS:
            raise self.error(key, f"a list of more than {MAX_ITEMS} items")
        return list(values)

    def texts(self, key: str, default: Sequence[str]) -> tuple[str, ...]:
        """Return a list of texts, without repetitions."""
        values = self.items(key, default)
        if not all(isinstance(value, str) for value in values):
            raise self.error(key, "must be a list of texts in quotes")
        return tuple(dict.fromkeys(values))

    def sides(
        self, known: tuple[str, ...], key: str = "sides", what: str = "side"
    ) -> tuple[str, ...]:
        """Return the sides that a key names: one, a list of them, or "all" as `ALL`.

        Args:
            known: The names of all sides; numbers stand for names, too.
            key: The key.
            what: What is named, in place of a side.
        """
        value = self.value(key, object, f"names or numbers of {what}s")
        names = value if isinstance(value, list) else [value]
        if names == list(ALL):
            return ALL
        if ALL[0] in names and ALL[0] not in known:
            raise self.error(key, f"'all' stands for every {what}, and goes with no other name")
        if not names:
            raise self.error(key, f"names no {what}")
        for name in names:
            number = type(name) is int and abs(name) <= sys.maxsize
            if not (number or isinstance(name, str)):
                raise self.error(key, f"must be names or numbers of {what}s")
            if str(name) not in known:
                near = suggestion(str(name), known)
                raise self.error(key, f"unknown {what} {str(name)!r}{near}")
        return tuple(map(str, names))

    def table(self, key: str) -> "TomlTable":
        """Return a table; an empty one where the table does not have the key."""
        data = self.value(key, dict, f"one table, written as [{key}]", {})
        return TomlTable(data, self.file, (*self.key, key))

    def tables(self, key: str) -> list["TomlTable"]:
        """Return the tables written as [[key]]."""
        wanted = f"must be tables, each written as [[{key}]]"
        if self.has(key) and isinstance(self.data[key], dict):
            raise self.error(key, wanted)
        entries = self.items(key, [])
        if not all(isinstance(entry, dict) for entry in entries):
            raise self.error(key, wanted)
        return [TomlTable(e, self.file, (*self.key, key, k)) for k, e in enumerate(entries)]

    def formula(self, key: str, value: Any = None) -> Formula:
        """Return the formula of a key, or of an item of its list: a text or a number."""
        if value is None:
            value = self.value(key, (str, int, float), "a formula in quotes or a number")
        if not isinstance(value, str):
            return number(self.finite(key, value))
        try:
            formula = parse(value, self.file.dimension, self.file.definitions)
            expression = formula.ufl(_coordinates(self.file.dimension))  # refuses what has no value
        except InputError as error:
            raise self.error(key, str(error)) from None
        if isinstance(expression, ScalarValue | Zero):  # "0*x + 1" is constant, too
            return Formula(formula.text, number(float(expression)).root)
        return formula

    def optional_formula(self, key: str) -> Formula | None:
        """Return a formula; None where the table does not have the key."""
        return self.formula(key) if self.has(key) else None

    def vector(self, key: str, size: int) -> tuple[Formula, ...]:
        """Return the formulas of a list, which has so many."""
        values = self.value(key, list, f"a list of {size} formulas, one for each component")
        if len(values) != size:
            raise self.error(key, f"must be a list of {size} formulas, not of {len(values)}")
        return tuple(self.formula(key, value) for value in values)

    def finish(self) -> None:
        """Refuse a key that nobody has asked for."""
        for key in self.data:
            if key not in self.asked:
                raise self.error(key, f"unknown key{suggestion(key, sorted(self.asked))}")


class TomlFile:
    """The text of a scene file, and the lines of its keys.

    An error names the line:

        raise TomlFile("scene.toml", text, ()).error(("domain", "cells"), "must be an integer")

    Args:
        name: The name of the file, for messages.
        text: The text of the file.
        overrides: Values in place of those of the file, see `apply_override`.

    Attributes:
        dimension: The space dimension of the formulas in the file.
        definitions: The names that stand for formulas in the file.
    """

    def __init__(self, name: str, text: str, overrides: Sequence[str]):
        self.name, self.text, self.overrides = name, text, tuple(overrides)
        self.overridden: set[Key] = set()
        self.dimension = 2
        self.definitions: dict[str, Formula] = {}

    def load(self) -> TomlTable:
        """Return the whole file as a table.

        Raises:
            InputError: The file is too large or no TOML.
        """
        if len(self.text) > MAX_BYTES:
            raise InputError(f"a scene file has at most {MAX_BYTES} characters", self.name)
        try:
            data = tomllib.loads(self.text)
        except ValueError as error:
            raise InputError(str(error), self.name) from None
        except RecursionError:
            raise InputError("nested too deeply", self.name) from None
        self.overridden = {apply_override(data, text) for text in self.overrides}
        return TomlTable(data, self)

    def error(self, key: Key, message: str) -> InputError:
        """Return an error whose subject is file, line and key.

        The line is that of the key or, without one, of the table around it.
        """
        name = ".".join(str(part + 1) if isinstance(part, int) else part for part in key)
        if any(key[: len(path)] == path for path in self.overridden):
            return InputError(message, f"--set {name}")
        lines = self.lines()
        position = key
        while position and position not in lines:
            position = position[:-1]
        line = f", line {lines[position]}" if position else ""
        return InputError(message, f"{self.name}{line}{': ' + name if name else ''}")

    def lines(self) -> dict[Key, int]:
        """Return the line, from 1, of each key and header."""
        found: dict[Key, int] = {}
        counts: dict[Key, int] = {}
        table: Key = ()
        for count, line in enumerate(self.text.splitlines(), 1):
            header, assignment = _HEADER.fullmatch(line), _ASSIGNMENT.match(line)
            if header:
                table = _parts(header[2])
                if header[1] == "[[":
                    counts[table] = counts.get(table, -1) + 1
                    found.setdefault(table, count)
                    table = (*table, counts[table])
                found.setdefault(table, count)
            elif assignment:
                found.setdefault((*table, *_parts(assignment[1])), count)
        return found


def _parts(name: str) -> Key:
    return tuple(part.strip().strip("\"'") for part in name.split("."))


def _coordinates(dimension: int) -> ufl.SpatialCoordinate:
    cell = "triangle" if dimension == 2 else "tetrahedron"
    return ufl.SpatialCoordinate(
        ufl.Mesh(basix.ufl.element("Lagrange", cell, 1, shape=(dimension,)))
    )
