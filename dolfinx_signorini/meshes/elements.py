"""Continuous piecewise polynomials in a basis whose coefficients bound the polynomial.

In the Bernstein basis the functions are non-negative and add up to 1, so that a polynomial lies
between its smallest and its largest coefficient. Coefficients that are not below those of the
obstacle keep the polynomial above the obstacle at every point, and not only at nodes.

Each coefficient belongs to a control point: the dofs of the Bernstein basis and the nodes of
equidistant interpolation have the same places and numbers.

Sources: Lai and Schumaker, Spline functions on triangulations, Cambridge (2007), Chapter 2;
Ainsworth, Andriamaro and Davydov, SIAM J. Sci. Comput. 33 (2011) 3087-3109.
"""

import functools
from collections.abc import Iterator
from typing import Any
from weakref import WeakKeyDictionary

import basix
import basix.ufl
import numpy as np
from dolfinx import fem, mesh

from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.kinds import check, integer, sequence, simplices
from dolfinx_signorini.base.ranks import shared, summed
from dolfinx_signorini.base.tolerances import ROUNDING, SOLVED

HIGHEST_DEGREE = 4  # that problems are tested with
# Of references for these problems. Higher degrees are of no use, and their tables fill the memory.
LARGEST_DEGREE = 2 * HIGHEST_DEGREE

_element = functools.cache(basix.ufl.element)
# By mesh and degree; spaces in Python would keep their mesh for ever.
_numbered: WeakKeyDictionary[mesh.Mesh, dict[int, Any]] = WeakKeyDictionary()


def bernstein_space(
    domain: mesh.Mesh, degree: int, shape: tuple[int, ...] = ()
) -> fem.FunctionSpace:
    """Return the continuous piecewise polynomials in the Bernstein basis.

    `fem.dirichletbc` takes a function of this space, and no number: from degree 2 on coefficients
    are no values.

    Args:
        domain: A mesh of triangles or tetrahedra.
        degree: The polynomial degree, 1 to 8; of degree 1 the basis is that of Lagrange elements.
        shape: The shape of the values: (2,) or (3,) for displacements, () for scalars.

    Raises:
        InputError: The mesh has other cells, or the degree or the shape is another one.
    """
    sizes = sequence(integer(1), "a tuple of numbers")
    check(
        domain=(domain, simplices(2, 3)),
        degree=(degree, integer(1, LARGEST_DEGREE)),
        shape=(shape, sizes),
    )
    kinds = basix.LagrangeVariant
    return lagrange_space(
        domain, degree, kinds.gll_warped if degree == 1 else kinds.bernstein, tuple(shape)
    )


def lagrange_space(
    domain: mesh.Mesh, degree: int, variant: basix.LagrangeVariant, shape: tuple[int, ...] = ()
) -> fem.FunctionSpace:
    """Return the continuous piecewise polynomials in the basis of a variant.

    Args:
        domain: The mesh.
        degree: The polynomial degree.
        variant: Basix's name of the basis.
        shape: The shape of the values.
    """
    cell, size = domain.topology.cell_name(), shape or None
    element = _element("Lagrange", cell, degree, lagrange_variant=variant, shape=size)
    return fem.functionspace(domain, element)


def discontinuous_space(domain: mesh.Mesh, degree: int) -> fem.FunctionSpace:
    """Return the piecewise polynomials of a degree that may jump, whose dofs a mesh numbers once.

    Args:
        domain: The mesh; the call is collective.
        degree: The polynomial degree; of degree 0 the functions are constant in each cell.
    """
    element = _element("DG", domain.topology.cell_name(), degree)
    numbered = _numbered.setdefault(domain, {})
    if degree not in numbered:
        numbered[degree] = fem.functionspace(domain, element)._cpp_object
    return fem.FunctionSpace(domain, element, numbered[degree])


def is_bernstein(space: fem.FunctionSpace) -> bool:
    """Return whether the basis of a space is the Bernstein basis of a degree above 1."""
    element = space.element.basix_element
    return bool(element.lagrange_variant == basix.LagrangeVariant.bernstein and element.degree > 1)


def nodal_space(space: fem.FunctionSpace) -> fem.FunctionSpace:
    """Return the space with the same dofs and a nodal basis: its nodes are the control points.

    Args:
        space: A space of continuous elements; one with a nodal basis is returned as it is.
    """
    if not is_bernstein(space):
        return space
    nodal: fem.FunctionSpace | None = getattr(space, "_nodal", None)  # each datum asks for it
    if nodal is None:
        degree = space.element.basix_element.degree
        nodal = lagrange_space(space.mesh, degree, basix.LagrangeVariant.equispaced)
        assert np.array_equal(nodal.dofmap.list, space.dofmap.list)
        space._nodal = nodal  # type: ignore[attr-defined]
    return nodal


