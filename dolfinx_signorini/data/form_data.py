"""The data of a problem that is posed in UFL: formulas with the cells or facets that they are on.

An integrand of L(v) is linear in v and grad v. For v = 1 and grad v = 0 the integrand is the load,
and for v = 0 and a unit vector as grad v a component of what acts on grad v. Integrands of a(u, v)
have the reaction and the entries of the diffusion by the same substitution. Summands that depend on
finite element functions are left out.
"""

from collections.abc import Iterator, Sequence
from functools import reduce
from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
import ufl
from dolfinx import mesh
from ufl import classes
from ufl.core.expr import Expr
from ufl.corealg.traversal import traverse_unique_terminals

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.data.coefficients import Coefficients
from dolfinx_signorini.data.formulas import Formula, number
from dolfinx_signorini.data.reading import Terminals, formula_of, lowered, read
from dolfinx_signorini.data.sampling import DEGREE, Datum
from dolfinx_signorini.meshes.sided_meshes import (
    boundary_facets,
    facet_cells,
    facet_vertices,
    owned_cells,
)
from dolfinx_signorini.problem.signorini import SignoriniProblem

Jet = tuple[float, Array]  # a value and a gradient

NAMES = {  # of data of forms, by the kind of integral and the number of arguments
    ("cell", 1): "the load",
    ("cell", 2): "the coefficient",
    ("exterior_facet", 1): "the flux",
    ("exterior_facet", 2): "the coefficient on the boundary",
}


def data_of(problem: SignoriniProblem) -> list[Datum]:
    """Return the data of a problem that depend on the coordinates, as far as they are readable.

    Args:
        problem: The problem.
    """
    found = [*_form_data(problem, problem.L), *_form_data(problem, problem.a)]
    obstacle = problem.obstacle_data
    if isinstance(obstacle, Expr) and (formula := formula_of(obstacle)) is not None:
        domain = problem.space.mesh
        facets = np.intersect1d(problem.contact, boundary_facets(domain)).astype(np.int32)
        parts = _on_facets(domain, facet_cells(domain, facets))
        degree = problem.space.element.basix_element.degree
        found.append(Datum("the obstacle", formula, "height", degree, *parts))
    return [datum for datum in found if datum.formula.constant is None]


def coefficients_of(problem: SignoriniProblem) -> Coefficients:
    """Return the coefficients of a problem, as far as integrals over all cells are readable.

    Args:
        problem: The problem.
    """
    domain = problem.space.mesh
    value, *slopes = jets(domain.geometry.dim)
    load, reaction = (
        _over_all_cells(form, [value] * count) for count, form in ((1, problem.L), (2, problem.a))
    )
    rows = tuple(tuple(_over_all_cells(problem.a, [s, t]) for t in slopes) for s in slopes)
    return Coefficients(load, reaction, rows)


def _over_all_cells(form: ufl.Form, chosen: Sequence[Jet]) -> Formula:
    cells = [i for i in form.integrals() if i.integral_type() == "cell" and _is_everywhere(i)]
    terms = [term for i in cells for term in summands(lowered(i.integrand()))]
    return _sum_of_readable(terms, form.arguments(), chosen)


def _form_data(problem: SignoriniProblem, form: ufl.Form) -> Iterator[Datum]:
    degree = max(DEGREE, problem.space.element.basix_element.degree)
    for integral in form.integrals():
        kind = integral.integral_type()
        name = NAMES.get((kind, len(form.arguments())))
        parts = _parts(problem.space.mesh, integral)
        if name is None or parts is None:
            continue
        terms = summands(lowered(integral.integrand()))
        for formula in _formulas(terms, form.arguments(), problem.space.mesh):
            yield Datum(name, formula, "mass", degree if kind == "cell" else DEGREE, *parts)


def _formulas(
    terms: Sequence[Expr], arguments: Sequence[ufl.Argument], domain: mesh.Mesh
) -> Iterator[Formula]:
    """The formulas that an integrand has in front of arguments and their derivatives."""
    unit = np.eye(domain.geometry.dim)
    normals = unit if any(map(_has_normal, terms)) else unit[:1]
    every = combinations_with_replacement(jets(domain.geometry.dim), len(arguments))
    for chosen, normal in product(every, normals):
        formula = _sum_of_readable(terms, arguments, chosen, {ufl.FacetNormal(domain): normal})
        yield formula
        diagonal = len(chosen) > 1 and chosen[0] is chosen[1] and chosen[0][0] == 0.0
        if diagonal and formula.constant is None:
            # A thin layer that lets nothing through is narrow in the reciprocal only.
            yield Formula(f"1/({formula.text})", number(1.0).root / formula.root)


