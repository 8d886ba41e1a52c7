"""Two cells on any number of ranks: solve, measure, and print what came out as JSON.

mpirun -n 5 python3 tests/extremes/few_cells.py
"""

import json
import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[2])]

from cases import Case, attained, square  # noqa: E402
from dolfinx import fem  # noqa: E402
from mpi4py import MPI  # noqa: E402

from dolfinx_signorini import error_norms  # noqa: E402
from dolfinx_signorini.meshes.sided_meshes import owned_cells  # noqa: E402

KNOWN = {"L4": 1.0, "Linf": 1.0, "W1_4": 1.0, "L2_boundary": 2.0, "H1_2_boundary_spectral": 2.0}


TOLERANCES = {"cascade": 1e-13, "bqnls": 1e-8, "bntr": 1e-8}


def main() -> None:
    """Solve the model problem on two cells, and take norms of the function 1."""
    comm = MPI.COMM_WORLD
    domain = square(1)
    digits = {name: attained(Case(domain), name, rtol) for name, rtol in TOLERANCES.items()}
    one = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
    one.x.array[:] = 1.0
    norms = error_norms(one, None, KNOWN)
    empty = comm.allreduce(int(len(owned_cells(domain)) == 0))
    if comm.rank == 0:
        print(json.dumps({"digits": digits, "empty": empty, "norms": norms, "known": KNOWN}))


if __name__ == "__main__":
    main()
