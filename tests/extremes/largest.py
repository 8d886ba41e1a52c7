"""The paper's problem on four million unknowns: errors, seconds and memory, printed as JSON.

python3 tests/extremes/largest.py
"""

import json
import resource
import sys
import time
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[2])]

from mpi4py import MPI  # noqa: E402

from dolfinx_signorini import (  # noqa: E402
    christof_haubner,
    coarse_levels,
    friedrichs_keller,
    solve_cascade,
)
from dolfinx_signorini.studies.paper.sampling import LINF, paper_errors  # noqa: E402
from dolfinx_signorini.studies.paper.solution import paper_problem  # noqa: E402

N = 2001
RTOL = 1e-7  # with the default, the solve would stop where the discretisation error hides the rest


def main() -> None:
    """Solve by a cascade and measure three errors."""
    comm = MPI.COMM_WORLD
    start = time.perf_counter()

    def problem_on(n: int, coarser):
        return paper_problem(christof_haubner(friedrichs_keller(comm, n)))

    problem = solve_cascade(problem_on, [*coarse_levels(N), N], rtol=RTOL)
    result = problem.result
    problem.destroy()
    exact = christof_haubner(problem.space.mesh)
    report = {
        "errors": paper_errors(problem.u, exact, ("L4", LINF, "W1_4")),
        "unknowns": problem.unknowns,
        "natural_residual": result.natural_residual,
        "solve": sum(result.seconds[phase] for phase in ("predict", "solve", "accept")),
        "seconds": time.perf_counter() - start,
        "gigabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9,
    }
    if comm.rank == 0:
        print(json.dumps(report))


if __name__ == "__main__":
    main()
