"""The document: each statement with the command that checks it and its figures."""

import textwrap
from collections.abc import Sequence

from dolfinx_signorini.paper.theory.evidence import Check, Rows
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


def results(statements: Sequence[Statement], rows: Rows) -> dict[str, list[Check]]:
    """Return the checks of statements, by their keys.

    Args:
        statements: The statements.
        rows: The rows of their experiments.
    """
    return {statement.key: statement.checks(rows) for statement in statements}


def summary(statements: Sequence[Statement], checks: dict[str, list[Check]]) -> str:
    """Return a table with one line per statement: its headline, and how many checks hold.

    Args:
        statements: The statements.
        checks: Their checks, see `results`.
    """
    lines = []
    for statement in statements:
        found = checks[statement.key]
        first, holding = found[0], sum(check.holds for check in found)
        cells = [statement.name, first.what, first.proven, first.measured]
        lines.append([*map(_cell, cells), f"{holding} of {len(found)}"])
    return markdown_table(("statement", "headline", "proven", "measured", "checks hold"), lines)


def section(statement: Statement, checks: Sequence[Check], rows: Rows, max_n: int) -> str:
    """Return what the document says about a statement.

    Args:
        statement: The statement.
        checks: Its checks.
        rows: The rows, for the tables.
        max_n: Cells per side of the finest mesh.
    """
    reasons = any(check.reason for check in checks)
    columns = ["measured quantity", "proven", "measured", "holds"]
    lines = []
    for check in checks:
        cells = [check.what, check.proven, check.measured, "yes" if check.holds else "NO"]
        lines.append([_cell(cell) for cell in [*cells, *([check.reason] if reasons else [])]])
    if reasons:
        columns.append("better because")
    parts = [
        f"## {statement.name}",
        _wrapped(statement.claim),
        f"    dolfinx-signorini theory --statement {statement.key} --max-n {max_n}",
        _wrapped(statement.comment),
        markdown_table(columns, lines),
    ]
    for title, text in statement.tables(rows):
        parts += [f"{title}:", text]
    return "\n\n".join(part.rstrip() for part in parts) + "\n"


def document(statements: Sequence[Statement], rows: Rows, max_n: int, command: str) -> str:
    """Return the whole document in Markdown.

    Args:
        statements: The statements, in order.
        rows: The rows of their experiments.
        max_n: Cells per side of the finest mesh.
        command: The command that writes the document.
    """
    checks = results(statements, rows)
    parts = [INTRODUCTION.format(command=command), summary(statements, checks)]
    shown = {""}
    for statement in statements:
        parts.append(section(statement, checks[statement.key], rows, max_n))
        if statement.figure not in shown:
            shown.add(statement.figure)
            parts.append(f"![{statement.figure}]({PICTURES}/{statement.figure}.png)\n")
    return "\n".join(parts)


def _cell(text: str) -> str:
    """A text as a cell of a table: bars would end it."""
    return text.replace("||", "‖")


def _wrapped(text: str) -> str:
    return textwrap.fill(_cell(text), 100, break_long_words=False, break_on_hyphens=False)
