"""Errors of single cells, and orders that are lost, as the highest derivatives of a solution tell.

Let w be the solution of degree k on the mesh with every cell divided, and I w its interpolation on
the undivided mesh. On each part of a cell the derivatives of order k of w are constant. These
derivatives differ from those of I w by about h/2 times D^{k+1} u, where h is an edge of the part.
On an interval of length h interpolation with degree k leaves

    c h^{k+1} |D^{k+1} u|,     c = || x (x - 1/k) ... (x - 1) || / (k+1)!  for x between 0 and 1,

of the values of u, where the norm is L^p on (0, 1) and means an average in L^p of the interval, and
c' h^k |D^{k+1} u| of the first derivatives at most, with c' = 1 / ((k+1) k^k). If u bends more in
one part of a cell than in the others, the derivatives of this part tell so, and the size of w - I w
on the whole cell does not.

Around a singular point, where u is like r^a, the derivatives of order k grow by the factor
2^(k - a) in a division, and the error in energy falls by 2^-a and not by 2^-k: k - a is the order
that is lost. Of a smooth solution these derivatives change the less, the smaller the cells are.

Source: Davis, Interpolation and Approximation, Blaisdell (1963), Theorem 3.1.1.
"""

import math
from itertools import product

import basix
import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh

from dolfinx_signorini.accuracy.cells import blocks_of_cells, volumes
from dolfinx_signorini.accuracy.terms import difference
from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.ranks import largest
from dolfinx_signorini.meshes.elements import component_arrays
from dolfinx_signorini.meshes.jacobians import inverses
from dolfinx_signorini.meshes.sided_meshes import cell_edges, owned_cells
from dolfinx_signorini.norms.pointwise import length
from dolfinx_signorini.norms.power_sums import collected, p_norm

EXCESS = 2.5  # for half an edge 2, and what elements leave beyond interpolation
SAMPLES = 1001  # of a polynomial, for its norm on the interval


def left_by_derivatives(detail: fem.Function, derivatives: float, p: float) -> Array:
    """Estimate the L^p norm of the error of a solution on each owned cell, or of its derivatives.

    Args:
        detail: The difference w - I w, a function of a Lagrange space on straight-sided cells.
        derivatives: 0 for values, 1 for first derivatives, of which the sup norm is estimated.
        p: The exponent.
    """
    degree, domain = detail.function_space.element.basix_element.degree, detail.function_space.mesh
    if derivatives:
        share = 1.0 / ((degree + 1) * degree**degree)
    else:
        values = np.polyval(np.poly(np.arange(degree + 1) / degree), np.linspace(0.0, 1.0, SAMPLES))
        share = float(p_norm(values, p, 1.0 / SAMPLES)) / math.factorial(degree + 1)
    sizes = volumes(domain) / math.factorial(domain.topology.dim)
    return EXCESS * share * highest_derivatives(detail, derivatives) * sizes ** (1.0 / p)


def highest_derivatives(f: fem.Function, derivatives: float) -> Array:
    """Return the sizes of the derivatives of the order k of the degree, times h^(k - derivatives).

    Args:
        f, derivatives: See `left_by_derivatives`.
    """
    space, domain = f.function_space, f.function_space.mesh
    element, dim = space.element.basix_element, domain.topology.dim
    degree = element.degree
    table = element.tabulate(degree, np.zeros((1, dim)))[:, 0, :, 0]
    directions = product(range(dim), repeat=degree)
    rows = table[[basix.index(*map(d.count, range(dim))) for d in directions]]
    found = []
    for block in blocks_of_cells(domain, dim**degree):
        edges = cell_edges(domain, block)
        size = np.linalg.norm(edges, axis=1).max(axis=1)
        maps = size[:, None, None] * inverses(edges)
        dofs = space.dofmap.list[block]
        sizes = []
        for part in component_arrays(f):
            values = part[dofs] @ rows.T
            for _ in range(degree):  # from directions of the reference cell to coordinates
                values = values.reshape(len(block), dim, dim ** (degree - 1))
                values = np.swapaxes(values, 1, 2) @ maps
            sizes.append(np.linalg.norm(values.reshape(len(block), dim**degree), axis=1))
        found.append(length(sizes) / size**derivatives)
    return np.concatenate(found)


def lost_order(f: fem.Function, detail: fem.Function, domain: Mesh, parents: LocalIndices) -> Array:
    """Tell how much order is lost, as the growth of the highest derivatives has it; collective.

    A cell counts as the worst of its vertices, and a vertex as the cells around: a singular point
    is seen from the next cells, too, and derivatives that vanish in one cell by chance do not look
    like growth.

    Args:
        f: The function, of a Lagrange space on straight-sided cells, each one a part of a cell.
        detail: What f has beyond its interpolation on the undivided cells.
        domain: The mesh of the undivided cells.
        parents: The undivided cell around each owned cell.

    Returns:
        For each owned cell of `domain` the logarithm to the base 2 of the growth.
    """
    cells, degree = owned_cells(domain), f.function_space.element.basix_element.degree
    around, sizes = domain.geometry.dofmap[cells], []
    for part in (detail, difference(f, detail)):
        derivatives = highest_derivatives(part, degree)
        on_cells = collected(derivatives, parents, len(cells), math.inf)
        values = np.broadcast_to(on_cells[:, None], around.shape)
        sizes.append(largest(domain.geometry.index_map(), around, values)[around])
    with np.errstate(all="ignore"):
        lost = np.log2(1.0 + sizes[0] / sizes[1])
    return np.asarray(np.where(sizes[0] > 0.0, lost, 0.0).max(axis=1, initial=0.0))
