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

        document = Document(MEASURED, rows)
        print(document.text("dolfinx-signorini theory"))

    Args:
        statements: The statements, in order.
        rows: The rows of the experiments of the statements.

    Attributes:
        verdicts: The verdicts on the checks of each statement, by its key.
    """

    def __init__(self, statements: Sequence[Statement], rows: Rows):
        self.statements, self.rows = statements, rows
        self.verdicts = {
            statement.key: [check.verdict(rows) for check in statement.checks]
            for statement in statements
        }

    @property
    def failing(self) -> list[str]:
        """The names of the checks that do not hold."""
        return [
            f"{statement.key}: {check.name}"
            for statement in self.statements
            for check, verdict in zip(statement.checks, self.verdicts[statement.key], strict=True)
            if not verdict.holds
        ]

    def section(self, statement: Statement) -> str:
        """Return what the document says about one of the statements."""
        pairs = list(zip(statement.checks, self.verdicts[statement.key], strict=True))
        parts = [
            f"### {statement.name}",
            _wrapped(statement.claim, "> "),
            _wrapped(f"{statement.comment} `{_command(statement)}`"),
        ]
        listed = [pair for pair in pairs if not pair[0].column]
        if listed:
            parts.append(_list(listed))
        crossed = [pair for pair in pairs if pair[0].column]
        if crossed:
            parts += ["Orders, measured and proven:", _cross(crossed)]
        return "\n\n".join(part.rstrip() for part in parts) + "\n"

    def summary(self) -> str:
        """Return a line for each statement, the checks that fail, and how many checks hold."""
        lines = []
        for statement in self.statements:
            verdicts = self.verdicts[statement.key]
            holding = sum(verdict.holds for verdict in verdicts)
            if verdicts:
                lines.append(f"{statement.name:<34}{holding} of {len(verdicts)} checks hold")
        lines += [f"does not hold: {check}" for check in self.failing]
        count = sum(map(len, self.verdicts.values()))
        return "\n".join([*lines, f"{count - len(self.failing)} of {count} checks hold"])

    def text(self, command: str) -> str:
        """Return the whole document, which says that a command has written it."""
        verdicts = [verdict for found in self.verdicts.values() for verdict in found]
        failing = self.failing
        words = {
            "command": command,
            "count": len(verdicts),
            "holding": len(verdicts) - len(failing),
        }
        parts, shown = [INTRODUCTION.format(**words)], {""}
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
    rows = list(dict.fromkeys(check.what for check, _ in pairs))
    columns = list(dict.fromkeys(check.column for check, _ in pairs))
    cells = {
        (c.what, c.column): f"{v.measured.removeprefix('order ')} / {c.proven}"
        + ("" if v.holds else " NO")
        for c, v in pairs
    }
    lines = [[row, *(cells.get((row, column), "") for column in columns)] for row in rows]
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


def _command(statement: Statement) -> str:
    """The command for one statement, as a shell takes it."""
    return shlex.join(("dolfinx-signorini", "theory", "--statement", statement.key))


def _wrapped(text: str, prefix: str = "") -> str:
    return textwrap.fill(
        text,
        100,
        initial_indent=prefix,
        subsequent_indent=prefix,
        break_long_words=False,
        break_on_hyphens=False,
    )
