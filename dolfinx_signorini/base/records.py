"""Results on disk: files of finished rows, and files that are either whole or absent.

A records file has one JSON object per line. The first object holds the settings that the rows
depend on. Every further object is a finished row, which is on disk before the next row is started.
A run that was killed leaves at most one unfinished line at the end of the file; the next run on
the same file drops this line and goes on behind the last finished row.
"""

import argparse
import contextlib
import fcntl
import glob
import json
import os
import shutil
import uuid
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeVar, cast

import dolfinx
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.errors import InputError, together
from dolfinx_signorini.base.logs import Progress, log

T = TypeVar("T")
Row = dict[str, Any]  # of a table: entries by name, as JSON has them

ROWS = "rows.jsonl"  # the records file of a job


class Wanted(NamedTuple):
    """A row of a table that is computed where the file has no such row.

    Attributes:
        title: What the row is called where it is told that the row is there already.
        key: The entries by which the row is known.
        compute: Returns the other entries.
        work: How much there is to compute, in any unit.
    """

    title: str
    key: Mapping[str, Any]
    compute: Callable[[], Mapping[str, Any]]
    work: float


class Records:
    """Rows in a file; all ranks hold the same rows, and rank 0 writes the file:

        records = Records(comm, Path("results/rows.jsonl"), {"method": "cascade"})
        records.append({"n": 101, "error": 5.87e-4})

    Args:
        comm: The communicator; the constructor and all methods are collective.
        path: The file; a missing folder is made.
        settings: What the rows depend on; a file with other settings is refused.
        keys: The keys that every row must have.

    Attributes:
        rows: The finished rows, from the file and of this run.

    Raises:
        InputError: The file cannot be written, is not a records file, or has other settings.
    """

    def __init__(
        self, comm: MPI.Comm, path: Path, settings: Mapping[str, Any], keys: Sequence[str] = ()
    ):
        self.comm, self.path = comm, path
        self.rows: list[Row] = on_first(
            comm, path.parent, lambda: _open(path, json.loads(json.dumps(settings)), keys)
        )

    def row(self, wanted: Wanted) -> Row:
        """Return the finished row that is wanted, or compute and add the row."""
        row = self.finished(wanted.key)
        if row is not None:
            log.info("%s: already done", wanted.title)
            return row
        self.append({**wanted.key, **wanted.compute()})
        return self.rows[-1]

    def table(self, task: str, wanted: Sequence[Wanted]) -> list[Row]:
        """Return rows in their order, and tell how far those are that have to be computed.

        Args:
            task: What the rows are, in words.
            wanted: The rows.
        """
        work = [each.work if self.finished(each.key) is None else 0.0 for each in wanted]
        rows = []
        with Progress(task, sum(work)) as progress:
            for each, done in zip(wanted, work, strict=True):
                rows.append(self.row(each))
                progress.advance(done)
        return rows

    def finished(self, key: Mapping[str, Any]) -> Row | None:
        """Return the row that has some entries, or None if no such row is finished."""
        return next((row for row in self.rows if key.items() <= row.items()), None)

    def append(self, row: Mapping[str, Any]) -> None:
        """Add the finished row of rank 0; the row is on disk when the call returns.

        Raises:
            InputError: The file cannot be written.
        """

        def write() -> str:
            line = json.dumps(row)
            with self.path.open("a") as file:
                file.write(line + "\n")
                file.flush()
                os.fsync(file.fileno())
            return line

        self.rows.append(json.loads(on_first(self.comm, self.path.parent, write)))


def on_first(comm: MPI.Comm, folder: Path, action: Callable[[], T]) -> T:
    """Call a function that writes to an output folder, on rank 0 only.

    Args:
        comm: The communicator; the call is collective.
        folder: The output folder, which an error names.
        action: The function.

    Returns:
        The value that the function returned, on all ranks.

    Raises:
        InputError: The function raised an InputError, or the folder cannot be written; raised on
            all ranks.
    """
    subject = f"output folder {folder}"
    with together(comm, subject):
        try:
            value = action() if comm.rank == 0 else None
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror or error}", subject) from None
    return cast(T, comm.bcast(value))


def refuse_foreign(folder: Path, names: Iterable[str], own: Collection[str] = ()) -> None:
    """Refuse a folder with files in the way that this program did not write; rank 0 only.

    Args:
        folder: The output folder.
        names: The files that are going to be written into the folder.
        own: The files that an earlier run wrote into the folder.

    Raises:
        InputError: The folder has one of the other files.
    """
    for name in names:
        if os.path.lexists(folder / name) and name not in own:
            raise InputError(
                f"has a {name} that is no result of this program; choose another --out",
                f"output folder {folder}",
            )


