"""A figure that a notebook shows, with any backend of matplotlib."""

import io
import re
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import TriMesh
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

DPI = 150
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


def add_triangles(
    axes: Axes,
    points: npt.NDArray[np.float64],
    triangles: npt.NDArray[np.int64],
    values: npt.NDArray[np.float64],
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

        picture = Picture(figsize=(6.0, 4.0), layout="constrained")
        picture.subplots().plot([0.0, 1.0], [0.0, 1.0])
        picture
    """

    def __init__(self, **options: Any) -> None:
        """Make a figure with the resolution of all pictures of the package.

        Args:
            options: The arguments of matplotlib's `Figure`.
        """
        super().__init__(**{"dpi": DPI, **options})

    def _repr_png_(self) -> bytes:
        """Return the picture as IPython asks for the picture."""
        return self.png()

    def png(self) -> bytes:
        """Return the picture as the content of a PNG file."""
        buffer = io.BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()
