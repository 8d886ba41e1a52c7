"""(c) What an unknown costs as the mesh is refined, and how many linear solves a level takes.

    ./with-dolfinx python3 benchmarks/cost_per_unknown.py [--cells 51 ... 2001] [--repeats 5]

Microseconds per unknown of the contact solve, all its levels included, beside the plain linear
solve of the same matrix. All sizes are measured in turn, --repeats times over.
"""

import argparse

from common import SCENES, contact_solve, linear_solve, spread, table, timed, write_json
from mpi4py import MPI

from dolfinx_signorini.solvers.cascade import DEFAULT_RTOL

SIZES = [51, 101, 201, 501, 1001, 2001]
MICRO = 1e6


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, nargs="+", default=SIZES)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=list(SCENES))
    args = parser.parse_args()
    comm = MPI.COMM_WORLD
    results = []
    for scene in args.scenes:
        problems = {n: SCENES[scene](comm, n) for n in args.cells}
        contact_solve(problems[args.cells[0]], scene, args.cells[0], DEFAULT_RTOL)
        contact: dict[int, list[float]] = {n: [] for n in problems}
        linear: dict[int, list[float]] = {n: [] for n in problems}
        solves = {}
        for _ in range(args.repeats):
            for n, problem in problems.items():
                seconds, _ = timed(comm, linear_solve, problem, DEFAULT_RTOL)
                linear[n].append(MICRO * seconds / problem.unknowns)
                seconds, (_, solves[n]) = timed(
                    comm, contact_solve, problem, scene, n, DEFAULT_RTOL
                )
                contact[n].append(MICRO * seconds / problem.unknowns)
        for n, problem in problems.items():
            problem.destroy()
            entry = {"contact": spread(contact[n]), "linear": spread(linear[n])}
            results.append({"scene": scene, "n": n, "linear_solves": solves[n]} | entry)
    rows = [
        (
            r["scene"],
            r["n"],
            r["contact"]["median"],
            r["linear"]["median"],
            "+".join(map(str, r["linear_solves"])),
        )
        for r in results
    ]
    columns = ("scene", "N", "contact", "linear", "solves per level")
    if comm.rank == 0:
        print(table(f"microseconds per unknown, medians of {args.repeats}", columns, rows))
    write_json(comm, "cost_per_unknown", {"repeats": args.repeats, "results": results})


main()