def check_outputs(comm: MPI.Comm, folder: Path, names: Iterable[str]) -> None:
    """Refuse a folder without rows of an earlier run where files are in the way.

    Args:
        comm: The communicator; the call is collective.
        folder: The output folder of a job whose rows are in `ROWS`.
        names: The files that the job writes beside the rows.

    Raises:
        InputError: The folder has one of the files, and no rows.
    """

    def check() -> None:
        rows = folder / ROWS
        if not (rows.is_file() and rows.stat().st_size):
            refuse_foreign(folder, names)

    on_first(comm, folder, check)


def remove_outputs(folder: Path, names: Iterable[str]) -> None:
    """Delete the files of an earlier run, of which the present one may write fewer; rank 0 only.

    Args:
        folder: The output folder.
        names: See `check_outputs`, which has refused files of others.
    """
    for name in names:
        (folder / name).unlink(missing_ok=True)


def versions() -> dict[str, str]:
    """Return the versions of this package, DOLFINx and PETSc, which a result depends on."""
    try:
        own = version("dolfinx_signorini")
    except PackageNotFoundError:  # run from a checkout
        from dolfinx_signorini import __version__ as own
    petsc = ".".join(str(part) for part in PETSc.Sys.getVersion())
    return {"dolfinx_signorini": own, "dolfinx": dolfinx.__version__, "petsc": petsc}


def write_file(path: Path, content: str) -> None:
    """Write a text file under another name, then rename it: no reader sees half of the file."""
    with whole_file(path) as file:
        file.write(content.encode("utf-8"))


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """Give a binary file to write, which takes the place of a file when it is complete.

    The new file is discarded where its writer fails.
    """
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}.part")
    with in_use(path.parent, f".{glob.escape(path.name)}.{32 * '?'}.part"):
        try:
            with temporary.open("xb") as file:
                yield file
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise


@contextlib.contextmanager
def in_use(folder: Path, leftovers: str) -> Iterator[None]:
    """Hold a folder while a block writes there; first remove what killed runs left, by a pattern.

    All who write share a lock of the folder, which ends with their process: who gets the lock alone
    knows that nobody writes, and that unfinished files are of runs that were killed.
    """
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # others write, or the file system has no locks
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            for path in folder.glob(leftovers):
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_SH)
        yield
    finally:
        os.close(descriptor)


def folder_name(text: str) -> Path:
    """Return the folder that a text of the command line names.

    Raises:
        argparse.ArgumentTypeError: The text is empty, or no name that a folder can have.
    """
    if not text.strip() or "\0" in text:
        raise argparse.ArgumentTypeError("must name a folder, '.' for this one")
    return Path(text)


def _open(path: Path, settings: Row, keys: Sequence[str]) -> list[Row]:
    """Return the finished rows of a records file, and drop an unfinished one from the file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.stat().st_size == 0:
        write_file(path, json.dumps({"settings": settings}) + "\n")
        return []
    if not os.access(path, os.W_OK):
        raise InputError(f"{path.name} cannot be written", f"output folder {path.parent}")
    *lines, unfinished = path.read_bytes().split(b"\n")  # the last one is empty after a whole row
    entries = _entries(path, lines, keys)
    found = entries[0].get("settings") if entries else None
    if not isinstance(found, dict):
        raise InputError("no settings; choose another --out, or remove the file", f"{path}, line 1")
    for key in settings | found:
        if settings.get(key) != found.get(key):
            both = f"{key} = {found.get(key)}, not {settings.get(key)}"
            told = both if both.isprintable() else f"another {key}"  # a text of several lines
            subject = f"output folder {path.parent}"
            raise InputError(f"holds results for {told}; choose another --out", subject)
    if unfinished:
        with path.open("rb+") as file:
            file.truncate(path.stat().st_size - len(unfinished))
    return entries[1:]


def _entries(path: Path, lines: Sequence[bytes], keys: Sequence[str]) -> list[Row]:
    """Return the object of every line; all but the first must have some keys."""
    entries = []
    for number, line in enumerate(lines, start=1):
        try:
            entry = json.loads(line)
            if not isinstance(entry, dict) or not (number == 1 or set(keys) <= entry.keys()):
                raise ValueError
            entries.append(entry)
        except ValueError:
            raise InputError(
                "not a row of this program; choose another --out, or remove the file",
                f"{path}, line {number}",
            ) from None
    return entries
