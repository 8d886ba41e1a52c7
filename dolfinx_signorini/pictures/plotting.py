"""Files of pictures."""

from collections.abc import Iterable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from dolfinx_signorini.pictures.picture import DPI

SUFFIXES = (".png", ".svg")


def picture_files(names: Iterable[str]) -> list[str]:
    """Return the names of the files of some pictures."""
    return [name + suffix for name in names for suffix in SUFFIXES]


def save(figure: Figure, path: Path) -> None:
    """Save a figure as PNG and as SVG, and close the figure.

    Args:
        figure: The figure.
        path: The name of both files, which their suffixes complete.
    """
    for suffix in SUFFIXES:
        figure.savefig(path.with_suffix(suffix), dpi=DPI)
    plt.close(figure)
