"""Results on disk: rows appended as they are done, and files that are whole or absent.

A records file has one JSON object per line. The first holds the settings that its rows depend on;
each further one is a finished row, written to disk before the next is started. A run that was
killed leaves at the most one unfinished line at the end, which is dropped when it resumes.
"""

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx_signorini.errors import InputError, require


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
        outcome: tuple[list[dict[str, Any]], str] | None = None
        if comm.rank == 0:
            try:
                outcome = (_open(path, json.loads(json.dumps(settings)), keys), "")
            except InputError as error:
                outcome = ([], str(error))
            except OSError as error:
                outcome = ([], refusal(path.parent, error))
        rows, message = comm.bcast(outcome, root=0)
        if message:
            raise InputError(message)
        self.rows: list[dict[str, Any]] = rows

    def append(self, row: Mapping[str, Any]) -> None:
        """Add rank 0's finished row, and return when it is on disk."""
        line, message = json.dumps(row), ""
        if self.comm.rank == 0:
            try:
                with self.path.open("a") as file:
                    file.write(line + "\n")
                    file.flush()
                    os.fsync(file.fileno())
            except OSError as error:
                message = refusal(self.path.parent, error)
        require(self.comm, not message, message)
        self.rows.append(json.loads(self.comm.bcast(line, root=0)))


def refusal(folder: Path, error: OSError) -> str:
    """Return what to say where a file of an output folder cannot be written."""
    return f"output folder {folder}: cannot be written: {error.strerror or error}"


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
