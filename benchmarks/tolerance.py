"""What the default tolerances leave of the algebraic error, in every norm of the paper.

    ./with-dolfinx python3 benchmarks/tolerance.py [--cells 101 401 1001] [--methods cascade]

The algebraic error is the difference to the same discrete problem solved down to a natural
residual of 1e-11; the table shows its norm over the norm of the discretisation error u - u_h.
"""

from functools import partial

from common import coarse_state, paper, parser, report
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini import METHODS, christof_haubner, coarse_levels, error_norms
from dolfinx_signorini.problem.signorini import DEFAULT_RTOL
from dolfinx_signorini.studies.paper.sampling import PAPER_NAMES
from dolfinx_signorini.studies.paper.study import PAPER_NORMS

TIGHT = 1e-11

NORMS = [PAPER_NAMES.get(norm, norm) for norm in PAPER_NORMS]  # sup norms are maxima


def main() -> None:
    """Measure and print."""
    options = parser(__doc__, [101, 401, 1001])
    options.add_argument("--methods", nargs="+", choices=METHODS, default=["cascade"])
    args = options.parse_args()
    comm = MPI.COMM_WORLD
    rows, results = [], []
    for n in args.cells:
        problem = paper(comm, n)
        coarse, _ = coarse_state(partial(paper, comm), coarse_levels(n), DEFAULT_RTOL)
        tight = problem.solve(coarse=coarse, rtol=TIGHT)
        errors = error_norms(tight, christof_haubner(problem.space.mesh), NORMS)
        values = tight.x.array.copy()
        for method in args.methods:
            start = {"coarse": coarse} if method == "cascade" else {}
            u = problem.solve(method, warm_start=False, **start)
            difference = fem.Function(problem.space)
            difference.x.array[:] = u.x.array - values
            algebraic = error_norms(difference, None, NORMS)
            ratios = {norm: algebraic[norm] / errors[norm] for norm in NORMS}
            results.append({"n": n, "method": method} | ratios)
            rows.append((method, n, *(f"{value:.1e}" for value in ratios.values())))
        problem.destroy()
    title, columns = "algebraic / discretisation error", ("method", "N", *NORMS)
    report(comm, "tolerance", title, columns, rows, {"results": results})


main()
