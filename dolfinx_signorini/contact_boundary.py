"""The contact boundary of a solved problem on rank 0, with gap and pressure, and its pictures."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from dolfinx_signorini.elements import along_edge, control_points, values_at_control_points
from dolfinx_signorini.meshes import edge_chains, facet_cells
from dolfinx_signorini.palette import COLOUR_MAP, COLOURS

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

# Gaps relative to the largest |u|: what is rounding, and, times (h / L)^{3/2} with the mesh width h
# and the size L of the boundary, what a mesh cannot tell from contact (a gap opens like r^{3/2}).
TOUCHING = 1e-6
CLEAR = 0.3
ROUNDING = 1e-12  # of coordinates, relative to L


class Solved(Protocol):
    """The part of a solved `SignoriniProblem` that this module needs."""

    sign: float
    space: fem.FunctionSpace
    u: fem.Function

    @property
    def contact(self) -> npt.NDArray[np.int32]:
        """The contact facets that this rank knows."""

    @property
    def fixed_dofs(self) -> npt.NDArray[np.int32]:
        """The owned dofs with Dirichlet data."""

    @property
    def gap(self) -> fem.Function:
        """The gap."""

    @property
    def pressure(self) -> fem.Function:
        """The density of the contact pressure."""


@dataclass(frozen=True)
class ContactBoundary:
    """Points and straight pieces of the contact boundary.

    A solved problem has one, on rank 0:

        boundary = gather_contact_boundary(problem)
        if boundary is not None:
            print(boundary.sizes[boundary.in_contact].sum())

    Attributes:
        points: Coordinates of the contact dofs, shape (points, dimension), sorted.
        values: u, gap and pressure density there, shape (points, 3); the pressure is that of the
            dof, and NaN where u has Dirichlet data, because the force there is that of the data.
        pieces: The facets as indices of points, shape (pieces, dimension); in the plane a facet is
            as many pieces as its degree.
        touching: Whether the dof of a point is (but for rounding) at the obstacle.
        clear: Whether the gap is large against the accuracy of the mesh.
        upper: Whether the obstacle is an upper one.
    """

    points: Array
    values: Array
    pieces: Indices
    touching: npt.NDArray[np.bool_]
    clear: npt.NDArray[np.bool_]
    upper: bool

    @property
    def sizes(self) -> Array:
        """Length or area of each piece."""
        x = self.points[self.pieces]
        edges = x[:, 1:] - x[:, :1]
        gram = np.einsum("fik,fjk->fij", edges, edges)
        return np.sqrt(np.linalg.det(gram)) / (1.0 if self.points.shape[1] == 2 else 2.0)

    @property
    def in_contact(self) -> npt.NDArray[np.bool_]:
        """Whether a piece touches the obstacle with all of its points."""
        return np.asarray(self.touching[self.pieces].all(axis=1))

    @property
    def undecided(self) -> npt.NDArray[np.bool_]:
        """Whether a piece is not in contact, but nowhere clear of the obstacle either."""
        return np.asarray(~self.in_contact & ~self.clear[self.pieces].any(axis=1))

    def chains(self) -> list[Indices]:
        """Return the points in order along each connected part of a plane contact boundary."""
        pieces = self.pieces.copy()
        crowded = np.bincount(pieces.ravel())[pieces] > 2  # where a domain touches itself
        pieces[crowded] = len(self.points) + np.arange(np.count_nonzero(crowded))
        return [
            np.append(
                self.pieces[curve[0, 0], curve[0, 1]], self.pieces[curve[:, 0], 1 - curve[:, 1]]
            )
            for curve in edge_chains(pieces)
        ]


def gather_contact_boundary(problem: Solved) -> ContactBoundary | None:
    """Return the contact boundary of a solved problem on rank 0, and None on the others.

    Args:
        problem: The problem; the call is collective.
    """
    space = problem.space
    domain, index_map = space.mesh, space.dofmap.index_map
    tdim = domain.topology.dim
    count = domain.topology.index_map(tdim - 1).size_local
    pairs = facet_cells(domain, problem.contact[problem.contact < count])
    closures = np.array(space.element.basix_element.entity_closure_dofs[tdim - 1])
    local = space.dofmap.list[pairs[:, 0, None], closures[pairs[:, 1]]]
    fixed = fem.Function(space)
    fixed.x.array[problem.fixed_dofs] = 1.0
    fixed.x.scatter_forward()
    pieces = local[:, :tdim]
    if tdim == 2 and len(local):
        chain = along_edge(local)
        pieces = np.concatenate([chain[:, i : i + 2] for i in range(chain.shape[1] - 1)])
    used = np.unique(local)
    opened = problem.gap.x.array
    gap, values = (
        values_at_control_points(space, entries)[used] for entries in (opened, problem.u.x.array)
    )
    pressure = problem.pressure.x.array[used].copy()
    pressure[fixed.x.array[used] > 0.0] = np.nan
    data = (
        index_map.local_to_global(used),
        control_points(space)[used][:, :tdim],
        np.stack((values, gap, pressure, opened[used]), axis=1),
        index_map.local_to_global(pieces.flatten()).reshape(-1, tdim),
    )
    parts = domain.comm.gather(data, root=0)
    return None if parts is None else _merged(parts, problem.sign < 0.0)


def draw_contact(boundary: ContactBoundary) -> Figure:
    """Return a picture of gap and pressure: along curves, or on the surface of a solid."""
    return _draw_lines(boundary) if boundary.points.shape[1] == 2 else _draw_surface(boundary)


def _merged(parts: list[tuple[Indices, Array, Array, Indices]], upper: bool) -> ContactBoundary:
    """Number the points of all ranks by their place, so that the number of ranks does not show."""
    numbers, points, values, pieces = (np.concatenate(item) for item in zip(*parts, strict=True))
    numbers, first = np.unique(numbers, return_index=True)
    points, values = points[first], values[first]
    order = np.lexsort(np.round(points, 12).T[::-1])
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    pieces = np.sort(place[np.searchsorted(numbers, pieces)], axis=1)
    pieces = pieces[np.lexsort(pieces.T[::-1])]
    points, values = points[order], values[order]
    size, gap = float(np.abs(values[:, 0]).max(initial=0.0)), values[:, 1]
    widths = np.linalg.norm(points[pieces[:, 1]] - points[pieces[:, 0]], axis=1)
    extent = float(np.ptp(points, axis=0).max())
    points[np.abs(points) < ROUNDING * extent] = 0.0
    clear = gap > CLEAR * size * (float(widths.max()) / extent) ** 1.5
    touching = values[:, 3] <= TOUCHING * size
    return ContactBoundary(points, values[:, :3], pieces, touching, clear, upper)


def _draw_lines(boundary: ContactBoundary) -> Figure:
    figure = Figure(figsize=(7.6, 5.4), layout="constrained")
    above, below = both = figure.subplots(2, 1, sharex=True)
    start = 0.0
    for chain in boundary.chains():
        x = boundary.points[chain]
        s = start + np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(x, axis=0).T))))
        for axes, column, colour in ((above, 1, COLOURS[0]), (below, 2, COLOURS[1])):
            if start > 0.0:
                axes.axvline(start, color="black", linewidth=0.8, linestyle=":")
            axes.plot(s, boundary.values[chain, column], color=colour)
            _shade(axes, s, boundary.touching[chain])
        start = float(s[-1])
    above.set_ylabel(_gap_label(boundary))
    below.set(xlabel="arc length along the contact boundary", ylabel="contact pressure")
    for axes in both:
        axes.grid(alpha=0.3)
        axes.margins(x=0.0)
    figure.suptitle("Contact boundary (grey: in contact)", fontsize="large")
    return figure


def _draw_surface(boundary: ContactBoundary) -> Figure:
    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    low, high = boundary.points.min(axis=0), boundary.points.max(axis=0)
    size = float((high - low).max())
    for column, name in ((1, _gap_label(boundary)), (2, "contact pressure")):
        axes: Any = figure.add_subplot(1, 2, column, projection="3d")
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


def _gap_label(boundary: ContactBoundary) -> str:
    return "gap " + ("$g - u$" if boundary.upper else "$u - g$")


def _shade(axes: Any, s: Array, touching: npt.NDArray[np.bool_]) -> None:
    """Shade the pieces whose both ends are in contact."""
    both = np.concatenate(([False], touching[:-1] & touching[1:], [False]))
    changes = np.flatnonzero(both[1:] != both[:-1])
    for first, last in zip(changes[::2], changes[1::2], strict=True):
        axes.axvspan(s[first], s[last], color="0.5", alpha=0.25, linewidth=0)
