"""The one-sided approximation along the boundary, near the detachment point, as a picture."""

from dataclasses import dataclass
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from mpi4py import MPI

from dolfinx_signorini.paper.theory.experiments import discretise
from dolfinx_signorini.paper.theory.one_sided import edge_data, node_cases, one_sided_approximation
from dolfinx_signorini.paper.theory.scenes import paper_scene
from dolfinx_signorini.plotting import COLOURS

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class BoundaryTrace:
    """Functions along the boundary, at samples of its edges in order.

    Attributes:
        s: Arc length of the samples.
        lower: R_h(u) - u there.
        upper: R_h(u) there.
        w_h: The one-sided approximation there.
        nodes: Arc length of the nodes.
        values: w_h at the nodes.
        cases: The case of Fig. 1 of each node: 1, 2 or 3; 0 for none.
    """

    s: Array
    lower: Array
    upper: Array
    w_h: Array
    nodes: Array
    values: Array
    cases: npt.NDArray[np.int64]


def boundary_trace(comm: MPI.Comm, n: int) -> BoundaryTrace:
    """Compute the one-sided approximation of the paper's solution along the boundary.

    Args:
        comm: The communicator that shares the mesh.
        n: Cells per side.
    """
    discretisation = discretise(comm, paper_scene(), n)
    curve, data = discretisation.curve, edge_data(discretisation)
    ritz = curve.values(discretisation.ritz)
    w_h = curve.values(one_sided_approximation(discretisation).w_h)

    def along(nodal: Array) -> Array:
        return nodal[:, None] * (1.0 - data.t) + np.roll(nodal, -1)[:, None] * data.t

    upper = along(ritz)
    result = BoundaryTrace(
        s=(curve.s[:, None] + curve.widths[:, None] * data.t).ravel(),
        lower=(upper - data.u).ravel(),
        upper=upper.ravel(),
        w_h=along(w_h).ravel(),
        nodes=curve.s,
        values=w_h,
        cases=node_cases(data, w_h - ritz),
    )
    discretisation.destroy()
    return result


def draw_one_sided(trace: BoundaryTrace, window: tuple[float, float] = (0.0, 0.72)) -> Figure:
    """Draw R_h(u) - u <= w_h with the case of each node, like Fig. 1 of the paper."""
    figure, axes = plt.subplots(figsize=(9.5, 4.8))
    shown = (trace.s >= window[0]) & (trace.s <= window[1])
    axes.plot(trace.s[shown], trace.lower[shown], color=COLOURS[0], label="$R_h(u) - u$")
    axes.plot(trace.s[shown], trace.w_h[shown], color=COLOURS[1], label="$w_h$", linewidth=1)
    nodes = (trace.nodes >= window[0]) & (trace.nodes <= window[1])
    for case, marker, name in ((1, "o", "touches here"), (2, "<", "before"), (3, ">", "behind")):
        style: dict[str, Any] = {"color": COLOURS[2 + case - 1], "linestyle": "", "zorder": 3}
        at = nodes & (trace.cases == case)
        label = f"case {case}: {name} ({int((trace.cases == case).sum())} nodes)"
        axes.plot(trace.nodes[at], trace.values[at], marker, label=label, **style)
    axes.axvline(0.5, color="black", linestyle=":", label="detachment point")
    axes.set(xlabel="$x_1$ on the bottom edge", title="One-sided approximation (11)")
    axes.grid(alpha=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    figure.tight_layout()
    return figure
