"""What all versions of dolfinx have to agree on."""

import numpy as np
import pytest
import ufl
from dolfinx import fem

from dolfinx_signorini.base import compat
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, facet_cells, owned_cells


def test_points_of_an_edge_run_from_its_first_to_its_last_vertex_in_the_cell(comm):
    domain = friedrichs_keller(comm, 5)
    points = np.array([[0.0], [0.3], [0.7], [1.0]])
    position = fem.Expression(ufl.SpatialCoordinate(domain), points, comm=comm)
    facets = facet_cells(domain, boundary_facets(domain))
    values = compat.evaluate(position, domain, facets).reshape(-1, 4, 2)
    ends = np.array([[1, 2], [0, 2], [0, 1]])[facets[:, 1]]
    cells = np.array(domain.geometry.dofmap).reshape(-1, 3)
    corners = domain.geometry.x[np.take_along_axis(cells[facets[:, 0]], ends, axis=1)][:, :, :2]
    wanted = (1.0 - points) * corners[:, None, 0] + points * corners[:, None, 1]
    assert np.abs(values - wanted).max(initial=0.0) <= 1e-14


def test_cells_and_no_entities_at_all_are_evaluated_too(comm):
    domain = friedrichs_keller(comm, 3)
    x = ufl.SpatialCoordinate(domain)
    expression = fem.Expression(ufl.as_vector([x[0], 2.0]), np.array([[0.2, 0.2]]), comm=comm)
    cells = owned_cells(domain)
    values = compat.evaluate(expression, domain, cells).reshape(-1, 1, 2)
    assert len(values) == len(cells)
    assert values[:, 0, 1] == pytest.approx(2.0)
    assert compat.evaluate(expression, domain, cells[:0]).size == 0


def test_interpolation_points_are_those_of_the_element(comm):
    space = fem.functionspace(friedrichs_keller(comm, 3), ("Lagrange", 1))
    points = compat.interpolation_points(space.element)
    assert points == pytest.approx(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
