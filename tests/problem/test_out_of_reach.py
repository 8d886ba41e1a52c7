"""An obstacle that nothing reaches says nothing, and no body says anything about another one."""

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_signorini as signorini
from dolfinx_signorini.bounds.energy_bound import energy_bound
from dolfinx_signorini.pictures.contact_boundary import (
    gather_contact_boundary,
    gather_contact_region,
)
from dolfinx_signorini.problem.detachment import detachment_points

FAR = [3.0, 1e3, 1e13, 1e300]


def side(domain, axis, place):
    return mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[axis], place))


def forms(space, load):
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    return ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, ufl.inner(load, v) * ufl.dx


def held(space, where, value=0.0):
    return fem.dirichletbc(value, fem.locate_dofs_topological(space, 1, where), space)


@pytest.mark.parametrize("far", FAR)
@pytest.mark.parametrize("bernstein", [False, True])
def test_data_beyond_an_obstacle_are_refused(bernstein, far, comm):
    domain = mesh.create_unit_square(comm, 8, 8)
    x = ufl.SpatialCoordinate(domain)
    V = signorini.bernstein_space(domain, 2 if bernstein else 1)
    a, L = forms(V, fem.Constant(domain, -1.0))
    wall = side(domain, 1, 1.0)
    lower = ufl.conditional(x[1] > 0.99, 0.5, -far)
    with pytest.raises(signorini.InputError, match="above the Dirichlet data") as caught:
        signorini.ObstacleProblem(a, L, lower=lower, bcs=[signorini.dirichlet(V, wall, 0.0)])
    assert caught.value.subject == "lower"


@pytest.mark.parametrize("far", FAR)
@pytest.mark.parametrize("load", [0.0, -1.0])
def test_obstacles_that_cross_are_refused(load, far, comm):
    domain = mesh.create_unit_square(comm, 8, 8)
    x = ufl.SpatialCoordinate(domain)
    V = fem.functionspace(domain, ("Lagrange", 1))
    a, L = forms(V, fem.Constant(domain, load))
    near = ufl.lt(x[0], 0.3)
    lower, upper = ufl.conditional(near, 0.1, -far), ufl.conditional(near, -0.3, far)
    bcs = [held(V, side(domain, 0, 1.0), 0.05)]
    with pytest.raises(signorini.InputError, match="below the lower obstacle"):
        signorini.ObstacleProblem(a, L, lower=lower, upper=upper, bcs=bcs)


@pytest.mark.parametrize("far", FAR)
def test_clamped_bodies_beyond_an_obstacle_are_refused(far, comm):
    domain = mesh.create_unit_square(comm, 8, 8)
    x = ufl.SpatialCoordinate(domain)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    bottom = side(domain, 1, 0.0)
    clamp = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0.0))
    gap = ufl.conditional(x[0] < 0.01, -0.05, far)
    with pytest.raises(signorini.InputError, match="below the Dirichlet data") as caught:
        signorini.ContactProblem(
            signorini.elasticity(u, v, young=1.0, poisson=0.3),
            ufl.inner(fem.Constant(domain, (0.0, -0.1)), v) * ufl.dx,
            contact=bottom,
            gap=gap,
            direction=(0.0, -1.0),
            bcs=[fem.dirichletbc(np.zeros(2), clamp, V)],
        )
    assert caught.value.subject == "gap"


def test_obstacles_and_data_that_meet_up_to_rounding_are_taken(comm):
    """The load is 0 at the start of a loop, and nothing but the obstacles has a size."""
    domain = mesh.create_unit_square(comm, 8, 8)
    x = ufl.SpatialCoordinate(domain)
    V = fem.functionspace(domain, ("Lagrange", 1))
    noise = 0.1 * ufl.sin(2.0 * np.pi * (x[0] + 1.0)) ** 2 - 3e-17
    for load in (0.0, 1.0):
        a, L = forms(V, fem.Constant(domain, load))
        for walls in (side(domain, 0, 1.0), side(domain, 0, 0.0)):
            problem = signorini.ObstacleProblem(
                a, L, lower=-noise, upper=noise, bcs=[held(V, walls)]
            )
            problem.solve()
            problem.destroy()


