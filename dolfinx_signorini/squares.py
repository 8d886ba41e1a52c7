"""Forms that are sums of squares: symmetric and positive semidefinite as they are written."""

from collections.abc import Iterator

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


def summands(term: Expr) -> Iterator[Expr]:
    """Yield the summands of an integrand, sums of sums taken apart."""
    if isinstance(term, Sum):
        for operand in term.ufl_operands:
            yield from summands(operand)
    else:
        yield term


def _is_square(term: Expr) -> bool:
    factors = list(_factors(term))
    others = [factor for factor in factors if not isinstance(factor, RealValue)]
    positive = all(float(factor) > 0.0 for factor in factors if isinstance(factor, RealValue))
    numbers, orders = zip(*map(_differentiated, others), strict=True)
    return positive and sorted(numbers) == [0, 1] and orders[0] == orders[1]


def _factors(term: Expr) -> Iterator[Expr]:
    if isinstance(term, Product | Inner | Dot | Conj):
        for operand in term.ufl_operands:
            yield from _factors(operand)
    else:
        yield term


def _differentiated(factor: Expr) -> tuple[int, int]:
    """The number of an argument and how many gradients are taken of it; -1 for anything else."""
    order = 0
    while isinstance(factor, Grad):
        order, (factor,) = order + 1, factor.ufl_operands
    return (factor.number() if isinstance(factor, Argument) else -1), order
