"""The job `theory`: the paper's statements as experiments, and the document about them."""

import argparse
import shlex
from collections.abc import Mapping

from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.logs import Progress, log, say
from dolfinx_signorini.base.records import Row, check_outputs, on_first, write_file
from dolfinx_signorini.commands.options import add_out
from dolfinx_signorini.pictures.picture import picture_files
from dolfinx_signorini.studies.paper.theory.examples import paper_example
from dolfinx_signorini.studies.paper.theory.families import (
    discretise,
    experiments,
    run_experiments,
)
from dolfinx_signorini.studies.paper.theory.figures import FIGURES, draw_one_sided
from dolfinx_signorini.studies.paper.theory.one_sided import OneSided, one_sided_approximation
from dolfinx_signorini.studies.paper.theory.report import PICTURES, Document
from dolfinx_signorini.studies.paper.theory.statements import MEASURED, Statement, select

SMALLEST = 201  # cells per side of the finest mesh
DOCUMENT, ONE_SIDED = "theory.md", "one_sided"
FINE = 49  # cells per side of the mesh on which w_h is drawn


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the job."""
    parser.add_argument(
        "--statement",
        action="append",
        metavar="NUMBER",
        help="a statement, may be repeated, whose tables are printed; all by default, which take "
        "more than a minute: " + ", ".join(MEASURED),
    )
    parser.add_argument(
        "--max-n",
        type=int,
        default=SMALLEST,
        metavar="N",
        help=f"cells per side of the finest mesh, {SMALLEST} to {_largest()} (default %(default)s)",
    )
    add_out(parser, "results/theory", "rows, document and pictures")


def run(args: argparse.Namespace) -> int:
    """Compute what is missing, and write the document and print its summary on rank 0.

    The tables of statements that were asked for are printed, too.

    Raises:
        InputError: An argument makes no sense or the folder cannot be used.
        NotConvergedError: Some problem could not be solved.
    """
    comm = MPI.COMM_WORLD
    if not SMALLEST <= args.max_n <= _largest():
        message = f"must lie between {SMALLEST} and {_largest()}, not {args.max_n}"
        raise InputError(message, "--max-n")
    chosen = select(args.statement)
    needed = {name for statement in chosen for name in statement.experiments}
    names = [name for name in experiments() if name in needed]
    files = [f"{PICTURES}/{name}" for name in picture_files((*FIGURES, ONE_SIDED))]
    check_outputs(comm, args.out, (DOCUMENT, *files))
    rows = run_experiments(comm, names, args.max_n, args.out)
    approximation = None
    with Progress("document and pictures"):
        if any(statement.figure == ONE_SIDED for statement in chosen):
            discretisation = discretise(comm, paper_example(), FINE)
            approximation = one_sided_approximation(discretisation)
            discretisation.destroy()
        on_first(comm, args.out, lambda: _write(args, chosen, rows, approximation))
    return 0


def _write(
    args: argparse.Namespace,
    chosen: list[Statement],
    rows: Mapping[str, list[Row]],
    approximation: OneSided | None,
) -> None:
    """Print the summary and write the document with the tables; rank 0 only."""
    document = Document(chosen, rows)
    say(document.summary())
    for statement in chosen if args.statement else ():
        say("\n" + document.section(statement))
    pictures = args.out / PICTURES
    pictures.mkdir(parents=True, exist_ok=True)
    for name in {statement.figure for statement in chosen} & FIGURES.keys():
        FIGURES[name](rows).save(pictures / name)
    if approximation is not None:
        draw_one_sided(approximation).save(pictures / ONE_SIDED)
    write_file(args.out / DOCUMENT, document.text(_command(args)))
    log.info("tables: %s, pictures beside it", args.out / DOCUMENT)


def _largest() -> int:
    """The cells per side of the finest mesh of all experiments."""
    return max(max(experiment["cells"]) for experiment in experiments().values())


def _command(args: argparse.Namespace) -> str:
    chosen = [word for key in args.statement or () for word in ("--statement", key)]
    return shlex.join(["dolfinx-signorini", "theory", *chosen, "--max-n", str(args.max_n)])