def jets(dimension: int) -> list[Jet]:
    """Return what stands for arguments: the value 1, and slopes 1 in each direction.

    Args:
        dimension: The dimension of space.
    """
    return [(1.0, np.zeros(dimension)), *((0.0, e) for e in np.eye(dimension))]


def coefficient(
    term: Expr,
    arguments: Sequence[ufl.Argument],
    chosen: Sequence[Jet],
    terminals: Terminals | None = None,
) -> Formula | None:
    """Return what a lowered expression is for certain arguments; None if that is not readable.

    Args:
        term: The expression.
        arguments: The arguments.
        chosen: The value and the gradient of each of them.
        terminals: Numbers that stand for other parts of the expression.
    """
    known: dict[Expr, Any] = dict(terminals or {})
    for argument, (value, slope) in zip(arguments, chosen, strict=True):
        known |= {argument: value, ufl.grad(argument): slope}
    return read(term, known)


def _sum_of_readable(
    terms: Sequence[Expr],
    arguments: Sequence[ufl.Argument],
    chosen: Sequence[Jet],
    terminals: Terminals | None = None,
) -> Formula:
    found = [coefficient(term, arguments, chosen, terminals) for term in terms]
    roots = [formula.root for formula in found if formula is not None]
    text = " + ".join(formula.text for formula in found if formula is not None)
    return Formula(text, reduce(lambda a, b: a + b, roots, number(0.0).root))


def summands(integrand: Expr) -> list[Expr]:
    """Return the summands of an expression."""
    if isinstance(integrand, classes.Sum):
        return [term for operand in integrand.ufl_operands for term in summands(operand)]
    return [integrand]


def _has_normal(integrand: Expr) -> bool:
    return any(isinstance(t, ufl.FacetNormal) for t in traverse_unique_terminals(integrand))


def _parts(domain: mesh.Mesh, integral: Any) -> tuple[Array, LocalIndices] | None:
    """The vertices and the owned cells of what an integral is over; None for other kinds."""
    data, numbers = integral.subdomain_data(), _numbers(integral)
    kind, topology = integral.integral_type(), domain.topology
    everywhere = _is_everywhere(integral)
    if kind not in ("cell", "exterior_facet"):
        return None
    if kind == "cell":
        cells = owned_cells(domain) if everywhere else _entities(data, numbers)
        cells = cells[cells < topology.index_map(topology.dim).size_local]
        x = np.asarray(domain.geometry.x[:, : domain.geometry.dim], dtype=np.float64)
        return x[domain.geometry.dofmap[cells]], cells
    if everywhere:
        pairs = facet_cells(domain, boundary_facets(domain))
    elif isinstance(data, mesh.MeshTags):
        facets = np.intersect1d(_entities(data, numbers), boundary_facets(domain))
        pairs = facet_cells(domain, facets.astype(np.int32))
    else:
        pairs = _entities(data, numbers).reshape(-1, 2)
        pairs = pairs[pairs[:, 0] < topology.index_map(topology.dim).size_local]
    return _on_facets(domain, pairs)


def _numbers(integral: Any) -> tuple[Any, ...]:
    number_ = integral.subdomain_id()
    return number_ if isinstance(number_, tuple) else (number_,)


def _is_everywhere(integral: Any) -> bool:
    numbered = all(isinstance(k, int | np.integer) for k in _numbers(integral))
    return integral.subdomain_data() is None or not numbered


def _entities(data: Any, numbers: tuple[int, ...]) -> LocalIndices:
    """The entities with some numbers, of tags or of pairs of numbers and entities."""
    if isinstance(data, mesh.MeshTags):
        found = [data.find(int(k)) for k in numbers]
    else:
        found = [np.asarray(entities).ravel() for k, entities in data if k in numbers]
    return np.concatenate([np.empty(0, dtype=np.int32), *found]).astype(np.int32)


def _on_facets(domain: mesh.Mesh, pairs: LocalIndices) -> tuple[Array, LocalIndices]:
    """The vertices and cells of facets, which are given by cells and local numbers."""
    x = np.asarray(domain.geometry.x[:, : domain.geometry.dim], dtype=np.float64)
    nodes = domain.geometry.dofmap[pairs[:, :1], facet_vertices(domain)[pairs[:, 1]]]
    return x[nodes], pairs[:, 0]
