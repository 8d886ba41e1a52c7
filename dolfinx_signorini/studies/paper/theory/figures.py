"""The pictures of the theory, one per group of statements."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from dolfinx_signorini.pictures.palette import COLOURS, MARKERS
from dolfinx_signorini.pictures.picture import Picture, add_curve, name_cells
from dolfinx_signorini.studies.paper.solution import DETACHMENT
from dolfinx_signorini.studies.paper.tables import read_data
from dolfinx_signorini.studies.paper.theory.checks import (
    Row,
    Rows,
    entry,
    fine,
    last_order,
    value_of,
)
from dolfinx_signorini.studies.paper.theory.examples import PLACES
from dolfinx_signorini.studies.paper.theory.measures import PLACED
from dolfinx_signorini.studies.paper.theory.one_sided import OneSided, node_cases
from dolfinx_signorini.studies.paper.theory.proven import (
    CONSTANTS,
    NAMES,
    TRACE,
    allowed_order,
    proven_order,
)

POWER_EXPONENTS = (2.5, 3.5, 6.0, 16.0, np.inf)
LEGENDS: dict[str, dict[str, Any]] = {
    "inside": {"loc": "lower left"},
    "right": {"loc": "center left", "bbox_to_anchor": (1, 0.5)},
    "below": {"loc": "upper center", "bbox_to_anchor": (0.5, -0.14), "ncols": 2},
}


def draw_curves(
    rows: Rows, panels: Sequence[Mapping[str, Any]], figsize: Sequence[float], **options: Any
) -> Picture:
    """Draw panels of `data/curves.toml`; the options are those of `subplots`."""
    figure = Picture(figsize=figsize)
    for axes, panel in zip(figure.panels(1, len(panels), **options), panels, strict=True):
        _draw_panel(axes, rows, panel)
    return figure


def draw_contact_sets(rows: Rows, panels: Sequence[Mapping[str, Any]], **options: Any) -> Picture:
    """Draw the contact sets by N beside the error of the detachment point (Definition 5.5)."""
    figure = Picture(**options)
    left, right = figure.panels(1, 2)
    family = rows["paper"]
    for i, found in enumerate(row["contact_set"] for row in family):
        points = found["detachments"]
        _draw_intervals(left, i, found["intervals"])
        left.plot(points, [i] * len(points), "D", color=COLOURS[1])
    left.plot([], [], color=COLOURS[0], linewidth=6, label="$u_h = 0$")
    left.plot([], [], "D", color=COLOURS[1], label="detachment point")
    left.axvline(DETACHMENT[0], color="black", linestyle=":", label="end of the contact of $u$")
    left.axvline(1.0, color="0.6", linewidth=1, label="corner (1, 0)")
    _name_rows(left, family, "arc length from (0, 0)", "Contact set of $u_h$")
    left.set_xlim(0.4, 1.35)
    left.legend(**LEGENDS["below"])
    _draw_panel(right, rows, panels[0])
    return figure


def draw_enclosure(rows: Rows) -> Picture:
    """Draw the enclosures of the detachment point."""
    figure = Picture(figsize=(6.8, 3.6))
    (axes,) = figure.panels()
    for i, row in enumerate(rows["bounds"]):
        _draw_intervals(axes, i, [(row["enclosure"]["outer"], row["enclosure"]["inner"])])
    axes.axvline(DETACHMENT[0], color="black", linestyle=":", label="detachment point")
    _name_rows(axes, rows["bounds"], "$x_1$ on the bottom edge", "Contact begins in here")
    axes.legend()
    return figure


def draw_powers(rows: Rows) -> Picture:
    """Draw measured, proven and allowed orders against p (Corollaries 4.1 and 4.2)."""
    figure = Picture(figsize=(13, 3.6))
    panels = figure.panels(1, 4, sharex=True)
    x = np.arange(len(POWER_EXPONENTS))
    for axes, norm in zip(panels, ("W1_inf", "Linf", "W1_4", TRACE), strict=True):
        proven = [proven_order(p, norm).value for p in POWER_EXPONENTS]
        allowed = [allowed_order(p, norm) for p in POWER_EXPONENTS]
        families = [rows[f"power {p:g}"] for p in POWER_EXPONENTS]
        figures = [[(row["n"], row["errors"][norm]) for row in family] for family in families]
        measured = list(map(last_order, figures))
        axes.plot(x, proven, "-", color=COLOURS[1], label="proven (less any eps)")
        axes.plot(x, allowed, "--", color=COLOURS[2], label="allowed by the singularity")
        axes.plot(x, measured, "o", color=COLOURS[0], label="measured")
        axes.set(title=NAMES[norm], xlabel="p of $W^{2,p}$")
        axes.set_xticks(x, [f"{p:g}" for p in POWER_EXPONENTS])
    panels[0].set_ylabel("order")
    panels[0].legend(fontsize="small")
    return figure


def draw_logarithms(rows: Rows) -> Picture:
    """Draw the fourth power of the normalised W^{1,4} error against ln N (Remark 4.4, 1)."""
    figure = Picture(figsize=(6.4, 4.2))
    (axes,) = figure.panels()
    n, errors = np.transpose([(row["n"], row["errors"]["W1_4"]) for row in rows["power inf"]])
    x, y, B = np.log(n), (errors * n) ** 4, CONSTANTS["B"]
    axes.plot(x, y[-1] + B * (x - x[-1]), color=COLOURS[1], label=f"slope B = {B:.4f}")
    axes.plot(x, y, "o", color=COLOURS[0], label="measured")
    axes.set(xlabel="ln N", ylabel="$(W^{1,4}$ error / $h)^4$")
    axes.set_title("The logarithm in $W^{1,4}$, $u = -r^{3/2} \\sin(3\\theta/2)$")
    axes.legend()
    return figure


def draw_placement(rows: Rows) -> Picture:
    """Draw the errors by the place of the detachment point (Section 7)."""
    figure = Picture(figsize=(8, 5))
    (axes,) = figure.panels()
    families = {place: rows[f"placed {place:g}"] for place in PLACES}
    for i, norm in enumerate(PLACED):
        last = {place: family[-1]["errors"][norm] for place, family in families.items()}
        marker, colour = MARKERS[i % len(MARKERS)], COLOURS[i % len(COLOURS)]
        values = [last[place] / last[0.0] for place in PLACES]
        axes.plot(PLACES, values, marker + "-", color=colour, label=NAMES[norm])
    axes.set_xticks(PLACES, ["on a node", "a quarter", "the middle", "three quarters"])
    n = families[0.0][-1]["n"]
    axes.set(xlabel="place in the edge", ylabel="error over that with the point on a node")
    axes.set_title(f"Place of the detachment point, N = {n}")
    axes.legend(**LEGENDS["right"])
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


def _draw_panel(axes: Axes, rows: Rows, panel: Mapping[str, Any]) -> None:
    """One panel of `data/curves.toml`."""
    family = fine(rows[panel["on"]], panel.get("first", 0))
    n = [row["n"] for row in family]
    if broad := panel.get("broad"):
        values = [entry(broad["of"])(row) for row in family]
        axes.loglog(n, values, color="0.75", linewidth=7, label=broad["label"])
    for i, curve in enumerate(panel["curves"]):
        values = list(map(value_of(curve), family))
        add_curve(axes, n, values, curve["label"], curve.get("colour", i), curve.get("order"))
    name_cells(axes, n)
    axes.set(title=panel["title"], ylabel=panel["quantity"])
    axes.legend(**LEGENDS[panel.get("legend", "inside")])


def _draw_intervals(axes: Axes, height: int, intervals: Sequence[tuple[float, float]]) -> None:
    for interval in intervals:
        style: dict[str, Any] = {"linewidth": 6, "solid_capstyle": "butt"}
        axes.plot(interval, [height, height], color=COLOURS[0], **style)


def _name_rows(axes: Axes, family: Sequence[Row], xlabel: str, title: str) -> None:
    """Write the cells per side beside intervals, one above the other."""
    axes.set_yticks(range(len(family)), [str(row["n"]) for row in family])
    axes.set(xlabel=xlabel, ylabel="cells per side N", title=title)


_CURVES = read_data("curves")
# By name; `draw_one_sided` draws what is in no row.
FIGURES: dict[str, Callable[[Rows], Picture]] = {
    "contact_sets": partial(draw_contact_sets, **_CURVES.pop("contact_sets")),
    **{name: partial(draw_curves, **given) for name, given in _CURVES.items()},
    "powers": draw_powers,
    "logarithms": draw_logarithms,
    "enclosure": draw_enclosure,
    "placement": draw_placement,
}
