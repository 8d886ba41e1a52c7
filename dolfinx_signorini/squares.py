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
    if not isinstance(term, Product | Inner | Dot):
        return False
    one, other = term.ufl_operands
    if isinstance(one, RealValue):
        return float(one) > 0.0 and _is_square(other)
    (first, order), (second, same) = _differentiated(one), _differentiated(other)
    return {first, second} == {0, 1} and order == same


def _differentiated(factor: Expr) -> tuple[int, int]:
    """The number of an argument and how many gradients are taken of it; -1 for anything else."""
    order = 0
    while isinstance(factor, Grad | Conj):
        order += isinstance(factor, Grad)
        (factor,) = factor.ufl_operands
    return (factor.number() if isinstance(factor, Argument) else -1), order
