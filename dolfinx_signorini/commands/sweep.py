"""The job `sweep`: one key of a scene file over several values, as a table and a plot.

A value that is refused, or whose problem cannot be solved, costs its own row only: the table says
why the row has no numbers, and the command ends with the exit code of the failure.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError, NotConvergedError
from dolfinx_signorini.base.logs import Progress, log
from dolfinx_signorini.base.records import (
    ROWS,
    Records,
    Row,
    check_outputs,
    on_first,
    remove_outputs,
    write_file,
)
from dolfinx_signorini.base.tables import csv_table, text_table
from dolfinx_signorini.commands.options import add_out, add_scene
from dolfinx_signorini.pictures.palette import curve_style
from dolfinx_signorini.pictures.picture import Picture, picture_files, typeset_norm
from dolfinx_signorini.scenes.files.reading import load_scene, naming_the_file
from dolfinx_signorini.scenes.files.scene import Scene
from dolfinx_signorini.scenes.output.pictures import scene_boundaries
from dolfinx_signorini.scenes.output.summary import force_columns, summarise
from dolfinx_signorini.scenes.solving import solve_scene

PICTURE, TABLE = "sweep", "sweep.csv"
OUTPUTS = (TABLE, *picture_files([PICTURE]))
FAILED = "not solved"  # the column that says why a row has no numbers


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the job."""
    add_scene(parser)
    parser.add_argument("key", help="the key, for example domain.cells or contact.obstacle")
    parser.add_argument(
        "values",
        nargs="+",
        metavar="VALUE",
        help="its values; those such as -x go behind --, unlike -0.3 or -1-x",
    )
    add_out(parser, "results/sweep", "rows, table and plot")


def run(args: argparse.Namespace) -> int:
    """Solve the scene for each value, and write the table and the plot on rank 0.

    Returns:
        0, or 2 if a value was refused, or else 3 if some problem could not be solved.

    Raises:
        InputError: All values are refused by the scene file, or the folder cannot be used.
    """
    comm, values = MPI.COMM_WORLD, list(dict.fromkeys(value.strip() for value in args.values))
    scenes, failures = _scenes(args, comm, values)
    check_outputs(comm, args.out, OUTPUTS)
    text = next(iter(scenes.values())).text
    settings = {"scene": text, "set": args.overrides, "key": args.key}
    records = Records(comm, args.out / ROWS, settings, keys=("value",))
    # A file of a mesh may be another one than that of the rows at hand.
    keys = {v: {"value": v, **scene.domain.record()} for v, scene in scenes.items()}
    done: dict[str, Row] = {}
    for value, key in keys.items():
        if finished := records.finished(key):
            log.info("%s = %s: already done", args.key, value)
            done[value] = finished
    missing = [value for value in values if value not in done]
    with Progress("sweep", len(missing)) as progress:
        for value in missing:
            if value in scenes:
                try:
                    with naming_the_file(args.scene, scenes[value]):
                        row = _row(scenes[value], comm)
                except (InputError, NotConvergedError) as error:
                    failures[value] = error
            progress.advance()
            if value in failures:
                log.warning("%s = %s: %s: %s", args.key, value, FAILED, failures[value])
                continue
            records.append(keys[value] | row)
            done[value] = row = records.rows[-1]
            told = args.key, value, row["unknowns"], row["seconds"]
            log.info("%s = %s: %d unknowns, %.2f s", *told)
    rows = [done.get(v) or {"value": v, FAILED: str(failures[v])} for v in values]
    on_first(comm, args.out, lambda: _write(args.out, args.key, rows))
    return min((error.exit_code for error in failures.values()), default=0)


def _scenes(
    args: argparse.Namespace, comm: MPI.Comm, values: Sequence[str]
) -> tuple[dict[str, Scene], dict[str, InputError | NotConvergedError]]:
    """Return the scene for each value, and why other values are refused, by value."""
    scenes: dict[str, Scene] = {}
    failures: dict[str, InputError | NotConvergedError] = {}
    for value in values:
        try:
            scenes[value] = load_scene(args.scene, comm, [*args.overrides, f"{args.key}={value}"])
        except InputError as error:
            failures[value] = error
    if not scenes:  # the file or the key is wrong rather than the values
        raise failures[values[0]]
    return scenes, failures


