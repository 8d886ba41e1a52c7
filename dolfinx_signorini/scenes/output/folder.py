"""The output folder of a scene: results appear there when all of them are complete.

All files are written to a temporary folder inside the output folder first, and moved when the last
one is complete, so that no run leaves half a result behind. A run that is interrupted deletes its
temporary folder; that of a run that was killed is deleted by the next run. The record lists the
files of its run: a later run replaces these files, and no others.
"""

import errno
import json
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.records import in_use, on_first, refuse_foreign

RECORD = "record.json"
# The files of each of the `OUTPUTS`, of which a run writes some; the record comes with all of them.
FILES = {
    "fields": ("fields.bp", "fields.xdmf", "fields.h5"),
    "boundary": ("boundary.csv", "contact_boundary.csv"),
    "pictures": ("solution.png", "contact.png", "contact_boundary.png", "accuracy.png"),
    "report": ("report.html",),
}
PART = ".part-"  # how the names of temporary folders begin; eight characters follow
PROBE = 65_536  # bytes that must fit before a run begins


@contextmanager
def output_folder(comm: MPI.Comm, folder: Path, outputs: Sequence[str]) -> Iterator[Path]:
    """Give a temporary folder to write to; the files in it are moved to `folder` at the end.

    Args:
        comm: The communicator; the call is collective.
        folder: Where the files go, in a folder that exists; results of earlier runs there are
            replaced, and other files stay.
        outputs: Which of `OUTPUTS` will be written.

    Raises:
        InputError: The folder cannot be written, or has other files of the same names.
    """
    with ExitStack() as stack:
        part = on_first(comm, folder, lambda: _prepare(folder, outputs, stack))
        yield part
        comm.barrier()
        on_first(comm, folder, lambda: _move(part, folder))


def reserve(folder: Path, size: int) -> None:
    """Raise an OSError unless some bytes fit into a folder."""
    with tempfile.TemporaryFile(dir=folder) as file:
        try:
            os.posix_fallocate(file.fileno(), 0, size)
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
                raise


def _prepare(folder: Path, outputs: Sequence[str], stack: ExitStack) -> Path:
    """Return a new temporary folder, which is deleted when the stack is closed."""
    subject = f"output folder {folder}"
    made = not folder.exists()
    if not made and not folder.is_dir():
        raise InputError("cannot be written, it is no folder", subject)
    own = _own_files(folder)
    refuse_foreign(folder, (RECORD, *(name for output in outputs for name in FILES[output])), own)
    # A signal may stop the run at any instruction: what is made is to be removed before it exists.
    if made:
        stack.callback(_remove_empty, folder)
    folder.mkdir(exist_ok=True)
    stack.enter_context(in_use(folder, PART + 8 * "?"))
    part = folder / f"{PART}{secrets.token_hex(4)}"
    stack.callback(shutil.rmtree, part, ignore_errors=True)
    part.mkdir()
    reserve(part, PROBE)
    return part


def _own_files(folder: Path) -> set[str]:
    """Return the names of the files that an earlier run has written to a folder."""
    known = {RECORD, *(name for names in FILES.values() for name in names)}
    try:
        record = json.loads((folder / RECORD).read_bytes())
        ours = "dolfinx_signorini" in record["versions"]
        named = known & set(record.get("files", known)) if ours else set()
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return set()
    return {name for name in named if name == "fields.bp" or not (folder / name).is_dir()}


def _move(part: Path, folder: Path) -> None:
    """Replace the files of an earlier run by the files in another folder, the record first."""
    for name in _own_files(folder) - {RECORD}:
        old = folder / name
        if old.is_dir() and not old.is_symlink():
            shutil.rmtree(old)
        else:
            old.unlink(missing_ok=True)
    for path in sorted(part.iterdir(), key=lambda path: path.name != RECORD):
        path.replace(folder / path.name)
    part.rmdir()


def _remove_empty(folder: Path) -> None:
    """Delete a folder unless files are in the folder."""
    with suppress(OSError):
        folder.rmdir()
