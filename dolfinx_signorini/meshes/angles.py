"""Angles between the faces of simplices: at vertices of triangles, at edges of tetrahedra."""

import basix
import numpy as np
from dolfinx import mesh

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.meshes.jacobians import inverses
from dolfinx_signorini.meshes.sided_meshes import cell_edges


def cell_angles(domain: mesh.Mesh, cells: LocalIndices) -> Array:
    """Return the interior angles of cells, in the order of their vertices or edges.

    Args:
        domain: A mesh of straight-sided triangles or tetrahedra.
        cells: Cells of this rank.

    Returns:
        Radians, shape (cells, 3) for triangles and (cells, 6) for tetrahedra.
    """
    kind, dim = basix.CellType[domain.topology.cell_name()], domain.topology.dim
    # The gradients of the barycentric coordinates are normals of the faces, and point inside.
    slopes = inverses(cell_edges(domain, cells))
    slopes = np.concatenate([-slopes.sum(axis=1, keepdims=True), slopes], axis=1)
    products = slopes @ slopes.transpose(0, 2, 1)
    angles = []
    for vertices in basix.topology(kind)[dim - 2]:
        # The faces that meet at an edge are opposite to the vertices that the edge does not have.
        i, j = sorted(set(range(dim + 1)) - set(vertices))
        cosines = -products[:, i, j] / np.sqrt(products[:, i, i] * products[:, j, j])
        angles.append(np.arccos(np.clip(cosines, -1.0, 1.0)))
    return np.stack(angles, axis=1)
