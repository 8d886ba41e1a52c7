"""The statements of the paper: what they claim, what is computed for them, what is seen.

Texts and checks are in `data/statements.toml`, whose first lines say how to read a check.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dolfinx_signorini.studies.paper.tables import read_data
from dolfinx_signorini.studies.paper.theory.checks import RULES, Check, Together
from dolfinx_signorini.studies.paper.theory.tables import TABLES
from dolfinx_signorini.studies.paper.theory.values import TOGETHER, value_of

Texts = Mapping[str, Any]


@dataclass(frozen=True)
class Statement:
    """A statement of the paper, with its experiments or the reason why there are none:

        (statement,) = select(["3.6"])
        verdicts = [check.verdict(rows) for check in statement.checks]

    Attributes:
        key: The number of the statement, by which the command line knows the statement.
        checks: The measurements.
        name: The name of the statement.
        claim: What the statement says, in one line.
        comment: How the statement is measured and what is seen.
        reason: Why nothing is measured; empty where something is.
        figure: Name of the picture; empty without one.
        drawn: The experiments that the picture reads besides those of the checks.
        beyond: Whether the statement goes beyond the paper.
    """

    key: str
    checks: tuple[Check, ...]
    name: str
    claim: str
    comment: str = ""
    reason: str = ""
    figure: str = ""
    drawn: Sequence[str] = ()
    beyond: bool = False

    @property
    def experiments(self) -> set[str]:
        """The names of the experiments that the checks and the picture read."""
        names = {name for check in self.checks for name in check.experiments}
        return names | set(self.drawn) if self.checks else names


def _statement(key: str, texts: Texts) -> Statement:
    checks = tuple(check for entry in texts.get("checks", ()) for check in _checks(entry))
    fields: dict[str, Any] = {
        field: " ".join(value.split()) if isinstance(value, str) else value
        for field, value in texts.items()
        if field != "checks"
    }
    return Statement(key, checks, **fields)


def _checks(texts: Texts) -> list[Check]:
    """The checks of an entry of the file, one for each item of "each"."""
    items = [[item] if isinstance(item, str) else item for item in texts.get("each", [[]])]
    return [check for item in items for check in _checks_of(_filled(texts, item), item)]


def _filled(texts: Texts, item: Sequence[str]) -> Texts:
    """The entry with the parts of an item in place of $1, $2, ..."""
    filled = {"on": item[0] if item else ""} | dict(texts)
    for number, part in enumerate(item, start=1):
        for key, value in filled.items():
            if isinstance(value, str):
                filled[key] = value.replace(f"${number}", part)
    return filled


def _checks_of(texts: Texts, item: Sequence[str]) -> list[Check]:
    """The checks of an entry without placeholders."""
    if "use" in texts:
        own = {k: v for k, v in texts.items() if k not in ("use", "each", "on")}
        given = item or [texts["on"]] if texts["use"] != "logarithms" else ()
        return TABLES[texts["use"]](*given, **own)
    kind, rule = next((RULES[key], value) for key, value in texts.items() if key in RULES)
    on = _GROUPS.get(texts["on"], [texts["on"]]) if isinstance(texts["on"], str) else texts["on"]
    whole = texts.get("together")
    value = TOGETHER[whole] if whole else value_of(texts)
    make = Together if whole else Check
    what, proven, column = texts["what"], texts["proven"], texts.get("column", "")
    numbers = map(float, rule)
    return [make(what, proven, tuple(on), value, kind(*numbers), texts.get("first", 0), column)]


_TEXTS = read_data("statements")
# Where each numbered formula of the paper is measured, or why not.
EQUATIONS: Mapping[str, str] = _TEXTS.pop("equations")
INTRODUCTION: str = _TEXTS.pop("introduction")  # of the document, with places for its figures
_GROUPS: Mapping[str, list[str]] = _TEXTS.pop("groups")
STATEMENTS = tuple(_statement(key, texts) for key, texts in _TEXTS.items())
CHECKS = {statement.key: statement.checks for statement in STATEMENTS if statement.checks}
MEASURED = tuple(statement for statement in STATEMENTS if statement.checks)


def select(keys: Sequence[str] | None) -> list[Statement]:
    """Return statements by their keys, all of them by default.

    Raises:
        KeyError: A key is unknown, or nothing is measured for the statement.
    """
    known = {statement.key: statement for statement in MEASURED}
    return list(STATEMENTS) if not keys else [known[key] for key in dict.fromkeys(keys)]
