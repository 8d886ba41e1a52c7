"""Rules of quadrature that users name, and that are too coarse for the space of a form.

A rule of a low degree sees functions at few points. The functions whose gradients vanish there have
no energy: the matrix is singular, or indefinite by rounding, and no tolerance helps.
"""

from collections.abc import Iterator

import ufl
from ufl.algorithms.analysis import extract_arguments, extract_type
from ufl.classes import Derivative

from dolfinx_signorini.base.logs import log


def warn_of_coarse_rule(a: ufl.Form) -> None:
    """Warn of a named rule that leaves functions without energy.

    Args:
        a: A bilinear form on a Lagrange space.
    """
    space = a.arguments()[0].ufl_function_space()
    degree = space.element.basix_element.degree
    simplex = space.mesh.topology.cell_name() in ("interval", "triangle", "tetrahedron")
    needed = 2 * (degree - 1) if simplex else 2 * degree  # the degree of squares of gradients
    named = min(_named_degrees(a), default=needed)
    if named < needed:
        log.warning(
            "the form names a quadrature rule of degree %d, which leaves functions of degree %d "
            "without energy, so that a solve may fail: name degree %d, or none",
            named,
            degree,
            needed,
        )


def _named_degrees(a: ufl.Form) -> Iterator[int]:
    """The degrees of the rules that users named for integrals of gradients over cells."""
    for integral in a.integrals_by_type("cell"):
        data, derivatives = integral.metadata(), extract_type(integral.integrand(), Derivative)
        degree = 1 if data.get("quadrature_rule") == "vertex" else data.get("quadrature_degree")
        if isinstance(degree, int) and degree >= 0 and any(map(extract_arguments, derivatives)):
            yield degree
