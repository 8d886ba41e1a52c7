"""Values that stand in place of values of a scene file: domain.cells=200."""

import tomllib
from collections.abc import Sequence
from typing import Any

from dolfinx_signorini.base.errors import InputError

Path = tuple[str | int, ...]  # of a key in the tables of a file; items of lists are counted from 0


def apply_override(data: dict[str, Any], text: str) -> Path:
    """Put another value into the tables of a scene file.

    A table that is missing is made; an item of a list has to be there already.

    Args:
        data: The tables as the TOML parser returned them.
        text: Key and value, for example "dirichlet.1.value=2"; items are counted from 1. The value
            is written as in TOML; quotes around a text may be left out.

    Returns:
        The path of the key.

    Raises:
        InputError: The text is no key with a value, or there is no such item.
    """
    name, equals, value = text.partition("=")
    parts = [part.strip() for part in name.split(".")]
    if not equals or not all(parts):
        raise InputError(f"must be KEY=VALUE, for example domain.cells=200, not {text!r}", "--set")
    place: Any = data
    path: list[str | int] = []
    for part, below in zip(parts, [*parts[1:], None], strict=True):
        index = _index(place, part, path, name)
        path.append(index)
        if below is None:
            place[index] = _value(value.strip())
        elif isinstance(place, dict):
            place = place.setdefault(str(index), {})
        else:
            place = place[index]
    return tuple(path)


def _index(place: Any, part: str, above: Sequence[str | int], name: str) -> str | int:
    """Return what a part of a key stands for: a key of a table, or the place in a list."""
    if isinstance(place, dict):
        return part
    subject = f"--set {name.strip()}"
    where = ".".join(str(k + 1) if isinstance(k, int) else k for k in above)
    if not isinstance(place, list):
        raise InputError(f"{where!r} is no table", subject)
    digits = len(str(len(place)))  # longer numbers are not even read
    if not part.isdecimal() or len(part) > digits or not 1 <= int(part) <= len(place):
        items = f"1 to {len(place)}" if len(place) > 1 else "1"
        raise InputError(f"the items of {where!r} have the numbers {items}, not {part!r}", subject)
    return int(part) - 1


def _value(text: str) -> Any:
    """Return the TOML value that a text is, or the text itself."""
    try:
        data = tomllib.loads(f"value = {text}")
    except ValueError:
        return text
    except RecursionError:
        raise InputError("is nested too deeply", "--set") from None
    return data["value"] if len(data) == 1 else text
