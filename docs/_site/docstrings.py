"""Docstrings as plain sentences, made ready for Sphinx.

In a docstring single backticks mark code, and an indented block after a line that ends in a colon
is an example. Stars, bars and underscores are letters of mathematics.
"""

import re
from typing import Any

SECTION = re.compile(r"(Args|Returns|Raises|Attributes|Yields|Note|Example):\s*$")


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
    lines[:] = converted(lines)


def converted(lines: list[str]) -> list[str]:
    """Return a docstring with examples as code, and letters of mathematics as letters."""
    result: list[str] = []
    code: int | None = None  # the indentation of the text around an example
    for number, line in enumerate(lines):
        indent = len(line) - len(line.lstrip())
        if code is not None and line.strip() and indent <= code:
            code = None
        if code is not None or not line.strip():
            result.append(line)
            continue
        text = _escaped(line)
        if line.rstrip().endswith(":") and not SECTION.match(line.strip()):
            following = lines[number + 1 :]
            block = next((k for k in following if k.strip()), "")
            if following[:1] == [""] and len(block) - len(block.lstrip()) > indent:
                text, code = text.rstrip() + ":", indent
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
