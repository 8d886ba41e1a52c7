"""The job `tradeoff`: what accuracy costs, measured on a grid of configurations."""

import argparse
import csv
import io
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx_signorini import plotting
from dolfinx_signorini.accuracy.family import Family
from dolfinx_signorini.accuracy.runs import Configuration
from dolfinx_signorini.errors import InputError
from dolfinx_signorini.norms import listed_norms
from dolfinx_signorini.paper.solution import paper_family
from dolfinx_signorini.quadrature import QuadratureRule
from dolfinx_signorini.records import Records, on_first, versions, write_file
from dolfinx_signorini.scenes import Scene, load_scene
from dolfinx_signorini.scenes.posing import scene_family
from dolfinx_signorini.tradeoff import plots
from dolfinx_signorini.tradeoff.measuring import (
    Row,
    cheapest,
    describe,
    grid,
    is_baseline,
    measure_grid,
    pareto_front,
    targets,
)
from dolfinx_signorini.tradeoff.page import write_page

NORMS = "L4,Linf,W1_4,W1_inf"
REFERENCE = 1.6  # times the cells across of the finest P2 mesh, where no solution is known


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
        help="limit on the unknowns (default %(default)s; 1100000 for the paper's finest mesh)",
    )
    parser.add_argument(
        "--repeats", type=int, default=3, help="how often to time each solve (default %(default)s)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("results/tradeoff"),
        metavar="DIR",
        help="folder for rows, tables and diagrams; a run that was stopped goes on from what it "
        "finds there, and runs on other numbers of ranks add to it (default %(default)s)",
    )
    parser.add_argument(
        "--page",
        type=Path,
        metavar="FILE",
        help="also write a page of rules with the diagrams beside it; for the paper's problem",
    )


def run(args: argparse.Namespace) -> int:
    """Measure the grid, and write rows, tables and diagrams; print the tables on rank 0.

    Raises:
        InputError: An argument makes no sense or the folder cannot be used.
    """
    comm = MPI.COMM_WORLD
    norms = _norms(args)
    paper = args.scene == "paper"
    scene = None if paper else load_scene(Path(args.scene), comm)
    make_family = _families(scene)
    family = make_family(1)
    items = grid(args.max_unknowns, family.dimension, sweeps=paper)
    if not items:
        raise InputError(f"--max-unknowns: no mesh has as few as {args.max_unknowns}")
    reference = None if paper or _is_known(family, comm) else _reference(items)
    settings = {
        "scene": "paper" if scene is None else scene.text,
        "norms": norms,
        "repeats": args.repeats,
        "reference": "exact" if reference is None else str(reference),
    }
    records = Records(comm, args.out / "rows.jsonl", settings)
    rows = measure_grid(records, make_family, items, norms, args.repeats, reference)
    main = [row for row in rows if row["purpose"] == "main"]
    on_first(comm, args.out, lambda: _write(args.out, main, rows, settings))
    if page := args.page:
        limit = args.max_unknowns
        on_first(comm, page.parent, lambda: write_page(page, records.rows, limit, versions()))
    return 0


def target_table(rows: Sequence[Row], norm: str) -> str:
    """Return, for one norm, the cheapest configuration for each error against uniform P1.

    Args:
        rows: Rows of the main grid.
        norm: The norm.
    """
    best = min((row["errors"][norm] for row in rows if is_baseline(row)), default=float("nan"))
    lines = []
    for target in targets(rows, norm):
        row = cheapest(rows, norm, target)
        base = cheapest([r for r in rows if is_baseline(r)], norm, target)
        if row is None:
            continue
        against = "uniform P1 does not get there"
        if base is not None:
            against = (
                f"against {base['total']:.3g} s for {describe(base)} "
                f"({base['total'] / row['total']:.1f} times)"
            )
        mark = "*" if target == best else " "
        lines.append(
            f"  {target:9.3e}{mark} {describe(row):22s} {row['unknowns']:8d} unknowns "
            f"{row['total']:8.3g} s  {against}"
        )
    head = f"for an error in {norm} of at most ... the cheapest configuration is ..."
    return "\n".join([head, *lines])


def _norms(args: argparse.Namespace) -> list[str]:
    norms = list(listed_norms(args.norms))
    if args.repeats < 1:
        raise InputError(f"--repeats: at least 1, not {args.repeats}")
    if args.page and args.scene != "paper":
        raise InputError("--page: only for the paper's problem")
    return norms


def _families(scene: Scene | None) -> Callable[[int], Family]:
    if scene is None:
        return lambda rule: paper_family(rule=QuadratureRule("Gauss-Jacobi", rule))
    family = scene_family(scene)
    return lambda rule: family


def _is_known(family: Family, comm: MPI.Comm) -> bool:
    """Whether the scene has a known solution; a mesh of a few cells tells."""
    posed = family.pose(family.make(comm, 4), 1)
    posed.problem.destroy()
    return posed.exact is not None


def _reference(items: Sequence[Any]) -> Configuration:
    """A finer solve than all of the grid, for scenes without a known solution."""
    n = max(item.configuration.n for item in items if item.configuration.degree == 2)
    graded = any(item.configuration.graded for item in items)
    return Configuration(graded, int(REFERENCE * n), 2)


def _write(
    folder: Path, main: Sequence[Row], rows: Sequence[Row], settings: dict[str, Any]
) -> None:
    """Write and print the results; rank 0 only."""
    norms = settings["norms"]
    notes = (
        "seconds: wall clock, from nothing to the solution (coarse levels, mesh, assembly, solve), "
        f"median of {settings['repeats']}; compilation of the forms is left out\n"
        f"errors against: {settings['reference']}; *: the best of uniform P1 here"
    )
    tables = "\n\n".join([notes, *(target_table(main, norm) for norm in norms)]) + "\n"
    print(tables, flush=True)
    write_file(folder / "targets.txt", tables)
    fronts = {norm: [_short(row, norm) for row in pareto_front(main, norm)] for norm in norms}
    report = {"versions": versions(), "settings": settings, "rows": rows, "pareto": fronts}
    write_file(folder / "tradeoff.json", json.dumps(report, indent=1) + "\n")
    write_file(folder / "tradeoff.csv", _csv(rows))
    for norm in norms:
        figure = plots.draw_work_precision(main, norm)
        plotting.save(figure, folder / f"work_precision_{norm}")


def _short(row: Row, norm: str) -> dict[str, Any]:
    return {
        "configuration": describe(row),
        "unknowns": row["unknowns"],
        "seconds": row["total"],
        "error": row["errors"][norm],
    }


def _csv(rows: Sequence[Row]) -> str:
    """All rows, with one column for each phase and each norm."""
    flat = []
    for row in rows:
        line: dict[str, Any] = {}
        for key, value in row.items():
            if isinstance(value, dict):
                line |= {f"{key}_{name}": part for name, part in value.items()}
            elif not isinstance(value, list):
                line[key] = value
        flat.append(line)
    columns = list(dict.fromkeys(key for line in flat for key in line))
    out = io.StringIO()
    writer = csv.DictWriter(out, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(flat)
    return out.getvalue()
