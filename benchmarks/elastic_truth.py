"""What finite elements find of elastic contacts with known results, degree 1 and 2.

    ./with-dolfinx python3 benchmarks/elastic_truth.py
    ./with-dolfinx python3 benchmarks/elastic_truth.py --cases "plane" "nearly incompressible"

Hertz's contact in the plane (tests/problem/hertz.py), the same with Poisson's ratio 0.49, 0.499 and
0.4999, Hertz's contact in space (hertz_space.py), and a flat punch (punch.py), each on a block with
the closed form as data on its other sides. The errors are relative: of the displacement in the
energy norm, of the contact force, and of the largest pressure (in the middle of the punch).
"""

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "problem"))

import hertz
import hertz_space
import numpy as np
import punch
from common import parser, report
from mpi4py import MPI
from test_hertz import errors as plane_errors
from test_hertz_space import errors as space_errors
from test_known_contacts import punch_errors

COMM = MPI.COMM_WORLD
COLUMNS = ("case", "degree", "cells", "energy", "force", "pressure", "half width", "exact")
NAMES = ("NU", "MU", "LAMBDA", "KAPPA", "E_STAR", "A", "P0")


def plane(n: int, degree: int, poisson: float = 0.3) -> tuple[Any, ...]:
    """Hertz in the plane, with a Poisson's ratio of its own."""
    before = [getattr(hertz, name) for name in NAMES]
    vars(hertz).update(zip(NAMES, hertz.constants(poisson), strict=True))
    try:
        energy, peak, force, radius = plane_errors(n, degree)
        return energy, force, peak, radius, hertz.A
    finally:
        vars(hertz).update(zip(NAMES, before, strict=True))


def space(n: int, degree: int) -> tuple[Any, ...]:
    """Hertz in space."""
    return *space_errors(n, degree), hertz_space.A


def flat(n: int, degree: int) -> tuple[Any, ...]:
    """The flat punch, which touches all of its width."""
    return *punch_errors(n, degree), punch.A, punch.A


CASES: dict[str, tuple[Any, tuple[int, ...]]] = {
    "plane": (plane, (32, 64, 128, 256)),
    "nearly incompressible": (plane, (32, 64, 128)),
    "punch": (flat, (32, 64, 128, 256)),
    "space": (space, (8, 16, 32)),
}


def main() -> None:
    """Measure and print."""
    options = parser(__doc__ or "", None)
    options.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    args, rows = options.parse_args(), []
    for name in args.cases:
        measure, sizes = CASES[name]
        ratios = (0.3, 0.49, 0.499, 0.4999) if name == "nearly incompressible" else (None,)
        for ratio in ratios:
            more = () if ratio is None else (ratio,)
            for degree in (1, 2):
                for n in np.array(sizes) // degree:
                    found = [float(value) for value in measure(int(n), degree, *more)]
                    label = name if ratio is None else f"Poisson {ratio}"
                    rows.append([label, degree, int(n), *found])
                    if COMM.rank == 0:
                        print(*rows[-1], sep="  ", flush=True)
    report(COMM, "elastic_truth", "known contacts", COLUMNS, rows, {"rows": rows})


if __name__ == "__main__":
    main()
