"""The data of a problem that is posed in UFL: formulas with the cells or facets that they are on.

An integrand of L(v) is linear in v and grad v. For v = 1 and grad v = 0 the integrand is the load,
and for v = 0 and a unit vector as grad v a component of what acts on grad v. Integrands of a(u, v)
have the reaction and the entries of the diffusion by the same substitution. Summands that depend on
finite element functions are left out.
"""

from collections.abc import Iterator
from functools import reduce
from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import mesh
from ufl import classes
from ufl.core.expr import Expr
from ufl.corealg.traversal import traverse_unique_terminals

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

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]

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


def _form_data(problem: SignoriniProblem, form: ufl.Form) -> Iterator[Datum]:
    degree = max(DEGREE, problem.space.element.basix_element.degree)
    for integral in lowered(form).integrals():
        kind = integral.integral_type()
        name = NAMES.get((kind, len(form.arguments())))
        parts = _parts(problem.space.mesh, integral)
        if name is None or parts is None:
            continue
        for formula in _coefficients(integral.integrand(), form.arguments(), problem.space.mesh):
            yield Datum(name, formula, "mass", degree if kind == "cell" else DEGREE, *parts)


def _coefficients(
    integrand: Expr, arguments: tuple[ufl.Argument, ...], domain: mesh.Mesh
) -> Iterator[Formula]:
    """The formulas that an integrand has in front of arguments and their derivatives."""
    dimension = domain.geometry.dim
    zero, unit = np.zeros(dimension), np.eye(dimension)
    jets = [(1.0, zero), *((0.0, e) for e in unit)]
    normals = unit if _has_normal(integrand) else unit[:1]
    for chosen, normal in product(combinations_with_replacement(jets, len(arguments)), normals):
        terminals: dict[Expr, Any] = {ufl.FacetNormal(domain): normal}
        for argument, (value, slope) in zip(arguments, chosen, strict=True):
            terminals |= {argument: value, ufl.grad(argument): slope}
        formula = _sum_of_readable(integrand, terminals)
        yield formula
        diagonal = len(chosen) > 1 and chosen[0][1].any() and chosen[0] is chosen[1]
        if diagonal and formula.constant is None:
            # A thin layer that lets nothing through is narrow in the reciprocal only.
            yield Formula(f"1/({formula.text})", number(1.0).root / formula.root)


def _sum_of_readable(integrand: Expr, terminals: Terminals) -> Formula:
    """The sum of the readable summands of an expression."""
    parts = [read(summand, terminals) for summand in _summands(integrand)]
    roots = [part.root for part in parts if part is not None]
    return Formula(str(integrand), reduce(lambda a, b: a + b, roots, number(0.0).root))


def _summands(integrand: Expr) -> list[Expr]:
    if isinstance(integrand, classes.Sum):
        return [term for operand in integrand.ufl_operands for term in _summands(operand)]
    return [integrand]


def _has_normal(integrand: Expr) -> bool:
    return any(isinstance(t, ufl.FacetNormal) for t in traverse_unique_terminals(integrand))


def _parts(domain: mesh.Mesh, integral: Any) -> tuple[Array, Indices] | None:
    """The vertices and the owned cells of what an integral is over; None for other kinds."""
    data, number_ = integral.subdomain_data(), integral.subdomain_id()
    kind, topology = integral.integral_type(), domain.topology
    numbers = number_ if isinstance(number_, tuple) else (number_,)
    everywhere = data is None or not all(isinstance(k, int | np.integer) for k in numbers)
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


def _entities(data: Any, numbers: tuple[int, ...]) -> Indices:
    """The entities with some numbers, of tags or of pairs of numbers and entities."""
    if isinstance(data, mesh.MeshTags):
        found = [data.find(int(k)) for k in numbers]
    else:
        found = [np.asarray(entities).ravel() for k, entities in data if k in numbers]
    return np.concatenate([np.empty(0, dtype=np.int32), *found]).astype(np.int32)


def _on_facets(domain: mesh.Mesh, pairs: Indices) -> tuple[Array, Indices]:
    """The vertices and cells of facets, which are given by cells and local numbers."""
    x = np.asarray(domain.geometry.x[:, : domain.geometry.dim], dtype=np.float64)
    nodes = domain.geometry.dofmap[pairs[:, :1], facet_vertices(domain)[pairs[:, 1]]]
    return x[nodes], pairs[:, 0]
