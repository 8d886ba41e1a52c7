"""Forms whose data jump inside of cells: integrated piece by piece, or with a warning.

Summands f v of loads and c u v of bilinear forms have projections in place of f and c, see
`jumps.projected`; so have the entries of the diffusion A in grad u . A grad v. A problem that is
solved without them tells where its diffusion jumps inside of cells, where no polynomial follows.
"""

from collections.abc import Sequence
from functools import cache, reduce
from itertools import product
from typing import Any

import ufl
from dolfinx import mesh
from ufl.core.expr import Expr

from dolfinx_signorini.base.logs import log
from dolfinx_signorini.data.form_data import choices_in_diffusion
from dolfinx_signorini.data.formulas import Formula
from dolfinx_signorini.data.interfaces.facet_jumps import integrable_on_facets
from dolfinx_signorini.data.interfaces.interface import interfaces
from dolfinx_signorini.data.interfaces.jumps import projected
from dolfinx_signorini.data.interfaces.rules import cell_rule
from dolfinx_signorini.data.interfaces.singular_sets import is_singular
from dolfinx_signorini.data.readings import Place, Reading
from dolfinx_signorini.meshes.quadrature import CELL_RULE, FACET_RULE
from dolfinx_signorini.meshes.sided_meshes import boundary_facets


def piecewise(form: ufl.Form, domain: mesh.Mesh) -> ufl.Form | None:
    """Return a form with data that jump inside of cells integrated piece by piece.

    Args:
        form: A linear or bilinear form.
        domain: The mesh of the form; the call is collective.

    Returns:
        The form; None where no readable datum jumps inside of a cell or facet.
    """
    integrals, reading = [], Reading(form)
    for i, integral in enumerate(form.integrals()):
        kind = integral.integral_type()
        changed = dict[Place, Expr]()
        for place in reading.places(i) if kind in ("cell", "exterior_facet") else []:
            new = _integrable(reading, place, domain, kind == "cell")
            if new is not None:
                changed[place] = new
        if not changed:
            integrals.append(integral)
            continue
        kept = [reading.terms[i][k] for _, k in reading.places(i) if (i, k) not in changed]
        if kept:
            integrals.append(integral.reconstruct(integrand=reduce(lambda a, b: a + b, kept)))
        total = reduce(lambda a, b: a + b, changed.values())
        metadata = _rule(integral, form.arguments(), domain)
        integrals.append(integral.reconstruct(integrand=total, metadata=metadata))
    same = all(a is b for a, b in zip(integrals, form.integrals(), strict=False))
    return None if same and len(integrals) == len(form.integrals()) else ufl.Form(integrals)


def _integrable(reading: Reading, place: Place, domain: mesh.Mesh, in_cells: bool) -> Expr | None:
    """A summand that quadrature rules integrate well; None if it is one already, or unknown."""
    arguments, dimension = reading.form.arguments(), domain.geometry.dim
    degree, count = arguments[0].ufl_function_space().element.basix_element.degree, len(arguments)
    if reading.has_normals(place):
        return _along_normals(reading, place, domain, count * degree)
    factor = reading.formula(place, [0] * count)
    if factor is None:
        return None
    if is_singular(factor):
        if _has_slopes(reading, place, count, dimension):
            return None
        found = _projected(factor, domain, count * degree, in_cells)
        return None if found is None else found * reduce(lambda a, b: a * b, arguments)
    if count == 1 or not in_cells or factor.constant != 0.0:
        return None
    slopes = range(1, dimension + 1)
    read = [reading.formula(place, [a, b]) for a in slopes for b in slopes]
    entries = [entry for entry in read if entry is not None]
    if len(entries) < dimension**2 or not any(map(is_singular, entries)):
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


def _along_normals(reading: Reading, place: Place, domain: mesh.Mesh, degree: int) -> Expr | None:
    """A summand with normals that is integrated well: each component has a factor of its own."""
    arguments, dimension = reading.form.arguments(), domain.geometry.dim
    read = [reading.formula(place, [0] * len(arguments), k) for k in range(dimension)]
    factors = [factor for factor in read if factor is not None]
    if len(factors) < dimension or not reading.is_linear_in_normals(place):
        return None
    if any(_has_slopes(reading, place, len(arguments), dimension, k) for k in range(dimension)):
        return None
    parts = [_projected(factor, domain, degree, False) for factor in factors]
    if all(part is None for part in parts):
        return None
    x, n = ufl.SpatialCoordinate(domain), ufl.FacetNormal(domain)
    both = enumerate(zip(parts, factors, strict=True))
    flux = sum((factor.ufl(x) if part is None else part) * n[k] for k, (part, factor) in both)
    return reduce(lambda a, b: a * b, arguments, flux)


def _has_slopes(
    reading: Reading, place: Place, count: int, dimension: int, normal: int = 0
) -> bool:
    """Whether a summand depends on derivatives of its arguments, for a direction of the normal."""
    for k, slope in product(range(count), range(1, dimension + 1)):
        found = reading.formula(place, [slope if j == k else 0 for j in range(count)], normal)
        if found is None or found.constant != 0.0:
            return True
    return False


def _projected(formula: Formula, domain: mesh.Mesh, degree: int, in_cells: bool) -> Expr | None:
    """A formula as an expression that is integrated well; None where nothing is to be changed."""
    if not is_singular(formula):
        return None
    smooth = formula.ufl(ufl.SpatialCoordinate(domain))
    if in_cells:
        found = projected(formula, domain, degree)
        return None if found is None else ufl.conditional(*found, smooth)
    on_facets = integrable_on_facets(formula, domain, boundary_facets(domain), degree)
    return None if on_facets == smooth else on_facets


def _rule(
    integral: ufl.Integral, arguments: Sequence[ufl.Argument], domain: mesh.Mesh
) -> dict[str, Any]:
    """A rule for projections, which have the degree of the arguments together: the user's if fine.

    Where data are smooth, the integral is the user's.
    """
    given: dict[str, Any] = integral.metadata()
    degree = arguments[0].ufl_function_space().element.basix_element.degree
    needed, named = 2 * len(arguments) * degree, given.get("quadrature_degree")
    if integral.integral_type() == "cell":
        rule = cell_rule(domain, needed)
    else:
        rule = FACET_RULE if domain.topology.dim == 2 else CELL_RULE
    fine = isinstance(named, int) and named >= max(needed, rule.degree)
    return given if fine else rule.metadata


def warn_of_cut_coefficients(a: ufl.Form, domain: mesh.Mesh) -> None:
    """Warn, once for each conditional, where the diffusion chooses inside of cells.

    Conditionals that are unreadable, such as those of finite element functions, are passed over.

    Args:
        a: A bilinear form.
        domain: The mesh of the form; the call is collective.
    """
    if domain.topology.cell_name() not in ("triangle", "tetrahedron"):
        return
    for choice, formula, corners in choices_in_diffusion(a):
        depths = [interface.depths(corners).any() for interface in interfaces(formula)]
        if domain.comm.allreduce(any(depths)):
            _warn_once(str(choice))


@cache
def _warn_once(choice: str) -> None:
    log.warning(
        "a: the coefficient %s chooses inside of cells, which leaves an error of order h^(1/2) in "
        "the energy norm for any degree; let facets follow the jump, and give the coefficient on "
        'cells: the page "Coefficients that jump" (docs/howto/jumps.md)',
        choice,
    )
