"""Results on disk: rows appended as they are done, and files that are whole or absent.

A records file has one JSON object per line. The first holds the settings that its rows depend on;
each further one is a finished row, written to disk before the next is started. A run that was
killed leaves at the most one unfinished line at the end, which is dropped when it resumes.
"""

import json
import os
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar, cast

import dolfinx
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.errors import InputError

T = TypeVar("T")


class Records:
    """Rows in a file; all ranks hold the same, rank 0 writes.

    Args:
        comm: The communicator; all methods are collective.
        path: The file; its folder is made if it is missing.
        settings: What the rows depend on; a file with other settings is refused.
        keys: What every row must have.

    Raises:
        InputError: The file cannot be written, is not a records file, or has other settings.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        path: Path,
        settings: Mapping[str, Any],
        keys: Sequence[str] = (),
    ):
        self.comm, self.path = comm, path
        self.rows: list[dict[str, Any]] = on_first(
            comm, path.parent, lambda: _open(path, json.loads(json.dumps(settings)), keys)
        )

    def append(self, row: Mapping[str, Any]) -> None:
        """Add rank 0's finished row, and return when it is on disk."""

        def write() -> str:
            line = json.dumps(row)
            with self.path.open("a") as file:
                file.write(line + "\n")
                file.flush()
                os.fsync(file.fileno())
            return line

        self.rows.append(json.loads(on_first(self.comm, self.path.parent, write)))


def on_first(comm: MPI.Comm, folder: Path, action: Callable[[], T]) -> T:
    """Do something with an output folder on rank 0.

    Args:
        comm: The communicator; the call is collective.
        folder: The folder, for the message.
        action: What to do.

    Returns:
        What it returned, on all ranks.

    Raises:
        InputError: It raised one, or the folder cannot be written; raised on all ranks.
    """
    value, message = None, ""
    if comm.rank == 0:
        try:
            value = action()
        except InputError as error:
            message = str(error)
        except OSError as error:
            reason = error.strerror or error
            message = f"output folder {folder}: cannot be written: {reason}"
    value, message = comm.bcast((value, message), root=0)
    if message:
        raise InputError(message)
    return cast(T, value)


def versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    try:
        own = version("dolfinx_signorini")
    except PackageNotFoundError:  # run from a checkout
        from dolfinx_signorini import __version__ as own
    petsc = ".".join(str(part) for part in PETSc.Sys.getVersion())
    return {"dolfinx_signorini": own, "dolfinx": dolfinx.__version__, "petsc": petsc}


def write_file(path: Path, content: str) -> None:
    """Write a text file under another name first, so that it never exists half-written."""
    temporary = path.with_name(path.name + ".part")
    temporary.write_text(content)
    temporary.replace(path)


def _open(path: Path, settings: dict[str, Any], keys: Sequence[str]) -> list[dict[str, Any]]:
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.stat().st_size == 0:
        write_file(path, json.dumps({"settings": settings}) + "\n")
        return []
    if not os.access(path, os.W_OK):
        raise InputError(f"output folder {path.parent}: {path.name} cannot be written")
    lines = path.read_bytes().split(b"\n")
    unfinished = lines.pop()  # empty after a finished row
    entries = []
    for number, line in enumerate(lines, start=1):
        try:
            entry = json.loads(line)
            if not isinstance(entry, dict) or not (number == 1 or set(keys) <= entry.keys()):
                raise ValueError
            entries.append(entry)
        except ValueError:
            raise InputError(
                f"{path}, line {number}: not a row of this program; choose another --out, or "
                "remove the file"
            ) from None
    found = entries[0].get("settings") if entries else None
    if not isinstance(found, dict):
        raise InputError(f"{path}, line 1: no settings; choose another --out, or remove the file")
    for key in settings | found:
        if settings.get(key) != found.get(key):
            raise InputError(
                f"output folder {path.parent}: holds results for {key} = {found.get(key)}, not "
                f"{settings.get(key)}; choose another --out"
            )
    if unfinished:
        with path.open("rb+") as file:
            file.truncate(path.stat().st_size - len(unfinished))
    return entries[1:]