def control_points(space: fem.FunctionSpace, cells: LocalIndices | None = None) -> Array:
    """Return the places of the dofs of this rank, shape (dofs, 3): nodes or control points.

    A node on an edge lies where the ends of the edge put the node, without the rounding of the
    other corners: on the boundary y = 0 all coordinates y are 0.

    Args:
        space: A scalar space of continuous elements.
        cells: Cells of this rank whose dofs are wanted; None for all. Other places are 0.
    """
    geometry = space.mesh.geometry
    if cells is None and np.array_equal(space.dofmap.list, geometry.dofmap):
        return np.array(geometry.x, dtype=np.float64)
    dofs = space.dofmap.list if cells is None else space.dofmap.list[cells]
    places = np.zeros((int(space.dofmap.list.max(initial=-1)) + 1, 3))
    for dof, place in zip(dofs.T, _on_cells(space, cells), strict=True):
        places[dof] = place
    return places


def points_on_cells(space: fem.FunctionSpace, cells: LocalIndices) -> Array:
    """Return the places of the dofs of some cells, shape (cells, dofs of a cell, 3).

    Args:
        space: A scalar space of continuous elements.
        cells: The cells.
    """
    return np.stack(list(_on_cells(space, cells)), axis=1)


def _on_cells(space: fem.FunctionSpace, cells: LocalIndices | None) -> Iterator[Array]:
    """The places on cells of one dof of the cells after the other, shape (cells, 3)."""
    geometry = space.mesh.geometry
    nodes = geometry.dofmap if cells is None else geometry.dofmap[cells]
    for shares in _shares(space):
        yield sum(shares[k] * geometry.x[nodes[:, k]] for k in np.flatnonzero(shares))


def _shares(space: fem.FunctionSpace) -> Array:
    """The values of the functions of the geometry at the dofs of a cell, one row for each dof."""
    element = space.mesh.ufl_domain().ufl_coordinate_element().sub_elements[0]
    shares = np.array(element.tabulate(0, control_lattice(space))[0])
    for exact in (0.0, 1.0):
        shares[np.abs(shares - exact) < SOLVED] = exact
    return shares


def control_lattice(space: fem.FunctionSpace) -> Array:
    """Return the places of the dofs of a cell in the reference cell, shape (dofs, coordinates).

    Args:
        space: A space of continuous elements.
    """
    element = space.element.basix_element
    if is_bernstein(space):
        element = _nodal_element(element.cell_type, element.degree)
    return np.asarray(element.points)


def values_at_control_points(space: fem.FunctionSpace, coefficients: Array) -> Array:
    """Return the values of a function at the places of its dofs.

    Args:
        space: The space of the function.
        coefficients: The values of all dofs of this rank.
    """
    return _changed(space, coefficients, None, 0)


def determined(space: fem.FunctionSpace, known: Mask) -> Mask:
    """Tell at the places of which dofs a function has a value that known coefficients determine.

    A nodal value is its coefficient; in the Bernstein basis a value on a facet or in a cell has
    positive shares of all coefficients there.

    Args:
        space: The space of the function.
        known: Whether the coefficient of each dof of this rank is known.
    """
    shares = values_at_control_points(space, np.where(known, 0.0, 1.0))
    return np.asarray(np.abs(shares) <= ROUNDING)


def coefficients_of(
    space: fem.FunctionSpace, values: Array, cells: LocalIndices | None = None
) -> Array:
    """Return the dofs of the function of a space that has given values at their places.

    The coefficients of a facet or an edge depend on the values there alone.

    Args:
        space: The space of the function.
        values: The values at the places of all dofs of this rank.
        cells: Cells of this rank on which the dofs are wanted; None for all. The entries of dofs of
            no such cell are not changed.
    """
    return _changed(space, values, cells, 1)


def tested_at_places(space: fem.FunctionSpace, tested: Array) -> Array:
    """Return a functional of the functions with the value 1 at one place of a dof, and 0 at others.

    The transpose of `coefficients_of`; the call is collective.

    Args:
        space: The space.
        tested: The functional of the basis functions, at all dofs of this rank.
    """
    if not is_bernstein(space):
        return tested
    element, index_map = space.element.basix_element, space.dofmap.index_map
    dofs = space.dofmap.list[: space.mesh.topology.index_map(space.mesh.topology.dim).size_local]
    # Each cell around a place tells its coefficient.
    shares = shared(index_map, dofs, tested)
    return summed(index_map, dofs, shares @ _bases(element.cell_type, element.degree)[1])


def component_arrays(f: fem.Function) -> list[Array]:
    """Return the coefficients of each component of a function, one for each node, as views.

    Args:
        f: The function; a scalar function has one component.
    """
    size = f.function_space.dofmap.bs
    return [f.x.array[k::size] for k in range(size)]


