"""Tables of text: for terminals, in Markdown and as CSV."""

import csv
import io
from collections.abc import Sequence
from typing import Any

LISTED = 8  # items of a list in a line: two lines of a terminal


def listed(texts: Sequence[str], separator: str = ", ") -> str:
    """Return the first of some texts in one line, and how many more there are."""
    more = len(texts) - LISTED
    return separator.join(texts[:LISTED]) + (f" and {more} more" if more > 0 else "")


def text_table(columns: Sequence[str], rows: Sequence[Sequence[Any]], title: str = "") -> str:
    """Return a table for a terminal: the first column to the left, the others to the right.

    Args:
        columns: The heads of the columns.
        rows: The cells of each row; a float that is no text yet is shown with three digits.
        title: A line above the table.
    """
    lines = _cells(columns, rows)
    widths = _widths(lines)
    body = ["  ".join(_padded(line, widths)).rstrip() for line in lines]
    body.insert(1, "-" * (sum(widths) + 2 * (len(widths) - 1)))
    return "\n".join([title, *body] if title else body) + "\n"


def markdown_table(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return the same in Markdown, without a title, aligned so that the source reads well, too."""
    lines = _cells(columns, rows)
    widths = [max(width, 3) for width in _widths(lines)]
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    padded = [_padded(line, widths) for line in lines]
    return "".join("| " + " | ".join(line) + " |\n" for line in [padded[0], rule, *padded[1:]])


def csv_table(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return the same as CSV, with all digits of its numbers."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([columns, *rows])
    return text.getvalue()


def _cells(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> list[list[str]]:
    body = [[f"{cell:.3g}" if isinstance(cell, float) else str(cell) for cell in r] for r in rows]
    return [list(columns), *body]


def _widths(lines: Sequence[Sequence[str]]) -> list[int]:
    return [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]


def _padded(line: Sequence[str], widths: Sequence[int]) -> list[str]:
    first, *others = zip(line, widths, strict=True)
    return [first[0].ljust(first[1]), *(text.rjust(width) for text, width in others)]
