"""Refined meshes that go on following curves and curved surfaces where a coefficient jumps.

A bisected facet on a curve has its new vertex on the chord. The vertex is moved onto the curve,
along the gradient of the function whose zeros are the curve; on the boundary of the domain, along
the boundary.
"""

from collections.abc import Sequence

import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.ranks import largest, summed
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.data.formulas import Formula
from dolfinx_signorini.data.interfaces.cutting import planes
from dolfinx_signorini.data.interfaces.interface import Interface, interfaces
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
    vertices = _Vertices(sided)
    for curve in curves:
        vertices.move(curve)
    vertices.store()


class _Vertices:
    """The vertices of a mesh, which are the nodes of its geometry.

    Attributes:
        x: The coordinates of the vertices, shape (vertices, dimension).
        altitudes: The smallest altitude of the cells around each.
        normals: The mean of n n^T over the boundary facets around, 0 inside.
        free: Whether the boundary facets around a vertex are in a plane and on the same sides.
    """

    def __init__(self, sided: SidedMesh):
        self.domain, self.dimension = sided.mesh, sided.mesh.topology.dim
        self.places = self.domain.geometry.index_map()
        self.x: Array = np.array(self.domain.geometry.x[:, : self.dimension], dtype=np.float64)
        # The gradients of the barycentric coordinates are as long as altitudes are short.
        cells = owned_cells(self.domain)
        inverse, corners = (
            np.linalg.inv(cell_edges(self.domain, cells)),
            self.domain.geometry.dofmap,
        )
        steep = np.linalg.norm(inverse, axis=2).max(axis=1, initial=0.0)
        steepest = np.repeat(steep, corners.shape[1])
        self.altitudes = 1.0 / largest(self.places, corners[cells].ravel(), steepest)
        facets = boundary_facets(self.domain)
        nodes = facet_nodes(self.domain, facets)
        numbers = summed(self.places, nodes)

        def mean(values: Array) -> Array:
            return np.asarray(
                summed(self.places, nodes, values[:, None]) / np.maximum(numbers, 1.0)
            )

        self.normals, self.free = planes(self.x[nodes], sided.combinations(facets)[1], mean)

    def move(self, curve: Interface) -> None:
        """Move the vertices near an interface onto it."""
        value, slope = curve.values(self.x), curve.gradients(self.x)
        slope -= np.einsum("vij,vj->vi", self.normals, slope)
        with np.errstate(all="ignore"):
            steps = NEAR * self.altitudes * np.sign(value) / np.linalg.norm(slope, axis=1)
            ends = self.x - steps[:, None] * slope
        crossing = np.flatnonzero(self.free & (value * curve.values(ends) < 0.0))
        shares = curve.zeros(self.x[crossing], ends[crossing])
        far = shares > SOLVED
        chosen, shares = crossing[far], shares[far, None]
        self.x[chosen] += shares * (ends[chosen] - self.x[chosen])

    def store(self) -> None:
        """Give the mesh the vertices, those of the ranks that own them."""
        own = np.arange(self.places.size_local)
        for k in range(self.dimension):
            self.domain.geometry.x[:, k] = summed(self.places, own, self.x[own, k])
