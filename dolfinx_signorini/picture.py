"""A figure that a notebook shows, with any backend of matplotlib."""

import io

from matplotlib.figure import Figure

DPI = 150


class Picture(Figure):
    """A figure of matplotlib that shows itself where a cell of a notebook ends with the figure.

    Figures that pyplot makes do so with some backends only:

        picture = Picture(figsize=(6.0, 4.0), layout="constrained")
        picture.subplots().plot([0.0, 1.0], [0.0, 1.0])
        picture
    """

    def _repr_png_(self) -> bytes:
        """Return the picture as IPython asks for the picture."""
        return self.png()

    def png(self) -> bytes:
        """Return the picture as the content of a PNG file."""
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=DPI)
        return buffer.getvalue()
