"""The pictures of the theory, one per group of statements."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from dolfinx_signorini.pictures.palette import COLOURS, MARKERS
from dolfinx_signorini.studies.paper.pictures import draw_convergence
from dolfinx_signorini.studies.paper.tables import read_data
from dolfinx_signorini.studies.paper.theory.checks import (
    Row,
    Rows,
    Value,
    entry,
    fine,
    interpolation_constant,
    orders,
    over,
)
from dolfinx_signorini.studies.paper.theory.examples import PLACES
from dolfinx_signorini.studies.paper.theory.measures import TRACE
from dolfinx_signorini.studies.paper.theory.one_sided import OneSided, node_cases
from dolfinx_signorini.studies.paper.theory.proven import allowed_order, proven_order
from dolfinx_signorini.studies.paper.theory.tables import NAMES
from dolfinx_signorini.studies.paper.theory.values import (
    PLACED,
    contact_set,
    detachment_error,
    value_of,
)

FINE = 31  # cells per side of the paper's solution
POWER_EXPONENTS = (2.5, 3.5, 6.0, 16.0, np.inf)
LAST = 0.72  # arc length up to which the one-sided approximation is drawn
LEGENDS: dict[str, dict[str, Any]] = {
    "inside": {"loc": "lower left"},
    "right": {"loc": "center left", "bbox_to_anchor": (1, 0.5)},
    "below": {"loc": "upper center", "bbox_to_anchor": (0.5, -0.14), "ncols": 2},
}


def draw_curves(rows: Rows, panels: Sequence[Mapping[str, Any]], **style: Any) -> Figure:
    """Draw panels of curves against the cells per side.

    Args:
        rows: The rows of the experiments.
        panels: The panels as `data/curves.toml` has them.
        style: Arguments of `subplots`.
    """
    figure, axes_of = plt.subplots(1, len(panels), squeeze=False, **style)
    for axes, panel in zip(axes_of[0], panels, strict=True):
        family = fine(rows[panel["on"]], panel.get("first", 0))
        if broad := panel.get("broad"):
            values = [entry(broad["of"])(row) for row in family]
            n = [row["n"] for row in family]
            axes.loglog(n, values, color="0.75", linewidth=7, label=broad["label"])
        for i, curve in enumerate(panel["curves"]):
            index, order = curve.get("colour", i), curve.get("order")
            _curve(axes, family, value_of(curve), curve["label"], index, order)
        _finish(axes, family, panel["title"], panel["quantity"], panel.get("legend", "inside"))
    return _tight(figure)


def draw_powers(rows: Rows) -> Figure:
    """Draw measured, proven and allowed orders against p (Corollaries 4.1 and 4.2)."""
    figure, panels = plt.subplots(1, 4, figsize=(13, 3.6), sharex=True)
    x = np.arange(len(POWER_EXPONENTS))
    for axes, norm in zip(panels.flat, ("W1_inf", "Linf", "W1_4", TRACE), strict=True):
        proven = [proven_order(p, norm).value for p in POWER_EXPONENTS]
        allowed = [allowed_order(p, norm) for p in POWER_EXPONENTS]
        families = [rows[f"power {p:g}"] for p in POWER_EXPONENTS]
        measured = [orders(family, entry(f"errors/{norm}"))[-1] for family in families]
        axes.plot(x, proven, "-", color=COLOURS[1], label="proven (less any eps)")
        axes.plot(x, allowed, "--", color=COLOURS[2], label="allowed by the singularity")
        axes.plot(x, measured, "o", color=COLOURS[0], label="measured")
        axes.set(title=NAMES[norm], xlabel="p of $W^{2,p}$")
        axes.grid(alpha=0.3)
        axes.set_xticks(x, [f"{p:g}" for p in POWER_EXPONENTS])
    panels[0].set_ylabel("order")
    panels[0].legend(fontsize="small")
    return _tight(figure)


def draw_logarithms(rows: Rows) -> Figure:
    """Draw the fourth power of the normalised W^{1,4} error against ln N (Remark 4.4, 1)."""
    figure, axes = plt.subplots(figsize=(6.4, 4.2))
    family, value = rows["power inf"], over(entry("errors/W1_4"), 1.0, to=4.0)
    x = np.log([row["n"] for row in family])
    y = np.array([value(row) for row in family])
    B = interpolation_constant()
    axes.plot(x, y[-1] + B * (x - x[-1]), color=COLOURS[1], label=f"slope B = {B:.4f}")
    axes.plot(x, y, "o", color=COLOURS[0], label="measured")
    axes.set(xlabel="ln N", ylabel="$(W^{1,4}$ error / $h)^4$")
    axes.set_title("The logarithm in $W^{1,4}$, $u = -r^{3/2} \\sin(3\\theta/2)$")
    axes.grid(alpha=0.3)
    axes.legend()
    return _tight(figure)


def draw_enclosure(rows: Rows) -> Figure:
    """Draw the enclosures of the detachment point."""
    figure, axes = plt.subplots(figsize=(6.8, 3.6))
    family = rows["bounds"]
    for i, row in enumerate(family):
        found = row["enclosure"]
        axes.plot([found["outer"], found["inner"]], [i, i], color=COLOURS[0], linewidth=6)
    axes.axvline(0.5, color="black", linestyle=":", label="detachment point")
    axes.set_yticks(range(len(family)), [str(row["n"]) for row in family])
    axes.set(xlabel="$x_1$ on the bottom edge", ylabel="N", title="Contact begins in here")
    axes.grid(alpha=0.3)
    axes.legend()
    return _tight(figure)


def draw_errors(rows: Rows) -> Figure:
    """Draw the errors of the paper's solution with the orders of Theorem 6.1."""
    return draw_convergence(
        fine(rows["paper"], FINE), ("W1_inf", "W1_4", "Linf", "H1_2_boundary", "L4")
    )


