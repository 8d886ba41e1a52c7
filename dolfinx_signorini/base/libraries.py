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

# What belongs to the machine and the compiler: libraries of others are not loaded.
MACHINE = "SOABI", "CC", "CFLAGS"
ERRORS = 2000  # characters of what a compiler says


def library(key: str, source: Callable[[], str], arguments: Sequence[str], folder: Path) -> Path:
    """Return the file of a library, which is compiled unless the folder has one.

    Args:
        key: What tells this code from all others.
        source: Returns the code, where it must be compiled.
        arguments: The arguments of the compiler.
        folder: Where the libraries are.

    Raises:
        RuntimeError: There is no compiler, or it refuses the code.
    """
    parts = key, *arguments, *(str(sysconfig.get_config_var(name)) for name in MACHINE)
    name = hashlib.sha1("\n".join(parts).encode()).hexdigest()
    file = folder / f"signorini_{name}.so"
    if not file.exists():
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as place:
            code, made = Path(place, "code.c"), Path(place, "code.so")
            code.write_text(source())
            _compile([str(code), "-o", str(made), *arguments])
            os.replace(made, file)
    return file


def _compile(arguments: Sequence[str]) -> None:
    """Call the compiler of the environment, or the one that Python was compiled with."""
    given = os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc"
    flags = f"{sysconfig.get_config_var('CFLAGS') or ''} {os.environ.get('CFLAGS', '')}"
    include = f"-I{ffcx.codegeneration.get_include_path()}"
    # Bessel functions are in the standard of POSIX alone.
    standard = "-std=c17", "-D_XOPEN_SOURCE=700", "-fPIC", "-shared", include
    command = [*shlex.split(f"{given} {flags}"), *standard]
    try:
        subprocess.run([*command, *arguments, "-lm"], check=True, capture_output=True, text=True)
    except FileNotFoundError:
        message = f"there is no C compiler {given!r}; install one, or name one in CC"
        raise RuntimeError(message) from None
    except subprocess.CalledProcessError as error:
        said = error.stderr[:ERRORS]
        raise RuntimeError(f"the C compiler {given!r} could not compile:\n{said}") from None
