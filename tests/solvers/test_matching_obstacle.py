"""Obstacles made for a chosen solution: touched where the flux presses, out of reach elsewhere."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.norms.manufactured import matching_obstacle

COMM = MPI.COMM_WORLD


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("upper", [False, True])
def test_the_obstacle_is_on_the_right_side_of_the_solution(upper, degree):
    # u = 2 + x has a flux on the left and on the right, and none at the bottom and the top.
    domain = friedrichs_keller(COMM, 6)
    space = fem.functionspace(domain, ("Lagrange", degree))
    x = ufl.SpatialCoordinate(domain)
    u = 2.0 + x[0]
    flux = ufl.dot(ufl.grad(u), ufl.FacetNormal(domain))
    sign = -1.0 if upper else 1.0
    g = matching_obstacle(space, boundary_facets(domain), u, flux, upper)
    dofs = fem.locate_dofs_topological(space, 1, boundary_facets(domain))
    at = space.tabulate_dof_coordinates()[dofs]
    gap = sign * (2.0 + at[:, 0] - g.x.array[dofs])
    pressed = np.minimum(at[:, 0], 1.0 - at[:, 0]) < 1e-12
    assert gap[pressed] == pytest.approx(0.0, abs=1e-14)
    assert gap[~pressed] == pytest.approx(3.0)
    assert COMM.allreduce(int((~pressed).sum())) > 0
