"""Forms whose data jump inside of cells: integrated piece by piece, or with a warning.

Summands f v of loads and c u v of bilinear forms have projections in place of f and c, see
`jumps.integrable`; so have the components of loads on vectors, and the entries of the diffusion A
in grad u . A grad v. A problem that is solved without them tells where its diffusion jumps inside
of cells, where no polynomial follows.
"""

import math
from collections.abc import Sequence
from functools import reduce
from itertools import product
from typing import Any

import ufl
from dolfinx import mesh
from ufl.core.expr import Expr

from dolfinx_signorini.base.logs import warn_once
from dolfinx_signorini.base.ranks import anywhere
from dolfinx_signorini.data.form_data import choices_in_diffusion
from dolfinx_signorini.data.formulas import Formula
from dolfinx_signorini.data.interfaces.facet_jumps import integrable_on_facets, jumps_in_cells
from dolfinx_signorini.data.interfaces.jumps import integrable
from dolfinx_signorini.data.interfaces.rules import cell_rule, facet_rule
from dolfinx_signorini.data.interfaces.singular_sets import is_singular
from dolfinx_signorini.data.readings import Place, Reading
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
    arguments = reading.form.arguments()
    if len(arguments) == 2 and arguments[0].ufl_shape:
        return None  # stiffnesses of bodies
    found = _of_values(reading, place, domain, in_cells)
    if found is not None or len(arguments) == 1 or not in_cells:
        return found
    return _of_slopes(reading, place, domain)


def _of_values(reading: Reading, place: Place, domain: mesh.Mesh, in_cells: bool) -> Expr | None:
    """A summand without derivatives: factors of components of v, and of the normal, or of u v."""
    v, *others = reading.form.arguments()
    size = v.ufl_shape[0] if v.ufl_shape else 1
    has_normals, n = reading.has_normals(place), ufl.FacetNormal(domain)
    if has_normals and not reading.is_linear_in_normals(place):
        return None
    normals = range(domain.geometry.dim if has_normals else 1)
    if any(_has_slopes(reading, place, k) for k in normals):
        return None
    every = list(product(normals, range(size)))
    factors = [reading.formula(place, [c] * (1 + len(others)), k) for k, c in every]
    degree = (1 + len(others)) * v.ufl_function_space().element.basix_element.degree
    parts = _projected(factors, domain, degree, in_cells and not has_normals)
    if parts is None:
        return None
    total: Expr = ufl.as_ufl(0.0)
    for (k, c), part in zip(every, parts, strict=True):
        value = part * n[k] if has_normals else part
        total += reduce(lambda a, b: a * b, others, value * (v[c] if v.ufl_shape else v))
    return total


def _of_slopes(reading: Reading, place: Place, domain: mesh.Mesh) -> Expr | None:
    """A summand A grad u . grad v of a scalar problem."""
    v, u = reading.form.arguments()
    reaction, dimension = reading.formula(place, [0, 0]), domain.geometry.dim
    if reaction is None or reaction.constant != 0.0:
        return None
    slopes = range(1, dimension + 1)
    entries = [reading.formula(place, [a, b]) for a in slopes for b in slopes]
    degree = 2 * (v.ufl_function_space().element.basix_element.degree - 1)
    flat = _projected(entries, domain, degree, True)
    if flat is None:
        return None
    A = ufl.as_matrix([flat[dimension * i : dimension * (i + 1)] for i in range(dimension)])
    return ufl.inner(ufl.dot(A, ufl.grad(u)), ufl.grad(v))


def _has_slopes(reading: Reading, place: Place, normal: int) -> bool:
    """Whether a summand depends on derivatives of its arguments, for a direction of the normal."""
    arguments = reading.form.arguments()
    slopes = ufl.grad(arguments[0]).ufl_shape
    size = math.prod(arguments[0].ufl_shape)
    for k, code in product(range(len(arguments)), range(size, size + math.prod(slopes))):
        chosen = [code if j == k else 0 for j in range(len(arguments))]
        found = reading.formula(place, chosen, normal)
        if found is None or found.constant != 0.0:
            return True
    return False


def _projected(
    read: Sequence[Formula | None], domain: mesh.Mesh, degree: int, in_cells: bool
) -> list[Expr] | None:
    """Formulas as expressions that are integrated well.

    None where one of them is unreadable, or nothing is to be changed.
    """
    formulas = [formula for formula in read if formula is not None]
    if len(formulas) < len(read) or not any(map(is_singular, formulas)):
        return None
    if in_cells:
        found = [integrable(formula, domain, degree) for formula in formulas]
    else:
        on = boundary_facets(domain)
        found = [integrable_on_facets(formula, domain, on, degree) for formula in formulas]
    x = ufl.SpatialCoordinate(domain)
    return None if found == [formula.ufl(x) for formula in formulas] else found


def _rule(
    integral: ufl.Integral, arguments: Sequence[ufl.Argument], domain: mesh.Mesh
) -> dict[str, Any]:
    """A rule for projections, which have the degree of the arguments together: the user's if fine.

    Where data are smooth, the integral is the user's.
    """
    given: dict[str, Any] = integral.metadata()
    degree = arguments[0].ufl_function_space().element.basix_element.degree
    needed, named = 2 * len(arguments) * degree, given.get("quadrature_degree")
    in_cells = integral.integral_type() == "cell"
    rule = cell_rule(domain, needed) if in_cells else facet_rule(domain)
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
        if anywhere(domain.comm, jumps_in_cells(formula, corners)):
            warn_once(
                f"a: the coefficient {choice} chooses inside of cells, which leaves an error of "
                "order h^(1/2) in the energy norm for any degree; let facets follow the jump, and "
                'give the coefficient on cells: the page "Coefficients that jump" '
                "(docs/howto/jumps.md)"
            )
