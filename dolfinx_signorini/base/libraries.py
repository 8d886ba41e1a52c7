"""Libraries from C code, compiled once on a machine and kept beside the forms of DOLFINx.

The C compiler alone is called: what DOLFINx uses makes a module of Python from each code, which
takes twice as long, and lists the folder of all codes each time. A process writes a library under a
name of its own and renames it, so that others see whole libraries only, and nobody waits for a
process that was killed.
"""

import hashlib
import os
import shlex
import subprocess
import sysconfig
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import ffcx.codegeneration
from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError, together

# What belongs to the machine and the compiler: libraries of others are not loaded.
MACHINE = "SOABI", "CC"
ERRORS = 2000  # characters of what a compiler says


def library(
    comm: MPI.Comm, key: str, source: Callable[[], str], arguments: Sequence[str], folder: Path
) -> Path:
    """Return the file of a library, which is compiled unless the folder has one; collective.

    Args:
        comm: The communicator of those who need the library.
        key: What tells this code from all others.
        source: Returns the code, where it must be compiled.
        arguments: The arguments of the compiler.
        folder: Where the libraries are.

    Raises:
        InputError: There is no compiler, the compiler refuses the code, or the folder cannot be
            written.
    """
    parts = key, *arguments, *(str(sysconfig.get_config_var(name)) for name in MACHINE)
    name = hashlib.sha1("\n".join(parts).encode()).hexdigest()
    file = folder / f"signorini_{name}.so"
    for first in (True, False):  # the others find the file, unless their machine is another one
        with together(comm, "code"):
            if (comm.rank == 0) == first and not file.exists():
                _make(file, source(), arguments)
    return file


def _make(file: Path, code: str, arguments: Sequence[str]) -> None:
    """Compile a library next to its place, and put it there."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=file.parent) as place:
            written, made = Path(place, "code.c"), Path(place, "code.so")
            written.write_text(code)
            _compile([str(written), "-o", str(made), *arguments])
            os.replace(made, file)
    except OSError as error:
        message = f"cannot be written: {error.strerror or error}; set XDG_CACHE_HOME"
        raise InputError(message, f"folder of compiled code {file.parent}") from None


def _compile(arguments: Sequence[str]) -> None:
    """Call the compiler of the environment, or the one that Python was compiled with."""
    given = os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc"
    include = f"-I{ffcx.codegeneration.get_include_path()}"
    # Bessel functions are in the standard of POSIX alone.
    standard = "-std=c17", "-D_XOPEN_SOURCE=700", "-fPIC", "-shared", include
    command = [*shlex.split(given), *standard, *arguments, "-lm"]
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except FileNotFoundError:
        message = f"there is none of the name {given!r}; install one, or name one in CC"
        raise InputError(message, "C compiler") from None
    except subprocess.CalledProcessError as error:
        message = f"{given!r} could not compile:\n{error.stderr[:ERRORS]}"
        raise InputError(message, "C compiler") from None
