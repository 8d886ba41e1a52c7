"""(e) Peak memory of the contact pipeline beside that of the linear one.

    ./with-dolfinx python3 benchmarks/memory.py [--cells 501 1001 2001] [--repeats 5]

Mesh, assembly and solve in a process of its own for each figure; the memory is the largest
resident set of the process, as the kernel counts it, with and without that of an idle start.
"""

import argparse
import json
import resource
from pathlib import Path
from typing import Any

from common import SCENES, child, contact_solve, linear_solve, spread, table, write_json
from mpi4py import MPI

from dolfinx_signorini.solvers.cascade import DEFAULT_RTOL


def measure(what: str, n: int) -> None:
    """Run one pipeline and print its peak memory in megabytes."""
    if what != "idle":
        problem = SCENES["paper"](MPI.COMM_SELF, n)
        if what == "linear":
            linear_solve(problem, DEFAULT_RTOL)
        else:
            contact_solve(problem, "paper", n, DEFAULT_RTOL)
    kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(json.dumps({"megabytes": kilobytes / 1024}))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, nargs="+", default=[501, 1001, 2001])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--measure", choices=("idle", "linear", "contact"), help=argparse.SUPPRESS)
    args = parser.parse_args()
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
    print(table(f"peak memory in megabytes, medians of {args.repeats}", columns, rows))
    write_json(MPI.COMM_WORLD, "memory", {"repeats": args.repeats, "results": results})


main()
