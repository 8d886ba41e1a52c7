"""The statements of the paper: what they claim, what is computed for them, what is seen.

The texts are in `data/statements.toml`; the checks are in the modules of the sections.
"""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

from dolfinx_signorini.studies.paper.theory import beyond, section2, section3, section4, section5
from dolfinx_signorini.studies.paper.theory.checks import Check
from dolfinx_signorini.studies.paper.theory.families import POWER_EXPONENTS, power_name

CHECKS: Mapping[str, tuple[Check, ...]] = {
    key: checks
    for section in (section2, section3, section4, section5, beyond)
    for key, checks in section.CHECKS.items()
}


@dataclass(frozen=True)
class Statement:
    """A statement of the paper, with its experiments or the reason why there are none:

        (statement,) = select(["3.6"])
        verdicts = [check.verdict(rows) for check in statement.checks]

    Attributes:
        key: The number of the statement, by which the command line knows the statement.
        name: The name of the statement.
        claim: What the statement says, in one line.
        comment: How the statement is measured and what is seen.
        reason: Why nothing is measured; empty where something is.
        figure: Name of the picture; empty without one.
        beyond: Whether the statement goes beyond the paper.
        checks: The measurements.
    """

    key: str
    name: str
    claim: str
    comment: str
    reason: str
    figure: str
    beyond: bool
    checks: tuple[Check, ...]

    @property
    def experiments(self) -> set[str]:
        """The names of the experiments that the checks and the picture read."""
        names = {name for check in self.checks for name in check.experiments}
        return names | set(DRAWN.get(self.figure, ())) if self.checks else names


# What the picture of a statement reads besides the checks of the statement.
DRAWN = {
    "errors": ("paper",),
    "powers": tuple(map(power_name, POWER_EXPONENTS)),
    "projection": ("paper", "smooth"),
    "supercloseness": ("paper",),
    "dual": ("dual",),
    "contact_sets": ("paper",),
    "factors": ("paper", "unknown"),
    "enclosure": ("bounds",),
}


def _statement(key: str, texts: Mapping[str, Any]) -> Statement:
    fields = ("name", "claim", "comment", "reason", "figure")
    name, claim, comment, reason, figure = (
        " ".join(str(texts.get(field, "")).split()) for field in fields
    )
    beyond, checks = bool(texts.get("beyond")), CHECKS.get(key, ())
    return Statement(key, name, claim, comment, reason, figure, beyond, checks)


_FILE = resources.files("dolfinx_signorini.studies.paper").joinpath("data/statements.toml")
_TEXTS = tomllib.loads(_FILE.read_text(encoding="utf-8"))
# Where each numbered formula of the paper is measured, or why not.
EQUATIONS: Mapping[str, str] = _TEXTS.pop("equations")
STATEMENTS = tuple(_statement(key, texts) for key, texts in _TEXTS.items())
MEASURED = tuple(statement for statement in STATEMENTS if statement.checks)


def select(keys: Sequence[str] | None) -> list[Statement]:
    """Return statements by their keys, all of them by default.

    Raises:
        KeyError: A key is unknown, or nothing is measured for the statement.
    """
    known = {statement.key: statement for statement in MEASURED}
    return list(STATEMENTS) if not keys else [known[key] for key in dict.fromkeys(keys)]
