"""The job `accuracy`: solve a scene to an accuracy, or as accurately as a time allows."""

import argparse
from pathlib import Path

from mpi4py import MPI

from dolfinx_signorini.accuracy import MAX_UNKNOWNS, Outcome, solve_to
from dolfinx_signorini.families import paper_family, scene_family
from dolfinx_signorini.scenes import load_scene


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the job."""
    parser.add_argument("scene", help='a scene file, or "paper" for the paper\'s problem')
    parser.add_argument(
        "--norm", default="L2", help="norm of the error: L4, Linf, W1_4, ... (default %(default)s)"
    )
    request = parser.add_mutually_exclusive_group(required=True)
    request.add_argument("--accuracy", type=float, metavar="E", help="the largest error allowed")
    request.add_argument(
        "--budget", type=float, metavar="S", help="seconds for coarse runs and the solution"
    )
    parser.add_argument(
        "--max-unknowns",
        type=int,
        default=MAX_UNKNOWNS,
        metavar="N",
        help="limit on the unknowns (default %(default)s)",
    )


def run(args: argparse.Namespace) -> int:
    """Choose mesh, degree and tolerance, solve, and print on rank 0 what came out.

    Raises:
        InputError: An argument makes no sense, or the request is out of reach.
        NotConvergedError: Some problem could not be solved.
    """
    comm = MPI.COMM_WORLD
    if args.scene == "paper":
        family = paper_family()
    else:
        family = scene_family(load_scene(Path(args.scene), comm))
    outcome = solve_to(
        comm,
        family,
        args.norm,
        accuracy=args.accuracy,
        budget=args.budget,
        max_unknowns=args.max_unknowns,
    )
    outcome.run.destroy()
    if comm.rank == 0:
        print(summary(outcome), flush=True)
    return 0


def summary(outcome: Outcome) -> str:
    """Return what was tried, predicted and reached, as text."""
    lines = [f"{'configuration':24s} {'rtol':>8s} {'unknowns':>9s} {'seconds':>9s} {'error':>10s}"]
    for trial in outcome.trials:
        c = trial.configuration
        rtol = "default" if c.rtol is None else f"{c.rtol:.1e}"
        lines.append(
            f"{c!s:24s} {rtol:>8s} {trial.unknowns:9d} {trial.seconds:9.3g} {trial.error:10.3e}"
        )
    predicted, final = outcome.predicted, outcome.run
    against = "estimated from a finer solution" if outcome.estimated else "exact solution known"
    lines += [
        "",
        f"chosen:    {final.configuration}, {final.unknowns} unknowns",
        f"predicted: error {predicted.error:.3g} in {outcome.norm}, {predicted.seconds:.3g} s",
        f"came out:  error {outcome.error:.3g} in {outcome.norm} ({against}), "
        f"{final.total_seconds:.3g} s; {outcome.seconds:.3g} s with all coarse runs",
    ]
    return "\n".join(lines)
