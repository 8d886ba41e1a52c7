"""Refined meshes that go on following curves and curved surfaces where a coefficient jumps.

A bisected facet on a curve has its new vertex on the chord. The vertex is moved onto the curve,
along the gradient of the function whose zeros are the curve; on the boundary of the domain, along
the boundary.
"""

from collections.abc import Sequence

import numpy as np
from dolfinx import mesh

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.ranks import averaged, largest, summed
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.data.formulas import Formula
from dolfinx_signorini.data.interfaces.cutting import planes
from dolfinx_signorini.data.interfaces.interface import interfaces
from dolfinx_signorini.meshes.sided_meshes import (
    SidedMesh,
    boundary_facets,
    cell_edges,
    facet_nodes,
    owned_cells,
)

NEAR = 0.25  # of the altitudes of the cells around: vertices that far from a curve are moved


def follow(sided: SidedMesh, formulas: Sequence[Formula]) -> None:
    """Move vertices onto the curves next to them; the call is collective.

    Args:
        sided: The mesh with its sides, whose vertices are moved unless cells belong to regions.
        formulas: The formulas that jump at the curves.
    """
    curves = interfaces(*formulas)
    if not curves or sided.regions:
        return
    domain, dimension = sided.mesh, sided.mesh.topology.dim
    x: Array = np.array(domain.geometry.x[:, :dimension], dtype=np.float64)
    altitudes, (normals, free) = _altitudes(domain), _planes(sided, x)
    for curve in curves:
        value, slope = curve.values(x), curve.gradients(x)
        slope -= np.einsum("vij,vj->vi", normals, slope)
        with np.errstate(all="ignore"):
            steps = NEAR * altitudes * np.sign(value) / np.linalg.norm(slope, axis=1)
            ends = x - steps[:, None] * slope
        crossing = np.flatnonzero(free & (value * curve.values(ends) < 0.0))
        shares = curve.zeros(x[crossing], ends[crossing])
        far = shares > SOLVED
        chosen, shares = crossing[far], shares[far, None]
        x[chosen] += shares * (ends[chosen] - x[chosen])
    places = domain.geometry.index_map()
    own = np.arange(places.size_local)  # ghosts get what their owners have
    for k in range(dimension):
        domain.geometry.x[:, k] = summed(places, own, x[own, k])


def _altitudes(domain: mesh.Mesh) -> Array:
    """The smallest altitude of the cells around each vertex.

    The gradients of the barycentric coordinates are as long as altitudes are short.
    """
    cells = owned_cells(domain)
    corners = domain.geometry.dofmap[cells]
    inverse = np.linalg.inv(cell_edges(domain, cells))
    steep = np.linalg.norm(inverse, axis=2).max(axis=1, initial=0.0)
    steepest = np.repeat(steep, corners.shape[1])
    return np.asarray(1.0 / largest(domain.geometry.index_map(), corners.ravel(), steepest))


def _planes(sided: SidedMesh, x: Array) -> tuple[Array, Mask]:
    """The planes of the boundary at vertices with coordinates x, see `planes`."""
    places, facets = sided.mesh.geometry.index_map(), boundary_facets(sided.mesh)
    nodes = facet_nodes(sided.mesh, facets)

    def mean(values: Array) -> Array:
        return averaged(places, nodes, values[:, None])

    return planes(x[nodes], sided.combinations(facets)[1], mean)
