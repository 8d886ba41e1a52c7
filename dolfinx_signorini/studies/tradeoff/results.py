"""The files of a comparison: rows as JSON and CSV, tables, work-precision diagrams, and a page."""

import json
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from dolfinx_signorini.base.records import Row, versions, write_file
from dolfinx_signorini.base.tables import csv_table, markdown_table, text_table
from dolfinx_signorini.pictures.picture import Picture, picture_files
from dolfinx_signorini.studies.tradeoff import plots
from dolfinx_signorini.studies.tradeoff.comparing import (
    compared,
    describe,
    order_table,
    pareto_front,
    rivals,
    target_table,
)
from dolfinx_signorini.studies.tradeoff.measuring import told_by_kernel

TARGETS, REPORT, TABLE = "targets.txt", "tradeoff.json", "tradeoff.csv"
DIAGRAM = "work_precision"  # with the norm


def result_files(norms: Iterable[str]) -> list[str]:
    """Return the names of the files of a comparison, for the norms in which errors are measured."""
    pictures = picture_files(f"{DIAGRAM}_{norm}" for norm in norms)
    return [TARGETS, REPORT, TABLE, *pictures]


def write_results(folder: Path, rows: Sequence[Row], settings: dict[str, Any]) -> str:
    """Write the files of a comparison, and return a summary for a terminal.

    The summary has a line for each norm: the best error of uniform P1, or else the last target.

    Args:
        folder: The output folder.
        rows: All rows of the grid.
        settings: The settings of the rows, with "norms", "repeats" and "reference".
    """
    norms = settings["norms"]
    main = {norm: compared(rows, norm) for norm in norms}
    notes = (
        "seconds: wall clock, from nothing to the solution (coarse levels or the whole adaptive "
        "loop, mesh, assembly, solve), "
        f"median of {settings['repeats']}; compilation of the forms is left out\n"
        f"errors against: {settings['reference']}; *: the best of uniform P1 here\n"
    )
    found = {norm: target_table(main[norm], norm) for norm in norms}
    titles = (
        text_table(*table, f"for an error in {norm} of at most ...")
        for norm, table in found.items()
    )
    tables = "\n".join([notes, *titles])
    write_file(folder / TARGETS, tables)
    fronts = {norm: [_short(row, norm) for row in pareto_front(main[norm], norm)] for norm in norms}
    report = {"versions": versions(), "settings": settings, "rows": rows, "pareto": fronts}
    write_file(folder / REPORT, json.dumps(report, indent=1) + "\n")
    write_file(folder / TABLE, _csv(rows))
    for norm in norms:
        plots.draw_work_precision(main[norm], norm).save(folder / f"{DIAGRAM}_{norm}")
    heads = next(iter(found.values()))[0]
    best = [
        (norm, *next((line for line in lines if line[0].endswith("*")), lines[-1]))
        for norm, (_, lines) in found.items()
        if lines
    ]
    return f"{notes}\n{text_table(('norm', *heads), best)}"


def _short(row: Row, norm: str) -> dict[str, Any]:
    """The entry of a row in a Pareto front."""
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
    return csv_table(columns, [[line.get(key) for key in columns] for line in flat])


def write_page(path: Path, rows: Sequence[Row], norms: Sequence[str], max_unknowns: int) -> None:
    """Write the page and its diagrams, which go into a folder of the page's name.

    Args:
        path: The page, a Markdown file.
        rows: All rows of the paper's problem; those on several ranks are left out.
        norms: The norms of the error.
        max_unknowns: The limit that the rows were measured with.
    """
    folder = path.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    rows = [row for row in rows if row["ranks"] == 1]
    programs = ", ".join(f"{name} {version}" for name, version in versions().items())
    command = f"dolfinx-signorini tradeoff --max-unknowns {max_unknowns} --page {path.name}"
    lines = ["# Speed against accuracy", "", f"With {programs}, on {_processor()}:", ""]
    lines += [f"    {command}", ""]
    for norm in norms:
        table = markdown_table(*target_table(compared(rows, norm), norm))
        lines += [f"## The fastest for an error in {norm}", "", table]
    table = markdown_table(*order_table(rows, norms))
    lines += ["## Orders in h, measured (and allowed by approximation)", "", table]
    lines += ["## The diagrams", ""]
    for name, text, figure in _diagrams(rows, norms):
        figure.save(folder / name)
        lines += [f"![{text}]({folder.name}/{name}.png)", ""]
    write_file(path, "\n".join(lines))


def _diagrams(rows: Sequence[Row], norms: Sequence[str]) -> Iterator[tuple[str, str, Picture]]:
    """Name, description and figure of each diagram."""
    for norm in norms:
        text = f"error in {norm} against seconds and unknowns, with slopes"
        figure = plots.draw_work_precision(compared(rows, norm), norm)
        yield f"{DIAGRAM}_{norm}", text, figure
    sweep: dict[str, list[Row]] = {}
    for row in rows:
        if row["purpose"] == "tolerance":
            sweep.setdefault(describe(row), []).append(row)
    if sweep:
        yield "tolerance", "algebraic error", plots.draw_tolerance(sweep, norms[0])
    yield "phases", "where the time goes", plots.draw_phases(rivals(rows, norms))


def _processor() -> str:
    """The processor of this machine, as the kernel calls it."""
    model = told_by_kernel("cpuinfo", "model name")
    return f"{os.cpu_count()} cores" + (f" of {model}" if model else "")
