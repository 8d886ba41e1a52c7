"""Data that are not smooth inside boundary facets, as `jumps` has them for cells."""

import math
from collections.abc import Sequence
from itertools import combinations

import basix
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import mesh
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices
from dolfinx_signorini.base.ranks import function_with, highest, largest
from dolfinx_signorini.base.tolerances import HALVINGS, ROUNDING, SOLVED, TINY
from dolfinx_signorini.data.formulas import Formula, evaluated
from dolfinx_signorini.data.interfaces.interface import inner_lattice, interfaces
from dolfinx_signorini.data.interfaces.jumps import Projection
from dolfinx_signorini.data.interfaces.pieces import inside
from dolfinx_signorini.data.interfaces.singular_sets import is_singular
from dolfinx_signorini.meshes.elements import discontinuous_space
from dolfinx_signorini.meshes.polynomials import barycentric
from dolfinx_signorini.meshes.sided_meshes import (
    entity_nodes,
    facet_cells,
    facet_vertices,
    longest_side,
    owned_facets,
)

PARTS = 16  # of an edge, each of which may have a jump


def integrable_on_facets(
    formula: Formula, domain: mesh.Mesh, facets: npt.NDArray[np.int32], degree: int
) -> Expr:
    """Return a formula as an expression that quadrature rules on boundary facets integrate well.

    In the cell of a facet where the formula is not smooth, a function has the projection on the
    facet as its trace, and another function is positive on this facet and 0 on the others.

    Args:
        formula: The formula.
        domain: A mesh of triangles or tetrahedra; the call is collective.
        facets: The boundary facets that the expression is integrated on.
        degree: The degree of the polynomials with which the formula is going to be integrated.
    """
    result = formula.ufl(ufl.SpatialCoordinate(domain))
    if not is_singular(formula):
        return result
    dimension, cell = domain.topology.dim, basix.CellType[domain.topology.cell_name()]
    pairs = facet_cells(domain, np.unique(owned_facets(domain, facets)).astype(np.int32))
    vertices = facet_vertices(domain)
    corners = domain.geometry.x[domain.geometry.dofmap[pairs[:, :1], vertices[pairs[:, 1]]]]
    kind = basix.cell.subentity_types(cell)[dimension - 1][0]
    variant = basix.LagrangeVariant.gll_warped
    element = basix.create_element(basix.ElementFamily.P, kind, degree, variant)
    found, values = Projection(formula, domain, element, corners).coefficients()
    if not domain.comm.allreduce(len(found)):
        return result
    space = discontinuous_space(domain, degree)
    marks = discontinuous_space(domain, dimension)
    for local in range(len(vertices)):
        chosen = pairs[found, 1] == local
        if not domain.comm.allreduce(int(chosen.sum())):
            continue
        cells = pairs[found[chosen], 0]
        on, nodes = _on_facet(space.element.basix_element, vertices[local])
        table = np.array(element.tabulate(0, nodes))[0, :, :, 0]
        trace = function_with(space, space.dofmap.list[cells][:, on], values[chosen] @ table.T)
        shares = barycentric(marks.element.basix_element.points)
        heights = shares[:, vertices[local]].prod(axis=1)
        bubble = function_with(marks, marks.dofmap.list[cells], heights)
        result = ufl.conditional(ufl.gt(bubble, SOLVED), trace, result)
    return result


def _on_facet(
    element: basix.finite_element.FiniteElement, vertices: npt.NDArray[np.int32]
) -> tuple[Indices, Array]:
    """Which nodes of a cell lie on a facet, and their coordinates in the reference facet."""
    shares = barycentric(np.array(element.points))
    on = np.flatnonzero(np.abs(shares[:, vertices].sum(axis=1) - 1.0) <= ROUNDING)
    return on, np.ascontiguousarray(shares[on][:, vertices[1:]])


def jumps_in_cells(formula: Formula, corners: Array) -> bool:
    """Return whether a formula jumps inside of cells of this rank, and has no kink alone.

    Args:
        formula: The formula.
        corners: The corners of the cells, shape (cells, corners, dimension).
    """
    crossed = [curve.crosses(corners) for curve in interfaces(formula)]
    corners = corners[np.any(crossed, axis=0)] if crossed else corners[:0]
    # From the middle of a cell to points everywhere in the cell: an inclusion may touch no edge.
    points = inside(corners, inner_lattice(corners.shape[1] - 1)).swapaxes(0, 1)
    middles = np.broadcast_to(corners.mean(axis=1, keepdims=True), points.shape)
    values = evaluated(formula.root, points)
    size = float(np.abs(values[np.isfinite(values)]).max(initial=0.0))
    return len(jumps_on_edges(formula, np.stack((middles, points), axis=2), size)) > 0


