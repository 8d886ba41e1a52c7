"""The job `solve`: solve a scene file, print a summary, write its results."""

import argparse
import logging
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx_signorini.accuracy.steps import MAX_UNKNOWNS, Step, step_line
from dolfinx_signorini.base.costs import cost_text
from dolfinx_signorini.base.errors import InputError, NotConvergedError, option_name
from dolfinx_signorini.base.logs import Progress, log, say
from dolfinx_signorini.base.records import folder_name
from dolfinx_signorini.base.timing import Phases
from dolfinx_signorini.commands.options import add_scene
from dolfinx_signorini.meshes.elements import HIGHEST_DEGREE
from dolfinx_signorini.scenes.files.reading import load_scene, naming_the_file
from dolfinx_signorini.scenes.files.scene import OUTPUTS, Scene
from dolfinx_signorini.scenes.output.files import write_results
from dolfinx_signorini.scenes.output.folder import output_folder
from dolfinx_signorini.scenes.output.pictures import scene_boundaries
from dolfinx_signorini.scenes.output.summary import Summary, lines, listing, summarise, time_line
from dolfinx_signorini.scenes.solving import SceneResult, solve_scene


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the job."""
    add_scene(parser)
    parser.add_argument(
        "--out",
        type=folder_name,
        metavar="DIR",
        help="folder for the results (default: the scene's name with -results, here)",
    )
    parser.add_argument(
        "--outputs",
        metavar="NAMES",
        help=f"results to write, separated by commas: {', '.join(OUTPUTS)} (default: those that "
        "the scene names; with --out and none named: all)",
    )
    parser.add_argument(
        "--report", action="store_true", help="write one HTML page with everything on it"
    )
    parser.add_argument(
        "--bound", action="store_true", help="compute a proven bound of the energy error"
    )
    parser.add_argument(
        "--costs",
        action="store_true",
        help="print the forms, matrices and vectors made for the finest level, with bytes and "
        "seconds",
    )

    dial = parser.add_argument_group(
        "accuracy", "refine a coarse mesh where the solution needs it, in place of the scene's mesh"
    )
    request = dial.add_mutually_exclusive_group()
    request.add_argument("--accuracy", type=float, metavar="E", help="the largest error allowed")
    request.add_argument(
        "--budget",
        type=float,
        metavar="S",
        help="seconds for all meshes together; files come on top",
    )
    dial.add_argument(
        "--norm",
        help="norm of this error: L4, Linf, W1_4, ..., of bodies also energy or stress_L2 "
        "(default: the scene's, or L2)",
    )
    dial.add_argument(
        "--degree",
        type=int,
        choices=range(1, HIGHEST_DEGREE + 1),
        help="degree of the elements (default: the loop chooses, 2 to 4 in the plane and 2 in "
        "space, none below the scene's)",
    )
    dial.add_argument(
        "--max-unknowns",
        type=int,
        metavar="N",
        help=f"limit on the unknowns (default: {MAX_UNKNOWNS})",
    )


def run(args: argparse.Namespace) -> int:
    """Solve the scene; print its summary and write its results on rank 0.

    Returns:
        0, or 3 if the accuracy was not reached.

    Raises:
        InputError: The scene is refused, or the folder cannot be written.
        NotConvergedError: The scene could not be solved.
    """
    comm, phases = MPI.COMM_WORLD, Phases(MPI.COMM_WORLD)
    adapted = args.accuracy is not None or args.budget is not None
    scene = load_scene(args.scene, comm, args.overrides, adapted)
    asked = _asked(args, scene)
    scene.refuse([*asked, *(["bound"] if args.bound else [])], option=True)
    outputs = _outputs(args, scene.outputs)
    folder = args.out or Path(f"{args.scene.stem}-results")
    with output_folder(comm, folder, outputs) if outputs else nullcontext() as part:
        phases.lap("reading")
        with naming_the_file(args.scene, scene, asked):
            result = _solve(scene, comm, **asked, phases=phases)
        try:
            with Progress("summary"):
                boundaries = scene_boundaries(result)
                summary = summarise(result, boundaries, args.bound)
            costs = result.posed.problem.costs() if args.costs else None
            if comm.rank == 0:
                _print(result, summary)
                if costs is not None:
                    print(cost_text(costs), end="")
            if part is not None:
                with Progress("files"):
                    write_results(result, summary, boundaries, outputs, part)
        finally:
            result.destroy()
    if outputs:
        phases.lap("files")
    if comm.rank == 0:
        print(listing([time_line(phases.seconds)]), end="")
        if outputs:
            print(f"results: {folder}/")
    return 0 if result.found is None or result.found.reached else NotConvergedError.exit_code


def _solve(scene: Scene, comm: MPI.Comm, **options: Any) -> SceneResult:
    """Solve the scene; print each step of the adaptive loop, unless the program is to be quiet."""

    def told(step: Step) -> None:
        if comm.rank == 0 and log.isEnabledFor(logging.INFO):
            say(step_line(step))

    with Progress("solution"):
        return solve_scene(scene, comm, **options, on_step=told)


def _asked(args: argparse.Namespace, scene: Scene) -> dict[str, Any]:
    """The accuracy or budget of the command line, with its norm and limit."""
    names = ("accuracy", "budget", "norm", "max_unknowns", "degree")
    asked = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    if asked and not asked.keys() & {"accuracy", "budget"} and scene.accuracy is None:
        raise InputError("goes with --accuracy or --budget", option_name(next(iter(asked))))
    return asked


def _outputs(args: argparse.Namespace, named: tuple[str, ...]) -> tuple[str, ...]:
    outputs = named
    if args.outputs is not None:
        outputs = tuple(dict.fromkeys(name.strip() for name in args.outputs.split(",")))
        for name in outputs:
            if name not in OUTPUTS:
                raise InputError(f"unknown {name!r}, known are {', '.join(OUTPUTS)}", "--outputs")
    elif args.out is not None and not named and not args.report:
        outputs = tuple(OUTPUTS)
    return tuple(dict.fromkeys((*outputs, "report"))) if args.report else outputs


def _print(result: SceneResult, summary: Summary) -> None:
    if result.found is not None:
        print()
    print(result.posed.scene.title)
    rows = [*lines(summary), ("expected orders", str(result.expectation))]
    print(listing(rows), end="")
    for note in result.expectation.notes:
        print(f"note: {note}")
