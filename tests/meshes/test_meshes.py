"""What meshes know of their facets."""

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.base.ranks import largest
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, entity_nodes

COMM = MPI.COMM_WORLD


def test_nodes_of_facets_where_a_rank_may_have_none():
    domain = friedrichs_keller(COMM, 2)
    facets = boundary_facets(domain)
    nodes = entity_nodes(domain, 1, facets)
    x = domain.geometry.x[nodes]
    assert nodes.shape == (len(facets), 2)
    assert np.linalg.norm(x[:, 0] - x[:, 1], axis=1) == pytest.approx(0.5)
    assert entity_nodes(domain, 1, facets[:0]).shape == (0, 2)


def test_the_largest_value_of_all_ranks_around_each_vertex():
    domain = friedrichs_keller(COMM, 5)
    space = fem.functionspace(domain, ("Lagrange", 1))
    cells = domain.topology.index_map(2).size_local
    middles = domain.geometry.x[domain.geometry.dofmap[:cells]].mean(axis=1)
    sizes = np.sin(7.0 * middles[:, 0] + 40.0 * middles[:, 1]) + 2.0
    dofs = space.dofmap.list[:cells]
    found = largest(space.dofmap.index_map, dofs, sizes[:, None])

    middles, sizes = (np.concatenate(COMM.allgather(part)) for part in (middles, sizes))
    corners = np.concatenate(COMM.allgather(domain.geometry.x[domain.geometry.dofmap[:cells]]))
    for place, value in zip(space.tabulate_dof_coordinates(), found, strict=True):
        around = (np.abs(corners - place).max(axis=2) < 1e-9).any(axis=1)
        assert value == sizes[around].max()
