"""What an interpolated reference in place of the exact solution does to the measured error.

    ./with-dolfinx python3 benchmarks/interpolated_reference.py [--cells 101 401]

The relative change of each norm of the error where the exact solution is replaced by its
interpolant into Lagrange elements of the same mesh. The same rules integrate both errors: the
change is that of the interpolant alone. At the detachment point the solution is only
r^{3/2}-smooth, which no degree mends: sup norms and large p notice.
"""

from common import paper, parser, report
from mpi4py import MPI

from dolfinx_signorini import QuadratureRule, christof_haubner, error_norms, interpolated
from dolfinx_signorini.studies.paper.sampling import PAPER_NAMES
from dolfinx_signorini.studies.paper.study import PAPER_NORMS

# On cells and on facets, for the exact solution and its interpolants alike.
RULES = QuadratureRule("Gauss-Jacobi", 15), QuadratureRule("Gauss-Jacobi", 31)
NORMS = [PAPER_NAMES.get(norm, norm) for norm in PAPER_NORMS]  # sup norms are maxima


def main() -> None:
    """Measure and print."""
    options = parser(__doc__, [101, 401])
    options.add_argument("--degrees", type=int, nargs="+", default=[2, 3, 4, 5, 6])
    args = options.parse_args()
    comm = MPI.COMM_WORLD
    rows, results = [], []
    for n in args.cells:
        problem = paper(comm, n)
        u = problem.solve()
        exact = christof_haubner(problem.space.mesh)
        problem.destroy()
        errors = error_norms(u, exact, NORMS, *RULES)
        for degree in args.degrees:
            other = error_norms(u, interpolated(exact, degree), NORMS, *RULES)
            change = {norm: other[norm] / errors[norm] - 1.0 for norm in NORMS}
            results.append({"n": n, "degree": degree} | change)
            rows.append((n, degree, *(f"{value:+.1e}" for value in change.values())))
    title = "relative change of the error against the exact solution"
    columns = ("N", "degree", *NORMS)
    rules = [str(rule) for rule in RULES]
    content = {"rules": rules, "results": results}
    report(comm, "interpolated_reference", title, columns, rows, content)


main()
