"""Errors from data that are not smooth inside of cells, which no comparison of solutions shows."""

import numpy as np

from dolfinx_signorini.accuracy.cut_cells import cut_errors
from dolfinx_signorini.accuracy.kinks import kink_errors
from dolfinx_signorini.accuracy.targets import Target
from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.data.coefficients import Coefficients
from dolfinx_signorini.problem.signorini import SignoriniProblem


def data_errors(problem: SignoriniProblem, data: Coefficients, target: Target) -> Array:
    """Return what jumps and kinks of data inside of cells leave in the error.

    Args:
        problem: The problem, which has been solved; the call is collective.
        data: The coefficients of the problem.
        target: What is to be accurate.

    Returns:
        One value for each owned cell.
    """
    return np.maximum(cut_errors(problem, data, target), kink_errors(problem, data, target))
