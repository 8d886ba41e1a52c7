"""The tables of a scene file, read key by key, with errors that name file, line and key."""

import difflib
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Any

import ufl
from ufl.constantvalue import ScalarValue, Zero

from dolfinx_signorini.base.compat import ELEMENTS
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.data.formulas import Formula, number
from dolfinx_signorini.data.parsing import parse, suggestion
from dolfinx_signorini.scenes.files.toml_file import Key, TomlFile

Rule = tuple[str, Callable[[Any], Any]]  # what numbers must be, in words, and whether they are
Check = Callable[[str], Any]  # raises an InputError for a text that is not allowed

NEEDED: Any = object()  # in place of a default: a table must have the key
ANY: Rule = "", lambda number: True
POSITIVE: Rule = "must be positive", lambda number: number > 0.0
MAX_ITEMS = 2_000  # of a list
ALL = ("all",)  # the names that stand for all sides


class TomlTable:
    """A table of a scene file, whose keys are asked for one by one.

    A key that nobody has asked for is an unknown one:

        file = TomlFile("scene.toml", text, ())
        table = TomlTable(file.data, file)
        degree = table.integer("degree", 1, 2)
        table.finish()

    Args:
        data: The table as the TOML parser returned it.
        file: The file that the table comes from.
        key: Where in the file the table is.
    """

    def __init__(self, data: Mapping[str, Any], file: TomlFile, key: Key = ()):
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
        self, key: str, kind: type | tuple[type, ...], wanted: str, default: Any = NEEDED
    ) -> Any:
        """Return the value of a key.

        Args:
            key: The key.
            kind: The type, or types, that the value must have; true and false are no numbers.
            wanted: The type in words, for the message.
            default: The value where the table does not have the key.
        """
        if not self.has(key):
            if default is not NEEDED:
                return default
            others = [other for other in self.data if other not in self.asked]
            for near in difflib.get_close_matches(key, others, n=1):
                raise self.error(near, f"unknown key; did you mean {key!r}?")
            raise self.error(None, f"{key!r} is missing")
        value = self.data[key]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise self.error(key, f"must be {wanted}")
        return value

    def text(self, key: str, default: Any = NEEDED, check: Check = str) -> str:
        """Return a text that passes a check; for defaults see `value`."""
        text = str(self.value(key, str, "a text in quotes", default))
        with self.naming(key):
            check(text)
        return text

    def texts(self, key: str, default: Sequence[str], check: Check = str) -> tuple[str, ...]:
        """Return a list of texts that pass a check, without repetitions."""
        values = self.items(key, default)
        if not all(isinstance(value, str) for value in values):
            raise self.error(key, "must be a list of texts in quotes")
        with self.naming(key):
            for text in values:
                check(text)
        return tuple(dict.fromkeys(values))

    def integer(self, key: str, low: int, high: int, default: Any = NEEDED) -> int:
        """Return an integer between two bounds, both of them allowed."""
        value = int(self.value(key, int, "an integer", default))
        if not low <= value <= high:
            raise self.error(key, f"must lie between {low} and {high}")
        return value

    def real(self, key: str, rule: Rule = ANY, default: Any = NEEDED) -> Any:
        """Return a finite number that obeys a rule; for defaults see `value`."""
        value = self.value(key, (int, float), "a number", default)
        return value if value is default else self.finite(key, value, rule)

    def finite(self, key: str, value: Any, rule: Rule = ANY) -> float:
        """Return the value of a key, or an item of its list, as a finite float; see `real`."""
        result = math.inf
        if isinstance(value, int | float) and not isinstance(value, bool):
            with suppress(OverflowError):
                result = float(value)
        if not math.isfinite(result):
            raise self.error(key, "must be a finite number")
        words, holds = rule
        if not holds(result):
            raise self.error(key, f"{words}, not {result:g}")
        return result

    def items(self, key: str, default: Any = NEEDED) -> list[Any]:
        """Return a list."""
        values = self.value(key, list, "a list", default)
        if len(values) > MAX_ITEMS:
            raise self.error(key, f"a list of more than {MAX_ITEMS} items")
        return list(values)

    def sides(
        self,
        known: tuple[str, ...],
        key: str = "sides",
        what: str = "side",
        default: Any = NEEDED,
    ) -> tuple[str, ...]:
        """Return the sides that a key names: one, a list of them, or "all" as `ALL`.

        Args:
            known: The names of all sides; numbers stand for names, too.
            key: The key.
            what: What is named, in place of a side.
            default: See `value`.
        """
        value = self.value(key, object, f"names or numbers of {what}s", default)
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

    def formula(self, key: str, default: Any = NEEDED, rule: Rule = ANY) -> Any:
        """Return a formula, a text or a number; for defaults see `value`.

        A formula that is a constant obeys the rule.
        """
        value = self.value(key, (str, int, float), "a formula in quotes or a number", default)
        if value is default:
            return value
        formula = self.parsed(key, value)
        if formula.constant is not None:
            self.finite(key, formula.constant, rule)
        return formula

    def parsed(self, key: str, value: Any) -> Formula:
        """Return the formula that is the value of a key, or an item of its list."""
        if not isinstance(value, str):
            return number(self.finite(key, value))
        x = ufl.SpatialCoordinate(ufl.Mesh(ELEMENTS[self.file.dimension]))
        try:
            formula = parse(value, self.file.dimension, self.file.definitions)
            expression = formula.ufl(x)  # refuses what has no value
        except InputError as error:
            raise self.error(key, str(error)) from None
        if isinstance(expression, ScalarValue | Zero):  # "0*x + 1" is constant, too
            return Formula(formula.text, number(float(expression)).root)
        return formula

    def vector(self, key: str, size: int, default: Any = NEEDED) -> tuple[Formula, ...]:
        """Return the formulas of a list, which has so many; for defaults see `value`."""
        wanted = f"a list of {size} formulas, one for each component"
        values = self.value(key, list, wanted, default)
        if values is not default and len(values) != size:
            raise self.error(key, f"must be a list of {size} formulas, not of {len(values)}")
        return tuple(self.parsed(key, value) for value in values)

    def check_needed(self, key: str, other: str, message: str) -> None:
        """Refuse a key that makes no sense without another one."""
        if self.has(key) and not self.has(other):
            raise self.error(key, message)

    def finish(self) -> None:
        """Refuse a key that nobody has asked for."""
        for key in self.data:
            if key not in self.asked:
                raise self.error(key, f"unknown key{suggestion(key, sorted(self.asked))}")


def one_of(choices: Iterable[str]) -> Check:
    """Return the check that a text is one of some."""
    known = tuple(choices)

    def check(text: str) -> None:
        if text not in known:
            raise InputError(f"unknown {text!r}{suggestion(text, known)}")

    return check
