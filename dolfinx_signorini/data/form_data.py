"""The data of forms in UFL: formulas with the cells or facets that they are on.

Summands that depend on finite element functions are left out.
"""

from collections.abc import Iterator
from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
import ufl
from dolfinx import mesh
from ufl import classes
from ufl.core.expr import Expr
from ufl.corealg.traversal import unique_pre_traversal

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.data.formulas import ONE, Formula
from dolfinx_signorini.data.reading import formula_of
from dolfinx_signorini.data.readings import Reading
from dolfinx_signorini.data.sampling import DEGREE, Datum
from dolfinx_signorini.meshes.sided_meshes import (
    boundary_facets,
    cell_corners,
    facet_cells,
    facet_vertices,
    owned_cells,
)

NAMES = {  # of data of forms, by the kind of integral and the number of arguments
    ("cell", 1): "the load",
    ("cell", 2): "the coefficient",
    ("exterior_facet", 1): "the flux",
    ("exterior_facet", 2): "the coefficient on the boundary",
}


def form_data(form: ufl.Form) -> Iterator[Datum]:
    """Yield the data of a form that depend on the coordinates, as far as they are readable."""
    space, reading = form.arguments()[0].ufl_function_space(), Reading(form)
    domain, degree = space.mesh, max(DEGREE, space.element.basix_element.degree)
    for i, integral in enumerate(form.integrals()):
        kind = integral.integral_type()
        name = NAMES.get((kind, len(form.arguments())))
        if name is None:
            continue
        parts = _parts(domain, integral)
        for formula in _formulas(reading, i, domain.geometry.dim, space.dofmap.bs):
            if formula.constant is None:
                yield Datum(name, formula, "mass", degree if kind == "cell" else DEGREE, *parts)


def choices_in_diffusion(a: ufl.Form) -> Iterator[tuple[Expr, Formula, Array]]:
    """Yield the outermost conditionals in the diffusion of a form, as far as they are readable.

    With each conditional come its formula and the vertices of the owned cells that its integral is
    over.
    """
    domain, reading = a.arguments()[0].ufl_function_space().mesh, Reading(a)
    for i, integral in enumerate(a.integrals()):
        for place in reading.places(i) if integral.integral_type() == "cell" else []:
            reaction = reading.formula(place, [0, 0])
            if reaction is None or reaction.constant == 0.0:
                for choice in _outermost_choices(reading.terms[i][place[1]]):
                    if (formula := formula_of(choice)) is not None:
                        yield choice, formula, _cells_of(domain, integral)[0]


def _formulas(reading: Reading, integral: int, dimension: int, size: int) -> Iterator[Formula]:
    """The formulas that an integrand has in front of arguments and their derivatives.

    The arguments have `size` components.
    """
    count, places = len(reading.form.arguments()), reading.places(integral)
    normals = range(dimension if any(map(reading.has_normals, places)) else 1)
    every = combinations_with_replacement(range(size * (dimension + 1)), count)
    for chosen, normal in product(every, normals):
        formula = reading.total(places, chosen, normal)
        diagonal = count > 1 and chosen[0] == chosen[1] >= size
        yield from with_reciprocal(formula) if diagonal else [formula]


def with_reciprocal(entry: Formula) -> list[Formula]:
    """Return an entry of the diagonal of a diffusion, and its reciprocal if that is no constant.

    A thin layer that lets nothing through is narrow in the reciprocal only.
    """
    if entry.constant is not None:
        return [entry]
    return [entry, Formula(f"1/({entry.text})", ONE / entry.root)]


def _outermost_choices(term: Expr) -> list[Expr]:
    """The conditionals of an expression that are in no other one."""
    found = [part for part in unique_pre_traversal(term) if isinstance(part, classes.Conditional)]
    inner = {p for e in found for part in e.ufl_operands for p in unique_pre_traversal(part)}
    return [part for part in found if part not in inner]


def _parts(domain: mesh.Mesh, integral: Any) -> tuple[Array, LocalIndices]:
    """The vertices and the owned cells of the cells or boundary facets that an integral is over."""
    if integral.integral_type() == "cell":
        return _cells_of(domain, integral)
    return on_boundary(domain, facets_of(domain, integral))


def cells_of(domain: mesh.Mesh, integral: Any) -> LocalIndices | None:
    """Return the owned cells that an integral is over; None for all of them."""
    if is_everywhere(integral):
        return None
    cells = _entities(integral)
    return cells[cells < len(owned_cells(domain))]


def facets_of(domain: mesh.Mesh, integral: Any) -> LocalIndices:
    """Return the facets of the boundary that an integral is over, as far as this rank has them."""
    boundary = boundary_facets(domain)
    if is_everywhere(integral):
        return boundary
    facets = _entities(integral)
    if not isinstance(integral.subdomain_data(), mesh.MeshTags):
        dim = domain.topology.dim
        domain.topology.create_connectivity(dim, dim - 1)
        links = domain.topology.connectivity(dim, dim - 1)
        facets = links.array.reshape(links.num_nodes, -1)[tuple(facets.reshape(-1, 2).T)]
    return np.intersect1d(facets, boundary).astype(np.int32)


def _cells_of(domain: mesh.Mesh, integral: Any) -> tuple[Array, LocalIndices]:
    cells = cells_of(domain, integral)
    return on_cells(domain, owned_cells(domain) if cells is None else cells)


def _numbers(integral: Any) -> tuple[Any, ...]:
    number_ = integral.subdomain_id()
    return number_ if isinstance(number_, tuple) else (number_,)


def is_everywhere(integral: Any) -> bool:
    """Return whether an integral is over all cells or facets of its kind."""
    numbered = all(isinstance(k, int | np.integer) for k in _numbers(integral))
    return integral.subdomain_data() is None or not numbered


def _entities(integral: Any) -> LocalIndices:
    """The entities with the numbers of an integral, of tags or of pairs of numbers and entities."""
    data, numbers = integral.subdomain_data(), _numbers(integral)
    if isinstance(data, mesh.MeshTags):
        found = [data.find(int(k)) for k in numbers]
    else:
        found = [np.asarray(entities).ravel() for k, entities in data if k in numbers]
    return np.concatenate([np.empty(0, dtype=np.int32), *found]).astype(np.int32)


def on_cells(domain: mesh.Mesh, cells: LocalIndices) -> tuple[Array, LocalIndices]:
    """Return the vertices of cells, shape (cells, vertices, dimension), and the cells."""
    return cell_corners(domain, cells), cells


def on_boundary(domain: mesh.Mesh, facets: LocalIndices) -> tuple[Array, LocalIndices]:
    """Return the vertices of those facets that are on the boundary and owned, and their cells."""
    own = np.intersect1d(facets, boundary_facets(domain)).astype(np.int32)
    pairs = facet_cells(domain, own)
    x = np.asarray(domain.geometry.x[:, : domain.geometry.dim], dtype=np.float64)
    nodes = domain.geometry.dofmap[pairs[:, :1], facet_vertices(domain)[pairs[:, 1]]]
    return x[nodes], pairs[:, 0]