def facet_dofs(space: fem.FunctionSpace, pairs: LocalIndices) -> LocalIndices:
    """Return the dofs of facets, those of the vertices first, shape (facets, dofs of a facet).

    Args:
        space: A scalar space of continuous elements.
        pairs: The cells of the facets, and the numbers of the facets in these cells.
    """
    element = space.element.basix_element
    closures = np.array(element.entity_closure_dofs[space.mesh.topology.dim - 1])
    return np.asarray(space.dofmap.list[pairs[:, :1], closures[pairs[:, 1]]])


def facet_pieces(
    space: fem.FunctionSpace, pairs: LocalIndices
) -> tuple[LocalIndices, LocalIndices]:
    """Return pieces of facets between dofs: segments in the plane, and triangles in space.

    Args:
        space, pairs: See `facet_dofs`.

    Returns:
        The dofs of each piece, shape (pieces, dimension), and the facet of each piece. In the plane
        the pieces lie between neighbouring dofs, in space between the vertices of the facets.
    """
    dofs, dim = facet_dofs(space, pairs), space.mesh.topology.dim
    if dim == 2:
        chain = np.column_stack((dofs[:, :1], dofs[:, 2:], dofs[:, 1:2]))  # along each facet
        parts = [chain[:, i : i + 2] for i in range(chain.shape[1] - 1)]
    else:
        quadrilaterals = space.element.basix_element.cell_type == basix.CellType.hexahedron
        parts = [dofs[:, corners] for corners in ([0, 1, 2], [1, 3, 2])[: 1 + quadrilaterals]]
    return np.concatenate(parts), np.tile(np.arange(len(pairs), dtype=np.int32), len(parts))


def bernstein_at_nodes(space: fem.FunctionSpace, dim: int) -> Array:
    """Return the values of the Bernstein polynomials at the nodes of each facet, or of the cell.

    Args:
        space: A space with a nodal basis on triangles or tetrahedra.
        dim: The dimension of facets or cells.

    Returns:
        Shape (entities of the dimension in a cell, nodes of an entity, polynomials of the entity).
    """
    element = space.element.basix_element
    values = _bernstein_at(element.cell_type, element.degree, element.points)
    return np.array([values[np.ix_(dofs, dofs)] for dofs in element.entity_closure_dofs[dim]])


@functools.cache
def subtriangles(cell: basix.CellType, degree: int) -> LocalIndices:
    """Return the small triangles between the dofs of a cell in the plane, shape (triangles, 3).

    Args:
        cell: Triangles or quadrilaterals.
        degree: The degree of the elements.
    """
    lattice = _nodal_element(cell, degree).points
    places = np.rint(degree * lattice).astype(int)
    number = {(i, j): dof for dof, (i, j) in enumerate(places.tolist())}
    found = []
    for i, j in number:
        for corners in (((i, j), (i + 1, j), (i, j + 1)), ((i, j), (i - 1, j), (i, j - 1))):
            if all(corner in number for corner in corners):
                found.append([number[corner] for corner in corners])
    return np.array(found, dtype=np.int32)


def _changed(
    space: fem.FunctionSpace, entries: Array, cells: LocalIndices | None, way: int
) -> Array:
    if not is_bernstein(space):
        return entries
    element = space.element.basix_element
    matrix = _bases(element.cell_type, element.degree)[way]
    dofs = space.dofmap.list if cells is None else space.dofmap.list[cells]
    result = entries.copy()
    result[dofs] = entries[dofs] @ matrix.T
    return result


@functools.cache
def _nodal_element(cell: basix.CellType, degree: int) -> Any:
    family, variant = basix.ElementFamily.P, basix.LagrangeVariant.equispaced
    return basix.create_element(family, cell, degree, variant)


@functools.cache
def _bases(cell: basix.CellType, degree: int) -> tuple[Array, Array]:
    """The matrix from coefficients to values at control points, and its inverse."""
    values = _bernstein_at(cell, degree, _nodal_element(cell, degree).points)
    inverse: Array = np.asarray(np.linalg.inv(values), dtype=np.float64)
    inverse[np.abs(inverse) < SOLVED] = 0.0
    return values, inverse


def _bernstein_at(cell: basix.CellType, degree: int, points: Array) -> Array:
    """The Bernstein polynomials at points of a reference cell, one column each."""
    family, variant = basix.ElementFamily.P, basix.LagrangeVariant.bernstein
    values = np.array(basix.create_element(family, cell, degree, variant).tabulate(0, points))
    values[np.abs(values) < SOLVED] = 0.0
    return np.asarray(values[0, :, :, 0], dtype=np.float64)
