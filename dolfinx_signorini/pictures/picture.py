"""A figure that a notebook shows, with any backend of matplotlib, and its files."""

import io
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import TriMesh
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, Indices
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.kinds import check, instance, optional
from dolfinx_signorini.base.records import on_first
from dolfinx_signorini.pictures.palette import curve_style

SUFFIXES = (".png", ".svg")  # of the files of a picture
NORM = re.compile(r"(L|W1_|H)(inf|\d+(?:\.\d+)?)(_2)?(_boundary)?(_\w+)?")


def typeset_norm(name: str) -> str:
    """Return the name of a norm as matplotlib sets it, for example "W1_inf" as W^{1,inf}.

    Args:
        name: The name; an unknown name is returned unchanged.
    """
    match = NORM.fullmatch(name)
    if match is None:
        return name
    kind, number, half, boundary, rest = match.groups(default="")
    power = r"\infty" if number == "inf" else number
    upper = {"L": power, "W1_": f"1,{power}", "H": f"{power}/2" if half else power}[kind]
    place = r"(\partial\Omega)" if boundary else ""
    return f"${kind[0]}^{{{upper}}}{place}$" + rest.replace("_", " ")


def saved(comm: MPI.Comm, figure: "Picture | None", path: Path | str | None) -> "Picture | None":
    """Save a picture where a path is given, and return the picture; collective.

    Args:
        comm: The communicator of those who have drawn.
        figure: The picture, on rank 0.
        path: The file, with a suffix that matplotlib knows; None for no file.

    Raises:
        InputError: The file cannot be written, or its suffix is unknown; raised on all ranks.
    """
    check(path=(path, optional(instance((str, Path), "a path"))))
    if path is None:
        return figure

    def write() -> None:
        assert figure is not None  # rank 0
        try:
            figure.savefig(path)
        except ValueError as error:  # of a suffix
            raise InputError(str(error), "path") from None

    on_first(comm, Path(path).parent, write)
    return figure


def picture_files(names: Iterable[str]) -> list[str]:
    """Return the names of the files of some pictures."""
    return [name + suffix for name in names for suffix in SUFFIXES]


def add_curve(
    axes: Axes,
    n: Sequence[float],
    values: Sequence[float],
    label: str,
    index: int,
    order: float | None = None,
) -> None:
    """Draw values against cells per side, both logarithmic.

    Args:
        axes: Where to draw.
        n: The cells per side.
        values: The values, which are drawn as markers.
        label: The name of the values.
        index: The number of the colour and the marker.
        order: The order of a line through the last value; None for a line from value to value.
    """
    style = curve_style(index)
    line = "-" if order is None else ""
    axes.loglog(n, values, linestyle=line, label=label, linewidth=0.9, **style)
    if order is not None:
        line_of_order = values[-1] * (np.asarray(n, dtype=float) / n[-1]) ** -order
        axes.loglog(n, line_of_order, color=style["color"], linewidth=0.9)


def name_cells(axes: Axes, n: Sequence[int]) -> None:
    """Write the cells per side below axes, but for those whose labels would overlap."""
    ticks = [n[-1]]
    for value in n[-2::-1]:
        if ticks[-1] >= 1.2 * value:
            ticks.append(value)
    axes.set_xticks(ticks, [str(value) for value in ticks], minor=False)
    axes.minorticks_off()
    axes.set_xlabel("cells per side N")


def add_triangles(
    axes: Axes,
    points: Array,
    triangles: Indices,
    values: Array,
    **options: Any,
) -> TriMesh:
    """Draw triangles with colours that are linear between their vertices, and return the drawing.

    Matplotlib's own function makes an object of each triangle to find how large the drawing is,
    which takes far longer than to draw a fine mesh.

    Args:
        axes: Where to draw.
        points: Coordinates, shape (points, 2).
        triangles: Indices of points, shape (triangles, 3).
        values: The values at the points.
        options: Arguments of matplotlib's collections, such as `norm`.
    """
    x, y = points.T
    mesh = TriMesh(Triangulation(x, y, triangles), array=values, rasterized=True, **options)
    mesh.set_in_layout(False)
    axes.add_collection(mesh, autolim=False)
    axes.update_datalim(points)
    axes.autoscale_view()
    return mesh


class Picture(Figure):
    """A figure of matplotlib that shows itself where a cell of a notebook ends with the figure.

    Figures that pyplot makes do so with some backends only:

        picture = Picture(figsize=(6.0, 4.0))
        picture.panels()[0].plot([0.0, 1.0], [0.0, 1.0])
        picture
    """

    def __init__(self, **options: Any) -> None:
        """Make a figure with the resolution and the layout of all pictures of the package.

        Args:
            options: The arguments of matplotlib's `Figure`.
        """
        super().__init__(**{"dpi": 150, "layout": "constrained", **options})

    def panels(self, rows: int = 1, columns: int = 1, **options: Any) -> list[Axes]:
        """Return axes with a grid, row by row.

        Args:
            rows, columns: How many.
            options: Arguments of matplotlib's `subplots`.
        """
        axes = self.subplots(rows, columns, squeeze=False, **options)
        for each in axes.flat:
            each.grid(alpha=0.3)
        return list(axes.flat)

    def legend_below(self, handles: Sequence[Any] | None = None) -> None:
        """Write a legend below all axes, in as many columns as the width has room for.

        Args:
            handles: What is named; by default all that has a label.
        """
        named = {} if handles is None else {"handles": handles}
        for columns in (4, 3, 2, 1):
            style = {"loc": "outside lower center", "ncols": columns, "frameon": False}
            legend = self.legend(**named, **style)
            if columns == 1 or legend.get_window_extent().width <= self.bbox.width:
                return
            legend.remove()

    def save(self, path: Path) -> None:
        """Write the picture as PNG and as SVG.

        Args:
            path: The name of both files, which their suffixes complete.
        """
        for suffix in SUFFIXES:
            self.savefig(path.with_suffix(suffix))

    def png(self) -> bytes:
        """Return the picture as the content of a PNG file."""
        buffer = io.BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()

    _repr_png_ = png  # as IPython asks for the picture