def data_jumps(
    domain: mesh.Mesh, given: Sequence[tuple[Formula, LocalIndices]]
) -> list[tuple[float, ...]]:
    """Return points at which Dirichlet data jump, where no function of finite energy has them.

    The edges of facets are looked at, see `jumps_on_edges`; where tables meet their values are
    compared.

    Args:
        domain: A mesh of straight-sided cells; the call is collective.
        given: The formulas, each with the facets of this rank on which it gives u.
    """
    comm, dim = domain.comm, domain.topology.dim
    nodes = [entity_nodes(domain, dim - 1, facets) for _, facets in given]
    x = np.asarray(domain.geometry.x[:, :dim], dtype=np.float64)
    values = [evaluated(formula.root, x[on]) for (formula, _), on in zip(given, nodes, strict=True)]
    every = np.concatenate([np.empty(0), *(v.ravel() for v in values)])
    every = every[np.isfinite(every)]
    low = -highest(comm, -every)
    size = highest(comm, every) - low
    if not size > TINY:  # data that vanish, or have no digits
        return []
    places: list[Array] = []
    both = np.full((2, len(x)), 0.0)
    for (formula, _), on, v in zip(given, nodes, values, strict=True):
        places.append(jumps_on_edges(formula, x[on[:, list(combinations(range(dim), 2))]], size))
        heights = np.where(np.isfinite(v), v, low) - low
        for row, above in zip(both, (heights, size - heights), strict=True):
            np.maximum(row, largest(domain.geometry.index_map(), on, above), out=row)
    places.append(x[both.sum(axis=0) > (1.0 + SOLVED) * size])
    found = np.concatenate(comm.allgather(np.concatenate([np.empty((0, dim)), *places])))
    digits = 9 - round(math.log10(longest_side(domain)))
    return sorted({tuple(map(float, point)) for point in np.round(found, digits) + 0.0})


def jumps_on_edges(formula: Formula, edges: Array, size: float) -> Array:
    """Return the points on some edges at which a formula jumps.

    Between the points of a lattice on the edges, bisection follows the larger difference: that of a
    continuous function goes to 0.

    Args:
        formula: The formula.
        edges: The edges of some facets or cells, shape (facets, edges, 2, dimension).
        size: The size of the values of the formula.
    """
    ends = edges.reshape(-1, *edges.shape[2:])
    lattice: Array = np.linspace(0.0, 1.0, PARTS + 1, dtype=np.float64)
    part, edge = np.nonzero(_steps(formula, ends, lattice[:, None]) > SOLVED * size)
    ends, low, high = ends[edge], lattice[part], lattice[part + 1]
    steps = []
    for _ in range(HALVINGS):
        first, second = _steps(formula, ends, np.stack((low, 0.5 * (low + high), high)))
        middle, left = 0.5 * (low + high), first >= second
        low, high = np.where(left, low, middle), np.where(left, middle, high)
        steps.append(np.maximum(first, second))
    # A power of the distance goes on falling; a sign has a value of its own between two others.
    stays = (steps[-1] > 0.25 * steps[HALVINGS // 2]) & (steps[-1] > SOLVED * size)
    return np.asarray(_along(ends, high)[stays])


def _along(ends: Array, places: Array) -> Array:
    """Points on edges at shares of the way from the first end, shape (..., edges)."""
    return np.asarray(ends[:, 0] + places[..., None] * (ends[:, 1] - ends[:, 0]))


def _steps(formula: Formula, ends: Array, places: Array) -> Array:
    """The differences of a formula between neighbouring points on edges, without a sign."""
    both: Array = np.asarray(places + np.zeros(len(ends)), dtype=np.float64)
    with np.errstate(invalid="ignore", over="ignore"):  # at poles
        return np.asarray(np.abs(np.diff(evaluated(formula.root, _along(ends, both)), axis=0)))
