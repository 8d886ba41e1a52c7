"""What quadrature leaves in the error, which all solutions share that are compared.

A rule of a higher degree gives other integrals of data that are no polynomials. With these loads
L+ and forms a+ the solution w has the residual (L+ - L)(v) - (a+ - a)(w, v), and a dual solution
tells what the residual is worth.

Source: Strang and Fix, An Analysis of the Finite Element Method, Prentice-Hall (1973), Section 4.3.
"""

from collections.abc import Iterator, Sequence
from functools import partial

import ufl
from dolfinx import fem
from ufl.algorithms import estimate_total_polynomial_degree
from ufl.core.expr import Expr

from dolfinx_signorini.accuracy.cells import MAX_DEGREE
from dolfinx_signorini.accuracy.targets import Functional
from dolfinx_signorini.base import compiled
from dolfinx_signorini.bounds.strong_form import polynomial_degree
from dolfinx_signorini.data.reading import lowered
from dolfinx_signorini.data.readings import Reading
from dolfinx_signorini.meshes.quadrature import QuadratureRule

HIGHER = 6  # degrees: rules of nearly twice the points in each direction


def missed_by_quadrature(a: ufl.Form, L: ufl.Form, w: fem.Function) -> list[ufl.Form]:
    """Return the forms of (L+ - L)(v) and -(a+ - a)(w, v), as far as the rules differ.

    Args:
        a, L: The forms, whose subdomains may differ.
        w: The solution.
    """
    load, stiffness = (ufl.Form(list(_raised(form))) for form in (L, a))
    forms = [] if load.empty() else [load]
    return forms if stiffness.empty() else [*forms, -ufl.action(stiffness, w)]


def missed_of_functional(functional: Functional, u: fem.Function) -> float:
    """Return by how much a rule of a higher degree changes the functional of u; collective."""
    return abs(compiled.integral(ufl.Form(list(_raised(functional(u), u))), "norm"))


def _raised(form: ufl.Form, *functions: fem.Function) -> Iterator[ufl.Integral]:
    """The integrals with more points, less those of a form, where that makes a difference."""
    parts, reading = (*form.arguments(), *functions), Reading(form)
    for i, integral in enumerate(form.integrals()):
        degree = reading.once(("few points", i), partial(_few_points, integral, parts))
        if degree is None:
            continue
        rule = QuadratureRule("default", max(min(degree + HIGHER, MAX_DEGREE), degree + 1))
        same = {**integral.metadata(), "quadrature_degree": degree}
        yield integral.reconstruct(metadata=rule.metadata)
        yield integral.reconstruct(integrand=-integral.integrand(), metadata=same)


def _few_points(integral: ufl.Integral, functions: Sequence[Expr]) -> int | None:
    """The degree of the rule of an integral if the rule is not exact; otherwise None."""
    integrand = lowered(integral.integrand())  # as DOLFINx has the integrand estimated
    degree = integral.metadata().get("quadrature_degree", -1)
    if not isinstance(degree, int) or degree < 0:
        degree = estimate_total_polynomial_degree(integrand)
        degree = max(degree) if isinstance(degree, tuple) else degree
    order = functions[0].ufl_function_space().element.basix_element.degree
    slopes = {ufl.grad(f): order - 1 for f in functions}
    known = polynomial_degree(integrand, dict.fromkeys(functions, order) | slopes)
    return None if known is not None and known <= degree else int(degree)
