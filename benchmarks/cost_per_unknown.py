"""(c) What an unknown costs as the mesh is refined, and how many linear solves a level takes.

    ./with-dolfinx python3 benchmarks/cost_per_unknown.py [--cells 51 ... 2001] [--repeats 5]

Microseconds per unknown of the contact solve, all its levels included, beside the plain linear
solve of the same matrix. All sizes are measured in turn, --repeats times over.
"""

from functools import partial

from common import SCENES, contact_solve, linear_solve, parser, report, spread, timed
from mpi4py import MPI

from dolfinx_signorini.problem.signorini import DEFAULT_RTOL

MICRO = 1e6


def main() -> None:
    """Measure and print."""
    options = parser(__doc__, [51, 101, 201, 501, 1001, 2001])
    options.add_argument("--scenes", nargs="+", default=list(SCENES), choices=list(SCENES))
    args = options.parse_args()
    comm = MPI.COMM_WORLD
    rows, results = [], []
    for scene in args.scenes:
        pose = partial(SCENES[scene], comm)
        problems = {n: pose(n) for n in args.cells}
        contact_solve(problems[args.cells[0]], pose, args.cells[0])
        contact: dict[int, list[float]] = {n: [] for n in problems}
        linear: dict[int, list[float]] = {n: [] for n in problems}
        solves = {}
        for _ in range(args.repeats):
            for n, problem in problems.items():
                seconds, _ = timed(comm, linear_solve, problem, DEFAULT_RTOL)
                linear[n].append(MICRO * seconds / problem.unknowns)
                seconds, solves[n] = timed(comm, contact_solve, problem, pose, n)
                contact[n].append(MICRO * seconds / problem.unknowns)
        for n, problem in problems.items():
            problem.destroy()
            entry = {"contact": spread(contact[n]), "linear": spread(linear[n])}
            results.append({"scene": scene, "n": n, "linear_solves": solves[n]} | entry)
            medians = [spread(values[n])["median"] for values in (contact, linear)]
            rows.append((scene, n, *medians, "+".join(map(str, solves[n]))))
    title = f"microseconds per unknown, medians of {args.repeats}"
    columns = ("scene", "N", "contact", "linear", "solves per level")
    content = {"repeats": args.repeats, "results": results}
    report(comm, "cost_per_unknown", title, columns, rows, content)


main()
