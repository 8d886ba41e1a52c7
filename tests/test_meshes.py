"""The Friedrichs-Keller triangulation, and how the ranks share it."""

import math

import numpy as np
import pytest
import ufl
from dolfinx import default_scalar_type, fem
from mpi4py import MPI

from dolfinx_signorini.meshes import boundary_facets, entity_nodes, friedrichs_keller

COMM = MPI.COMM_WORLD


@pytest.mark.parametrize("n", [1, 2, 7, 20])
def test_every_cell_has_one_owner_and_every_interior_facet_both_its_cells(n):
    domain = friedrichs_keller(COMM, n)
    topology = domain.topology
    assert topology.index_map(2).size_global == 2 * n * n
    assert topology.index_map(0).size_global == (n + 1) ** 2
    one = fem.Constant(domain, default_scalar_type(1.0))

    def total(integral):
        return COMM.allreduce(fem.assemble_scalar(fem.form(integral)))

    assert total(one * ufl.dx) == pytest.approx(1.0, rel=1e-13)
    assert total(one * ufl.ds) == pytest.approx(4.0, rel=1e-13)
    # The inner grid lines and the diagonals; without its ghost cell a facet would be missing.
    assert total(one("+") * ufl.dS) == pytest.approx(2.0 * (n - 1) + n * math.sqrt(2.0), rel=1e-13)


def test_the_ranks_share_the_cells_evenly_and_alike_in_every_run():
    first, second = (friedrichs_keller(COMM, 24) for _ in range(2))
    cells = first.topology.index_map(2).size_local
    assert abs(cells - 2 * 24**2 / COMM.size) <= 2 * 24
    assert np.array_equal(first.geometry.x, second.geometry.x)
    assert np.array_equal(first.geometry.dofmap, second.geometry.dofmap)


def test_nodes_of_facets_where_a_rank_may_have_none():
    domain = friedrichs_keller(COMM, 2)
    facets = boundary_facets(domain)
    nodes = entity_nodes(domain, 1, facets)
    x = domain.geometry.x[nodes]
    assert nodes.shape == (len(facets), 2)
    assert np.linalg.norm(x[:, 0] - x[:, 1], axis=1) == pytest.approx(0.5)
    assert entity_nodes(domain, 1, facets[:0]).shape == (0, 2)
