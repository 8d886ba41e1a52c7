"""(j) Where the time of small problems goes: cascades and warm starts of some thousand unknowns.

    ./with-dolfinx python3 benchmarks/small_problems.py [--cells 2 4 8 16 25] [--repeats 30]

The paper's problem with degree 2, after a warm-up that compiles the forms. The first table is a
cascade from the first mesh on. The second is the last mesh alone, which starts from the contact
state of the mesh before: what a step of the adaptive loop pays for a solve. All figures are
milliseconds, those of the fastest of the repeats.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from common import parser, report
from mpi4py import MPI

from dolfinx_signorini import ContactState, christof_haubner, friedrichs_keller
from dolfinx_signorini.studies.paper.solution import paper_problem

COMM = MPI.COMM_WORLD
MILLI = 1e3
Shares = dict[str, float]


@contextmanager
def share(shares: Shares, name: str) -> Iterator[None]:
    """Add the milliseconds of a block to a share."""
    start = time.perf_counter()
    yield
    shares[name] = shares.get(name, 0.0) + MILLI * (time.perf_counter() - start)


def level(n: int, degree: int, coarse: ContactState | None, shares: Shares) -> ContactState:
    """Solve on one mesh, and return what the next one starts from."""
    with share(shares, "mesh"):
        domain = friedrichs_keller(COMM, n)
    with share(shares, "formulas, space and arguments"):
        problem = paper_problem(christof_haubner(domain), degree)
    for name, seconds in problem.seconds.items():
        shares[f"assembly: {name}"] = shares.get(f"assembly: {name}", 0.0) + MILLI * seconds
    shares["formulas, space and arguments"] -= MILLI * sum(problem.seconds.values())
    with share(shares, "solve: rest"):
        problem.solve(coarse=coarse)
    for name, seconds in problem.result.seconds.items():
        shares[f"solve: {name}"] = shares.get(f"solve: {name}", 0.0) + MILLI * seconds
    shares["solve: rest"] -= MILLI * sum(problem.result.seconds.values())
    with share(shares, "contact state"):
        state = problem.contact_state()
    with share(shares, "objects freed"):
        problem.destroy()
    return state


def cascade(cells: Sequence[int], degree: int, coarse: ContactState | None = None) -> Shares:
    """Solve on one mesh after the other, and return the shares and their sum."""
    shares: Shares = {}
    with share(shares, "all"):
        for n in cells:
            coarse = level(n, degree, coarse, shares)
    return shares


def main() -> None:
    """Measure and print."""
    options = parser(__doc__, [2, 4, 8, 16, 25], repeats=30)
    options.add_argument("--degree", type=int, default=2)
    args = options.parse_args()
    *below, last = args.cells
    cascade(args.cells, args.degree)
    coarse = level(below[-1], args.degree, None, {})
    cases = {
        "cascade": lambda: cascade(args.cells, args.degree),
        "warm start": lambda: cascade([last], args.degree, coarse),
    }
    runs: dict[str, list[Shares]] = {name: [] for name in cases}
    for _ in range(args.repeats):
        for name, case in cases.items():
            runs[name].append(case())
    found = {name: min(made, key=lambda run: run["all"]) for name, made in runs.items()}
    rows = [(key, *(shares[key] for shares in found.values())) for key in found["cascade"]]
    title = f"milliseconds, the fastest of {args.repeats}: degree {args.degree}, N = {args.cells}"
    columns = ("share", *(f"{name}, ms" for name in cases))
    report(COMM, "small_problems", title, columns, rows, {"cells": args.cells, "shares": found})


main()
