"""The document: each statement with its measurements, and those without with the reason."""

import shlex
import textwrap
from collections.abc import Sequence

from dolfinx_signorini.base.tables import markdown_table
from dolfinx_signorini.studies.paper.theory.checks import Check, Rows, Verdict
from dolfinx_signorini.studies.paper.theory.statements import (
    EQUATIONS,
    INTRODUCTION,
    STATEMENTS,
    Statement,
)

PICTURES = "theory"  # the folder of the pictures, beside the document


class Document:
    """What was measured for statements, as a document in Markdown:

        document = Document(STATEMENTS, rows)
        print(document.text("dolfinx-signorini theory"))

    Args:
        statements: The statements, in order.
        rows: The rows of the experiments of the statements.

    Attributes:
        pairs: The checks of each statement with their verdicts, by its key.
    """

    def __init__(self, statements: Sequence[Statement], rows: Rows):
        self.statements = statements
        self.pairs = {
            s.key: [(check, check.verdict(rows)) for check in s.checks] for s in statements
        }

    @property
    def count(self) -> int:
        """The number of checks."""
        return sum(map(len, self.pairs.values()))

    @property
    def failing(self) -> list[str]:
        """The names of the checks that do not hold."""
        return [
            f"{key}: {check.name}"
            for key, pairs in self.pairs.items()
            for check, verdict in pairs
            if not verdict.holds
        ]

    def section(self, statement: Statement) -> str:
        """Return what the document says about one of the statements."""
        command = shlex.join(("dolfinx-signorini", "theory", "--statement", statement.key))
        parts = [
            f"### {statement.name}",
            _wrapped(statement.claim, "> "),
            _wrapped(f"{statement.comment} `{command}`"),
        ]
        listed, crossed = (
            [pair for pair in self.pairs[statement.key] if bool(pair[0].column) == crosses]
            for crosses in (False, True)
        )
        if listed:
            parts.append(_list(listed))
        if crossed:
            parts += ["Orders, measured and proven:", _cross(crossed)]
        return "\n\n".join(part.rstrip() for part in parts) + "\n"

    def summary(self) -> str:
        """Return a line for each statement, the checks that fail, and how many checks hold."""
        lines, failing = [], self.failing
        for statement in self.statements:
            verdicts = [verdict.holds for _, verdict in self.pairs[statement.key]]
            if verdicts:
                told = f"{sum(verdicts)} of {len(verdicts)} checks hold"
                lines.append(f"{statement.name:<34}{told}")
        lines += [f"does not hold: {check}" for check in failing]
        return "\n".join([*lines, f"{self.count - len(failing)} of {self.count} checks hold"])

    def text(self, command: str) -> str:
        """Return the whole document, which says that a command has written it."""
        failing, shown = self.failing, {""}
        holding = self.count - len(failing)
        parts = [INTRODUCTION.format(command=command, count=self.count, holding=holding)]
        if failing:
            parts.append(_wrapped(f"These do not hold: {'; '.join(failing)}.") + "\n")
        for beyond, title in ((False, "The paper"), (True, "Beyond the paper")):
            chosen = [s for s in self.statements if s.checks and s.beyond == beyond]
            parts += [f"## {title}\n"] if chosen else []
            for statement in chosen:
                parts.append(self.section(statement))
                if statement.figure not in shown:
                    shown.add(statement.figure)
                    parts.append(f"![{statement.figure}]({PICTURES}/{statement.figure}.png)\n")
        if len(self.statements) == len(STATEMENTS):
            parts += [_others(), _equations()]
        return "\n".join(parts)


def _list(pairs: Sequence[tuple[Check, Verdict]]) -> str:
    """One row for each check."""
    lines = [[c.name, c.proven, v.measured, "yes" if v.holds else "NO"] for c, v in pairs]
    return markdown_table(("measured quantity", "proven", "measured", "holds"), lines)


def _cross(pairs: Sequence[tuple[Check, Verdict]]) -> str:
    """One entry for each check."""
    columns = list(dict.fromkeys(check.column for check, _ in pairs))
    rows: dict[str, dict[str, str]] = {}
    for check, verdict in pairs:
        told = f"{verdict.measured.removeprefix('order ')} / {check.proven}"
        rows.setdefault(check.what, {})[check.column] = told + ("" if verdict.holds else " NO")
    lines = [[what, *(row.get(column, "") for column in columns)] for what, row in rows.items()]
    return markdown_table(("", *columns), lines)


def _others() -> str:
    """The statements without an experiment."""
    lines = [[s.name, s.claim, s.reason] for s in STATEMENTS if not s.checks]
    table = markdown_table(("statement", "claim", "why nothing is measured"), lines)
    return f"## Statements without an experiment\n\n{table}"


def _equations() -> str:
    """The numbered formulas."""
    tags: dict[str, list[str]] = {}
    for tag, text in EQUATIONS.items():
        tags.setdefault(text, []).append(tag)
    parts = [f"{', '.join(found)}: {text}" for text, found in tags.items()]
    words = "Where they are measured, or what they are: " + "; ".join(parts) + "."
    return f"## Numbered formulas\n\n{_wrapped(words)}\n"


def _wrapped(text: str, prefix: str = "") -> str:
    wrapper = textwrap.TextWrapper(100, initial_indent=prefix, subsequent_indent=prefix)
    wrapper.break_long_words = wrapper.break_on_hyphens = False
    return wrapper.fill(text)
