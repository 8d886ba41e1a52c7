"""Work-precision diagrams."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.lines import Line2D

from dolfinx_signorini.base.records import Row
from dolfinx_signorini.meshes.elements import HIGHEST_DEGREE
from dolfinx_signorini.pictures.palette import COLOURS, curve_style
from dolfinx_signorini.pictures.picture import Picture
from dolfinx_signorini.studies.tradeoff.comparing import describe, of_kind, pareto_front, slope
from dolfinx_signorini.studies.tradeoff.family import KINDS, MESHES, Kind

LINES = dict(zip(MESHES, (("o", "-"), ("s", "--"), ("^", ":")), strict=True))
FRONT: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 12}
FRONT |= {"markerfacecolor": "none", "markeredgecolor": "0.45", "label": "Pareto front"}


def draw_work_precision(rows: Sequence[Row], norm: str) -> Picture:
    """Draw error against seconds and against unknowns, with a line per mesh and degree."""
    figure = Picture(figsize=(11, 6.4))
    panels = figure.panels(1, 2, sharey=True)
    drawn: dict[Kind, Line2D] = {}
    for axes, cost, label in zip(
        panels, ("total", "unknowns"), ("seconds from nothing", "unknowns"), strict=True
    ):
        front = pareto_front(rows, norm, cost)
        axes.loglog([row[cost] for row in front], [row["errors"][norm] for row in front], **FRONT)
        for kind in KINDS:
            line = of_kind(rows, kind)
            line.sort(key=lambda row: (row["unknowns"], row["errors"][norm]))
            marker, style = LINES[kind.mesh]
            if line:
                (drawn[kind],) = axes.loglog(
                    [row[cost] for row in line],
                    [row["errors"][norm] for row in line],
                    style,
                    marker=marker,
                    color=COLOURS[kind.degree - 1],
                    markersize=4.5,
                    linewidth=1.2,
                )
        axes.set_xlabel(label)
    panels[0].set_ylabel(f"error in {norm}")
    panels[0].legend(loc="lower left")
    # A column for each degree.
    lines = sorted(drawn.items(), key=lambda item: (item[0].degree, KINDS.index(item[0])))
    figure.legend(
        [line for _, line in lines],
        [_label(kind, rows, norm) for kind, _ in lines],
        title="mesh and elements: order in unknowns",
        loc="outside lower center",
        ncols=HIGHEST_DEGREE,
        frameon=False,
    )
    return figure


def _label(kind: Kind, rows: Sequence[Row], norm: str) -> str:
    """The kind with its order in unknowns."""
    order = slope(of_kind(rows, kind), norm)
    return str(kind) if order is None else f"{kind}: {order:.2f}"


def draw_tolerance(sweep: Mapping[str, Sequence[Row]], norm: str) -> Picture:
    """Draw the algebraic error, relative to the discretisation error, against the tolerance.

    Args:
        sweep: For each mesh the rows with different tolerances.
        norm: The norm of the errors.
    """
    figure = Picture(figsize=(6.4, 4.4))
    (axes,) = figure.panels()
    for k, (name, rows) in enumerate(sweep.items()):
        rows = sorted(rows, key=lambda row: row["rtol"])
        axes.loglog(
            [row["rtol"] for row in rows],
            [row["algebraic"][norm] / row["errors"][norm] for row in rows],
            label=name,
            **curve_style(k),
        )
    axes.axhline(0.01, color="black", linestyle=":", linewidth=1.0, label="1 %")
    axes.set(
        xlabel="relative natural residual asked for",
        ylabel=f"algebraic / discretisation error, {norm}",
    )
    axes.legend()
    return figure


def draw_phases(rows: Sequence[Row]) -> Picture:
    """Draw the share of each phase in the seconds of some rows."""
    figure = Picture(figsize=(8, 0.9 + 0.55 * len(rows)))
    axes = figure.subplots()
    labels = [f"{describe(row)}: {row['total']:.3g} s" for row in rows]
    left = [0.0] * len(rows)
    for k, phase in enumerate(rows[0]["seconds"]):
        shares = [100.0 * row["seconds"][phase] / sum(row["seconds"].values()) for row in rows]
        axes.barh(labels, shares, left=left, color=COLOURS[k], label=phase, height=0.6)
        left = [a + b for a, b in zip(left, shares, strict=True)]
    axes.invert_yaxis()
    axes.set(xlabel="% of the seconds", xlim=(0, 100))
    axes.legend(loc="lower center", bbox_to_anchor=(0.4, 1.0), ncols=len(rows[0]["seconds"]))
    return figure
