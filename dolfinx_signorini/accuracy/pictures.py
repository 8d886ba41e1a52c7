"""The adaptive loop as a picture: the adapted mesh with its indicators, and the way to it."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from dolfinx_signorini.accuracy.adaptive import AdaptiveSolution
from dolfinx_signorini.base.ranks import gathered
from dolfinx_signorini.meshes.sided_meshes import cell_corners
from dolfinx_signorini.pictures.palette import COLOUR_MAP, COLOURS
from dolfinx_signorini.pictures.picture import Picture, add_triangles, typeset_norm

DECADES = 5  # of indicators that colours tell apart
MAX_LINES = 20_000  # cells: the edges of more are not drawn


def draw_adaptive(found: AdaptiveSolution) -> Picture | None:
    """Draw the mesh with the estimated error of each cell, and error against unknowns and seconds.

    Args:
        found: What the adaptive loop found; the call is collective.

    Returns:
        The figure on rank 0, and None on the other ranks. The mesh is drawn in the plane only, the
        way from two steps on; None where nothing is drawn.
    """
    domain = found.sided.mesh
    parts = gathered(domain.comm, cell_corners(domain)[:, :, :2], found.cells)
    if parts is None:
        return None
    plane, several = domain.topology.dim == 2, len(found.steps) > 1
    if not (plane or several):
        return None
    figure = Picture(figsize=(5.0 * plane + 5.5 * several, 4.5))
    axes = figure.subplots(1, plane + several, squeeze=False)
    if plane:
        _draw_mesh(figure, axes[0, 0], *parts)
    if several:
        _draw_steps(axes[0, -1], found)
    return figure


def _draw_mesh(figure: Figure, axis: Axes, polygons: np.ndarray, cells: np.ndarray) -> None:
    largest = float(cells.max(initial=0.0)) or 1.0
    points, triangles = polygons.reshape(-1, 2), np.arange(3 * len(cells)).reshape(-1, 3)
    colours = np.repeat(np.maximum(cells, largest * 10.0**-DECADES), 3)
    norm = LogNorm(largest * 10.0**-DECADES, largest)
    drawn = add_triangles(axis, points, triangles, colours, cmap=COLOUR_MAP, norm=norm)
    if len(cells) <= MAX_LINES:
        axis.triplot(*points.T, triangles, color="black", linewidth=0.15)
    axis.set_aspect("equal")
    axis.locator_params(axis="x", nbins=5)
    axis.set_xlabel("$x$")
    axis.set_ylabel("$y$")
    axis.set_title(f"{len(cells)} cells")
    figure.colorbar(drawn, ax=axis, label="estimated error of a cell", shrink=0.8)


def _draw_steps(axis: Axes, found: AdaptiveSolution) -> None:
    unknowns = [step.unknowns for step in found.steps]
    estimates = [step.estimate for step in found.steps]
    axis.loglog(unknowns, estimates, "o-", color=COLOURS[0], label="estimated error")
    for step in found.steps:
        axis.annotate(
            f"{step.seconds:.2g} s",
            (step.unknowns, step.estimate),
            textcoords="offset points",
            xytext=(4, 6),
            fontsize="small",
        )
    if found.request.accuracy is not None:
        label = "accuracy asked for"
        axis.axhline(found.request.accuracy, color=COLOURS[1], linestyle="--", label=label)
    axis.set_xlabel("unknowns")
    axis.set_ylabel(f"error in {typeset_norm(found.request.target.name)}")
    axis.margins(x=0.15, y=0.1)
    axis.grid(True, which="both", alpha=0.3)
    axis.legend()
