"""What the adaptive loop costs beside posing and solving its last mesh alone.

    ./with-dolfinx python3 benchmarks/loop_over_solve.py            # the table
    ./with-dolfinx python3 benchmarks/loop_over_solve.py --only 3   # one row of the table
    ./with-dolfinx python3 benchmarks/loop_over_solve.py --profile 3  # the functions of this row

Scenes of `request_scenes.py` with requests that end with about 50,000 unknowns or more. All is
measured after a run that compiles the forms, in seconds of the processor, which other programs
disturb least. The last mesh alone is posed and solved twice from nothing, and twice with the
contact set at hand: the least of these counts. The shares of the loop leave out what other columns
name.
"""

import argparse
import cProfile
import pstats
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest import mock

from common import markdown_table, write_json
from mpi4py import MPI
from request_truth import Functional
from requests import Request, coarse_mesh, solved

from dolfinx_signorini import SignoriniProblem
from dolfinx_signorini.accuracy import adaptive, loop, marking
from dolfinx_signorini.accuracy.estimates import Estimator
from dolfinx_signorini.scenes import solving

COMM = MPI.COMM_SELF
SEED = 1
MEAN = "mean"
# The scene, the norm and the accuracy.
REQUESTS: tuple[tuple[int, str, float], ...] = (
    (15, "Linf", 3e-5),
    (18, "L2", 1e-4),
    (78, "L2_boundary", 1e-8),
    (6, "Linf", 2e-8),
    (57, "L4", 8e-6),
    (117, "H1", 1e-2),
    (24, "mean", 4e-11),
    (69, "H1", 1e-9),
    (27, "Linf", 3e-3),
    (111, "L2", 1e-8),
)
PHASES: dict[str, tuple[tuple[Any, str], ...]] = {
    "reading": ((adaptive, "first_mesh"), (solving, "first_mesh")),
    "posing": ((loop, "posed"),),
    "solves": ((SignoriniProblem, "solve"),),
    "dual": ((SignoriniProblem, "solve_linearised"),),
    "estimate": ((Estimator, "compare"), (Estimator, "add_polygon")),
    "refinement": ((loop, "refined"), (marking.Marks, "apply")),
    "marking": ((loop, "mark_for_all"),),
}


@contextmanager
def watched() -> Iterator[dict[str, float]]:
    """Count the seconds of the phases of a loop, each without those that are called inside."""
    spent, running = dict.fromkeys([*PHASES, "other"], 0.0), ["other"]
    last = time.process_time()

    def switch() -> None:
        nonlocal last
        now = time.process_time()
        spent[running[-1]] += now - last
        last = now

    def clocked(name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def call_in_phase(*args: Any, **keywords: Any) -> Any:
            switch()
            running.append(name)
            try:
                return call(*args, **keywords)
            finally:
                switch()
                running.pop()

        return call_in_phase

    with ExitStack() as stack:
        for name, places in PHASES.items():
            for place, what in places:
                call = clocked(name, getattr(place, what))
                stack.enter_context(mock.patch.object(place, what, call))
        yield spent
        switch()


def looped(
    index: int,
    norm: str,
    accuracy: float,
    on_step: Callable[[Any], None] = lambda step: None,
) -> tuple[Any, loop.Loop]:
    """Return what the loop finds, and the loop."""
    trial, used = Request(SEED, index).trial, list[loop.Loop]()
    wanted = Functional(MEAN) if norm == MEAN else None
    told = trial.told and wanted is None

    class Watched(loop.Loop):
        def __init__(self, *args: Any):
            super().__init__(*args)
            used.append(self)

    with mock.patch.object(adaptive, "Loop", Watched):
        found, _ = solved(trial, told, norm, wanted, accuracy, coarse_mesh(trial), on_step)
    return found, used[0]


def alone(found: Any, used: loop.Loop) -> float:
    """Return the least seconds of posing and solving the last problem again."""
    taken = []
    for coarse in 2 * [None, found.problem.contact_state()]:
        began = time.process_time()
        problem = used.pose(found.sided)
        problem.solve(coarse=coarse, **used.keywords_on(found.sided.mesh))
        taken.append(time.process_time() - began)
        problem.destroy()
    return COMM.allreduce(min(taken), op=MPI.MAX)


def row(index: int, norm: str, accuracy: float) -> list[Any]:
    """Return the row of a request."""
    looped(index, norm, accuracy)[0].problem.destroy()  # compiles the forms
    with watched() as spent:
        found, used = looped(index, norm, accuracy)
    whole, last = sum(spent.values()), alone(found, used)
    count, steps = found.steps[-1].unknowns, len(found.steps)
    found.problem.destroy()
    shares = [f"{100.0 * s / whole:.0f}" for s in spent.values()]
    scene = Request(SEED, index)
    told = f"{scene.family} {index}", norm, f"{accuracy:.0e}", count, steps
    return [*told, f"{whole:.2f}", f"{last:.2f}", f"{whole / last:.1f}", *shares]


def profile(index: int, norm: str, accuracy: float) -> None:
    """Print the functions in which a loop spends its time."""
    looped(index, norm, accuracy)[0].problem.destroy()
    with cProfile.Profile(time.process_time) as found:
        looped(index, norm, accuracy)[0].problem.destroy()
    for order in ("tottime", "cumtime"):
        pstats.Stats(found).sort_stats(order).print_stats(60)


def main() -> None:
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--only", type=int, nargs="*", default=range(len(REQUESTS)))
    options.add_argument("--profile", type=int)
    args = options.parse_args()
    if args.profile is not None:
        return profile(*REQUESTS[args.profile])
    columns = ["scene", "norm", "asked", "unknowns", "steps", "loop s", "last s", "ratio"]
    columns += [f"{name} %" for name in (*PHASES, "other")]
    rows = []
    for number in args.only:
        rows.append(row(*REQUESTS[number]))
        if COMM.rank == 0:
            print(*rows[-1], sep="  ", flush=True)
    if COMM.rank == 0:
        print(markdown_table(columns, rows), end="")
    write_json(COMM, "loop_over_solve", {"columns": columns, "rows": rows})


if __name__ == "__main__":
    main()
