"""Shares and means of the values around dofs and vertices."""

import numpy as np
import pytest
from dolfinx import fem, mesh

from dolfinx_signorini.base.ranks import averaged, shared, summed
from dolfinx_signorini.meshes.sided_meshes import owned_cells


def linear(x):
    return 1.0 + x[0] - 3.0 * x[1]


@pytest.fixture(params=[1, 3])
def space(request, comm):
    return fem.functionspace(mesh.create_unit_square(comm, 6, 5), ("Lagrange", request.param))


def test_shares_of_a_value_add_up_to_the_value(space):
    index_map, f = space.dofmap.index_map, fem.Function(space)
    f.interpolate(linear)
    dofs = space.dofmap.list[: len(owned_cells(space.mesh))]
    sums = summed(index_map, dofs, shared(index_map, dofs, f.x.array))
    np.testing.assert_allclose(sums, f.x.array, rtol=1e-14)


def test_midpoints_around_a_vertex_of_a_lattice_have_the_vertex_as_their_mean(space):
    domain = space.mesh
    vertices, x = domain.geometry.index_map(), domain.geometry.x
    cells = domain.geometry.dofmap[: len(owned_cells(domain))]
    middles = linear(x[cells].mean(axis=1).T)[:, None]
    inside = np.all((x[:, :2] > 0.01) & (x[:, :2] < 0.99), axis=1)
    assert domain.comm.allreduce(int(inside.sum())) >= 20
    means = averaged(vertices, cells, middles)
    np.testing.assert_allclose(means[inside], linear(x[inside].T), atol=1e-14)
    alike = averaged(vertices, cells, np.full((len(cells), 1), 7.0))
    np.testing.assert_allclose(alike, 7.0)  # at corners with a single cell, too
    assert not averaged(vertices, cells[:0], middles[:0]).any()
