"""dolfinx is there and loads before the modules that need it, or the ways to install it are named.

The modules take seconds to load: who interrupts the command line meanwhile sees no traceback.
"""

import os
import signal
import sys
from importlib import import_module
from importlib.util import find_spec

MESSAGE = """dolfinx_signorini needs dolfinx, version 0.9 or newer:
    pip:        pip install "dolfinx-signorini[dolfinx]"    (Linux on x86_64, Python 3.12 or newer)
    Debian 13:  apt install python3-dolfinx-real python3-petsc4py-real
    conda:      conda install -c conda-forge fenics-dolfinx
A virtual environment beside Debian's dolfinx needs the option --system-site-packages."""

# While "python3 -m dolfinx_signorini" looks for the program, its name is "-m".
name = os.path.basename(sys.argv[0])
module = sys.orig_argv[-len(sys.argv)] if name == "-m" else ""
of_the_command_line = name == "dolfinx-signorini" or module.endswith("dolfinx_signorini")
if of_the_command_line and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, lambda *_: os._exit(128 + signal.SIGINT))
if find_spec("dolfinx") is None:
    if of_the_command_line:
        sys.exit(f"error: {MESSAGE}")
    raise ModuleNotFoundError(MESSAGE, name="dolfinx")
if find_spec("dolfinx_solver") is not None:  # the dolfinx of PyPI needs its MPI loaded first
    import_module("dolfinx_solver")
