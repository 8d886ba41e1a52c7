"""The names of the solvers, and their tolerances."""

from typing import Any

import numpy as np

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.solvers.tao import METHODS as TAO_METHODS

METHODS = ("cascade", *TAO_METHODS)


def check_method(method: Any) -> None:
    """Refuse what is no name of a solver.

    Raises:
        InputError: The subject is "method".
    """
    if not isinstance(method, str) or method not in METHODS:
        raise InputError(f"unknown {method!r}, known are {', '.join(METHODS)}", "method")


def checked_tolerance(rtol: Any, default: float, subject: str = "rtol") -> float:
    """Return a tolerance between 0 and 1, or the default in place of None.

    Args:
        rtol: The tolerance, or None.
        default: The default.
        subject: The name of the argument.

    Raises:
        InputError: The tolerance is no number between 0 and 1.
    """
    if rtol is None:
        return default
    if not isinstance(rtol, int | float | np.number) or not 0.0 < rtol < 1.0:
        raise InputError(f"must lie between 0 and 1, not {rtol}", subject)
    return float(rtol)
