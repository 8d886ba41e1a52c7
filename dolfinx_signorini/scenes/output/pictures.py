"""Pictures of a solved scene: the solution with its boundary parts, and the contact boundary."""

from dataclasses import dataclass
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from dolfinx_signorini.plotting import COLOURS
from dolfinx_signorini.scenes.output.boundary import ContactBoundary
from dolfinx_signorini.scenes.posing import facets_by_kind
from dolfinx_signorini.scenes.solving import SceneResult

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

COLOUR_MAP = "cividis"  # read the same with any colour vision
STYLES: dict[str, dict[str, Any]] = {
    "contact": {"color": COLOURS[1], "linewidth": 4.0},
    "Dirichlet": {"color": COLOURS[6], "linewidth": 2.0},
    "Neumann": {"color": COLOURS[5], "linewidth": 1.5, "linestyle": "--"},
}
# How a triangle of degree 2 is drawn: its dofs are the vertices, then the midpoints opposite them.
SUBTRIANGLES = {1: [[0, 1, 2]], 2: [[0, 5, 4], [5, 1, 3], [4, 3, 2], [3, 4, 5]]}


@dataclass(frozen=True)
class PlaneField:
    """A plane solution, gathered on rank 0.

    Attributes:
        points: Coordinates of the dofs, shape (points, 2).
        u: The values there.
        triangles: Indices of points, shape (triangles, 3).
        edges: For each kind of boundary condition its facets, shape (facets, 2 ends, 2).
    """

    points: Array
    u: Array
    triangles: Indices
    edges: dict[str, Array]


def gather_field(result: SceneResult) -> PlaneField | None:
    """Gather a plane solution; None on all ranks but 0. The call is collective."""
    space = result.u.function_space
    domain, index_map = space.mesh, space.dofmap.index_map
    owned = index_map.size_local
    cells = space.dofmap.list[: domain.topology.index_map(2).size_local]
    triangles = cells[:, SUBTRIANGLES[space.element.basix_element.degree]].reshape(-1, 3)
    domain.topology.create_connectivity(1, 0)
    domain.topology.create_connectivity(0, 2)
    edges = {}
    for kind, facets in facets_by_kind(result.posed.scene, result.posed.sided).items():
        geometry = domain.geometry.dofmap
        ends = [_ends(domain, geometry, facet) for facet in facets]
        edges[kind] = np.array(ends, dtype=np.float64).reshape(-1, 2, 2)
    data = (
        index_map.local_range[0],
        space.tabulate_dof_coordinates()[:owned, :2],
        result.u.x.array[:owned],
        index_map.local_to_global(triangles.flatten()).reshape(-1, 3),
        edges,
    )
    parts = domain.comm.gather(data, root=0)
    if parts is None:
        return None
    _, points, u, triangles, _ = (list(item) for item in zip(*parts, strict=True))
    return PlaneField(
        np.concatenate(points),
        np.concatenate(u),
        np.concatenate(triangles),
        {kind: np.concatenate([part[4][kind] for part in parts]) for kind in STYLES},
    )


def draw_plane(field: PlaneField, boundary: ContactBoundary, title: str) -> Figure:
    """Draw a plane solution with the parts of its boundary, the contact part thick."""
    width, height = np.ptp(field.points, axis=0)
    # The height that the colour bar and the legend need is about 1.4 inches.
    size = (7.6, float(np.clip(1.4 + 6.0 * height / width, 3.0, 7.4)))
    figure = plt.figure(figsize=size, layout="constrained")
    axes: Any = figure.add_subplot()
    drawn = axes.tripcolor(
        field.points[:, 0],
        field.points[:, 1],
        field.u,
        triangles=field.triangles,
        shading="gouraud",
        cmap=COLOUR_MAP,
        rasterized=True,
    )
    figure.colorbar(drawn, ax=axes, label="solution $u$", fraction=0.06, pad=0.03)
    for kind, edges in field.edges.items():
        if len(edges):
            axes.add_collection(LineCollection(list(edges), label=kind, zorder=3, **STYLES[kind]))
    points = boundary.detachment_points
    if len(points):
        axes.plot(
            *points.T,
            linestyle="",
            marker="o",
            markersize=8,
            markerfacecolor="white",
            markeredgecolor="black",
            zorder=4,
            label="detachment point",
        )
    axes.set(title=title, xlabel="$x$", ylabel="$y$", aspect="equal")
    axes.margins(0.04)
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    return figure


