"""Reading TOML tables with errors that name file, line and key."""

import math
import re
import tomllib
from collections.abc import Mapping
from typing import Any

import basix.ufl
import ufl

from dolfinx_signorini.errors import InputError
from dolfinx_signorini.scenes.expressions import Expression, number
from dolfinx_signorini.scenes.grammar import parse
from dolfinx_signorini.scenes.suggestions import suggestion

Key = tuple[str | int, ...]

MAX_BYTES = 64_000
MAX_ITEMS = 2_000  # of a list
_HEADER = re.compile(r"\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(#.*)?")
_ASSIGNMENT = re.compile(r"\s*([\w\"'.\s-]+?)\s*=")


class Table:
    """A table of a scene file, whose keys are asked for one by one.

    Args:
        data: What the TOML parser made of it.
        source: The file it comes from.
        key: Where in the file it is.
    """

    def __init__(self, data: Mapping[str, Any], source: "Source", key: Key = ()):
        self.data, self.source, self.key = data, source, key
        self.asked: set[str] = set()

    def error(self, key: str | None, message: str) -> InputError:
        """Return an error about a key, or about the table itself."""
        return self.source.error(self.key if key is None else (*self.key, key), message)

    def has(self, key: str) -> bool:
        """Return whether the key is there, and count it as known."""
        self.asked.add(key)
        return key in self.data

    def value(self, key: str, kind: type | tuple[type, ...], wanted: str) -> Any:
        """Return the value of a key that must be there and of a type, named for the message."""
        if not self.has(key):
            raise self.error(None, f"{key!r} is missing")
        value = self.data[key]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise self.error(key, f"must be {wanted}")
        return value

    def text(self, key: str) -> str:
        """Return a text."""
        return str(self.value(key, str, "a text in quotes"))

    def choice(self, key: str, choices: tuple[str, ...]) -> str:
        """Return one of some texts."""
        text = self.text(key)
        if text not in choices:
            raise self.error(key, f"unknown {text!r}{suggestion(text, choices)}")
        return text

    def flag(self, key: str) -> bool:
        """Return true or false; false if the key is not there."""
        return bool(self.value(key, bool, "true or false")) if self.has(key) else False

    def integer(self, key: str, low: int, high: int) -> int:
        """Return an integer between two bounds."""
        value = int(self.value(key, int, "an integer"))
        if not low <= value <= high:
            raise self.error(key, f"must lie between {low} and {high}")
        return value

    def real(self, key: str) -> float:
        """Return a finite number."""
        return self.finite(key, self.value(key, (int, float), "a number"))

    def finite(self, key: str, value: Any) -> float:
        """Return what should be a finite number as a float."""
        try:
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ValueError
            result = float(value)
            if not math.isfinite(result):
                raise ValueError
        except (ValueError, OverflowError):
            raise self.error(key, "must be a finite number") from None
        return result

    def items(self, key: str) -> list[Any]:
        """Return a list."""
        values = self.value(key, list, "a list")
        if len(values) > MAX_ITEMS:
            raise self.error(key, f"a list of more than {MAX_ITEMS} items")
        return list(values)

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a list of texts, without repetitions."""
        values = self.items(key)
        if not all(isinstance(value, str) for value in values):
            raise self.error(key, "must be a list of texts in quotes")
        return tuple(dict.fromkeys(values))

    def table(self, key: str) -> "Table":
        """Return a table; an empty one if the key is not there."""
        if not self.has(key):
            return Table({}, self.source, (*self.key, key))
        return Table(self.value(key, dict, "a table"), self.source, (*self.key, key))

    def tables(self, key: str) -> list["Table"]:
        """Return the tables written as [[key]]."""
        entries = self.items(key) if self.has(key) else []
        if not all(isinstance(entry, dict) for entry in entries):
            raise self.error(key, f"must be tables, written as [[{key}]]")
        return [Table(e, self.source, (*self.key, key, k)) for k, e in enumerate(entries)]

    def formula(
        self, key: str, dimension: int, definitions: Mapping[str, Expression]
    ) -> Expression:
        """Return a formula, written as a text or as a number."""
        value = self.value(key, (str, int, float), "a formula in quotes or a number")
        return self.formula_of(key, value, dimension, definitions)

    def formula_of(
        self, key: str, value: Any, dimension: int, definitions: Mapping[str, Expression]
    ) -> Expression:
        """Return what should be a formula."""
        if not isinstance(value, str):
            return number(self.finite(key, value))
        try:
            expression = parse(value, dimension, definitions)
            expression.ufl(_coordinates(dimension))  # says what has no value
        except InputError as error:
            raise self.error(key, str(error)) from None
        return expression

    def finish(self) -> None:
        """Complain about a key that nobody asked for."""
        for key in self.data:
            if key not in self.asked:
                raise self.error(key, f"unknown key{suggestion(key, sorted(self.asked))}")


class Source:
    """The text of a scene file, for the lines of its keys.

    Args:
        name: Name of the file, for messages.
        text: Its text.
    """

    def __init__(self, name: str, text: str):
        self.name, self.text = name, text

    def load(self) -> Table:
        """Return the whole file as a table.

        Raises:
            InputError: It is too large or no TOML.
        """
        if len(self.text) > MAX_BYTES:
            raise InputError(f"{self.name}: a scene file has at most {MAX_BYTES} characters")
        try:
            return Table(tomllib.loads(self.text), self)
        except (tomllib.TOMLDecodeError, ValueError) as error:
            raise InputError(f"{self.name}: {error}") from None
        except RecursionError:
            raise InputError(f"{self.name}: nested too deeply") from None

    def error(self, key: Key, message: str) -> InputError:
        """Return an error that names file, line and key."""
        lines = self.lines()
        position = key
        while position and position not in lines:
            position = position[:-1]
        line = f", line {lines[position]}" if position else ""
        name = ".".join(str(part + 1) if isinstance(part, int) else part for part in key)
        return InputError(f"{self.name}{line}{': ' + name if name else ''}: {message}")

    def lines(self) -> dict[Key, int]:
        """Return the line of each key and header."""
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
