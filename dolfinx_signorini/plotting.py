"""What all pictures have in common: colours, markers, and how a picture is saved."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

# Okabe and Ito's colours, told apart with any colour vision.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = "osD^vPX"


def save(figure: Figure, path: Path) -> None:
    """Save a figure as PNG and as SVG, and close the figure.

    Args:
        figure: The figure.
        path: The name of both files, which their suffixes complete.
    """
    for suffix in (".png", ".svg"):
        figure.savefig(path.with_suffix(suffix), dpi=150)
    plt.close(figure)
