"""Assembly: exact solutions that the elements hold, every kind of obstacle, what is stored."""

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.elements import control_points
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.solvers import METHODS

COMM = MPI.COMM_WORLD


def sides(domain):
    """Facets of the side with the last coordinate 0, and of all other sides."""
    tdim = domain.topology.dim
    facets = boundary_facets(domain)
    middle = dolfinx.mesh.compute_midpoints(domain, tdim - 1, facets)
    below = middle[:, tdim - 1] < 1e-9
    return facets[below], facets[~below]


def multiplier(problem):
    """A u - b at the contact dofs."""
    x = problem.system.vector_of(problem.u)
    force = problem.system.multiplier(x)
    x.destroy()
    return force


def patch_test(domain, degree, obstacle_below):
    """Laplace's equation with data of the plane x - y (x - z) on all sides but the lowest.

    The flux through the lowest side is +1: with the plane as obstacle it is in contact there, with
    pressure 1.
    """
    space = fem.functionspace(domain, ("Lagrange", degree))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    last = domain.topology.dim - 1
    below, others = sides(domain)
    plane = fem.Function(space)
    plane.interpolate(lambda x: x[0] - x[last])
    tdim = domain.topology.dim
    bc = fem.dirichletbc(plane, fem.locate_dofs_topological(space, tdim - 1, others))
    zero = fem.Constant(domain, 0.0) * v * ufl.dx
    a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    problem = SignoriniProblem(
        a, zero, contact=below, obstacle=lambda x: x[0] - x[last] - obstacle_below, bcs=[bc]
    )
    return problem, plane


DOMAINS = {
    "triangles": lambda: friedrichs_keller(COMM, 7),
    "quadrilaterals": lambda: dolfinx.mesh.create_unit_square(
        COMM, 5, 6, dolfinx.mesh.CellType.quadrilateral
    ),
    "tetrahedra": lambda: dolfinx.mesh.create_unit_cube(COMM, 3, 3, 3),
}


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("domain", DOMAINS)
def test_a_plane_in_contact_is_solved_exactly(domain, degree):
    problem, plane = patch_test(DOMAINS[domain](), degree, 0.0)
    u = problem.solve(rtol=1e-12)
    assert np.abs(u.x.array - plane.x.array).max(initial=0.0) <= 1e-10
    assert COMM.allreduce(len(problem.contact_dofs)) > 3
    # The forces add up to the pressure 1 tested with the sum of the basis functions of these dofs.
    indicator = fem.Function(problem.space)
    indicator.x.array[problem.contact_dofs] = 1.0
    indicator.x.scatter_forward()
    facets = sides(problem.space.mesh)[0]
    tags = dolfinx.mesh.meshtags(
        problem.space.mesh,
        problem.space.mesh.topology.dim - 1,
        np.sort(facets),
        np.ones(len(facets), dtype=np.int32),
    )
    ds = ufl.Measure("ds", problem.space.mesh, subdomain_data=tags)
    pressure = COMM.allreduce(fem.assemble_scalar(fem.form(indicator * ds(1))))
    force = COMM.allreduce(float(multiplier(problem).sum()))
    assert force == pytest.approx(pressure, rel=1e-9)
    problem.destroy()


def test_a_plane_is_not_in_contact_with_an_obstacle_below():
    # Without contact the lowest side is free, so u leaves the plane, and there is no force.
    problem, plane = patch_test(friedrichs_keller(COMM, 7), 1, 5.0)
    u = problem.solve(rtol=1e-12)
    difference = COMM.allreduce(float(np.abs(u.x.array - plane.x.array).sum()))
    force = multiplier(problem)
    problem.destroy()
    assert difference > 0.1
    assert problem.result.active_dofs == 0
    assert np.abs(force).max(initial=0.0) <= 1e-10


def general(obstacle, degree=1, bcs=None):
    domain = friedrichs_keller(COMM, 6)
    space = fem.functionspace(domain, ("Lagrange", degree))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    load = fem.Constant(domain, -1.0) * v * ufl.dx
    below, others = sides(domain)
    conditions = []
    if bcs is not None:
        dofs = fem.locate_dofs_topological(space, 1, others)
        conditions = [fem.dirichletbc(dolfinx.default_scalar_type(bcs), dofs, space)]
    return SignoriniProblem(a, load, contact=below, obstacle=obstacle(space), bcs=conditions)


def of_function(space, degree):
    function = fem.Function(fem.functionspace(space.mesh, ("Lagrange", degree)))
    function.interpolate(lambda x: 0.5 * x[0] - 0.25)
    return function


KINDS = {
    "callable": lambda space: lambda x: 0.5 * x[0] - 0.25,
    "expression": lambda space: 0.5 * ufl.SpatialCoordinate(space.mesh)[0] - 0.25,
    "function of the space": lambda space: of_function(space, space.element.basix_element.degree),
    "function of another space": lambda space: of_function(space, 3),
}


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_obstacles_of_every_kind_are_the_same(kind, degree):
    problem = general(KINDS[kind], degree)
    x = control_points(problem.space)[problem.contact_dofs]
    assert (x[:, 1] == 0.0).all()
    assert COMM.allreduce(len(x)) == 6 * degree + 1
    assert problem.obstacle == pytest.approx(0.5 * x[:, 0] - 0.25, abs=1e-14)
    problem.destroy()


@pytest.mark.parametrize("value", [0, -1, np.float64(-0.5), np.int64(-2)])
def test_numbers_are_obstacles(value):
    problem = general(lambda space: value)
    constant = general(lambda space: fem.Constant(space.mesh, float(value)))
    assert (problem.obstacle == value).all()
    assert (constant.obstacle == value).all()
    for item in (problem, constant):
        item.destroy()


def test_dirichlet_dofs_are_no_contact_dofs():
    problem = general(lambda space: -1.0, bcs=0.25)
    assert COMM.allreduce(len(problem.contact_dofs)) == 5
    assert not np.intersect1d(problem.contact_dofs, problem.fixed_dofs).size
    assert COMM.allreduce(len(problem.fixed_dofs)) == 6 * 3 + 1
    assert (problem.system.fixed_values == 0.25).all()
    assert problem.unknowns == 7**2
    problem.destroy()


@pytest.mark.parametrize("method", METHODS)
def test_feasible_to_the_last_bit_from_any_start(method):
    # Contact and data hold exactly, although the solvers add corrections in other units.
    problem = general(lambda space: lambda x: 0.2 + np.sin(40.0 * x[0]) / 7.0, bcs=1.0 / 3.0)
    arguments = {}
    if method != "cascade":
        start = fem.Function(problem.space)
        start.interpolate(lambda x: np.cos(50.0 * x[0]) * np.exp(x[1]) / 3.0)
        arguments["start"] = start
    u = problem.solve(method, **arguments).x.array
    gap = u[problem.contact_dofs] - problem.obstacle
    assert (gap >= 0.0).all()
    assert (u[problem.fixed_dofs] == problem.system.fixed_values).all()
    assert 0 < COMM.allreduce(int((gap == 0.0).sum())) == problem.result.active_dofs
    problem.destroy()
