"""The page on speed against accuracy: rules, each with the figures measured for it."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.records import versions, write_file
from dolfinx_signorini.base.tables import markdown_table
from dolfinx_signorini.norms.orders import DETACHMENT_EXPONENT, SMOOTH, approximation_order
from dolfinx_signorini.pictures import plotting
from dolfinx_signorini.studies.tradeoff import plots
from dolfinx_signorini.studies.tradeoff.comparing import Row, compared, of_kind, slope
from dolfinx_signorini.studies.tradeoff.grid import ADAPTED
from dolfinx_signorini.studies.tradeoff.kinds import KINDS
from dolfinx_signorini.studies.tradeoff.measuring import ENOUGH, told_by_kernel
from dolfinx_signorini.studies.tradeoff.rules import NORMS, rules, shown, sweep

BERNSTEIN = [
    "## What the Bernstein basis guarantees",
    "",
    "The elements are in the Bernstein basis: on an edge the gap is a sum of non-negative "
    "functions with coefficients that are not negative, and so the gap is not negative at any "
    "point. Each coefficient has a bound of its own, as TAO needs it. The condition is sufficient: "
    "the gap a (1 - t)^2 + 2 c t (1 - t) + b t^2 of degree 2 is not negative as soon as "
    "c >= -sqrt(a b). Nodal elements would hold the constraint at their nodes only.",
    "",
]
POSITION = (
    "The width h is the number of unknowns to the power -1/2; the diagrams name the order in "
    "unknowns, half as large. Graded meshes have the full orders as far as the detachment point is "
    "known: the gap behind it, to the power 2/3, is smooth, and its zero is extrapolated from "
    "places where the discrete gap is accurate. In W1_inf a single cell decides, and cells are "
    "halved, not scaled: the error jumps from one mesh to the next. In degree 4 the largest errors "
    "in L4 and Linf are no longer at this point, but at the other end of the free boundary, "
    "(0.05, 0), where u vanishes with four derivatives: graded meshes are not finer there, and the "
    "error depends on how cells lie about this end. Adapted meshes are finer at both."
)


def write_page(path: Path, rows: Sequence[Row], max_unknowns: int) -> None:
    """Write the page and its diagrams, which go into a folder of the page's name.

    Args:
        path: The page, a Markdown file.
        rows: All rows of the paper's problem, rows on several ranks included.
        max_unknowns: The limit that the rows were measured with.

    Raises:
        InputError: Some rule has no rows.
    """
    try:
        chapters = rules(rows)
    except (ValueError, KeyError, IndexError, StopIteration) as error:
        raise InputError(
            "some rows are missing; the page needs L4, Linf, W1_4 and W1_inf, at least 50000 "
            f"unknowns, and runs on one and on two ranks in the same --out ({error!r})",
            "--page",
        ) from None
    folder = path.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    serial = [row for row in rows if row["ranks"] == 1]
    lines = _introduction(max_unknowns, max(row["repeats"] for row in serial))
    for number, (title, text) in enumerate(chapters, start=1):
        lines += [f"## {number}. {title}", "", text, ""]
    lines += [*_orders(serial), *BERNSTEIN, "## The diagrams", ""]
    for name, text, figure in _diagrams(serial):
        plotting.save(figure, folder / name)
        lines += [f"![{text}]({folder.name}/{name}.png)", ""]
    write_file(path, "\n".join(lines))


def _introduction(max_unknowns: int, repeats: int) -> list[str]:
    """The lines about the commands that made the page, and about its figures."""
    programs = ", ".join(f"{name} {version}" for name, version in versions().items())
    return [
        "# Speed against accuracy",
        "",
        f"Made by a command from its own measurements, with {programs}, on {_processor()}:",
        "",
        f"    mpirun -n 2 dolfinx-signorini tradeoff --max-unknowns {max_unknowns}",
        f"    dolfinx-signorini tradeoff --max-unknowns {max_unknowns} --page docs/tradeoff.md",
        "",
        "The problem is the paper's. Seconds are wall-clock seconds of everything from nothing to "
        "the solution: coarse levels, or all steps of the adaptive loop, mesh, assembly and solve; "
        f"the median of {repeats} repeats of what takes less than {ENOUGH:g} s together. "
        "Compilation of the forms, once per form and machine, is left out. Graded meshes do not "
        "know the detachment point: the coarse levels find it. Adapted meshes are made for one "
        f"norm and accuracy each, with at most {ADAPTED} unknowns. Uniform P1 means the paper's "
        "meshes with the cascade. Sup norms are maxima. All figures, tables and diagrams of this "
        "page are from the two commands above.",
        "",
    ]


def _orders(rows: Sequence[Row]) -> list[str]:
    """The orders by regression over the finer meshes beside what approximation allows."""
    lines = []
    for kind in KINDS:
        exponent = DETACHMENT_EXPONENT if kind.mesh == "uniform" else SMOOTH
        cells, most = [], 0
        for norm in NORMS:
            own = of_kind(compared(rows, norm), kind)
            most = max([most, *(row["unknowns"] for row in own)])
            order = slope(own, norm)
            measured = "-" if order is None else f"{2.0 * order:.2f}"
            cells.append(f"{measured} ({approximation_order(norm, kind.degree, exponent):g})")
        lines.append((str(kind), str(most), *cells))
    table = markdown_table(("mesh and elements", "unknowns, at most", *NORMS), lines)
    return ["## Orders in h, measured (and allowed by approximation)", "", table, POSITION, ""]


def _diagrams(rows: Sequence[Row]) -> Iterator[tuple[str, str, Figure]]:
    """Name, description and figure of each diagram."""
    for norm in NORMS:
        text = f"error in {norm} against seconds and unknowns, with slopes"
        figure = plots.draw_work_precision(compared(rows, norm), norm)
        yield f"work_precision_{norm}", text, figure
    yield "tolerance", "algebraic error", plots.draw_tolerance(sweep(rows, "tolerance"), "L4")
    yield "phases", "where the time goes", plots.draw_phases(shown(rows))


def _processor() -> str:
    """The processor of this machine, as the kernel calls it."""
    for line in told_by_kernel("cpuinfo"):
        if line.startswith("model name"):
            return f"{os.cpu_count()} cores of {line.split(':', 1)[1].strip()}"
    return f"{os.cpu_count()} cores"
