"""What meshes know of their facets."""

import numpy as np
import pytest
from mpi4py import MPI

from dolfinx_signorini.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes import boundary_facets, entity_nodes

COMM = MPI.COMM_WORLD


def test_nodes_of_facets_where_a_rank_may_have_none():
    domain = friedrichs_keller(COMM, 2)
    facets = boundary_facets(domain)
    nodes = entity_nodes(domain, 1, facets)
    x = domain.geometry.x[nodes]
    assert nodes.shape == (len(facets), 2)
    assert np.linalg.norm(x[:, 0] - x[:, 1], axis=1) == pytest.approx(0.5)
    assert entity_nodes(domain, 1, facets[:0]).shape == (0, 2)
