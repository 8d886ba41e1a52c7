"""(d) How contact and linear solve speed up from 1 to 2 ranks, side by side.

    ./with-dolfinx python3 benchmarks/ranks.py [--cells 1001] [--repeats 5]

Each repeat starts mpirun with 1 and with 2 ranks in turn. A run measures the linear solve, with
BoomerAMG as PETSc sets it up ("linear") and with the settings of the contact solve ("tuned"), and
the contact solve, all its levels included: the median of 3 times each, in turn, after a warm-up.
"""

import argparse
import json
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from common import SCENES, child, contact_solve, linear_solve, parser, report, spread, timed
from mpi4py import MPI

from dolfinx_signorini.problem.signorini import DEFAULT_RTOL

WHAT = ("linear", "tuned", "contact")
TURNS = 3


def measure(scene: str, n: int) -> None:
    """Print the seconds of the solves."""
    comm = MPI.COMM_WORLD
    pose = partial(SCENES[scene], comm)
    problem = pose(n)
    actions = {
        "linear": lambda: linear_solve(problem, DEFAULT_RTOL),
        "tuned": lambda: linear_solve(problem, DEFAULT_RTOL, tuned=True),
        "contact": lambda: contact_solve(problem, pose, n),
    }
    for action in actions.values():
        action()
    turns = [
        {name: timed(comm, action)[0] for name, action in actions.items()} for _ in range(TURNS)
    ]
    if comm.rank == 0:
        print(json.dumps({name: median(turn[name] for turn in turns) for name in actions}))


def main() -> None:
    """Measure and print."""
    options = parser(__doc__, 1001)
    options.add_argument("--measure", choices=list(SCENES), help=argparse.SUPPRESS)
    args = options.parse_args()
    if args.measure:
        measure(args.measure, args.cells)
        return
    rows, results = [], []
    for scene in SCENES:
        runs: dict[int, list[Any]] = {1: [], 2: []}
        for _ in range(args.repeats):
            for ranks in runs:
                options = ("--measure", scene, "--cells", str(args.cells))
                runs[ranks].append(child(str(Path(__file__)), *options, ranks=ranks))
        line: list[Any] = [scene]
        entry: dict[str, Any] = {"scene": scene}
        for what in WHAT:
            one, two = ([run[what] for run in runs[ranks]] for ranks in (1, 2))
            speedup = spread([a / b for a, b in zip(one, two, strict=True)])
            entry[what] = {"1": spread(one), "2": spread(two), "speedup": speedup}
            line += [spread(one)["median"], spread(two)["median"], speedup["median"]]
        results.append(entry)
        rows.append(line)
    columns = ["scene"]
    for what in WHAT:
        columns += [f"{what} 1", f"{what} 2", "speed-up"]
    title = f"seconds on 1 and on 2 ranks, N = {args.cells}, medians of {args.repeats}"
    content = {"cells": args.cells, "results": results}
    report(MPI.COMM_WORLD, "ranks", title, columns, rows, content)


main()
