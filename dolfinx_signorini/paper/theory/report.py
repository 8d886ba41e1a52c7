"""The document: each statement with the command that checks it and its figures."""

import textwrap
from collections.abc import Sequence

from dolfinx_signorini.paper.theory.evidence import Rows
from dolfinx_signorini.paper.theory.statements import Statement
from dolfinx_signorini.tables import markdown_table

PICTURES = "theory"  # the folder of the pictures, beside the document

INTRODUCTION = """\
# The theory, measured

Every statement of C. Christof and C. Haubner, "Finite element error estimates in non-energy norms
for the two-dimensional scalar Signorini problem", Numer. Math. (2020), with the command that checks
it and the measured figure beside the proven one. This page and its pictures are written by

    {command}

An order is the one between the two finest meshes and counts as reached within 0.05; "- eps" stands
for "less any positive number". An inequality counts as satisfied if it is violated by no more than
1e-9 of its size: linear systems are solved to 1e-11. Numbers below that are printed as bounds, as
they are different on every machine. Meshes are Friedrichs-Keller triangulations with N cells per
side, elements are linear, and everything is the same on any number of processes.
"""


class Document:
    """What was measured for statements, as a document in Markdown:

        document = Document(STATEMENTS, rows, max_n=401)
        print(document.summary())

    Args:
        statements: The statements, in order.
        rows: The rows of their experiments.
        max_n: Cells per side of the finest mesh.

    Attributes:
        checks: The checks of each statement, by its key.
    """

    def __init__(self, statements: Sequence[Statement], rows: Rows, max_n: int):
        self.statements, self.rows, self.max_n = statements, rows, max_n
        self.checks = {statement.key: statement.checks(rows) for statement in statements}

    def summary(self) -> str:
        """Return a table of the statements: the headline of each, and how many checks hold."""
        lines = []
        for statement in self.statements:
            checks = self.checks[statement.key]
            first, holding = checks[0], sum(check.holds for check in checks)
            cells = [statement.name, first.what, first.proven, first.measured]
            lines.append([*map(_cell, cells), f"{holding} of {len(checks)}"])
        return markdown_table(("statement", "headline", "proven", "measured", "checks hold"), lines)

    def section(self, statement: Statement) -> str:
        """Return what the document says about one of the statements."""
        checks = self.checks[statement.key]
        columns = ["measured quantity", "proven", "measured", "holds"]
        if any(check.reason for check in checks):
            columns.append("better because")
        lines = []
        for check in checks:
            holds = "yes" if check.holds else "NO"
            cells = [check.what, check.proven, check.measured, holds, check.reason]
            lines.append([_cell(cell) for cell in cells[: len(columns)]])
        parts = [
            f"## {statement.name}",
            _wrapped(statement.claim),
            f"    dolfinx-signorini theory --statement {statement.key} --max-n {self.max_n}",
            _wrapped(statement.comment),
            markdown_table(columns, lines),
        ]
        for title, text in statement.tables(self.rows):
            parts += [f"{title}:", text]
        return "\n\n".join(part.rstrip() for part in parts) + "\n"

    def text(self, command: str) -> str:
        """Return the whole document, which says that a command has written it."""
        parts = [INTRODUCTION.format(command=command), self.summary()]
        shown = {""}
        for statement in self.statements:
            parts.append(self.section(statement))
            if statement.figure not in shown:
                shown.add(statement.figure)
                parts.append(f"![{statement.figure}]({PICTURES}/{statement.figure}.png)\n")
        return "\n".join(parts)


def _cell(text: str) -> str:
    """A text as a cell of a table, without the bars that would end the cell."""
    return text.replace("||", "‖")


def _wrapped(text: str) -> str:
    return textwrap.fill(_cell(text), 100, break_long_words=False, break_on_hyphens=False)
