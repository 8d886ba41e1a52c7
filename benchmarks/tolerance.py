"""What the default tolerances leave of the algebraic error, in every norm of the paper.

    ./with-dolfinx python3 benchmarks/tolerance.py [--cells 101 401 1001] [--methods cascade]

The algebraic error is the difference to the same discrete problem solved down to a natural
residual of 1e-11; the table shows its norm over the norm of the discretisation error u - u_h.
"""

import argparse

from common import coarse_state, table, write_json
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini import christof_haubner, error_norms, friedrichs_keller, paper_problem
from dolfinx_signorini.paper.study import PAPER_NORMS
from dolfinx_signorini.problem import METHODS
from dolfinx_signorini.solvers.cascade import DEFAULT_RTOL

TIGHT = 1e-11


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, nargs="+", default=[101, 401, 1001])
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=["cascade"])
    args = parser.parse_args()
    comm = MPI.COMM_WORLD
    rows, results = [], []
    for n in args.cells:
        exact = christof_haubner(friedrichs_keller(comm, n))
        problem = paper_problem(exact)
        coarse, _ = coarse_state(comm, "paper", n, DEFAULT_RTOL)
        tight = problem.solve(coarse=coarse, rtol=TIGHT).u
        errors = error_norms(tight, exact, PAPER_NORMS)
        for method in args.methods:
            start = {"coarse": coarse} if method == "cascade" else {}
            result = problem.solve(method, **start)
            difference = fem.Function(problem.space)
            difference.x.array[:] = result.u.x.array - tight.x.array
            algebraic = error_norms(difference, None, PAPER_NORMS)
            ratios = {norm: algebraic[norm] / errors[norm] for norm in PAPER_NORMS}
            results.append({"n": n, "method": method} | ratios)
            rows.append((method, n, *(f"{value:.1e}" for value in ratios.values())))
        problem.destroy()
    if comm.rank == 0:
        print(table("algebraic / discretisation error", ("method", "N", *PAPER_NORMS), rows))
    write_json(comm, "tolerance", {"results": results})


main()
