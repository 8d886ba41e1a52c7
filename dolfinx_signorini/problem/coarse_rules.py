"""Rules of quadrature that users name, and that are too coarse for the space of a form.

A rule of a low degree sees functions at few points. The functions whose gradients vanish there have
no energy: the matrix is singular, or indefinite by rounding, and no tolerance helps. A solver does
not know of rules, so that its message gets the cause here.
"""

from collections.abc import Callable, Iterator
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import ufl
from ufl.algorithms.analysis import extract_arguments, extract_type
from ufl.classes import Derivative

from dolfinx_signorini.base.errors import INDEFINITE, InputError, NotConvergedError
from dolfinx_signorini.solvers.unbounded import UNBOUNDED

P = ParamSpec("P")
R = TypeVar("R")


def coarse_rule(a: ufl.Form) -> str:
    """Return what a named rule leaves out of the energy of a form, or "".

    Args:
        a: A bilinear form on a Lagrange space.
    """
    space = a.arguments()[0].ufl_function_space()
    degree = space.element.basix_element.degree
    simplex = space.mesh.topology.cell_name() in ("interval", "triangle", "tetrahedron")
    needed = 2 * (degree - 1) if simplex else 2 * degree  # the degree of squares of gradients
    named = min(_named_degrees(a), default=needed)
    if named >= needed:
        return ""
    return (
        f"the form names a quadrature rule of degree {named}, which leaves functions of degree "
        f"{degree} without energy: name degree {needed}, or none"
    )


def names_coarse_rule(method: Callable[P, R]) -> Callable[P, R]:
    """Let a method of an object with a form `a` say where a coarse rule made it fail."""

    @wraps(method)
    def explained(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return method(*args, **kwargs)
        except (InputError, NotConvergedError) as error:
            owner: Any = args[0]
            cause = coarse_rule(owner.a) if _may_be_singular(error) else ""
            if not cause or cause in str(error):
                raise
            if isinstance(error, InputError):
                raise InputError(f"{error.message}; {cause}", error.subject) from error
            residual, reason = error.residual, error.reason
            raise NotConvergedError(error.message, residual, reason, cause) from error

    return explained


def _may_be_singular(error: InputError | NotConvergedError) -> bool:
    vanishing = error.message.startswith((INDEFINITE, UNBOUNDED))
    return isinstance(error, NotConvergedError) or vanishing


def _named_degrees(a: ufl.Form) -> Iterator[int]:
    """The degrees of the rules that users named for integrals of gradients over cells."""
    for integral in a.integrals_by_type("cell"):
        data, derivatives = integral.metadata(), extract_type(integral.integrand(), Derivative)
        degree = 1 if data.get("quadrature_rule") == "vertex" else data.get("quadrature_degree")
        if isinstance(degree, int) and degree >= 0 and any(map(extract_arguments, derivatives)):
            yield degree
