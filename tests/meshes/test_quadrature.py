"""A rule has the degree that its name says: in forms and as points, no more and no less."""

import math

import basix
import basix.ufl
import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.quadrature import CELL_RULE, FACET_RULE, QuadratureRule, interior_rule
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.references import Reference

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


@pytest.mark.parametrize("corners", [[(0, 0), (1, 0), (0, 1)], [(0.2, 0.1), (2, 0.5), (0.9, 3)]])
def test_a_cell_that_is_numbered_the_other_way_round_has_the_same_points(corners):
    # The norm of a root is not integrated exactly: each point of the rule shows in the digits.
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    values = []
    for order in ((0, 1, 2), (2, 1, 0)):
        cells, x = np.array([order], dtype=np.int64), np.array(corners, dtype=np.float64)
        domain = dolfinx.mesh.create_mesh(MPI.COMM_SELF, cells, x=x, e=element)
        zero = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
        y = ufl.SpatialCoordinate(domain)
        root = Reference(domain, ufl.sqrt(abs(y[0] - 0.3)), (0.0 * y[0], 0.0 * y[0]))
        values.append(error_norms(zero, root, ["L1"])["L1"])
    assert values[0] == pytest.approx(values[1], rel=1e-13)


def test_the_points_of_a_counterclockwise_cell_are_those_of_the_rule():
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    cells, x = np.array([[0, 1, 2]]), np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
    domain = dolfinx.mesh.create_mesh(MPI.COMM_SELF, cells, x=x, e=element)
    zero, y = (
        fem.Function(fem.functionspace(domain, ("Lagrange", 1))),
        ufl.SpatialCoordinate(domain),
    )
    root = Reference(domain, ufl.sqrt(y[1]), (0.0 * y[0], 0.0 * y[0]))
    points, weights = CELL_RULE.points(basix.CellType.triangle)
    expected = np.sqrt(points[:, 1]) @ weights
    assert error_norms(zero, root, ["L1"], CELL_RULE)["L1"] == pytest.approx(expected, rel=1e-13)
    turned, _ = CELL_RULE.points(basix.CellType.triangle, reverse=True)
    assert abs(np.sqrt(turned[:, 1]) @ weights - expected) > 1e-6 * expected


@pytest.mark.parametrize("cell", [basix.CellType.triangle, basix.CellType.tetrahedron])
@pytest.mark.parametrize("degree", range(1, 15))
def test_interior_rules_are_exact_and_positive_and_have_no_point_on_the_boundary(cell, degree):
    points, weights = interior_rule(cell, degree).points(cell)
    assert min(points.min(), (1.0 - points.sum(axis=1)).min()) > 1e-6
    assert weights.min() > 0.0
    # The integral of x^k over a simplex is k! / (k + dimension)!.
    exact = math.factorial(degree) / math.factorial(degree + points.shape[1])
    assert points[:, 0] ** degree @ weights == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_kink_on_facets_belongs_to_each_side(dim):
    # u is in the space: nothing but rounding is left, though grad u jumps where z = 0.4.
    domain = dolfinx.mesh.create_box(COMM, [(0.0,) * 3, (1.0,) * 3], (5, 5, 5))
    if dim == 2:
        domain = friedrichs_keller(COMM, 5)
    z = ufl.SpatialCoordinate(domain)[dim - 1]
    gradient = [0.0 * z] * (dim - 1) + [ufl.conditional(ufl.lt(z, 0.4), 1.0, 1.0 / 7.0)]
    exact = Reference(domain, (z - 0.4) * gradient[-1], tuple(gradient))
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 2)))
    u.interpolate(lambda x: (x[dim - 1] - 0.4) * np.where(x[dim - 1] < 0.4, 1.0, 1.0 / 7.0))
    for norm, error in error_norms(u, exact, ["Linf", "W1_inf", "H1", "W1_4"]).items():
        assert error < 1e-9, norm
