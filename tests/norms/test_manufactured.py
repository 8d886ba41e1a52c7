"""The manufactured-solution kit: data that belong to a solution, and what it finds wrong."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.base import compat
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, facet_cells, owned_cells
from dolfinx_signorini.norms.manufactured import contact_violations, manufacture, matching_obstacle
from dolfinx_signorini.studies.paper.solution import christof_haubner


def bottom_of(domain):
    facets = boundary_facets(domain)
    ends = compat.evaluate(
        fem.Expression(ufl.SpatialCoordinate(domain), np.array([[0.5]]), comm=domain.comm),
        domain,
        facet_cells(domain, facets),
    ).reshape(-1, 2)
    return facets[ends[:, 1] < 1e-12]


def largest(comm, values):
    return comm.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX)


def test_the_load_of_the_papers_solution(comm):
    """Differentiated by UFL, the closed form's u gives its gradient and load."""
    domain = friedrichs_keller(comm, 7)
    exact = christof_haubner(domain)
    data = manufacture(domain, exact.u, reaction=1.0)
    pairs = [data.load - exact.load]
    pairs += [a - b for a, b in zip(data.grad, exact.grad, strict=True)]
    points = np.array([[0.2, 0.3], [0.6, 0.1]])
    expression = fem.Expression(ufl.as_vector(pairs), points, comm=comm)
    difference = compat.evaluate(expression, domain, owned_cells(domain))
    assert largest(comm, difference) <= 1e-9


def test_load_and_flux_with_a_tensor_and_reaction(comm):
    """u = x^2 y with K = [[2, 1], [1, 3]] and c = 5, by hand."""
    domain = friedrichs_keller(comm, 3)
    x, y = ufl.SpatialCoordinate(domain)
    data = manufacture(domain, x**2 * y, ufl.as_matrix([[2, 1], [1, 3]]), 5.0)
    load = -(2 * 2 * y + 2 * 2 * x) + 5 * x**2 * y
    expression = fem.Expression(data.load - load, np.array([[0.3, 0.3]]), comm=comm)
    assert largest(comm, compat.evaluate(expression, domain, owned_cells(domain))) <= 1e-12
    flux = -(2 * x * y + 3 * x**2)  # n = (0, -1)
    expression = fem.Expression(data.flux - flux, np.array([[0.4]]), comm=comm)
    pairs = facet_cells(domain, bottom_of(domain))
    assert largest(comm, compat.evaluate(expression, domain, pairs)) <= 1e-12


def test_the_papers_solution_satisfies_all_conditions(comm):
    domain = friedrichs_keller(comm, 9)
    exact = christof_haubner(domain)
    flux = manufacture(domain, exact.u, reaction=1.0).flux
    assert contact_violations(domain, boundary_facets(domain), exact.u, flux, 0.0) == []


@pytest.mark.parametrize(
    ("u", "obstacle", "condition", "value", "point"),
    [
        (lambda x, y: y * (x - 0.3), 0.0, "flux >= 0", 0.7, (1.0, 0.0)),
        (lambda x, y: -y + 0.5 - x, 0.0, "u >= g", 0.5, (1.0, 0.0)),
        (lambda x, y: -y + x, 0.0, "flux = 0 where u does not touch g", 1.0, (1.0, 0.0)),
        (lambda x, y: 0 * y + x, "x + 0.25*x^2", "u >= g", 0.25, (1.0, 0.0)),
    ],
)
def test_what_fails_is_named_with_the_worst_point(u, obstacle, condition, value, point, comm):
    domain = friedrichs_keller(comm, 8)
    x, y = ufl.SpatialCoordinate(domain)
    if isinstance(obstacle, str):
        obstacle = x + 0.25 * x**2
    flux = manufacture(domain, u(x, y)).flux
    found = contact_violations(domain, bottom_of(domain), u(x, y), flux, obstacle)
    named = [v for v in found if v.condition.startswith(condition)]
    assert len(named) == 1
    assert named[0].value == pytest.approx(value)
    assert named[0].point == pytest.approx(point)
    mirrored = contact_violations(
        domain, bottom_of(domain), -u(x, y), -flux, -1.0 * obstacle, upper=True
    )
    assert [(v.value, v.point) for v in mirrored] == [(v.value, v.point) for v in found]


def test_an_obstacle_is_made_where_the_flux_presses(comm):
    domain = friedrichs_keller(comm, 10)
    x, y = ufl.SpatialCoordinate(domain)
    u = -y * ufl.max_value(0.0, x - 0.5) + 0.3 * x
    space = fem.functionspace(domain, ("Lagrange", 1))
    facets = bottom_of(domain)
    flux = manufacture(domain, u).flux
    assert contact_violations(domain, facets, u, flux, None) == []
    g = matching_obstacle(space, facets, u, flux)
    dofs = fem.locate_dofs_topological(space, 1, facets)
    at = space.tabulate_dof_coordinates()[dofs, 0]
    gap = 0.3 * at - g.x.array[dofs]
    assert largest(comm, gap[at > 0.5 - 1e-9]) <= 1e-14
    assert comm.allreduce(float(gap[at < 0.5 - 1e-9].min(initial=9.0)), op=MPI.MIN) >= 0.1


def test_a_flux_that_is_rounding_beside_that_of_the_domain_is_none(comm):
    domain = friedrichs_keller(comm, 8)
    x, y = ufl.SpatialCoordinate(domain)
    u, facets = x**2 * y**2 + 1e-50 * y, bottom_of(domain)
    space = fem.functionspace(domain, ("Lagrange", 1))
    exact = manufacture(domain, u)
    assert contact_violations(domain, facets, u, exact.flux, None) == []
    g = matching_obstacle(space, facets, u, exact.flux)
    dofs = fem.locate_dofs_topological(space, 1, facets)
    assert (g.x.array[dofs] < 0.0).all()  # u = 0 touches nothing
    strong = manufacture(domain, x**2 * y**2 + 1e-6 * y).flux
    (found,) = contact_violations(domain, facets, u, strong, None)
    assert found.value == pytest.approx(1e-6)
