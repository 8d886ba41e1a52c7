"""The page on speed against accuracy: ten rules, each with the figures measured for it."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from dolfinx_signorini import plotting
from dolfinx_signorini.errors import InputError
from dolfinx_signorini.orders import DETACHMENT_EXPONENT, SMOOTH, approximation_order, regression
from dolfinx_signorini.records import versions, write_file
from dolfinx_signorini.tables import markdown_table
from dolfinx_signorini.tradeoff import plots
from dolfinx_signorini.tradeoff.comparing import Row, kind_of
from dolfinx_signorini.tradeoff.kinds import KINDS
from dolfinx_signorini.tradeoff.rules import NORMS, RULES, shown, sweep

P2 = [
    "## What P2 guarantees",
    "",
    "P2 elements are in the Bernstein basis: on an edge the gap is a (1 - t)^2 + 2 c t (1 - t) + "
    "b t^2 with coefficients a, c, b that are not negative, and so is the gap at every point. Each "
    "coefficient has a bound of its own, as TAO needs it. The condition is sufficient: the gap of "
    "degree 2 is not negative as soon as c >= -sqrt(a b). Nodal elements would hold the constraint "
    "at vertices and midpoints only.",
    "",
]


POSITION = (
    "Graded meshes have the full orders, because the detachment point is known much better than to "
    "an edge: the gap behind it, to the power 2/3, is smooth, and its zero is extrapolated from "
    "dofs where the discrete gap is accurate. In W1_inf a single cell decides, and cells are "
    "halved, not scaled: the error jumps by up to 30 % from one N to the next, so that an order "
    "over few meshes may come out 0.2 lower or higher."
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
        rules = [rule(rows) for rule in RULES]
    except (ValueError, KeyError, IndexError, StopIteration) as error:
        raise InputError(
            "some rows are missing; the page needs L4, Linf, W1_4 and W1_inf, at least 50000 "
            f"unknowns, and runs on one and on two ranks in the same --out ({error!r})",
            "--page",
        ) from None
    folder = path.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    serial = [row for row in rows if row["ranks"] == 1]
    main = [row for row in serial if row["purpose"] == "main"]
    lines = _introduction(max_unknowns, max(row["repeats"] for row in main))
    for number, (title, text) in enumerate(rules, start=1):
        lines += [f"## {number}. {title}", "", text, ""]
    lines += [*_orders(main), *P2, "## The diagrams", ""]
    for name, text, figure in _diagrams(main, serial):
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
        f"the solution: coarse levels, mesh, assembly and solve, the median of {repeats} repeats. "
        "Compilation of the forms, once per form and machine, is left out. Graded meshes do not "
        "know the detachment point: the coarse levels find it. Uniform P1 means the paper's meshes "
        "with the cascade. All figures, tables and diagrams of this page are from the two commands "
        "above.",
        "",
    ]


def _orders(main: Sequence[Row]) -> list[str]:
    """The orders by regression over the finer meshes beside what approximation allows."""
    lines = []
    for kind in KINDS:
        own = [row for row in main if kind_of(row) == kind]
        finer = sorted(own, key=lambda row: row["n"])[len(own) // 2 :]
        widths = [1.0 / row["n"] for row in finer]
        cells = []
        for norm in NORMS:
            order = regression(widths, [row["errors"][norm] for row in finer])
            exponent = SMOOTH if kind.graded else DETACHMENT_EXPONENT
            allowed = approximation_order(norm, kind.degree, exponent)
            cells.append(f"{order:.2f} ({allowed:g})")
        lines.append((str(kind), f"{finer[0]['n']} to {finer[-1]['n']}", *cells))
    table = markdown_table(("mesh and elements", "N", *NORMS), lines)
    return ["## Orders in h, measured (and allowed by approximation)", "", table, POSITION, ""]


def _diagrams(main: Sequence[Row], serial: Sequence[Row]) -> Iterator[tuple[str, str, Figure]]:
    """Name, description and figure of each diagram."""
    for norm in NORMS:
        text = f"error in {norm} against seconds and unknowns"
        yield f"work_precision_{norm}", text, plots.draw_work_precision(main, norm)
    yield "tolerance", "algebraic error", plots.draw_tolerance(sweep(serial, "tolerance"), "L4")
    yield "phases", "where the time goes", plots.draw_phases(shown(main))


def _processor() -> str:
    """The processor of this machine, as the kernel calls it."""
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return f"{os.cpu_count()} cores of {line.split(':', 1)[1].strip()}"
    return f"{os.cpu_count()} cores"
