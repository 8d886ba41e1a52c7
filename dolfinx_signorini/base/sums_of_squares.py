"""Forms that are sums of squares: symmetric and positive semidefinite as they are written."""

from typing import Any

import ufl
from ufl.classes import Argument, Conj, Dot, Grad, Inner, Product, RealValue, Sum
from ufl.core.expr import Expr


def is_sum_of_squares(form: ufl.Form) -> bool:
    """Return whether each term of a bilinear form is a number c > 0 times (F u, F v).

    F is the identity or takes gradients. A rule of quadrature that a user has chosen may have
    negative weights: a form with such a rule does not count.
    """
    return not any(integral.metadata() for integral in form.integrals()) and all(
        _is_square(term) for integral in form.integrals() for term in summands(integral.integrand())
    )


def summands(term: Expr) -> list[Expr]:
    """Return the summands of an integrand, sums of sums taken apart."""
    return _operands(term, Sum)


def _is_square(term: Expr) -> bool:
    factors = _operands(term, Product | Inner | Dot | Conj)
    numbers = [float(factor) for factor in factors if isinstance(factor, RealValue)]
    others = [_argument(factor) for factor in factors if not isinstance(factor, RealValue)]
    # Of equal shape, for their product is a number: the same gradients of both arguments.
    return min(numbers, default=1.0) > 0.0 and sorted(others) == [0, 1]


def _operands(term: Expr, kinds: Any) -> list[Expr]:
    """The operands of nested operations of some kinds."""
    if not isinstance(term, kinds):
        return [term]
    return [part for operand in term.ufl_operands for part in _operands(operand, kinds)]


def _argument(factor: Expr) -> int:
    """The number of the argument that is differentiated, if at all; -1 for anything else."""
    while isinstance(factor, Grad):
        (factor,) = factor.ufl_operands
    return factor.number() if isinstance(factor, Argument) else -1
