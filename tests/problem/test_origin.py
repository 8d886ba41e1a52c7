"""Where the form vanishes on constants, the origin of u is anyone's choice."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

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
    for c in (0.0, origin):
        coarse, fine = (pose("boundary", comm, n)(c) for n in (32, 64))
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
