"""The text of a scene file: its tables with values in place of some, and the lines of its keys."""

import re
import tomllib
from collections.abc import Sequence
from typing import Any

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.data.formulas import Formula

Key = tuple[str | int, ...]  # where a value is in the tables; items of lists are counted from 0

MAX_BYTES = 1_000_000  # of a text that is parsed
_HEADER = re.compile(r"\s*(\[\[?)\s*([^\[\],]+?)\s*\]\]?\s*(#.*)?")  # a row of a list has a comma
_ASSIGNMENT = re.compile(r"\s*([\w\"'.-]+(?:\s+[\w\"'.-]+)*)\s*=")


class TomlFile:
    """The text of a scene file, and the lines of its keys.

    An error names the line:

        raise TomlFile("scene.toml", text, ()).error(("domain", "cells"), "must be an integer")

    Args:
        name: The name of the file, for messages.
        text: The text of the file.
        overrides: Values in place of those of the file, each as KEY=VALUE.

    Attributes:
        data: The whole file as the TOML parser returns it, with the overrides.
        dimension: The space dimension of the formulas in the file.
        components: The number of components of the unknown.
        definitions: The names that stand for formulas in the file.

    Raises:
        InputError: The file is too large or no TOML.
    """

    def __init__(self, name: str, text: str, overrides: Sequence[str]):
        self.name, self.text = name, text
        self.dimension, self.components = 2, 1
        self.definitions: dict[str, Formula] = {}
        if len(text) > MAX_BYTES or len(text.encode()) > MAX_BYTES:
            raise InputError(f"a scene file has at most {MAX_BYTES} bytes", name)
        try:
            self.data: dict[str, Any] = tomllib.loads(text)
        except ValueError as error:
            raise InputError(str(error), name) from None
        except RecursionError:
            raise InputError("nested too deeply", name) from None
        self.overridden = {_override(self.data, override) for override in overrides}

    def error(self, key: Key, message: str) -> InputError:
        """Return an error whose subject is file, line and key, and what overrides parts of the key.

        The line is that of the key or, without one, of the table around it.
        """
        name = _name(key)
        if any(key[: len(path)] == path for path in self.overridden):
            return InputError(message, f"--set {name}")
        lines = self.lines()
        position = key
        while position and position not in lines:
            position = position[:-1]
        line = f", line {lines[position]}" if position else ""
        inside = [_name(path) for path in self.overridden if name and path[: len(key)] == key]
        given = f" with --set {', '.join(sorted(inside))}" if inside else ""
        return InputError(message, f"{self.name}{line}{': ' + name if name else ''}{given}")

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


def _name(key: Sequence[str | int]) -> str:
    return ".".join(str(part + 1) if isinstance(part, int) else part for part in key)


def _parts(name: str) -> Key:
    return tuple(part.strip().strip("\"'") for part in name.split("."))


def _override(data: dict[str, Any], text: str) -> Key:
    """Put another value into the tables of a scene file.

    A table that is missing is made; an item of a list has to be there already.

    Args:
        data: The tables as the TOML parser returned them.
        text: Key and value, for example "dirichlet.1.value=2"; items are counted from 1. The value
            is written as in TOML; quotes around a text may be left out.

    Returns:
        The path of the key.

    Raises:
        InputError: The text is no key with a value, or there is no such item.
    """
    name, equals, value = text.partition("=")
    parts = [part.strip() for part in name.split(".")]
    if not equals or not all(parts):
        raise InputError(f"must be KEY=VALUE, for example domain.cells=200, not {text!r}", "--set")
    place: Any = data
    path: list[str | int] = []
    for part, below in zip(parts, [*parts[1:], None], strict=True):
        index = _index(place, part, path, name)
        path.append(index)
        if below is None:
            place[index] = _value(value.strip())
        elif isinstance(place, dict):
            place = place.setdefault(str(index), {})
        else:
            place = place[index]
    return tuple(path)


def _index(place: Any, part: str, above: Sequence[str | int], name: str) -> str | int:
    """Return what a part of a key stands for: a key of a table, or the place in a list."""
    if isinstance(place, dict):
        return part
    subject, where = f"--set {name.strip()}", _name(above)
    if not isinstance(place, list):
        raise InputError(f"{where!r} is no table", subject)
    digits = len(str(len(place)))  # longer numbers are not even read
    if not part.isdecimal() or len(part) > digits or not 1 <= int(part) <= len(place):
        items = f"1 to {len(place)}" if len(place) > 1 else "1"
        raise InputError(f"the items of {where!r} have the numbers {items}, not {part!r}", subject)
    return int(part) - 1


def _value(text: str) -> Any:
    """Return the TOML value that a text is, or the text itself."""
    try:
        data = tomllib.loads(f"value = {text}")
    except ValueError:
        return text
    except RecursionError:
        raise InputError("is nested too deeply", "--set") from None
    return data["value"] if len(data) == 1 else text
