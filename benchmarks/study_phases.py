"""(f) The study's phases beside the linear pipeline: mesh, assembly, one linear solve.

    ./with-dolfinx python3 benchmarks/study_phases.py [--max-n 1001] [--repeats 5]

In turn, --repeats times: the command `reproduce` with all its rows, tables and pictures, in this
process; and for each of its meshes the linear pipeline. Forms are compiled before.
"""

import argparse
import contextlib
import io
import json
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

from common import linear_solve, report, spread, timed
from mpi4py import MPI

from dolfinx_signorini import christof_haubner, friedrichs_keller
from dolfinx_signorini.base.timing import Phases
from dolfinx_signorini.commands import main as cli
from dolfinx_signorini.problem.signorini import DEFAULT_RTOL
from dolfinx_signorini.studies.paper.solution import paper_problem
from dolfinx_signorini.studies.paper.tables import paper_table

PHASES = ("coarse", "mesh", "forms", "assembly", "solve", "errors")


def reproduce(max_n: int) -> list[dict[str, float]]:
    """Run the command, and return the seconds of each row's phases."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        if cli.main(["reproduce", "--max-n", str(max_n), "--out", folder]):
            raise SystemExit("reproduce failed")
        rows = json.loads((Path(folder) / "results.json").read_text())["rows"]
    return [row["seconds"] for row in rows]


def linear_pipeline(n: int) -> dict[str, float]:
    """Return the seconds of mesh, assembly and linear solve."""
    phases = Phases(MPI.COMM_SELF)
    with phases("mesh"):
        exact = christof_haubner(friedrichs_keller(MPI.COMM_SELF, n))
    with phases("assembly"):
        problem = paper_problem(exact)
    with phases("solve"):
        linear_solve(problem, DEFAULT_RTOL)
    problem.destroy()
    return phases.seconds


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--max-n", type=int, default=1001)
    parser.add_argument("--repeats", type=int, default=5)
    args = parser.parse_args()
    first, second, *_ = map(int, paper_table(1))
    cells = range(first, args.max_n + 1, second - first)
    reproduce(first)
    whole, rows, linear = [], [], []
    for _ in range(args.repeats):
        seconds, phases = timed(MPI.COMM_SELF, reproduce, args.max_n)
        whole.append(seconds)
        rows.append(phases)
        linear.append([linear_pipeline(n) for n in cells])
    lines: list[tuple[Any, ...]] = []
    ratios = []
    for i, n in enumerate(cells):
        phases = [median(run[i].get(phase, 0.0) for run in rows) for phase in PHASES]
        pairs = zip(rows, linear, strict=True)
        ratio = spread([sum(row[i].values()) / sum(line[i].values()) for row, line in pairs])
        ratios.append({"n": n, "ratio": ratio})
        own = median(sum(run[i].values()) for run in linear)
        lines.append((n, *(f"{value:.2f}" for value in phases), f"{own:.2f}", ratio["median"]))
    sums = [sum(sum(line.values()) for line in run) for run in linear]
    total = spread([a / b for a, b in zip(whole, sums, strict=True)])
    columns = ("N", *PHASES, "linear pipeline", "row / linear pipeline")
    title = f"seconds, medians of {args.repeats}"
    content = {"whole": spread(whole), "linear": spread(sums), "ratio": total, "rows": ratios}
    content |= {"phases": rows, "pipelines": linear}
    report(MPI.COMM_SELF, "study_phases", title, columns, lines, content)
    print(
        f"reproduce --max-n {args.max_n}: {median(whole):.1f} s with tables and pictures, "
        f"linear pipelines {median(sums):.1f} s, ratio {total['median']:.2f}"
    )


main()
