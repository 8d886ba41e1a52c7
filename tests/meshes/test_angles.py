"""Angles of simplices: known ones, and those of mapped domains."""

import numpy as np
import pytest
from mpi4py import MPI

from dolfinx_signorini.meshes.angles import cell_angles
from dolfinx_signorini.meshes.box_meshes import box_mesh
from dolfinx_signorini.meshes.sided_meshes import owned_cells


def single(dim):
    """Return a mesh whose first cell is the reference cell but for the order of its vertices."""
    return box_mesh(MPI.COMM_SELF, [[0.0, 1.0]] * dim)


def test_the_angles_of_a_triangle():
    domain = single(2)
    domain.geometry.x[:, :2] *= [3.0, 4.0]
    for cell, angles in enumerate(cell_angles(domain, owned_cells(domain))):
        x = domain.geometry.x[domain.geometry.dofmap[cell]]
        right = [np.abs(x - point).min() == 0.0 for point in x]
        assert len(right) == 3
        # Each angle is opposite to a side of the length 3, 4 or 5.
        for k in range(3):
            side = np.linalg.norm(x[(k + 1) % 3] - x[(k + 2) % 3])
            assert np.sin(angles[k]) == pytest.approx(side / 5.0, rel=1e-12)


def test_the_angles_between_the_faces_of_tetrahedra_around_an_edge_are_a_full_circle():
    """The six tetrahedra of a cube share a diagonal, and have right angles at its other edges."""
    domain = single(3)
    angles = cell_angles(domain, owned_cells(domain))
    domain.topology.create_connectivity(3, 1)
    edges = domain.topology.connectivity(3, 1).array.reshape(-1, 6)
    around = np.bincount(edges.ravel(), angles.ravel())
    domain.topology.create_connectivity(1, 0)
    ends = domain.topology.connectivity(1, 0).array.reshape(-1, 2)
    lengths = np.zeros(len(around))
    for cell, row in enumerate(edges):
        x = domain.geometry.x[domain.geometry.dofmap[cell]]
        number = dict(zip(domain.topology.connectivity(3, 0).links(cell), range(4), strict=True))
        for edge in row:
            i, j = (number[v] for v in ends[edge])
            lengths[edge] = np.linalg.norm(x[i] - x[j])
    expected = {1: np.pi / 2.0, 2: np.pi, 3: 2.0 * np.pi}
    assert around == pytest.approx([expected[round(size**2)] for size in lengths], rel=1e-12)