def draw_contact_sets(rows: Rows) -> Figure:
    """Draw the contact sets by N, and the error of the detachment point (Definition 5.5)."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11.5, 5.4))
    family = rows["paper"]
    for i, found in enumerate(map(contact_set, family)):
        for a, b in found.intervals:
            left.plot([a, b], [i, i], color=COLOURS[0], linewidth=6, solid_capstyle="butt")
        left.plot(found.detachments, [i] * len(found.detachments), "D", color=COLOURS[1])
    left.plot([], [], color=COLOURS[0], linewidth=6, label="$u_h = 0$")
    left.plot([], [], "D", color=COLOURS[1], label="detachment point")
    left.axvline(0.5, color="black", linestyle=":", label="end of the contact of $u$")
    left.axvline(1.0, color="0.6", linewidth=1, label="corner (1, 0)")
    left.set_yticks(range(len(family)), [str(row["n"]) for row in family])
    left.set(xlabel="arc length from (0, 0)", ylabel="cells per side N", xlim=(0.4, 1.35))
    left.set_title("Contact set of $u_h$")
    left.legend(**LEGENDS["below"])
    fitting = fine(family, FINE)
    _curve(right, fitting, lambda row: 0.5 / row["n"], "first node in contact", 0, None)
    _curve(right, fitting, detachment_error, "by the change of sign, order 1", 1, 1.0)
    _finish(right, fitting, "Distance from the detachment point of $u$", "distance")
    return _tight(figure)


def draw_placement(rows: Rows) -> Figure:
    """Draw the errors by the place of the detachment point (Section 7)."""
    figure, axes = plt.subplots(figsize=(8, 5))
    families = {place: rows[f"placed {place:g}"] for place in PLACES}
    for i, norm in enumerate(PLACED):
        last = {place: family[-1]["errors"][norm] for place, family in families.items()}
        label = NAMES[norm]
        marker, colour = MARKERS[i % len(MARKERS)], COLOURS[i % len(COLOURS)]
        values = [last[place] / last[0.0] for place in PLACES]
        axes.plot(PLACES, values, marker + "-", color=colour, label=label)
    axes.set_xticks(PLACES, ["on a node", "a quarter", "the middle", "three quarters"])
    n = families[0.0][-1]["n"]
    axes.set(xlabel="place in the edge", ylabel="error over that with the point on a node")
    axes.set_title(f"Place of the detachment point, N = {n}")
    axes.grid(alpha=0.3)
    axes.legend(**LEGENDS["right"])
    return _tight(figure)


def draw_one_sided(found: OneSided) -> Figure:
    """Draw R_h(u) - u <= w_h with the case of each node, like Fig. 1 of the paper."""
    figure, axes = plt.subplots(figsize=(9.5, 4.8))
    data, w_h, cases = found.data, found.ritz + found.y, node_cases(found.data, found.y)
    shown, nodes = data.s <= LAST, data.s[:, 0]
    lower = data.along(found.ritz) - data.u
    axes.plot(data.s[shown], lower[shown], color=COLOURS[0], label="$R_h(u) - u$")
    axes.plot(data.s[shown], data.along(w_h)[shown], color=COLOURS[1], label="$w_h$", linewidth=1)
    for case, marker, name in ((1, "o", "touches here"), (2, "<", "before"), (3, ">", "behind")):
        style: dict[str, Any] = {"color": COLOURS[2 + case - 1], "linestyle": "", "zorder": 3}
        at = (nodes <= LAST) & (cases == case)
        label = f"case {case}: {name} ({int((cases == case).sum())} nodes)"
        axes.plot(nodes[at], w_h[at], marker, label=label, **style)
    axes.axvline(0.5, color="black", linestyle=":", label="detachment point")
    axes.set(xlabel="$x_1$ on the bottom edge", title="One-sided approximation (11)")
    axes.grid(alpha=0.3)
    axes.legend(**LEGENDS["right"])
    return _tight(figure)


# By name; `draw_one_sided` draws what is in no row.
FIGURES: dict[str, Callable[[Rows], Figure]] = {
    **{name: partial(draw_curves, **given) for name, given in read_data("curves").items()},
    "powers": draw_powers,
    "logarithms": draw_logarithms,
    "enclosure": draw_enclosure,
    "errors": draw_errors,
    "contact_sets": draw_contact_sets,
    "placement": draw_placement,
}


def _curve(
    axes: Axes, rows: Sequence[Row], value: Value, label: str, index: int, order: float | None
) -> None:
    """Markers for the values, and a line of a given order through the last one."""
    n = np.array([row["n"] for row in rows], dtype=float)
    values = np.array([value(row) for row in rows])
    style: dict[str, Any] = {"color": COLOURS[index % len(COLOURS)]}
    marker = MARKERS[index % len(MARKERS)]
    line = "" if order is not None else "-"
    axes.loglog(n, values, marker + line, label=label, linewidth=0.9, **style)
    if order is not None:
        axes.loglog(n, values[-1] * (n / n[-1]) ** -order, linewidth=0.9, **style)


def _finish(
    axes: Axes, rows: Sequence[Row], title: str, quantity: str, legend: str = "inside"
) -> None:
    axes.set(title=title, xlabel="cells per side N", ylabel=quantity)
    axes.set_xticks([row["n"] for row in rows], [str(row["n"]) for row in rows])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.grid(alpha=0.3)
    axes.legend(**LEGENDS[legend])


def _tight(figure: Figure) -> Figure:
    figure.tight_layout()
    return figure
