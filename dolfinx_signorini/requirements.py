"""What the package needs that pip cannot install: dolfinx."""

import sys
from importlib.util import find_spec
from pathlib import Path

MESSAGE = """dolfinx_signorini needs dolfinx, version 0.9 or newer, which pip cannot install:
    Debian 13:  apt install python3-dolfinx-real python3-petsc4py-real
    conda:      conda install -c conda-forge fenics-dolfinx
A virtual environment beside Debian's dolfinx needs the option --system-site-packages."""

if find_spec("dolfinx") is None:
    # While "python3 -m dolfinx_signorini" looks for the program, its name is "-m".
    if Path(sys.argv[0]).name in ("-m", "dolfinx-signorini"):
        sys.exit(f"error: {MESSAGE}")
    raise ModuleNotFoundError(MESSAGE, name="dolfinx")
