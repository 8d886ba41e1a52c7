"""The files of a comparison: rows as JSON and CSV, tables of targets, work-precision diagrams."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from dolfinx_signorini.base.records import versions, write_file
from dolfinx_signorini.base.tables import csv_table, text_table
from dolfinx_signorini.pictures import plotting
from dolfinx_signorini.studies.tradeoff import plots
from dolfinx_signorini.studies.tradeoff.comparing import (
    Row,
    compared,
    describe,
    pareto_front,
    target_table,
)

TARGETS, REPORT, TABLE = "targets.txt", "tradeoff.json", "tradeoff.csv"
DIAGRAM = "work_precision"  # with the norm


def result_files(norms: Iterable[str]) -> list[str]:
    """Return the names of the files of a comparison, for the norms in which errors are measured."""
    pictures = plotting.picture_files(f"{DIAGRAM}_{norm}" for norm in norms)
    return [TARGETS, REPORT, TABLE, *pictures]


def write_results(folder: Path, rows: Sequence[Row], settings: dict[str, Any]) -> str:
    """Write the files of a comparison, and return the tables of targets for a terminal.

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
    found = ((norm, target_table(main[norm], norm)) for norm in norms)
    titles = (text_table(*table, f"for an error in {norm} of at most ...") for norm, table in found)
    tables = "\n".join([notes, *titles])
    write_file(folder / TARGETS, tables)
    fronts = {norm: [_short(row, norm) for row in pareto_front(main[norm], norm)] for norm in norms}
    report = {"versions": versions(), "settings": settings, "rows": rows, "pareto": fronts}
    write_file(folder / REPORT, json.dumps(report, indent=1) + "\n")
    write_file(folder / TABLE, _csv(rows))
    for norm in norms:
        plotting.save(plots.draw_work_precision(main[norm], norm), folder / f"{DIAGRAM}_{norm}")
    return tables


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
