"""The page on speed against accuracy: tables and diagrams of the paper's problem."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from dolfinx_signorini.base.records import versions, write_file
from dolfinx_signorini.base.tables import markdown_table
from dolfinx_signorini.pictures import plotting
from dolfinx_signorini.studies.tradeoff import plots
from dolfinx_signorini.studies.tradeoff.comparing import (
    Row,
    compared,
    describe,
    order_table,
    rivals,
    target_table,
)
from dolfinx_signorini.studies.tradeoff.measuring import told_by_kernel


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
        plotting.save(figure, folder / name)
        lines += [f"![{text}]({folder.name}/{name}.png)", ""]
    write_file(path, "\n".join(lines))


def _diagrams(rows: Sequence[Row], norms: Sequence[str]) -> Iterator[tuple[str, str, Figure]]:
    """Name, description and figure of each diagram."""
    for norm in norms:
        text = f"error in {norm} against seconds and unknowns, with slopes"
        figure = plots.draw_work_precision(compared(rows, norm), norm)
        yield f"work_precision_{norm}", text, figure
    sweep: dict[str, list[Row]] = {}
    for row in rows:
        if row["purpose"] == "tolerance":
            sweep.setdefault(describe(row), []).append(row)
    if sweep:
        yield "tolerance", "algebraic error", plots.draw_tolerance(sweep, norms[0])
    yield "phases", "where the time goes", plots.draw_phases(rivals(rows, norms))


def _processor() -> str:
    """The processor of this machine, as the kernel calls it."""
    for line in told_by_kernel("cpuinfo"):
        if line.startswith("model name"):
            return f"{os.cpu_count()} cores of {line.split(':', 1)[1].strip()}"
    return f"{os.cpu_count()} cores"
