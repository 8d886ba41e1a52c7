"""Errors from data that are not smooth inside of cells, which no comparison of solutions shows."""

from collections.abc import Callable
from typing import TypeAlias

from dolfinx_signorini.accuracy.cells import joined
from dolfinx_signorini.accuracy.cut_cells import cut_errors
from dolfinx_signorini.accuracy.kinks import kink_errors
from dolfinx_signorini.accuracy.terms import Dual, Solved, Term
from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.data.coefficients import Coefficients
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem

# Returns what is known of the coefficients of a problem.
Reader: TypeAlias = Callable[[BoundConstrainedProblem], Coefficients]


def data_errors(read: Reader) -> Term:
    """Return what jumps and kinks of data inside of cells leave in the error, as a term.

    Args:
        read: Returns the coefficients of a problem.
    """

    def term(solved: Solved, dual: Dual | None) -> Array:
        data = read(solved.fine)
        parts = cut_errors(solved, data), kink_errors(solved, data)
        return joined(*parts, solved.target.power)

    return term