def _row(scene: Scene, comm: MPI.Comm) -> Row:
    """Solve one scene; return its numbers, the same on all ranks."""
    result = solve_scene(scene, comm)
    try:
        summary = summarise(result, scene_boundaries(result))
    finally:
        result.destroy()
    row = {
        "unknowns": summary.unknowns,
        "in contact": summary.contact_size,
        **force_columns(summary.forces),
        **summary.body,
        **{f"error {name}": error for name, error in summary.errors.items()},
        "seconds": summary.seconds,
    }
    if result.found is not None:
        row["estimate"] = result.found.estimate
    return dict(comm.bcast(row))


def _write(folder: Path, key: str, rows: list[Row]) -> None:
    """Print the table, and write table and plot; rank 0 only."""
    solved = [row for row in rows if FAILED not in row]
    numbers = list(
        dict.fromkeys(
            name for row in solved for name, entry in row.items() if isinstance(entry, int | float)
        )
    )
    columns = ["value", *numbers, *([FAILED] if len(solved) < len(rows) else [])]
    cells = [[row.get(name, "") for name in columns] for row in rows]
    print(_text([key, *numbers], rows, cells), end="", flush=True)
    remove_outputs(folder, OUTPUTS)
    write_file(folder / TABLE, csv_table([key, *columns[1:]], cells))
    if len(solved) > 1:
        draw_sweep(key, solved).save(folder / PICTURE)
    log.info("table%s: %s/", " and plot" if len(solved) > 1 else "", folder)


def _text(heads: list[str], rows: list[Row], cells: list[list[Any]]) -> str:
    """Return the table for a terminal, where a row without numbers says why."""
    table = text_table(heads, [line[: len(heads)] for line in cells]).splitlines()
    width = max(len(text) for text in (heads[0], *(row["value"] for row in rows)))
    for k, row in enumerate(rows, start=len(table) - len(rows)):
        if FAILED in row:
            table[k] = f"{table[k]:<{width}}  {FAILED}: {row[FAILED]}"
    return "\n".join(table) + "\n"


def draw_sweep(key: str, rows: list[Row]) -> Picture:
    """Return a plot of contact set and contact force, or of the errors, over the values of a key.

    Args:
        key: The key.
        rows: Numbers by name, and the `value` of the key as a text; at least two rows.

    Raises:
        InputError: There are fewer than two rows.
    """
    if len(rows) < 2:
        raise InputError("a plot needs two values at least", key)
    errors = [name for name in rows[0] if name.startswith(("error ", "estimate"))]
    forces = [name for name in rows[0] if name.startswith("force of contact")]
    panels = {"in contact": ["in contact"], "force of contact": forces}
    panels |= {"error": errors} if errors else {}
    figure = Picture(figsize=(4.0 * len(panels), 3.6))
    x, numeric = _positions(rows)
    for axes, (title, names) in zip(figure.panels(1, len(panels)), panels.items(), strict=True):
        axes.set(xlabel=key, ylabel=title)
        for k, name in enumerate(names):
            y = [row.get(name, float("nan")) for row in rows]
            label = typeset_norm(name.removeprefix("error "))
            line = "-" if numeric else ":"  # nothing lies between two formulas
            axes.plot(x, y, line, label=label, **curve_style(k))
        if title == "error":
            axes.set_yscale("log")
        if names != [title]:
            axes.legend(frameon=False)
        if numeric and min(x) > 0.0 and max(x) > 3.0 * min(x):
            axes.set_xscale("log")
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axes.xaxis.set_minor_formatter(NullFormatter())
        if not numeric:
            axes.set_xticks(
                x, [str(row["value"]).replace("$", r"\$") for row in rows], rotation=30, ha="right"
            )
    return figure


def _positions(rows: list[Row]) -> tuple[list[float], bool]:
    """Return the values as numbers, or their places in the list where one is no number."""
    try:
        return [float(row["value"]) for row in rows], True
    except ValueError:
        return [float(k) for k in range(len(rows))], False
