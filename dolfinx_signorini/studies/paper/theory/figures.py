"""The pictures of the theory, one per group of statements."""

from collections.abc import Callable, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from dolfinx_signorini.pictures.palette import COLOURS, MARKERS
from dolfinx_signorini.studies.paper.pictures import draw_convergence
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
from dolfinx_signorini.studies.paper.theory.families import POWER_EXPONENTS, placed_name, power_name
from dolfinx_signorini.studies.paper.theory.measures import TRACE
from dolfinx_signorini.studies.paper.theory.one_sided import OneSided, node_cases
from dolfinx_signorini.studies.paper.theory.proven import allowed_order, proven_order
from dolfinx_signorini.studies.paper.theory.tables import NAMES
from dolfinx_signorini.studies.paper.theory.values import PLACED, contact_set, detachment_error

FINE = 31  # cells per side of the paper's solution
TRANSITION = {"L16": (1.625, 2.0), "W1_16": (0.625, 1.0)}  # near the point and away from there
LAST = 0.72  # arc length up to which the one-sided approximation is drawn
TERMS = {
    "plus": ("interpolation", "bumps", "bump_load", "remainder"),
    "minus": ("interpolation", "sign", "remainder"),
}
TERM_NAMES = {
    "interpolation": "$(z - I_h z, w)$",
    "bumps": "$(z, \\Sigma)$, hat functions",
    "bump_load": "load of $\\Sigma$",
    "remainder": "approximation of $z$",
    "sign": "$-(I_h z, w)$",
}
LEGENDS: dict[str, dict[str, Any]] = {
    "inside": {"loc": "lower left"},
    "right": {"loc": "center left", "bbox_to_anchor": (1, 0.5)},
    "below": {"loc": "upper center", "bbox_to_anchor": (0.5, -0.14), "ncols": 2},
}


def draw_projection(rows: Rows) -> Figure:
    """Draw the errors of the Ritz projection with their proven orders (Lemma 3.2)."""
    figure, panels = plt.subplots(1, 2, figsize=(11, 5.6))
    for axes, example, p in zip(panels, ("paper", "smooth"), (3, 4), strict=True):
        family = fine(rows[example], FINE)
        proven = {f"W1_{p}": 1.0, "H1_2_boundary_spectral": 1.5}
        proven |= {f"L{p}_boundary": 2.0 - 1.0 / p, f"L{p}": 2.0}
        for i, (norm, order) in enumerate(proven.items()):
            name = norm.replace("_spectral", "")
            _curve(axes, family, entry(f"ritz/{norm}"), f"{name}, order {order:.3g}", i, order)
        _finish(axes, family, f"$u - R_h(u)$, {example} solution", "error", "below")
    return _tight(figure)


def draw_supercloseness(rows: Rows) -> Figure:
    """Draw supercloseness beside the H^1 error and the bound of Lemma 3.4 (Theorem 3.6)."""
    figure, axes = plt.subplots(figsize=(7.4, 5.4))
    family = fine(rows["paper"], 101)
    curves = (
        ("$u - u_h$, order 1", entry("errors/H1"), 1.0),
        ("$w_h$ (Lemma 3.5), order 3/2", entry("one_sided/norm"), 1.5),
        ("$R_h(u) - u_h$", entry("supercloseness"), None),
        ("its part near, order 3/2", entry("supercloseness_parts/near"), 1.5),
        ("its part far, order 2", entry("supercloseness_parts/far"), 2.0),
    )
    for i, (label, value, order) in enumerate(curves):
        _curve(axes, family, value, label, i, order)
    _finish(axes, family, "Supercloseness, the paper's solution", "$H^1$ norm", "right")
    return _tight(figure)


def draw_powers(rows: Rows) -> Figure:
    """Draw measured, proven and allowed orders against p (Corollaries 4.1 and 4.2)."""
    figure, panels = plt.subplots(1, 4, figsize=(13, 3.6), sharex=True)
    x = np.arange(len(POWER_EXPONENTS))
    for axes, norm in zip(panels.flat, ("W1_inf", "Linf", "W1_4", TRACE), strict=True):
        proven = [proven_order(p, norm).value for p in POWER_EXPONENTS]
        allowed = [allowed_order(p, norm) for p in POWER_EXPONENTS]
        families = [rows[power_name(p)] for p in POWER_EXPONENTS]
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
    family, value = rows[power_name(np.inf)], over(entry("errors/W1_4"), 1.0, to=4.0)
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


def draw_factors(rows: Rows) -> Figure:
    """Draw how the factors of the singularities converge."""
    figure, axes = plt.subplots(figsize=(6.8, 4.4))
    family = fine(rows["paper"], FINE)
    curves = (
        ("b - 10, order 2", lambda row: abs(row["factors"]["three_halves"] - 10.0), 2.0),
        ("a, order 2", lambda row: abs(row["factors"]["half"]), 2.0),
        ("corrected point - 1/2, order 2", lambda row: abs(row["factors"]["corrected"] - 0.5), 2.0),
        ("point by the contact set - 1/2", detachment_error, None),
    )
    for i, (label, value, order) in enumerate(curves):
        _curve(axes, family, value, label, i, order)
    _finish(axes, family, "Factors of $r^{1/2}$ and $r^{3/2}$, paper", "error", "right")
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


def draw_dual(rows: Rows) -> Figure:
    """Draw the terms of the chains (20), (21) and (26) (Propositions 5.4 and 5.7)."""
    figure, panels = plt.subplots(1, 2, figsize=(11.5, 6.2), sharey=True)
    titles = {"plus": "(20), (21): $(u - u_h)^+$", "minus": "(26): $(u - u_h)^-$"}
    for axes, (part, title) in zip(panels, titles.items(), strict=True):
        _band(axes, rows["dual"], entry(f"{part}/error"), "error (left-hand side)")
        for i, (name, label) in enumerate(TERM_NAMES.items()):
            if name in TERMS[part]:
                _curve(axes, rows["dual"], _size(part, name), label, i, None)
        _finish(axes, rows["dual"], title, "size of the term", "below")
    return _tight(figure)


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
    families = {place: rows[placed_name(place)] for place in PLACES}
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


def draw_transition(rows: Rows) -> Figure:
    """Draw the L^16 and W^{1,16} errors and their parts (Table 2)."""
    figure, panels = plt.subplots(1, 2, figsize=(11, 4.8))
    family = fine(rows["paper"], 101)
    for axes, (norm, (near, far)) in zip(panels, TRANSITION.items(), strict=True):
        _band(axes, family, entry(f"errors/{norm}"), "whole")
        _curve(axes, family, entry(f"parts/near/{norm}"), f"near, order {near}", 1, near)
        _curve(axes, family, entry(f"parts/far/{norm}"), f"far, order {far:g}", 0, far)
        _finish(axes, family, norm, "error $u - u_h$")
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
    "projection": draw_projection,
    "supercloseness": draw_supercloseness,
    "powers": draw_powers,
    "logarithms": draw_logarithms,
    "factors": draw_factors,
    "enclosure": draw_enclosure,
    "errors": draw_errors,
    "dual": draw_dual,
    "contact_sets": draw_contact_sets,
    "placement": draw_placement,
    "transition": draw_transition,
}


def _size(part: str, name: str) -> Value:
    return lambda row: abs(row[part][name])


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


def _band(axes: Axes, rows: Sequence[Row], value: Value, label: str) -> None:
    """A broad line, for what others are compared with."""
    n = [row["n"] for row in rows]
    axes.loglog(n, [value(row) for row in rows], color="0.75", linewidth=7, label=label)


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
