"""The job `tradeoff`: what accuracy costs, measured on a grid of configurations."""

import argparse
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path

from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.logs import Progress, log
from dolfinx_signorini.base.records import ROWS, Records, Row, check_outputs, on_first
from dolfinx_signorini.commands.options import add_out
from dolfinx_signorini.meshes.quadrature import QuadratureRule
from dolfinx_signorini.norms.names import listed_norms
from dolfinx_signorini.scenes import Scene, load_scene
from dolfinx_signorini.scenes.expectations import check_norms, expect
from dolfinx_signorini.studies.paper.solution import PAPER_RULE, paper_family
from dolfinx_signorini.studies.tradeoff.comparing import accuracies, compared
from dolfinx_signorini.studies.tradeoff.family import Family, scene_family
from dolfinx_signorini.studies.tradeoff.grid import adapted_kinds, finer_configuration, grid, ladder
from dolfinx_signorini.studies.tradeoff.measuring import Meter
from dolfinx_signorini.studies.tradeoff.results import (
    TARGETS,
    result_files,
    write_page,
    write_results,
)

NORMS = "L4,Linf,W1_4,W1_inf"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the job."""
    parser.add_argument(
        "scene", nargs="?", default="paper", help="a scene file (default: the paper's problem)"
    )
    parser.add_argument(
        "--norms",
        default=NORMS,
        help="norms of the error, separated by commas (default %(default)s)",
    )
    parser.add_argument(
        "--max-unknowns",
        type=int,
        default=110_000,
        metavar="N",
        help="limit on the unknowns (default %(default)s; 1100000 for the paper's finest mesh, "
        "which takes much longer)",
    )
    parser.add_argument(
        "--repeats", type=int, default=3, help="how often to time each solve (default %(default)s)"
    )
    add_out(
        parser,
        "results/tradeoff",
        "rows, tables and diagrams",
        ", and runs on other numbers of ranks add to it",
    )
    parser.add_argument(
        "--page",
        type=Path,
        metavar="FILE",
        help="also write a page of tables with the diagrams beside it; for the paper's problem",
    )


def run(args: argparse.Namespace) -> int:
    """Measure the grid, and write rows, tables and diagrams; print a summary on rank 0.

    Raises:
        InputError: An argument makes no sense or the folder cannot be used.
    """
    comm = MPI.COMM_WORLD
    norms = _norms(args)
    paper = args.scene == "paper"
    scene = None if paper else load_scene(Path(args.scene), comm)
    if scene is not None:
        scene.refuse(["tradeoff"])
        coarsest = scene.levels()[0].domain
        check_norms(norms, expect(scene, coarsest.make(comm)), "--norms")
    make_family = _families(scene)
    family = make_family(PAPER_RULE.degree)
    every = grid(args.max_unknowns, family.dimension, sweeps=paper)
    configurations = [c for c in every if family.has_kind(c.kind)]
    if not configurations:
        raise InputError(f"no mesh has as few as {args.max_unknowns}", "--max-unknowns")
    known = scene is None or scene.solution is not None
    reference = None if known else finer_configuration(args.max_unknowns, family.dimension)
    settings = {
        "scene": "paper" if scene is None else scene.text,
        "norms": norms,
        "repeats": args.repeats,
        "reference": "exact" if reference is None else str(reference),
        **({} if scene is None else scene.domain.record()),
    }
    check_outputs(comm, args.out, result_files(norms))
    records = Records(comm, args.out / ROWS, settings, keys=("mesh", "degree", "purpose", "ranks"))
    if args.page and comm.size > 1 and all(row["ranks"] > 1 for row in records.rows):
        message = "is of rows on one rank, and the folder has none; run without mpirun first"
        raise InputError(message, "--page")
    meter = Meter(records, make_family, norms, args.repeats, reference)
    rows = meter.measured(configurations)
    rows += _adapted(meter, rows, args.max_unknowns, family.dimension)
    meter.destroy()
    with Progress("tables and diagrams"):
        summary = on_first(comm, args.out, lambda: write_results(args.out, rows, settings))
    if comm.rank == 0:
        print(summary, end="", flush=True)
    log.info("tables: %s, diagrams beside it", args.out / TARGETS)
    if page := args.page:
        limit = args.max_unknowns
        on_first(comm, page.parent, lambda: write_page(page, records.rows, norms, limit))
    return 0


def _adapted(meter: Meter, rows: Sequence[Row], max_unknowns: int, dimension: int) -> list[Row]:
    """Measure the adaptive loop, asked for the accuracies that other rows reach."""
    found: list[Row] = []
    kinds = adapted_kinds(max_unknowns, dimension)
    with Progress("adapted meshes", len(meter.norms) * len(kinds)) as progress:
        for norm, kind in product(meter.norms, kinds):
            wanted = accuracies(compared(rows, norm), norm)
            found += meter.climbed(ladder(kind, norm, wanted, max_unknowns, dimension))
            progress.advance()
    return found


def _norms(args: argparse.Namespace) -> list[str]:
    """The norms of the command line, after the other arguments were checked."""
    norms = list(listed_norms(args.norms))
    if args.repeats < 1:
        raise InputError(f"at least 1, not {args.repeats}", "--repeats")
    if args.page and args.scene != "paper":
        raise InputError("only for the paper's problem", "--page")
    return norms


def _families(scene: Scene | None) -> Callable[[int], Family]:
    """The problem for a degree of the quadrature rule; a scene has a rule of its own."""
    if scene is None:
        return lambda rule: paper_family(rule=QuadratureRule("Gauss-Jacobi", rule))
    family = scene_family(scene)
    return lambda rule: family
