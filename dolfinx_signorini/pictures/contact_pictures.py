"""Pictures of the contact boundary: gap and pressure along curves, or on the surface of a solid."""

import itertools
from typing import Any

import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.tolerances import SIX_DIGITS
from dolfinx_signorini.pictures.contact_boundary import ContactBoundary
from dolfinx_signorini.pictures.palette import COLOUR_MAP, COLOURS
from dolfinx_signorini.pictures.picture import Picture

PRESSURE = r"contact pressure $\lambda$"
PEAK = 8.0  # of the pressure, relative to its 98 per cent quantile; a higher one is cut off
MARKED = 40  # points of the longest curve up to which each point is marked


def draw_contact(boundary: ContactBoundary) -> Picture:
    """Return a picture of gap and pressure: along curves, or on the surface of a solid."""
    return _draw_lines(boundary) if boundary.points.shape[1] == 2 else _draw_surface(boundary)


def _draw_lines(boundary: ContactBoundary) -> Picture:
    figure = Picture(figsize=(7.6, 5.4))
    above, below = both = figure.panels(2, sharex=True)
    start, curves = 0.0, boundary.curves()
    # All curves alike: a short one beside a long one is no less a curve.
    marker = "." if max((len(chain) for chain, _ in curves), default=0) <= MARKED else ""
    for chain, pieces in curves:
        x = boundary.points[chain]
        s = start + np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(x, axis=0).T))))
        for axes, column, colour in ((above, 1, COLOURS[0]), (below, 2, COLOURS[1])):
            if start > 0.0:
                axes.axvline(start, color="black", linewidth=0.8, linestyle=":")
            axes.plot(s, boundary.values[chain, column], color=colour, marker=marker)
            _shade(axes, s, boundary.touching[chain])
        _name_sides(both, boundary, pieces, s)
        start = float(s[-1])
    _cut_peak(below, boundary.values[:, 2])
    above.set_ylabel(_gap_label(boundary))
    below.set(xlabel="arc length $s$ along the contact boundary", ylabel=PRESSURE)
    for axes in both:
        axes.margins(x=0.0)
    figure.suptitle("Contact boundary (grey: in contact)", fontsize="large")
    return figure


def _cut_peak(axes: Any, pressure: Array) -> None:
    """Cut a peak off that would hide the rest: at corners the pressure may be infinite."""
    known = pressure[pressure > 0.0]
    if len(known) < 10:
        return
    usual, peak = float(np.quantile(known, 0.98)), float(known.max())
    if peak > PEAK * usual:
        axes.set_ylim(-0.1 * usual, 2.0 * usual)
        axes.set_title(f"cut off: the pressure reaches {peak:.2g}", fontsize="medium")


def _name_sides(both: Any, boundary: ContactBoundary, pieces: Indices, s: Array) -> None:
    """Write the names of the sides above a curve, with dotted lines where one side ends."""
    if not boundary.names:
        return
    sides = boundary.sides[pieces]
    breaks = np.concatenate(([0], np.flatnonzero(np.diff(sides)) + 1, [len(sides)]))
    for first, last in itertools.pairwise(breaks):
        if first > 0:
            for axes in both:
                axes.axvline(s[first], color="black", linewidth=0.8, linestyle=":")
        if sides[first] >= 0:
            both[0].text(
                (s[first] + s[last]) / 2.0,
                1.02,
                boundary.names[sides[first]],
                transform=both[0].get_xaxis_transform(),
                ha="center",
                parse_math=False,
            )


def _draw_surface(boundary: ContactBoundary) -> Picture:
    figure = Picture(figsize=(10.0, 4.6))
    for place, name in ((1, _gap_label(boundary)), (2, PRESSURE)):
        axes: Any = figure.add_subplot(1, 2, place, projection="3d")
        values = np.ma.masked_invalid(boundary.values[boundary.pieces, place]).mean(axis=1)
        faces = draw_faces(axes, boundary.points[boundary.pieces], values)
        axes.set_title(name)
        figure.colorbar(faces, ax=axes, shrink=0.6, pad=0.15)
    return figure


def draw_faces(axes: Any, triangles: Array, values: Array) -> Poly3DCollection:
    """Draw triangles in space with a colour each, and set the axes to their size.

    Args:
        axes: Axes of matplotlib in space.
        triangles: Coordinates of the corners, shape (triangles, 3, 3).
        values: What the colours mean, shape (triangles,).
    """
    corners = triangles.reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = float((high - low).max())
    faces = Poly3DCollection(list(triangles), cmap=COLOUR_MAP)
    faces.set_array(values)
    axes.add_collection3d(faces)
    for label, a, b in zip("xyz", low, high, strict=True):
        flat = b - a < SIX_DIGITS * size
        getattr(axes, f"set_{label}lim")(a - flat * 0.05 * size, b + flat * 0.05 * size)
        getattr(axes, f"set_{label}label")(f"${label}$")
        if flat:
            getattr(axes, f"set_{label}ticks")([a], [f"{round(a, 6) + 0.0:g}"])
        else:
            axes.locator_params(axis=label, nbins=5)
    axes.set_box_aspect(np.maximum(high - low, 0.1 * size), zoom=0.85)
    return faces


def _gap_label(boundary: ContactBoundary) -> str:
    u = boundary.unknown
    return "gap " + (f"$g - {u}$" if boundary.upper else f"${u} - g$")


def _shade(axes: Any, s: Array, touching: Mask) -> None:
    """Shade the pieces whose both ends are in contact."""
    both = np.concatenate(([False], touching[:-1] & touching[1:], [False]))
    changes = np.flatnonzero(both[1:] != both[:-1])
    for first, last in zip(changes[::2], changes[1::2], strict=True):
        axes.axvspan(s[first], s[last], color="0.5", alpha=0.25, linewidth=0)
