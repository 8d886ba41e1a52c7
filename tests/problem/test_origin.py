"""Where the form vanishes on constants, the origin of u is anyone's choice."""

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_signorini as ds
from dolfinx_signorini.pictures.contact_boundary import (
    gather_contact_boundary,
    gather_contact_region,
)
from dolfinx_signorini.solvers.residual import NaturalResidual

ORIGINS = [1.0, -300.0, 101325.0]


def pose(where, comm, n=32):
    """Return a function that poses a problem with data and obstacles that are c higher."""
    domain = mesh.create_unit_square(comm, n, n)
    facets = {
        name: mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y))
        for name, y in (("floor", 0.0), ("top", 1.0))
    }
    x = ufl.SpatialCoordinate(domain)

    def posed(c):
        if where == "body":
            space = fem.functionspace(domain, ("Lagrange", 1, (2,)))
            u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
            a, L = ds.elasticity(u, v, young=10.0, poisson=0.3), -(1.0 + x[0]) * v[1] * ufl.dx
            top = fem.locate_dofs_topological(space, 1, facets["top"])
            bcs = [fem.dirichletbc(np.array([0.0, c]), top, space)]
            gap = 0.03 + 0.1 * x[0] ** 2 - c
            d = (0.0, -1.0)
            return ds.ContactProblem(a, L, contact=facets["floor"], gap=gap, direction=d, bcs=bcs)
        space = fem.functionspace(domain, ("Lagrange", 1))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        a, L = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, -(1.0 + 2.0 * x[1]) * v * ufl.dx
        floor = c - 0.4 + 0.1 * ufl.sin(3.0 * ufl.pi * x[0])
        top = fem.locate_dofs_topological(space, 1, facets["top"])
        bcs = [fem.dirichletbc(c, top, space)]
        if where == "domain":
            return ds.ObstacleProblem(a, L, lower=floor, bcs=bcs)
        return ds.SignoriniProblem(a, L, contact=facets["floor"], obstacle=floor, bcs=bcs)

    return posed


def measured(problem):
    """What the obstacle does, which no origin of u changes."""
    problem.solve()
    contact = problem.zones[0].along_direction
    gather = gather_contact_region if problem.in_domain else gather_contact_boundary
    found = gather(contact)
    sizes = None if found is None else (*found.measured(), float(found.sizes.sum()))
    count = problem.comm.allreduce(len(problem.active))
    measure = NaturalResidual(problem.system)
    load = measure.load
    measure.destroy()
    force = np.atleast_1d(problem.force)
    return [*force, count, *problem.comm.bcast(sizes), load]


@pytest.mark.parametrize("origin", ORIGINS)
@pytest.mark.parametrize("where", ["boundary", "domain", "body"])
def test_what_the_obstacle_does_does_not_depend_on_the_origin(where, origin, comm):
    posed = pose(where, comm)
    if where == "body":
        origin = 0.01 * origin
    first, other = posed(0.0), posed(origin)
    known, found = measured(first), measured(other)
    # Rounding of u, over the sizes of its second differences.
    assert found == pytest.approx(known, rel=1e-6, abs=1e-10 * abs(origin) + 1e-6)
    for problem in (first, other):
        problem.destroy()


@pytest.mark.parametrize("origin", ORIGINS)
def test_an_early_stop_does_not_depend_on_the_origin(origin, comm):
    """The start on a finer mesh has no jump beside the data that the coarse mesh does not see."""
    errors = []
    posed = [pose("boundary", comm, n) for n in (32, 64)]  # ranks may share other meshes otherwise
    for c in (0.0, origin):
        coarse, fine = (problem(c) for problem in posed)
        coarse.solve()
        u = fine.solve(coarse=coarse.contact_state())
        assert fine.result.algebraic_share is not None
        values = u.x.array - c
        exact = fine.solve(rtol=1e-11, warm_start=False).x.array - c
        off = np.linalg.norm(comm.allgather(float(np.linalg.norm(values - exact))))
        errors.append(off)
        for problem in (coarse, fine):
            problem.destroy()
    assert errors[1] <= 2.0 * errors[0] + 1e-9 * abs(origin)


@pytest.mark.parametrize("height", [1.0, 293.15, 1e10])
def test_few_held_dofs_far_from_0_are_solved_for(height, comm):
    """Rounding of A u is in all rows, and not in those beside the data alone."""
    n = 160
    domain = mesh.create_unit_square(comm, n, n)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    low = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    corner = mesh.locate_entities_boundary(
        domain, 1, lambda x: np.isclose(x[0], 0.0) & (x[1] < 1.01 / n)
    )
    held = fem.dirichletbc(height, fem.locate_dofs_topological(space, 1, corner), space)
    stiffness = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    load = fem.Constant(domain, 0.0) * v * ufl.dx
    problem = ds.SignoriniProblem(stiffness, load, contact=low, obstacle=0.0, bcs=[held])
    off = np.abs(problem.solve().x.array - height).max(initial=0.0)
    assert comm.allreduce(off, op=MPI.MAX) <= 1e-6 * height
    problem.destroy()


def test_parts_that_are_apart_rest_where_their_own_data_have_them(comm):
    squares = [mesh.create_unit_square(MPI.COMM_SELF, 16, 16) for _ in range(2)]
    x = np.concatenate([each.geometry.x[:, :2] + [3.0 * k, 0.0] for k, each in enumerate(squares)])
    count = len(squares[0].geometry.x)
    cells = np.concatenate([each.geometry.dofmap + k * count for k, each in enumerate(squares)])
    own = cells if comm.rank == 0 else cells[:0]
    points = x if comm.rank == 0 else x[:0]
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    domain = mesh.create_mesh(comm, own.astype(np.int64), x=points, e=element)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    low = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0) & (x[0] > 2.0))
    first, second = (
        mesh.locate_entities_boundary(
            domain, 1, lambda x, k=k: np.isclose(x[1], 1.0) & ((x[0] > 2.0) == bool(k))
        )
        for k in (0, 1)
    )
    forces = []
    for height in (0.0, 1e5):
        bcs = [
            fem.dirichletbc(value, fem.locate_dofs_topological(space, 1, facets), space)
            for value, facets in ((height, first), (0.0, second))
        ]
        a, L = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, -v * ufl.dx
        problem = ds.SignoriniProblem(a, L, contact=low, obstacle=-0.2, bcs=bcs)
        problem.solve()
        forces.append((problem.force, comm.allreduce(len(problem.active))))
        problem.destroy()
    assert forces[1] == pytest.approx(forces[0], rel=1e-5) and forces[0][1] > 0


@pytest.mark.parametrize("cells, length", [((64, 8), 20.0), ((100, 5), 50.0)])
def test_a_thin_body_far_above_its_floor_needs_no_newton_steps(cells, length, comm):
    domain = mesh.create_rectangle(comm, [(0.0, 0.0), (length, 1.0)], cells)
    space = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    floor, left = (
        mesh.locate_entities_boundary(domain, 1, lambda x, k=k: np.isclose(x[k], 0.0))
        for k in (1, 0)
    )
    wall = fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(space, 1, left), space)
    a, L = ds.elasticity(u, v, young=1.0, poisson=0.3), -1e-6 * v[1] * ufl.dx
    down = {"contact": floor, "gap": 10.0, "direction": (0.0, -1.0)}
    problem = ds.ContactProblem(a, L, **down, bcs=[wall])
    problem.solve()
    assert problem.result.iterations == 0 and "bncg" in problem.result.reason
    problem.destroy()
