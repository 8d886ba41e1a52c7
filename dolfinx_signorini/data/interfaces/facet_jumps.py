"""Data that are not smooth inside boundary facets, as `jumps` has them for cells."""

import basix
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, mesh
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array, Indices
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.data.formulas import Formula
from dolfinx_signorini.data.interfaces.jumps import Projection
from dolfinx_signorini.data.interfaces.singular_sets import is_singular
from dolfinx_signorini.meshes.polynomials import barycentric
from dolfinx_signorini.meshes.sided_meshes import facet_cells, facet_vertices


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
    owned = facets < domain.topology.index_map(dimension - 1).size_local
    pairs = facet_cells(domain, np.unique(facets[owned]).astype(np.int32))
    vertices = facet_vertices(domain)
    corners = domain.geometry.x[domain.geometry.dofmap[pairs[:, :1], vertices[pairs[:, 1]]]]
    kind = basix.cell.subentity_types(cell)[dimension - 1][0]
    variant = basix.LagrangeVariant.gll_warped
    element = basix.create_element(basix.ElementFamily.P, kind, degree, variant)
    found, values = Projection(formula, domain, element, corners).coefficients()
    space = fem.functionspace(domain, ("DG", degree))
    marks = fem.functionspace(domain, ("DG", dimension))
    for local in range(len(vertices)):
        chosen = pairs[found, 1] == local
        if not domain.comm.allreduce(int(chosen.sum())):
            continue
        cells = pairs[found[chosen], 0]
        trace, bubble = fem.Function(space), fem.Function(marks)
        on, nodes = _on_facet(space.element.basix_element, vertices[local])
        table = np.array(element.tabulate(0, nodes))[0, :, :, 0]
        trace.x.array[space.dofmap.list[cells][:, on]] = values[chosen] @ table.T
        shares = barycentric(marks.element.basix_element.points)
        bubble.x.array[marks.dofmap.list[cells]] = shares[:, vertices[local]].prod(axis=1)
        for function in (trace, bubble):
            function.x.scatter_forward()
        result = ufl.conditional(ufl.gt(bubble, SOLVED), trace, result)
    return result


def _on_facet(
    element: basix.finite_element.FiniteElement, vertices: npt.NDArray[np.int32]
) -> tuple[Indices, Array]:
    """Which nodes of a cell lie on a facet, and their coordinates in the reference facet."""
    shares = barycentric(np.array(element.points))
    on = np.flatnonzero(np.abs(shares[:, vertices].sum(axis=1) - 1.0) < 1e-12)
    return on, np.ascontiguousarray(shares[on][:, vertices[1:]])