def sagging(comm, far, degree, n=24):
    """A membrane on a wavy floor, with obstacles beside it that nothing reaches."""
    domain = mesh.create_unit_square(comm, n, n)
    x = ufl.SpatialCoordinate(domain)
    V = fem.functionspace(domain, ("Lagrange", degree))
    a, L = forms(V, -1.5 * (1.0 + x[0]))
    parts = [side(domain, 1, 0.0), side(domain, 0, 0.0), side(domain, 0, 1.0)]
    floor = -0.4 + 0.1 * ufl.sin(3.0 * np.pi * x[0])
    problem = signorini.SignoriniProblem(
        a,
        L,
        contact=np.unique(np.concatenate(parts)).astype(np.int32),
        obstacle=ufl.conditional(x[1] < 1e-9, floor, -far),
        bcs=[held(V, side(domain, 1, 1.0))],
    )
    problem.solve(rtol=1e-11)
    return problem


@pytest.mark.parametrize("degree", [1, 2])
def test_detachment_points_stay_where_a_side_cannot_be_reached(degree, comm):
    problems = [sagging(comm, far, degree) for far in (1.0, *FAR)]
    first, *others = [detachment_points(problem) for problem in problems]
    assert len(first) == 4
    for found in others:
        assert len(found) == len(first)
        for one, other in zip(found, first, strict=True):
            assert one.position == pytest.approx(other.position, abs=1e-9)
            assert one.strength == pytest.approx(other.strength, rel=1e-6)
    for problem in problems:
        problem.destroy()


def squares(comm, n, places):
    """Unit squares beside each other, which share nothing."""
    one = mesh.create_unit_square(MPI.COMM_SELF, n, n)
    x, cells = one.geometry.x[:, :2], one.geometry.dofmap.astype(np.int64)
    points = np.concatenate([x + np.array([place, 0.0]) for place in places])
    every = np.concatenate([cells + k * len(x) for k in range(len(places))])
    if comm.rank:
        points, every = points[:0], every[:0]
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    return mesh.create_mesh(comm, every, x=points, e=element)


@pytest.mark.parametrize("in_domain", [False, True])
@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e-5])
def test_a_weak_body_beside_a_strong_one_is_as_alone(scale, in_domain, comm):
    found = []
    for places in ((3.0,), (0.0, 3.0)):
        domain = squares(comm, 24, places)
        x = ufl.SpatialCoordinate(domain)
        V = fem.functionspace(domain, ("Lagrange", 1))
        weak, own = x[0] > 2.0, ufl.conditional(x[0] > 2.0, x[0] - 3.0, x[0])
        size = ufl.conditional(weak, scale, 1.0)
        floor = size * (-0.4 + 0.1 * ufl.sin(3.0 * np.pi * own))
        a, L = forms(V, -(7.5 if in_domain else 1.5) * size * (1.0 + own))
        where = {"lower": floor} if in_domain else {"contact": side(domain, 1, 0.0)}
        kind = signorini.ObstacleProblem if in_domain else signorini.SignoriniProblem
        more = {} if in_domain else {"obstacle": floor}
        problem = kind(a, L, bcs=[held(V, side(domain, 1, 1.0))], **where, **more)
        problem.solve(rtol=1e-13)
        gather = gather_contact_region if in_domain else gather_contact_boundary
        boundary, row = gather(problem), None
        if boundary is not None:
            there = boundary.points[:, 0] > 2.0
            pieces = there[boundary.pieces].all(axis=1)
            row = [
                boundary.touching[there].sum(),
                boundary.clear[there].sum(),
                boundary.in_contact[pieces].sum(),
            ]
        points = [] if in_domain else detachment_points(problem)
        ends = sorted(p.position for p in points if p.position[0] > 2.0)
        found.append((row, np.array(ends)))
        problem.destroy()
    (alone, ends), (beside, other_ends) = found
    assert alone == beside and other_ends == pytest.approx(ends, abs=1e-7)
    assert in_domain or len(ends) == 4


@pytest.mark.parametrize("degree", [1, 2])
def test_the_bound_does_not_depend_on_how_far_an_obstacle_is_away(degree, comm):
    totals = []
    for far in (None, *FAR):
        domain = mesh.create_unit_square(comm, 8, 8)
        x = ufl.SpatialCoordinate(domain)
        V = fem.functionspace(domain, ("Lagrange", degree))
        a, L = forms(V, load := -3.0 * (1.0 + x[0]))
        wall = side(domain, 1, 1.0)
        bounds = {"lower": -0.4 + 0.3 * x[0] * x[1]} | ({} if far is None else {"upper": far})
        problem = signorini.ObstacleProblem(a, L, bcs=[held(V, wall)], **bounds)
        problem.solve(rtol=1e-11)
        terms = signorini.EnergyTerms(load=load, dirichlet=[(0.0, wall)])
        totals.append(energy_bound(problem, terms).total)
        problem.destroy()
    assert totals == pytest.approx(len(totals) * totals[:1], rel=1e-6)
