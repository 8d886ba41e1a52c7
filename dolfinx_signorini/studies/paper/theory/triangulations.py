"""Triangulations of the unit square beside those of Friedrichs and Keller (Remark 4.4, 3).

On obtuse triangles the stiffness matrix has positive entries off its diagonal, so that there is no
discrete maximum principle. Graded triangulations are not quasi-uniform, and excluded by
Assumption 2.5.
"""

import numpy as np
from dolfinx import mesh
from mpi4py import MPI

from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.meshes.angles import cell_angles
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import cell_corners, owned_cells, simplex_sizes
from dolfinx_signorini.norms.orders import grading_exponent
from dolfinx_signorini.scenes.domains.polygons import Polygon
from dolfinx_signorini.studies.paper.solution import DETACHMENT

SHIFT = 0.45  # of a cell: how far the rows of nodes are moved against each other
CORNERS = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))


def unstructured(comm: MPI.Comm, n: int) -> mesh.Mesh:
    """Return a triangulation by gmsh with n edges per side."""
    return Polygon(CORNERS, 1.0 / n).make(comm).mesh


def obtuse(comm: MPI.Comm, n: int) -> mesh.Mesh:
    """Return the Friedrichs-Keller triangulation with every other row of inner nodes moved."""
    domain = friedrichs_keller(comm, n)
    x = domain.geometry.x
    row, column = (np.rint(n * x[:, i]).astype(int) for i in (1, 0))
    inner = (column > 0) & (column < n) & (row > 0) & (row < n)
    x[inner, 0] -= SHIFT / n * (row[inner] % 2)
    return domain


def graded(comm: MPI.Comm, n: int) -> mesh.Mesh:
    """Return a Friedrichs-Keller triangulation drawn towards the detachment point.

    Cells have the size h r^{1 - mu}, and the order of W^{1,inf} is 1 again. The number n of cells
    per side is to be even, so that the point is a node.
    """
    domain = friedrichs_keller(comm, n)
    x = domain.geometry.x
    # Rays to the sides of the square; the maximum norm makes the square one half-ball.
    offset = np.asarray(x[:, :2] - np.array(DETACHMENT), dtype=np.float64)
    size = np.maximum(2.0 * np.abs(offset[:, :1]), offset[:, 1:])
    x[:, :2] = np.array(DETACHMENT) + size ** (1.0 / grading_exponent(1) - 1.0) * offset
    return domain


def shape(domain: mesh.Mesh) -> float:
    """Return the largest diameter of a cell over the smallest one of an inscribed circle."""
    x = cell_corners(domain)
    sides = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2)
    circles = 4.0 * simplex_sizes(x) / sides.sum(axis=1)
    return highest(domain.comm, sides) * highest(domain.comm, 1.0 / circles)


def largest_angle(domain: mesh.Mesh) -> float:
    """Return the largest angle of a cell in degrees."""
    return highest(domain.comm, np.degrees(cell_angles(domain, owned_cells(domain))))
