"""(e) Peak memory of the contact pipeline beside that of the linear one.

    ./with-dolfinx python3 benchmarks/memory.py [--cells 501 1001 2001] [--repeats 5]

Mesh, assembly and solve in a process of its own for each figure. The memory is the largest resident
set of the process, as the kernel counts it; the table also shows that of an idle process.
"""

import argparse
import json
import resource
from functools import partial
from pathlib import Path
from typing import Any

from common import child, contact_solve, linear_solve, paper, parser, report, spread
from mpi4py import MPI

from dolfinx_signorini.problem.signorini import DEFAULT_RTOL


def measure(what: str, n: int) -> None:
    """Run one pipeline and print its peak memory in megabytes."""
    if what != "idle":
        problem = paper(MPI.COMM_SELF, n)
        if what == "linear":
            linear_solve(problem, DEFAULT_RTOL)
        else:
            contact_solve(problem, partial(paper, problem.comm), n)
    kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(json.dumps({"megabytes": kilobytes / 1024}))


def main() -> None:
    """Measure and print."""
    options = parser(__doc__, [501, 1001, 2001])
    options.add_argument("--measure", choices=("idle", "linear", "contact"), help=argparse.SUPPRESS)
    args = options.parse_args()
    if args.measure:
        measure(args.measure, args.cells[0])
        return
    rows, results = [], []
    for n in args.cells:
        peaks: dict[str, list[float]] = {"idle": [], "linear": [], "contact": []}
        for _ in range(args.repeats):
            for what, values in peaks.items():
                run: Any = child(str(Path(__file__)), "--measure", what, "--cells", str(n))
                values.append(run["megabytes"])
        ratio = spread([c / a for a, c in zip(peaks["linear"], peaks["contact"], strict=True)])
        middle = {what: spread(values) for what, values in peaks.items()}
        results.append({"n": n, "ratio": ratio} | middle)
        rows.append((n, *(f"{middle[what]['median']:.0f}" for what in peaks), ratio["median"]))
    columns = ("N", "idle", "linear", "contact", "contact / linear")
    title = f"peak memory in megabytes, medians of {args.repeats}"
    content = {"repeats": args.repeats, "results": results}
    report(MPI.COMM_WORLD, "memory", title, columns, rows, content)


main()