def draw_contact_line(boundary: ContactBoundary, upper: bool) -> Figure:
    """Draw gap and pressure along a plane contact boundary."""
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(7.6, 5.4), sharex=True, layout="constrained"
    )
    start = 0.0
    for k, chain in enumerate(boundary.chains()):
        x = boundary.points[chain]
        s = start + np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(x, axis=0).T))))
        if k:
            for axes in (above, below):
                axes.axvline(start, color="black", linewidth=0.8, linestyle=":")
        above.plot(s, boundary.values[chain, 1], color=COLOURS[0])
        below.plot(s, boundary.values[chain, 2], color=COLOURS[1])
        for axes in (above, below):
            _shade(axes, s, boundary.touching[chain])
        start = float(s[-1])
    above.set_ylabel("gap " + ("$g - u$" if upper else "$u - g$"))
    below.set_ylabel("contact pressure")
    below.set_xlabel("arc length along the contact boundary")
    for axes in (above, below):
        axes.grid(alpha=0.3)
        axes.margins(x=0.0)
    figure.suptitle("Contact boundary (grey: in contact)", fontsize="large")
    return figure


def draw_contact_surface(boundary: ContactBoundary, upper: bool) -> Figure:
    """Draw gap and pressure on the contact boundary of a solid."""
    figure = plt.figure(figsize=(10.0, 4.6), layout="constrained")
    gap = "gap " + ("$g - u$" if upper else "$u - g$")
    low, high = boundary.points.min(axis=0), boundary.points.max(axis=0)
    size = float((high - low).max())
    for place, (column, name) in enumerate(((1, gap), (2, "contact pressure")), start=1):
        axes: Any = figure.add_subplot(1, 2, place, projection="3d")
        values = np.ma.masked_invalid(boundary.values[boundary.pieces, column]).mean(axis=1)
        faces = Poly3DCollection(list(boundary.points[boundary.pieces]), cmap=COLOUR_MAP)
        faces.set_array(values)
        axes.add_collection3d(faces)
        for label, a, b in zip("xyz", low, high, strict=True):
            flat = b - a < 1e-6 * size
            getattr(axes, f"set_{label}lim")(a - flat * 0.05 * size, b + flat * 0.05 * size)
            getattr(axes, f"set_{label}label")(f"${label}$")
            if flat:
                getattr(axes, f"set_{label}ticks")([a], [f"{round(a, 6) + 0.0:g}"])
        axes.set_box_aspect(np.maximum(high - low, 0.1 * size), zoom=0.85)
        axes.set_title(name)
        figure.colorbar(faces, ax=axes, shrink=0.6, pad=0.15)
    return figure


def _ends(domain: Any, geometry: Any, facet: int) -> Array:
    """The coordinates of the ends of a facet."""
    cell = domain.topology.connectivity(1, 2).links(facet)[0]
    local = np.flatnonzero(domain.topology.connectivity(2, 1).links(cell) == facet)[0]
    corners = [k for k in range(3) if k != local]  # edge k lies opposite vertex k
    return np.asarray(domain.geometry.x[geometry[cell, corners], :2])


def _shade(axes: Any, s: Array, touching: npt.NDArray[np.bool_]) -> None:
    """Shade the pieces whose both ends are in contact."""
    both = np.concatenate(([False], touching[:-1] & touching[1:], [False]))
    changes = np.flatnonzero(both[1:] != both[:-1])
    for first, last in zip(changes[::2], changes[1::2], strict=True):
        axes.axvspan(s[first], s[last], color="0.5", alpha=0.25, linewidth=0)
