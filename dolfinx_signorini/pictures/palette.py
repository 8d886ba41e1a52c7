"""The colours and markers of all pictures, which can be told apart with any colour vision."""

from typing import Any

# Okabe and Ito's colours.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = "osD^vPX"
COLOUR_MAP = "cividis"
# How matplotlib draws the facets where u touches the obstacle, on top of the contact boundary.
CONTACT: dict[str, Any] = {"color": COLOURS[1], "linewidth": 4.0}
IN_CONTACT: dict[str, Any] = {"color": COLOURS[2], "linewidth": 4.0}


def curve_style(number: int) -> dict[str, Any]:
    """Return the colour and the marker of a curve by its number, which may be any."""
    return {"color": COLOURS[number % len(COLOURS)], "marker": MARKERS[number % len(MARKERS)]}
