"""Docstrings as plain sentences, made ready for Sphinx.

In a docstring single backticks mark code, and an indented block after a line that ends in a colon
is an example. Stars, bars and underscores are letters of mathematics. A colon is a colon: in the
first line of an attribute, and in what is returned, Napoleon takes the words before a colon for a
type.
"""

import re
from typing import Any

SECTION = re.compile(r"(Args|Returns|Raises|Attributes|Yields|Note|Example):\s*$")
PROSE = "Returns", "Yields"  # sections without names before colons
ATTRIBUTES = "property", "attribute", "data"
COLON, HIDDEN = re.compile(r"(?<!:):(?!:)"), "\ue000"


def process(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Change the lines of a docstring in place; a handler of autodoc.

    Args:
        app: Sphinx.
        what: The kind of the documented thing.
        name: Its name.
        thing: The thing.
        options: Options of autodoc.
        lines: The lines.
    """
    lines[:] = converted(lines, what in ATTRIBUTES)


def shown(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Put the colons back that `process` hides from Napoleon; the handler that comes after it.

    Args:
        app, what, name, thing, options, lines: See `process`.
    """
    lines[:] = [line.replace(HIDDEN, ":") for line in lines]


def converted(lines: list[str], attribute: bool = False) -> list[str]:
    """Return a docstring with examples as code, and letters of mathematics as letters.

    Args:
        lines: The lines.
        attribute: Whether the docstring is that of an attribute.
    """
    result: list[str] = []
    section = ""
    code: int | None = None  # the indentation of the text around an example
    for number, line in enumerate(lines):
        indent = len(line) - len(line.lstrip())
        if code is not None and line.strip() and indent <= code:
            code = None
        if code is not None or not line.strip():
            result.append(line)
            continue
        text = _escaped(line)
        head = SECTION.match(line.strip())
        if head is not None:
            section = head[1]
        elif (attribute and not any(map(str.strip, result))) or section in PROSE:
            text = COLON.sub(HIDDEN, text)
        if line.rstrip().endswith(":") and head is None:
            following = lines[number + 1 :]
            block = next((k for k in following if k.strip()), "")
            if following[:1] == [""] and len(block) - len(block.lstrip()) > indent:
                text, code = text.rstrip().rstrip(HIDDEN + ":") + "::", indent
        result.append(text)
    return result


def _escaped(line: str) -> str:
    parts = re.split(r"(`[^`]+`)", line)
    return "".join(
        f"`{part}`"
        if part.startswith("`") and len(part) > 2
        else re.sub(r"([*|]|_\b)", r"\\\1", part)
        for part in parts
    )
