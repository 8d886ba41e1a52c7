"""How pictures are saved."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.figure import Figure


def save(figure: Figure, path: Path) -> None:
    """Save a figure as PNG and as SVG, and close the figure.

    Args:
        figure: The figure.
        path: The name of both files, which their suffixes complete.
    """
    for suffix in (".png", ".svg"):
        figure.savefig(path.with_suffix(suffix), dpi=150)
    plt.close(figure)
