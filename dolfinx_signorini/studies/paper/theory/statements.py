"""The statements of the paper: what they claim, what is computed for them, what is seen.

Texts and checks are in `data/statements.toml`, whose first lines say how to read a check.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.studies.paper.tables import read_data
from dolfinx_signorini.studies.paper.theory.checks import RULES, Check, value_of
from dolfinx_signorini.studies.paper.theory.measures import TOGETHER
from dolfinx_signorini.studies.paper.theory.proven import (
    CONSTANTS,
    allowed_order,
    printed,
    proven_order,
    smooth_order,
    supercloseness_order,
)

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
        beyond: Whether the statement goes beyond the paper.
    """

    key: str
    checks: tuple[Check, ...]
    name: str
    claim: str
    comment: str = ""
    reason: str = ""
    figure: str = ""
    beyond: bool = False

    @property
    def experiments(self) -> set[str]:
        """The names of the experiments that the checks and the picture read."""
        names = {name for check in self.checks for name in check.experiments}
        panels = CURVES[self.figure]["panels"] if self.figure in CURVES else ()
        return names.union(*(experiments_of(panel) for panel in panels))


def experiments_of(texts: Texts) -> Sequence[str]:
    """Return what a check or a panel is on: one experiment, a list of them, or a group."""
    on = texts["on"]
    return _GROUPS.get(on, [on]) if isinstance(on, str) else on


def _statement(key: str, texts: Texts) -> Statement:
    checks = tuple(check for entry in texts.get("checks", ()) for check in _checks(entry))
    fields: dict[str, Any] = {
        field: " ".join(value.split()) if isinstance(value, str) else value
        for field, value in texts.items()
        if field != "checks"
    }
    return Statement(key, checks, **fields)


def _checks(texts: Texts) -> list[Check]:
    """The checks of an entry of the file, one for each item of "each" and each norm."""
    items = [[item] if isinstance(item, str) else item for item in texts.get("each", [[]])]
    checks = []
    for item in items:
        filled = {"on": item[0] if item else ""} | dict(texts)
        filled = _filled(filled, {str(k): part for k, part in enumerate(item, start=1)})
        norms = filled.get("norms", [None])
        checks += [_check(_by_theorem(filled, norm) if "p" in filled else filled) for norm in norms]
    return checks


def _filled(texts: Texts, parts: Mapping[str, str]) -> dict[str, Any]:
    """The entry with parts in place of $1, $2, ... or $name in its texts."""
    filled = dict(texts)
    for key, value in filled.items():
        if isinstance(value, str):
            for name, part in parts.items():
                value = value.replace(f"${name}", part)
            filled[key] = value
    return filled


def _by_theorem(texts: Texts, norm: str | None) -> dict[str, Any]:
    """The entry with the orders of the theorems for its "p" in a norm, or of Theorem 3.6."""
    p, known = float(texts["p"]), dict[str, float]()
    if norm is None:
        found, own = supercloseness_order(p), {}
    else:
        found = proven_order(p, norm, texts.get("contact_sets", False))
        own = {"of": f"errors/{norm}", "column": printed(norm)}
        known = {"allowed": max(found.value, allowed_order(p, norm)), "smooth": smooth_order(norm)}
    known["proven"] = found.value
    sums = [str(limit).split(" + ") for limit in texts["order"]]
    order = [sum(known[x] if x in known else float(x) for x in parts) for parts in sums]
    filled = _filled(texts, {"proven": f"{found.value:.3g}", "theorem": str(found)})
    return filled | own | {"order": order}


def _check(texts: Texts) -> Check:
    """The check of an entry without placeholders."""
    kind, limits = next((RULES[key], value) for key, value in texts.items() if key in RULES)
    whole = texts.get("together")
    return Check(
        what=texts["what"],
        proven=texts["proven"],
        experiments=tuple(experiments_of(texts)),
        value=TOGETHER[whole] if whole else value_of(texts),
        rule=kind(*(CONSTANTS[x] if isinstance(x, str) else float(x) for x in limits)),
        first=texts.get("first", 0),
        column=texts.get("column", ""),
        together=bool(whole),
    )


_TEXTS, CURVES = read_data("statements"), read_data("curves")
# Where each numbered formula of the paper is measured, or why not.
EQUATIONS: Mapping[str, str] = _TEXTS.pop("equations")
INTRODUCTION: str = _TEXTS.pop("introduction")  # of the document, with places for its figures
_GROUPS: Mapping[str, list[str]] = _TEXTS.pop("groups")
STATEMENTS = tuple(_statement(key, texts) for key, texts in _TEXTS.items())
MEASURED = {statement.key: statement for statement in STATEMENTS if statement.checks}


def select(keys: Sequence[str] | None) -> list[Statement]:
    """Return statements by their keys, all of them by default.

    Raises:
        InputError: A key is unknown, or nothing is measured for the statement.
    """
    for key in keys or ():
        if key not in MEASURED:
            raise InputError(f"unknown {key!r}, known are {', '.join(MEASURED)}", "--statement")
    return list(STATEMENTS) if not keys else [MEASURED[key] for key in dict.fromkeys(keys)]
