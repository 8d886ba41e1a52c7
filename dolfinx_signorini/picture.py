"""A figure that a notebook shows, with any backend of matplotlib."""

import io
import re
from typing import Any

from matplotlib.figure import Figure

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
