"""The pictures of the theory: panels of `data/curves.toml`, and the one-sided approximation."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from dolfinx_signorini.pictures.palette import COLOURS, curve_style
from dolfinx_signorini.pictures.picture import Picture, add_curve, name_cells
from dolfinx_signorini.studies.paper.solution import DETACHMENT
from dolfinx_signorini.studies.paper.theory.checks import Rows, entry, fine, last_order, value_of
from dolfinx_signorini.studies.paper.theory.measures import PLACED
from dolfinx_signorini.studies.paper.theory.one_sided import OneSided, node_cases
from dolfinx_signorini.studies.paper.theory.proven import (
    CONSTANTS,
    allowed_order,
    printed,
    proven_order,
)
from dolfinx_signorini.studies.paper.theory.statements import CURVES, experiments_of

Panel = Mapping[str, Any]

LEGENDS: dict[str, dict[str, Any]] = {
    "inside": {"loc": "lower left"},
    "best": {},
    "small": {"fontsize": "small"},
    "right": {"loc": "center left", "bbox_to_anchor": (1, 0.5)},
    "below": {"loc": "upper center", "bbox_to_anchor": (0.5, -0.14), "ncols": 2},
}


def draw_panels(
    rows: Rows, panels: Sequence[Panel], figsize: Sequence[float], **options: Any
) -> Picture:
    """Draw panels of `data/curves.toml` side by side; the options are those of `subplots`."""
    figure = Picture(figsize=figsize)
    for axes, panel in zip(figure.panels(1, len(panels), **options), panels, strict=True):
        _DRAWN[panel.get("draw", "curves")](axes, rows, panel)
        axes.set(**panel["axes"])
        if legend := panel.get("legend", "inside"):
            axes.legend(**LEGENDS[legend])
    return figure


def draw_one_sided(found: OneSided) -> Picture:
    """Draw R_h(u) - u <= w_h with the case of each node, like Fig. 1 of the paper."""
    figure = Picture(figsize=(9.5, 4.8))
    (axes,) = figure.panels()
    data, w_h, cases = found.data, found.ritz + found.y, node_cases(found.data, found.y)
    nodes = data.s[:, 0]
    shown, bottom = data.s < 1.0, nodes < 1.0
    lower = data.along(found.ritz) - data.u
    axes.plot(data.s[shown], lower[shown], color=COLOURS[0], label="$R_h(u) - u$")
    axes.plot(data.s[shown], data.along(w_h)[shown], color=COLOURS[1], label="$w_h$", linewidth=1)
    for case, marker, name in ((1, "o", "touches here"), (2, "<", "before"), (3, ">", "behind")):
        style: dict[str, Any] = {"color": COLOURS[2 + case - 1], "linestyle": "", "zorder": 3}
        at = bottom & (cases == case)
        label = f"case {case}: {name} ({int((cases == case).sum())} nodes)"
        axes.plot(nodes[at], w_h[at], marker, label=label, **style)
    axes.axvline(DETACHMENT[0], color="black", linestyle=":", label="detachment point")
    axes.set(xlabel="$x_1$ on the bottom edge", title="One-sided approximation (11)")
    axes.legend(**LEGENDS["right"])
    return figure


def _curves(axes: Axes, rows: Rows, panel: Panel) -> None:
    """Values against the cells per side, with the orders of lines."""
    family = fine(rows[panel["on"]], panel.get("first", 0))
    n = [row["n"] for row in family]
    if broad := panel.get("broad"):
        values = [entry(broad["of"])(row) for row in family]
        axes.loglog(n, values, color="0.75", linewidth=7, label=broad["label"])
    for i, curve in enumerate(panel["curves"]):
        values = list(map(value_of(curve), family))
        add_curve(axes, n, values, curve["label"], curve.get("colour", i), curve.get("order"))
    name_cells(axes, n)


def _intervals(axes: Axes, rows: Rows, panel: Panel) -> None:
    """Intervals of the boundary, mesh by mesh one above the other, with points and marks."""
    family = rows[panel["on"]]
    bar: dict[str, Any] = {"color": COLOURS[0], "linewidth": 6}
    point: dict[str, Any] = {"marker": "D", "linestyle": "", "color": COLOURS[1]}
    for i, row in enumerate(family):
        ends = panel.get("ends", ())
        pairs = [[entry(end)(row) for end in ends]] if ends else entry(panel["of"])(row)
        for pair in pairs:
            axes.plot(pair, [i, i], solid_capstyle="butt", **bar)
        points = entry(panel["points"])(row) if "points" in panel else []
        axes.plot(points, [i] * len(points), **point)
    for style, label in zip((bar, point), panel.get("labels", ()), strict=False):
        axes.plot([], [], label=label, **style)
    for mark in panel["marks"]:
        axes.axvline(**mark)
    axes.set_yticks(range(len(family)), [str(row["n"]) for row in family])
    axes.set_ylabel("cells per side N")


def _powers(axes: Axes, rows: Rows, panel: Panel) -> None:
    """Measured, proven and allowed orders against p (Corollaries 4.1 and 4.2)."""
    families, norm = _numbered(rows, panel), panel["norm"]
    x = np.arange(len(families))
    errors = ([(r["n"], r["errors"][norm]) for r in family] for family in families.values())
    measured = list(map(last_order, errors))
    proven = [proven_order(p, norm).value for p in families]
    allowed = [allowed_order(p, norm) for p in families]
    axes.plot(x, proven, "-", color=COLOURS[1], label="proven (less any eps)")
    axes.plot(x, allowed, "--", color=COLOURS[2], label="allowed by the singularity")
    axes.plot(x, measured, "o", color=COLOURS[0], label="measured")
    axes.set_xticks(x, [f"{p:g}" for p in families])


def _logarithm(axes: Axes, rows: Rows, panel: Panel) -> None:
    """Values against ln N with a line of a known slope (Remark 4.4, 1)."""
    family, slope = rows[panel["on"]], CONSTANTS[panel["slope"]]
    x, y = np.log([row["n"] for row in family]), list(map(value_of(panel), family))
    label = f"slope {panel['slope']} = {slope:.4f}"
    axes.plot(x, y[-1] + slope * (x - x[-1]), color=COLOURS[1], label=label)
    axes.plot(x, y, "o", color=COLOURS[0], label="measured")


def _placement(axes: Axes, rows: Rows, panel: Panel) -> None:
    """The errors on the finest mesh by the place of the detachment point (Section 7)."""
    finest = {place: family[-1] for place, family in _numbered(rows, panel).items()}
    places, last = list(finest), [row["errors"] for row in finest.values()]
    for i, norm in enumerate(PLACED):
        values = [errors[norm] / last[0][norm] for errors in last]
        axes.plot(places, values, label=printed(norm), **curve_style(i))
    axes.set_xticks(places, panel["places"])
    axes.set_title(f"Place of the detachment point, N = {finest[0.0]['n']}")


def _numbered(rows: Rows, panel: Panel) -> dict[float, Sequence[Any]]:
    """The rows of the experiments of a panel, by the number behind the name of each."""
    return {float(name.split()[1]): rows[name] for name in experiments_of(panel)}


_DRAWN: Mapping[str, Callable[[Axes, Rows, Panel], None]] = {
    "curves": _curves,
    "intervals": _intervals,
    "powers": _powers,
    "logarithm": _logarithm,
    "placement": _placement,
}
# By name; `draw_one_sided` draws what is in no row.
FIGURES: dict[str, Callable[[Rows], Picture]] = {
    name: partial(draw_panels, **given) for name, given in CURVES.items()
}
