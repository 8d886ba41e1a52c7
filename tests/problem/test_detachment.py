"""Detachment points: the extrapolation of an exact gap, and ends of contact that are none."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini import SignoriniProblem, bernstein_space, boundary_facets, dirichlet
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.pictures.contact_boundary import gather_contact_boundary
from dolfinx_signorini.problem import detachment
from dolfinx_signorini.problem.detachment import DetachmentPoint, _extrapolated, detachment_points
from dolfinx_signorini.studies.paper.solution import christof_haubner, paper_problem

COMM = MPI.COMM_WORLD
H = 0.01
NODES = np.column_stack([np.arange(101) * H, np.zeros(101)])


def extrapolated(place, bend=0.0, end=None, direction=1.0):
    """The point found from the exact gap behind a detachment point on the x-axis.

    Args:
        place: Where the gap begins.
        bend: c of the gap s^{3/2} (1 + c s).
        end: The last dof in contact, below the place by default.
        direction: 1 for a gap on the right, -1 for one on the left.
    """
    s = np.maximum(direction * (NODES[:, 0] - place), 0.0)
    gap = s**1.5 * (1.0 + bend * s)
    inside = round((place - 0.5 * direction * H) / H) if end is None else end
    outside = inside + round(direction)
    middle = 0.5 * (NODES[inside] + NODES[outside])
    edge = DetachmentPoint(tuple(middle), H, 1.0)
    return _extrapolated(edge, NODES[inside], NODES[outside], NODES, gap)


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("place", [0.4111, 0.4149, 0.4188])
def test_the_zero_of_an_exact_gap_is_found(place, direction):
    point = extrapolated(place, direction=direction)
    assert point.position == pytest.approx((place, 0.0), abs=1e-9)
    assert point.uncertainty <= 1e-8
    bent = extrapolated(place, bend=0.2, direction=direction)
    assert abs(bent.position[0] - place) <= bent.uncertainty <= 0.5 * H


def test_an_extrapolation_that_leaves_the_edge_is_not_believed():
    # The gap says 0.40, three edges away from where the discrete contact set ends.
    point = extrapolated(0.4, end=43)
    assert point.position == pytest.approx((0.435, 0.0))
    assert point.uncertainty == pytest.approx(H)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("n", [24, 49])
def test_the_point_is_as_certain_as_it_claims(n, degree):
    for place in (0.5, 0.487, 0.5112):
        exact = christof_haubner(friedrichs_keller(COMM, n), (place, 0.0))
        problem = paper_problem(exact, degree)
        problem.solve(rtol=1e-10)
        (point,) = detachment_points(problem)
        problem.destroy()
        assert abs(point.position[0] - place) <= 1.2 * point.uncertainty
        assert point.uncertainty <= 1.0 / (n * degree) * (1.0 + 1e-9)


@pytest.mark.parametrize("n", [16, 64, 128])
@pytest.mark.parametrize("place", [0.15, 0.285, 0.35])
def test_the_point_stays_where_the_mesh_is_refined(n, place):
    """The solution r^(3/2) cos(3t/2), with contact on a small part of the lower side."""
    domain = mesh.create_unit_square(COMM, n, n)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    rest = np.setdiff1d(boundary_facets(domain), bottom)

    def exact(x):
        r, t = np.hypot(x[0] - place, x[1]), np.arctan2(x[1], x[0] - place)
        return r**1.5 * np.cos(1.5 * t)

    problem = SignoriniProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        fem.Constant(domain, 0.0) * v * ufl.dx,
        contact=bottom,
        bcs=[dirichlet(space, rest.astype(np.int32), exact)],
    )
    problem.solve(rtol=1e-10)
    (point,) = detachment_points(problem)
    assert abs(point.position[0] - place) <= 1.0 / n
    problem.destroy()


@pytest.mark.parametrize("degree", [3, 4])
@pytest.mark.parametrize("n", [10, 16])
def test_without_an_extrapolation_the_point_is_in_the_facet(n, degree):
    """The solution r^(3/2) cos(3t/2) with elements in whose basis coefficients are no values."""
    fallen_back = 0
    for place in (0.38, 0.4222, 0.6211, 0.7021):
        domain = mesh.create_unit_square(COMM, n, n)
        space = bernstein_space(domain, degree)
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
        rest = np.setdiff1d(boundary_facets(domain), bottom)
        data = fem.Function(space)
        values = fem.Function(fem.functionspace(domain, ("Lagrange", degree)))
        values.interpolate(lambda x, p=place: np.real((x[0] - p + 1j * x[1]) ** 1.5))
        data.interpolate(values)
        problem = SignoriniProblem(
            ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
            fem.Constant(domain, 0.0) * v * ufl.dx,
            contact=bottom,
            bcs=[fem.dirichletbc(data, fem.locate_dofs_topological(space, 1, rest))],
        )
        problem.solve(rtol=1e-10)
        points = detachment_points(problem)
        problem.destroy()
        for point in points:
            fallen_back += point.uncertainty > 0.9 / n
            assert abs(point.position[0] - place) <= 1.05 * point.uncertainty <= 1.06 / n
    assert degree < 4 or fallen_back > 0


def sagging(n, degree, shape="triangle", comm=COMM):
    """A membrane that sags, more to the right, onto a floor at -0.3."""
    domain = mesh.create_unit_square(comm, n, n, mesh.CellType[shape])
    space = fem.functionspace(domain, ("Lagrange", degree))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    top, bottom = (
        mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y))
        for y in (1.0, 0.0)
    )
    bc = fem.dirichletbc(0.0, fem.locate_dofs_topological(space, 1, top), space)
    a, load = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, -2.0 * x[0] * v * ufl.dx
    return SignoriniProblem(a, load, contact=bottom, obstacle=-0.3, bcs=[bc])


@pytest.mark.parametrize(("n", "degree"), [(64, 1), (100, 1), (32, 2), (24, 3)])
def test_a_strongly_curved_gap_is_extrapolated_too(n, degree):
    # 0.25154 is what degree 3 says on 256 squares. To the left the gap grows ever more slowly.
    problem = sagging(n, degree)
    problem.solve(rtol=1e-10)
    (point,) = detachment_points(problem)
    problem.destroy()
    edge = 1.0 / (n * degree)
    assert point.uncertainty < 0.5 * edge
    assert abs(point.position[0] - 0.25154) <= 1.2 * point.uncertainty


def test_points_that_are_as_strong_have_the_order_of_their_places(monkeypatch):
    # Four ends that differ by rounding, or by what a solve leaves: their order is that of places.
    problem = paper_problem(christof_haubner(friedrichs_keller(COMM, 2)))
    x = NODES[:, 0]
    held = np.minimum(np.abs(x - 0.25), np.abs(x - 0.75)) <= 0.105
    distance = np.abs(np.minimum(np.abs(x - 0.25), np.abs(x - 0.75)) - 0.105)
    for noise in (1e-9, -1e-9):
        tilt = 1.0 + noise * x
        gap, density = distance**1.5 * tilt * ~held, np.sqrt(distance) * tilt * held
        table = made_up_table(gap, density)
        monkeypatch.setattr(detachment, "_boundary_tables", lambda problem, table=table: table)
        places = [point.position[0] for point in detachment_points(problem)]
        assert places == sorted(places) and len(places) == 4


@pytest.mark.parametrize("n", [41, 53])
def test_ends_of_contact_without_gap_or_pressure_are_no_detachment_points(n):
    # Far from the detachment point u and du/dn vanish: the discrete contact set ends anywhere.
    problem = paper_problem(christof_haubner(friedrichs_keller(COMM, n)))
    problem.solve(rtol=1e-10)
    pieces = gather_contact_boundary(problem)
    points = detachment_points(problem)
    problem.destroy()
    if pieces is not None:
        free = pieces.values[pieces.pieces, 1] > 0.0
        assert np.count_nonzero(free[:, 0] != free[:, 1]) >= 2
    assert len(points) == 1
    assert abs(points[0].position[0] - 0.5) <= 1.2 * points[0].uncertainty


def made_up_table(gap, density):
    """All edges between neighbours on the line of nodes, with gap and density at both ends."""
    edges, pairs = np.stack((NODES[:-1], NODES[1:]), axis=1), (slice(None, -1), slice(1, None))
    fields = (np.column_stack([v[part] for part in pairs]) for v in (gap, density, gap))
    return [(edges, *fields, np.inf)]


def test_ends_that_belong_to_one_point_are_one(monkeypatch):
    problem = paper_problem(christof_haubner(friedrichs_keller(COMM, 2)))
    # One dof short of the end of contact has lost contact by rounding: three ends in three edges.
    x = NODES[:, 0]
    gap, density = np.maximum(x - 0.4, 0.0) ** 1.5, np.sqrt(np.maximum(0.4 - x, 0.0))
    gap[x < 0.401], gap[39], density[39] = 0.0, 1e-12, 0.0
    monkeypatch.setattr(detachment, "_boundary_tables", lambda problem: made_up_table(gap, density))
    (point,) = detachment_points(problem)
    assert abs(point.position[0] - 0.4) <= 0.02
    # Two ends far from each other are two.
    gap[70:], density[70:] = 0.0, np.sqrt(x[70:] - 0.695)
    places = sorted(point.position[0] for point in detachment_points(problem))
    assert len(places) == 2 and abs(places[1] - 0.695) <= 0.006


@pytest.mark.parametrize("degree", [1, 2])
def test_quadrilaterals_have_the_points_of_triangles(degree):
    # The contact boundary y = 1 is the last facet of quadrilaterals.
    found = []
    for kind in (mesh.CellType.triangle, mesh.CellType.quadrilateral):
        domain = mesh.create_unit_square(COMM, 40, 40, kind)
        top = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 1.0))
        space = fem.functionspace(domain, ("Lagrange", degree))
        u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
        a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
        problem = SignoriniProblem(a, 60.0 * (x[0] - 0.5) * v * ufl.dx, contact=top)
        problem.solve()
        found.append([point.position for point in detachment_points(problem)])
        problem.destroy()
    assert len(found[0]) == 1
    assert np.array(found[1]) == pytest.approx(np.array(found[0]), abs=4e-3)
