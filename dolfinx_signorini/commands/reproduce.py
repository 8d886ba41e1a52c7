"""The job `reproduce`: the paper's numerical experiment, its tables and pictures."""

import argparse
import json
from pathlib import Path

from mpi4py import MPI

from dolfinx_signorini.base.costs import Cost, cost_text
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.logs import Progress, log, say
from dolfinx_signorini.base.records import (
    Row,
    check_outputs,
    on_first,
    remove_outputs,
    versions,
    write_file,
)
from dolfinx_signorini.commands.options import add_out
from dolfinx_signorini.norms.names import listed_norms
from dolfinx_signorini.pictures.picture import picture_files
from dolfinx_signorini.solvers import METHODS
from dolfinx_signorini.solvers.cascade import checked_tolerance
from dolfinx_signorini.studies.paper import pictures
from dolfinx_signorini.studies.paper.sampling import PAPER_NAMES
from dolfinx_signorini.studies.paper.study import PAPER_NORMS, StudySettings, run_study
from dolfinx_signorini.studies.paper.tables import error_table, order_table, paper_table

LARGEST = 5001  # cells per side
PICTURES = ("solution_and_load", "convergence", "bottom_edge")
TABLES = ("table1.md", "table1.csv", "table2.md", "table2.csv", "tables.txt", "results.json")
OUTPUTS = (*TABLES, *picture_files(PICTURES))


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the job."""
    parser.add_argument(
        "--max-n",
        type=int,
        default=401,
        metavar="N",
        help="largest number of cells per side: 101, 201, ... up to N (default 401; "
        "1001 is the paper's whole table)",
    )
    parser.add_argument(
        "--method", choices=METHODS, default="cascade", help="solver (default %(default)s)"
    )
    parser.add_argument(
        "--norms",
        default=",".join(PAPER_NORMS),
        help="norms of the error, separated by commas (default: the paper's, where Linf_sampled, "
        "W1_inf_sampled and H1_2_boundary_sampled are by the paper's points; others: Linf, W1_inf, "
        "which are the maxima, H1_2_boundary, the same estimate by exact integrals, the norm "
        "H1_2_boundary_spectral itself, L2, H1, W1_8, L2_boundary, ...)",
    )
    parser.add_argument(
        "--rtol",
        type=float,
        help="relative natural residual of every solve (default: 1e-10 for the cascade, 1e-8 for "
        "the methods of TAO)",
    )
    add_out(parser, "results", "rows, tables and pictures")
    parser.add_argument(
        "--costs",
        action="store_true",
        help="print the forms, matrices and vectors made for the largest N, with bytes and seconds",
    )


def run(args: argparse.Namespace) -> int:
    """Run the study and write tables and pictures; print the tables on rank 0.

    Raises:
        InputError: An argument makes no sense or the folder cannot be used.
        NotConvergedError: Some problem could not be solved.
    """
    comm = MPI.COMM_WORLD
    settings = _settings(args)
    check_outputs(comm, args.out, OUTPUTS)
    first, second, *_ = map(int, paper_table(1))
    rows = run_study(comm, range(first, args.max_n + 1, second - first), settings, args.out)
    with Progress("tables and pictures"):
        picture = pictures.paper_picture(comm, first)
        on_first(comm, args.out, lambda: _write(args.out, rows, settings, picture))
    if args.costs and comm.rank == 0:
        print(f"Costs of N = {rows[-1]['n']}:")
        print(cost_text(Cost(**cost) for cost in rows[-1].get("costs", [])), flush=True)
    return 0


def _settings(args: argparse.Namespace) -> StudySettings:
    first = int(next(iter(paper_table(1))))
    if not first <= args.max_n <= LARGEST:
        raise InputError(f"must lie between {first} and {LARGEST}, not {args.max_n}", "--max-n")
    checked_tolerance(args.rtol, 1.0, "--rtol")
    norms = listed_norms(args.norms, PAPER_NAMES)
    return StudySettings(method=args.method, norms=norms, rtol=args.rtol)


def _write(
    folder: Path,
    rows: list[Row],
    settings: StudySettings,
    picture: pictures.PaperPicture | None,
) -> None:
    """Write and print the results; rank 0 only, which has the picture."""
    assert picture is not None
    tables = {"table1": error_table(rows, settings.norms)}
    if len(rows) > 1:
        tables["table2"] = order_table(rows, settings.norms)
    remove_outputs(folder, OUTPUTS)
    for name, table in tables.items():
        say(table.text())
        write_file(folder / f"{name}.md", table.markdown())
        write_file(folder / f"{name}.csv", table.csv())
    write_file(folder / "tables.txt", "\n".join(table.text() for table in tables.values()))
    report = {
        "versions": versions(),
        "settings": vars(settings) | {"norms": list(settings.norms)},
        "rows": rows,
        "tables": {
            name: {
                label: {
                    norm: {
                        "value": c.value,
                        "paper": None if c.paper is None else float(c.paper),
                        "difference": c.difference,
                        "agrees": c.agrees,
                    }
                    for norm, c in zip(table.columns, cells, strict=True)
                }
                for label, cells in table.rows
            }
            for name, table in tables.items()
        },
    }
    write_file(folder / "results.json", json.dumps(report, indent=1) + "\n")
    pictures.draw_solution_and_load(picture).save(folder / "solution_and_load")
    if len(rows) > 1:
        pictures.draw_convergence(rows, settings.norms).save(folder / "convergence")
    pictures.draw_bottom_edge(picture).save(folder / "bottom_edge")
    log.info("tables and pictures: %s/", folder)
