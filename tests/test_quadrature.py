"""A rule has the degree that its name says: in forms and as points, no more and no less."""

import basix
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.meshes import friedrichs_keller
from dolfinx_signorini.quadrature import CELL_RULE, FACET_RULE, QuadratureRule

COMM = MPI.COMM_WORLD


@pytest.mark.parametrize("degree", [2, 3, 4, 6])
def test_forms_are_integrated_by_the_rule_that_is_named(degree):
    domain = friedrichs_keller(COMM, 1)
    rule = QuadratureRule("default", degree)
    points, weights = rule.points(basix.CellType.triangle)
    x = ufl.SpatialCoordinate(domain)
    for power in (degree, degree + 2):
        form = fem.form(x[0] ** power * ufl.dx(metadata=rule.metadata))
        value = COMM.allreduce(fem.assemble_scalar(form))
        # Both triangles of the square, one of them turned by half a turn.
        by_points = (points[:, 0] ** power + (1.0 - points[:, 0]) ** power) @ weights
        assert value == pytest.approx(by_points, rel=1e-12)
        exact = 1.0 / (power + 1.0)
        assert (abs(value / exact - 1.0) < 1e-12) == (power == degree)


def test_the_rules_of_the_package():
    assert len(CELL_RULE.points(basix.CellType.triangle)[1]) == 16
    points, weights = FACET_RULE.points(basix.CellType.interval)
    assert len(weights) == 16
    # The square of the root of the distance to a point, in the norm of a gradient.
    assert np.sqrt(points[:, 0]) @ weights == pytest.approx(2.0 / 3.0, rel=1e-4)
