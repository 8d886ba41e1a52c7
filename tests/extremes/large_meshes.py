"""Meshes with thousands of nodes: a corner, a slit, obtuse cells, flat cells."""

from collections.abc import Callable

import basix.ufl
import numpy as np
import numpy.typing as npt
from dolfinx import mesh
from large import Array
from mpi4py import MPI
from scipy.spatial import Delaunay

from dolfinx_signorini.meshes.box_meshes import friedrichs_keller

Cells = npt.NDArray[np.int64]


def unit_square(n: int) -> mesh.Mesh:
    """The unit square with n cells per side, on all ranks."""
    return friedrichs_keller(MPI.COMM_WORLD, n)


def stretched(height: float) -> Callable[[int], mesh.Mesh]:
    """Return a function that makes rectangles of a height and the width 1 with n x n cells."""

    def make(n: int) -> mesh.Mesh:
        domain = unit_square(n)
        domain.geometry.x[:, 1] *= height
        return domain

    return make


def unit_cube(n: int) -> mesh.Mesh:
    """The unit cube with n cells per side, on all ranks."""
    return mesh.create_unit_cube(MPI.COMM_WORLD, n, n, n)


def corner(n: int) -> mesh.Mesh:
    """The unit square without its upper right quarter."""
    points, cells = _grid(n)
    return _mesh_of(points, cells[(points[cells].mean(axis=1) < 0.5).any(axis=1)])


def slit(n: int) -> mesh.Mesh:
    """The unit square, cut open from (1/2, 1/2) to (1, 1/2)."""
    points, cells = _grid(n)
    cut = np.flatnonzero((np.abs(points[:, 1] - 0.5) < 1e-12) & (points[:, 0] > 0.5 + 1e-12))
    upper = np.arange(len(points))
    upper[cut] = len(points) + np.arange(len(cut))
    above = points[cells].mean(axis=1)[:, 1] > 0.5
    cells[above] = upper[cells[above]]
    return _mesh_of(np.vstack([points, points[cut]]), cells)


def obtuse(count: int, height: float) -> mesh.Mesh:
    """The Delaunay triangulation of random points in the unit square, flattened to a height."""
    side = int(np.sqrt(count))
    e = np.arange(side) / side
    sides = ((e, 0 * e), (0 * e + 1.0, e), (1.0 - e, 0 * e + 1.0), (0 * e, 1.0 - e))
    inside = np.random.default_rng(1).random((count, 2)) * (1.0 - 1.0 / side) + 0.5 / side
    points = np.vstack([*map(np.column_stack, sides), inside])
    cells = Delaunay(points).simplices.astype(np.int64)
    a, b, c = (points[cells[:, k]].T for k in range(3))
    areas = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
    return _mesh_of(points * (1.0, height), cells[np.abs(areas) > 1e-12])


def largest_angle(domain: mesh.Mesh) -> float:
    """The largest angle of the triangles of a mesh, in degrees."""
    x = domain.geometry.x[domain.geometry.dofmap][:, :, :2]
    largest = 0.0
    for k in range(3):
        p, q = x[:, k - 1] - x[:, k], x[:, k - 2] - x[:, k]
        cross = np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
        largest = max(largest, float(np.arctan2(cross, (p * q).sum(axis=1)).max(initial=0.0)))
    return float(np.degrees(domain.comm.allreduce(largest, op=MPI.MAX)))


def _grid(n: int) -> tuple[Array, Cells]:
    """Nodes and cells of the Friedrichs-Keller triangulation of the unit square."""
    x, y = np.meshgrid(np.arange(n + 1) / n, np.arange(n + 1) / n)
    first = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).reshape(-1, 1)
    right, left = first + np.array([0, 1, n + 2]), first + np.array([0, n + 2, n + 1])
    return np.column_stack([x.ravel(), y.ravel()]), np.concatenate([right, left]).astype(np.int64)


def _mesh_of(points: Array, cells: Cells) -> mesh.Mesh:
    """The mesh of some triangles, shared by all ranks; points of no triangle are left out."""
    comm = MPI.COMM_WORLD
    used, numbers = np.unique(cells, return_inverse=True)
    points, cells = points[used], numbers.reshape(cells.shape)
    if comm.rank > 0:
        points, cells = points[:0], cells[:0]
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    return mesh.create_mesh(comm, cells, x=points, e=element)
