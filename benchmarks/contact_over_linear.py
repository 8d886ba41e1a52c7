"""(a) What contact costs: the whole cascade over one linear solve of the same matrix.

    ./with-dolfinx python3 benchmarks/contact_over_linear.py [--cells 501 1001 2001] [--repeats 5]

The numerator is everything that the contact problem needs beyond its assembled matrix: mesh,
assembly and solve of all coarse levels, prediction, linear solves and TAO's check on the finest.
The denominator is one CG + BoomerAMG solve, from zero, to the same relative residual, with
BoomerAMG as PETSc sets it up ("linear") and with the settings of the contact solve ("tuned").
"""

from functools import partial
from typing import Any

from common import SCENES, contact_solve, linear_solve, parser, report, spread, timed
from mpi4py import MPI

from dolfinx_signorini.problem.signorini import DEFAULT_RTOL

COLUMNS = (
    *("scene", "N", "/ linear", "range", "/ tuned", "contact s", "linear s", "tuned s"),
    "solves per level",
)


def measure(comm: MPI.Comm, scene: str, n: int, repeats: int) -> dict[str, Any]:
    """Measure the three solves in turn, some times over."""
    pose = partial(SCENES[scene], comm)
    problem = pose(n)
    contact, linear, tuned, solves = [], [], [], []
    for _ in range(repeats):
        linear.append(timed(comm, linear_solve, problem, DEFAULT_RTOL)[0])
        tuned.append(timed(comm, linear_solve, problem, DEFAULT_RTOL, True)[0])
        seconds, solves = timed(comm, contact_solve, problem, pose, n)
        contact.append(seconds)
    result = problem.result
    problem.destroy()
    ratio, ratio_tuned = (
        spread([c / x for c, x in zip(contact, other, strict=True)]) for other in (linear, tuned)
    )
    return {
        "scene": scene,
        "n": n,
        "ratio": ratio,
        "ratio_tuned": ratio_tuned,
        "contact_seconds": spread(contact),
        "linear_seconds": spread(linear),
        "tuned_seconds": spread(tuned),
        "linear_solves_by_level": solves,
        "finest_phases": result.seconds,
        "natural_residual": result.natural_residual,
    }


def main() -> None:
    """Measure and print."""
    options = parser(__doc__, [501, 1001, 2001])
    options.add_argument("--scenes", nargs="+", default=list(SCENES), choices=list(SCENES))
    args = options.parse_args()
    comm = MPI.COMM_WORLD
    rows, results = [], []
    for scene in args.scenes:
        pose = partial(SCENES[scene], comm)
        contact_solve(pose(63), pose, 63)  # compiles the forms
        for n in args.cells:
            r = measure(comm, scene, n, args.repeats)
            results.append(r)
            if comm.rank == 0:
                print(f"{scene} N = {n}: {r['ratio']['median']:.2f}", flush=True)
            seconds = [r[f"{what}_seconds"]["median"] for what in ("contact", "linear", "tuned")]
            spanned = f"{r['ratio']['min']:.2f}-{r['ratio']['max']:.2f}"
            ratios = (r["ratio"]["median"], spanned, r["ratio_tuned"]["median"])
            solves = "+".join(map(str, r["linear_solves_by_level"]))
            rows.append((scene, n, *ratios, *seconds, solves))
    title = f"contact / linear solve, medians of {args.repeats}"
    content = {"repeats": args.repeats, "results": results}
    report(comm, "contact_over_linear", title, COLUMNS, rows, content)


main()
