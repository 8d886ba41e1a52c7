"""Forms whose data jump inside of cells, integrated piece by piece.

Summands f v of loads and c u v of bilinear forms have projections in place of f and c, see
`jumps.integrable`; so have the entries of the diffusion A in grad u . A grad v.
"""

from collections.abc import Sequence
from functools import reduce
from typing import Any

import basix
import ufl
from dolfinx import mesh
from ufl.core.expr import Expr

from dolfinx_signorini.data.form_data import coefficient, jets, summands
from dolfinx_signorini.data.formulas import Formula
from dolfinx_signorini.data.interfaces.jumps import integrable, integrable_on_facets
from dolfinx_signorini.data.interfaces.roughness import rough
from dolfinx_signorini.data.reading import lowered
from dolfinx_signorini.meshes.quadrature import CELL_RULE, FACET_RULE, interior_rule
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.signorini import SignoriniProblem


def integrate_piecewise(problem: SignoriniProblem) -> None:
    """Let a problem have its data integrated piece by piece where they jump inside of cells.

    Args:
        problem: The problem; the call is collective.
    """
    domain = problem.space.mesh
    a, L = piecewise(problem.a, domain), piecewise(problem.L, domain)
    if a is not None or L is not None:
        problem.integrate(a, L)


def piecewise(form: ufl.Form, domain: mesh.Mesh) -> ufl.Form | None:
    """Return a form with data that jump inside of cells integrated piece by piece.

    Args:
        form: A linear or bilinear form.
        domain: The mesh of the form; the call is collective.

    Returns:
        The form; None where no readable datum jumps inside of a cell or facet.
    """
    integrals = []
    for integral in form.integrals():
        kind = integral.integral_type()
        kept: list[Expr] = []
        changed: list[Expr] = []
        terms = summands(lowered(integral.integrand()))
        for term in terms if kind in ("cell", "exterior_facet") else []:
            new = _integrable(term, form.arguments(), domain, kind == "cell")
            (kept if new is None else changed).append(term if new is None else new)
        if not changed:
            integrals.append(integral)
            continue
        if kept:
            integrals.append(integral.reconstruct(integrand=reduce(lambda a, b: a + b, kept)))
        total = reduce(lambda a, b: a + b, changed)
        metadata = _rule(form.arguments(), domain, kind == "cell")
        integrals.append(integral.reconstruct(integrand=total, metadata=metadata))
    same = all(a is b for a, b in zip(integrals, form.integrals(), strict=False))
    return None if same and len(integrals) == len(form.integrals()) else ufl.Form(integrals)


def _integrable(
    term: Expr, arguments: Sequence[ufl.Argument], domain: mesh.Mesh, in_cells: bool
) -> Expr | None:
    """A summand that quadrature rules integrate well; None if it is one already, or unknown."""
    dimension, count = domain.geometry.dim, len(arguments)
    degree = arguments[0].ufl_function_space().element.basix_element.degree
    value, *slopes = jets(dimension)
    factor = coefficient(term, arguments, [value] * count)
    if factor is None:
        return None
    if rough(factor):
        found = _projected(factor, domain, count * degree, in_cells)
        values = reduce(lambda a, b: a * b, arguments)
        # The rest of the summand has no derivatives of the arguments.
        return None if found is None or _has_slopes(term, arguments, dimension) else found * values
    if count == 1 or not in_cells or factor.constant != 0.0:
        return None
    rows = [[coefficient(term, arguments, [a, b]) for b in slopes] for a in slopes]
    entries = [entry for row in rows for entry in row if entry is not None]
    if len(entries) < dimension**2 or not any(map(rough, entries)):
        return None
    parts = [_projected(entry, domain, 2 * (degree - 1), in_cells) for entry in entries]
    if all(part is None for part in parts):
        return None
    x = ufl.SpatialCoordinate(domain)
    both = zip(parts, entries, strict=True)
    flat = [entry.ufl(x) if part is None else part for part, entry in both]
    A = ufl.as_matrix([flat[dimension * i : dimension * (i + 1)] for i in range(dimension)])
    v, u = arguments
    return ufl.inner(ufl.dot(A, ufl.grad(u)), ufl.grad(v))


def _has_slopes(term: Expr, arguments: Sequence[ufl.Argument], dimension: int) -> bool:
    """Whether a summand depends on derivatives of its arguments."""
    value, *slopes = jets(dimension)
    for k in range(len(arguments)):
        for slope in slopes:
            chosen = [value] * k + [slope] + [value] * (len(arguments) - k - 1)
            found = coefficient(term, arguments, chosen)
            if found is None or found.constant != 0.0:
                return True
    return False


def _projected(formula: Formula, domain: mesh.Mesh, degree: int, in_cells: bool) -> Expr | None:
    """A formula as an expression that is integrated well; None where nothing is to be changed."""
    if not rough(formula):
        return None
    if in_cells:
        found = integrable(formula, domain, degree)
    else:
        found = integrable_on_facets(formula, domain, boundary_facets(domain), degree)
    return None if found == formula.ufl(ufl.SpatialCoordinate(domain)) else found


def _rule(arguments: Sequence[ufl.Argument], domain: mesh.Mesh, in_cells: bool) -> dict[str, Any]:
    """A rule for projections, which have the degree of the arguments together."""
    if not in_cells and domain.topology.dim == 2:
        return FACET_RULE.metadata
    degree = arguments[0].ufl_function_space().element.basix_element.degree
    needed = 2 * len(arguments) * degree
    if not in_cells or needed <= CELL_RULE.degree:
        return CELL_RULE.metadata
    return interior_rule(basix.CellType[domain.topology.cell_name()], needed).metadata
