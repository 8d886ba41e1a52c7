"""Values at nodes of vectors, and of expressions that jump between cells, such as stresses.

The stress of a displacement of degree k is, for a constant material, of degree k - 1 in each cell,
and the size of a polynomial of degree 1 is largest at a corner: up to degree 2 the largest value at
the nodes of a cell is the largest one in the cell.
"""

import numpy as np
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.ranks import summed
from dolfinx_signorini.data.formula_values import values_at
from dolfinx_signorini.meshes.elements import (
    component_arrays,
    control_lattice,
    values_at_control_points,
)
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.sided_meshes import owned_cells, simplex_sizes


def values_in_cells(space: fem.FunctionSpace, expression: Expr) -> Array:
    """Return the values of an expression at the nodes of each owned cell, as seen from the cell.

    Data that jump where cells meet have the value of the cell.

    Args:
        space: A scalar space of continuous elements, whose nodes are taken; the call is collective.
        expression: A UFL expression of any shape.

    Returns:
        Shape (cells, nodes of a cell, components).
    """
    domain = space.mesh
    at_nodes = Points(domain, owned_cells(domain), control_lattice(space))
    return np.stack(values_at(domain, [expression])(at_nodes), axis=2)


def vectors_at_nodes(space: fem.FunctionSpace, u: fem.Function) -> Array:
    """Return the values of a vector at the nodes, or control points, of this rank, a row for each.

    Args:
        space: The scalar space of one component.
        u: The vector.
    """
    parts = component_arrays(u)
    return np.stack([values_at_control_points(space, part.copy()) for part in parts], axis=1)


def node_averages(space: fem.FunctionSpace, values: Array) -> Array:
    """Return the means at the nodes of values in cells, whose weights are the sizes of the cells.

    Args:
        space: The space of the nodes; the call is collective.
        values: See `values_in_cells`. The size of a quadrilateral or hexahedron is that of the
            simplex of a corner and the next ones.

    Returns:
        Shape (nodes of this rank, components).
    """
    domain, index_map = space.mesh, space.dofmap.index_map
    count, dim = len(owned_cells(domain)), domain.topology.dim
    simplex = domain.topology.cell_name() in ("triangle", "tetrahedron")
    corners = [0, *(k + 1 if simplex else 2**k for k in range(dim))]
    x = domain.geometry.x[domain.geometry.dofmap[:count, corners]]
    dofs, sizes = space.dofmap.list[:count], simplex_sizes(x)[:, None]
    total = summed(index_map, dofs, sizes)
    parts = [summed(index_map, dofs, sizes * part) for part in np.moveaxis(values, 2, 0)]
    return np.stack(parts, axis=1) / total[:, None]
