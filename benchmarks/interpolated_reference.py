"""What an interpolated reference in place of the exact solution does to the measured error.

    ./with-dolfinx python3 benchmarks/interpolated_reference.py [--cells 101 401]

The relative change of each norm of the error where the exact solution is replaced by its
interpolant into Lagrange elements of the same mesh. At the detachment point the solution is only
r^{3/2}-smooth, which no degree mends: sup norms and large p notice.
"""

import argparse

from common import table, write_json
from mpi4py import MPI

from dolfinx_signorini import christof_haubner, error_norms, friedrichs_keller, paper_problem
from dolfinx_signorini.paper.study import PAPER_NORMS
from dolfinx_signorini.references import interpolated


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, nargs="+", default=[101, 401])
    parser.add_argument("--degrees", type=int, nargs="+", default=[2, 3, 4, 5, 6])
    args = parser.parse_args()
    comm = MPI.COMM_WORLD
    rows, results = [], []
    for n in args.cells:
        exact = christof_haubner(friedrichs_keller(comm, n))
        problem = paper_problem(exact)
        u = problem.solve().u
        problem.destroy()
        errors = error_norms(u, exact, PAPER_NORMS)
        for degree in args.degrees:
            other = error_norms(u, interpolated(exact, degree), PAPER_NORMS)
            change = {norm: other[norm] / errors[norm] - 1.0 for norm in PAPER_NORMS}
            results.append({"n": n, "degree": degree} | change)
            rows.append((n, degree, *(f"{value:+.1e}" for value in change.values())))
    if comm.rank == 0:
        title = "relative change of the error against the exact solution"
        print(table(title, ("N", "degree", *PAPER_NORMS), rows))
    write_json(comm, "interpolated_reference", {"results": results})


main()
