"""(a) What contact costs: the whole cascade over one linear solve of the same matrix.

    ./with-dolfinx python3 benchmarks/contact_over_linear.py [--cells 501 1001 2001] [--repeats 5]

The numerator is everything that the contact problem needs beyond its assembled matrix: mesh,
assembly and solve of all coarse levels, prediction, linear solves and TAO's check on the finest.
The denominator is one CG + BoomerAMG solve, from zero, to the same relative residual, with
BoomerAMG as PETSc sets it up ("linear") and with the settings of the contact solve ("tuned").
"""

import argparse

from common import SCENES, contact_solve, linear_solve, spread, table, timed, write_json
from mpi4py import MPI

from dolfinx_signorini.solvers.cascade import DEFAULT_RTOL


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, nargs="+", default=[501, 1001, 2001])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=list(SCENES))
    args = parser.parse_args()
    comm = MPI.COMM_WORLD
    results = []
    for scene in args.scenes:
        warm = SCENES[scene](comm, 63)
        contact_solve(warm, scene, 63, DEFAULT_RTOL)
        for n in args.cells:
            problem = SCENES[scene](comm, n)
            contact, linear, tuned, solves = [], [], [], []
            for _ in range(args.repeats):
                seconds, _ = timed(comm, linear_solve, problem, DEFAULT_RTOL)
                linear.append(seconds)
                seconds, _ = timed(comm, linear_solve, problem, DEFAULT_RTOL, True)
                tuned.append(seconds)
                seconds, (result, solves) = timed(
                    comm, contact_solve, problem, scene, n, DEFAULT_RTOL
                )
                contact.append(seconds)
            problem.destroy()
            ratio, ratio_tuned = (
                spread([c / x for c, x in zip(contact, other, strict=True)])
                for other in (linear, tuned)
            )
            results.append(
                {
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
            )
            if comm.rank == 0:
                print(f"{scene} N = {n}: {ratio['median']:.2f}", flush=True)
    rows = [
        (
            r["scene"],
            r["n"],
            r["ratio"]["median"],
            f"{r['ratio']['min']:.2f}-{r['ratio']['max']:.2f}",
            r["ratio_tuned"]["median"],
            r["contact_seconds"]["median"],
            r["linear_seconds"]["median"],
            r["tuned_seconds"]["median"],
            "+".join(map(str, r["linear_solves_by_level"])),
        )
        for r in results
    ]
    columns = (
        *("scene", "N", "/ linear", "range", "/ tuned", "contact s", "linear s", "tuned s"),
        "solves per level",
    )
    if comm.rank == 0:
        print(table(f"contact / linear solve, medians of {args.repeats}", columns, rows))
    write_json(comm, "contact_over_linear", {"repeats": args.repeats, "results": results})


main()
