"""Orders of convergence: experimental, by regression, and those the theorems predict."""

import math
from collections.abc import Sequence

import numpy as np

from dolfinx_signorini.norms import Norm


def eoc(widths: Sequence[float], errors: Sequence[float]) -> list[float]:
    """Return the experimental order of convergence between each width and the one before.

    Args:
        widths: Mesh widths h, at least one.
        errors: One error per width, positive.

    Returns:
        One order less than there are widths.

    Source: Christof and Haubner, equation (30).
    """
    return (np.diff(np.log(errors)) / np.diff(np.log(widths))).tolist()


def regression(widths: Sequence[float], errors: Sequence[float]) -> float:
    """Return the order of the least-squares line through (log h, log error).

    Args:
        widths: Mesh widths h, at least two.
        errors: One error per width, positive.

    Source: Christof and Haubner, row "regr." of Table 2.
    """
    return float(np.polyfit(np.log(widths), np.log(errors), 1)[0])


def expected_order(norm: Norm) -> float | None:
    """Return the order that the theorems predict in a norm, up to an arbitrarily small epsilon.

    For bounded loads and regular contact sets, the errors in L^4 and W^{1,4} are of order 2 and 1
    and that in H^{1/2} of the boundary of order 3/2; smaller p inherit them. For larger p the
    inverse estimate loses 2 (1/4 - 1/p): at p = inf this gives the 3/2 and 1/2 that are proven.

    Args:
        norm: The norm.

    Returns:
        The order, or None where the theorems say nothing.

    Source: Christof and Haubner, Theorems 4.3 and 6.1; Table 2 for L^16 and W^{1,16}.
    """
    if norm.boundary:
        return 1.5 if norm.derivatives == 0.5 else None
    loss = 2.0 * max(0.0, 0.25 - (0.0 if math.isinf(norm.p) else 1.0 / norm.p))
    return 2.0 - norm.derivatives - loss
