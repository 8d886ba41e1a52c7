"""Norms of finite element functions cell by cell, and what cells share out."""

import math

import basix
import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, LocalIndices, blocks
from dolfinx_signorini.base.ranks import highest, summed
from dolfinx_signorini.meshes.elements import component_arrays
from dolfinx_signorini.meshes.jacobians import spanned
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.polynomials import equispaced
from dolfinx_signorini.meshes.quadrature import QuadratureRule, interior_rule
from dolfinx_signorini.meshes.sided_meshes import (
    boundary_facets,
    cell_edges,
    facet_cells,
    owned_cells,
)
from dolfinx_signorini.norms.names import Norm
from dolfinx_signorini.norms.pointwise import ErrorAtPoints, Quantity, length
from dolfinx_signorini.norms.power_sums import collected, p_norm, power, total

MAX_DEGREE = 20  # of the quadrature of p-th powers: larger p are integrated roughly


def cell_norms(f: fem.Function, norm: Norm, of: Quantity | None = None) -> Array:
    """Return a norm of a function, or of a quantity, on each owned cell.

    Args:
        f: A function of a Lagrange space on straight-sided triangles or tetrahedra.
        norm: An L^p or W^{1,p} norm of the domain. Sup norms are the largest values at the points
            of a lattice of degree 2k + 4 with the vertices, for functions of degree k.
        of: The quantity of the function whose L^p norm is meant, collective; by default the
            function.
    """
    domain, element = f.function_space.mesh, f.function_space.element.basix_element
    points = equispaced(domain.topology.dim, 2 * element.degree + 4)
    weights: Array = np.ones(1)
    if not math.isinf(norm.p):
        points, weights = rule_of_powers(element, norm.p).points(element.cell_type)
    parts = ErrorAtPoints(f, None, norm.derivatives > 0.0, of)
    found = []
    for cells in blocks_of_cells(domain, len(points)):
        values = parts(Points(domain, cells, points))
        found.append(p_norm(np.transpose([p_norm(v, norm.p, weights) for v in values]), norm.p))
    return np.asarray(np.concatenate(found) * volumes(domain) ** (1.0 / norm.p))


def largest_on_boundary(f: fem.Function) -> Array:
    """Return the largest size of a function on the boundary facets of each owned cell; 0 for none.

    Args:
        f: See `cell_norms`; the points are those of a lattice of the same degree.
    """
    domain, element = f.function_space.mesh, f.function_space.element.basix_element
    pairs = facet_cells(domain, boundary_facets(domain))
    lattice = equispaced(domain.topology.dim - 1, 2 * element.degree + 4)
    sizes = np.abs(length(Points(domain, pairs, lattice).values(f))).max(axis=1, initial=0.0)
    return collected(sizes, pairs[:, 0], len(owned_cells(domain)), math.inf)


def powers_tested(f: fem.Function, p: float) -> fem.Function:
    """Return the integral of |f|^(p-2) f times each basis function, up to a common factor.

    This is the derivative of the L^p norm of the domain at f; the call is collective.

    Args:
        f: A function of a Lagrange space on straight-sided triangles or tetrahedra.
        p: The exponent, from 1 on.
    """
    space, domain = f.function_space, f.function_space.mesh
    element, parts = space.element.basix_element, component_arrays(f)
    points, weights = rule_of_powers(element, p).points(element.cell_type)
    table = element.tabulate(0, points)[0, :, :, 0]
    in_blocks, sizes_of_cells = blocks_of_cells(domain, len(points)), volumes(domain)

    def values_in(cells: LocalIndices) -> list[Array]:
        return [part[space.dofmap.list[cells]] @ table.T for part in parts]

    sizes = [np.abs(length(values_in(cells))).max(initial=0.0) for cells in in_blocks]
    largest = highest(domain.comm, np.array(sizes)) or 1.0  # the others to high powers are nothing
    found = []
    for cells in in_blocks:
        values = [np.asarray(each / largest) for each in values_in(cells)]
        size = np.abs(length(values))
        units = [over(each, size) for each in values]
        factors = weights * over(power(size.copy(), p), size)
        scales = sizes_of_cells[cells, None]
        found.append([scales * ((factors * unit) @ table) for unit in units])
    tested, dofs = fem.Function(space), space.dofmap.list[: len(owned_cells(domain))]
    for result, shares in zip(component_arrays(tested), zip(*found, strict=True), strict=True):
        result[:] = summed(space.dofmap.index_map, dofs, np.concatenate(shares))
    return tested


def over(values: Array, sizes: Array) -> Array:
    """Return values over sizes, and 0 where the size is 0."""
    return np.divide(values, sizes, out=np.zeros_like(values), where=sizes > 0.0)


def blocks_of_cells(domain: mesh.Mesh, rows: int) -> list[LocalIndices]:
    """Return the owned cells in blocks, for so many rows for each cell; at least one block."""
    owned = owned_cells(domain)
    return [owned[part] for part in blocks(len(owned), rows)]


def shared_out(parts: Array, p: float, comm: MPI.Comm) -> Array:
    """Return numbers of cells that add up to the root of the sum of the p-th powers of parts.

    Args:
        parts: One value per owned cell, not negative.
        p: The exponent, from 1 on.
        comm: The communicator of the mesh; the call is collective.
    """
    whole = total(parts, p, comm) or 1.0
    return np.asarray(parts * (parts / whole) ** (p - 1.0))


def volumes(domain: mesh.Mesh) -> Array:
    """Return the volumes of the owned cells, each as a multiple of that of the reference cell."""
    return spanned(cell_edges(domain, owned_cells(domain)))


def summed_at_vertices(domain: mesh.Mesh, values: Array, cells: LocalIndices) -> Array:
    """Return for each vertex the sum of values of cells around the vertex, on all ranks.

    Args:
        domain: A mesh of straight-sided cells, whose nodes are the vertices; the call is
            collective.
        values: One value per cell.
        cells: The owned cells that have the values.
    """
    return summed(domain.geometry.index_map(), domain.geometry.dofmap[cells], values[:, None])


def rule_of_powers(element: basix.finite_element.FiniteElement, p: float) -> QuadratureRule:
    """Return the rule for the p-th powers of functions of an element, with positive weights."""
    exact = math.ceil(p) * element.degree
    return interior_rule(element.cell_type, min(exact, max(MAX_DEGREE, 2 * element.degree)))
