"""Changes that are refused and mended: later solves are those of a problem that is posed anew."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini import (
    ContactProblem,
    EnergyTerms,
    InputError,
    ObstacleProblem,
    SignoriniProblem,
    elasticity,
    energy_bound,
)


class Membrane:
    """A membrane with data that change, over an obstacle at its lower side."""

    def __init__(self, comm, n=6):
        self.mesh = mesh.create_unit_square(comm, n, n)
        self.space = V = fem.functionspace(self.mesh, ("Lagrange", 1))
        self.u, self.v = ufl.TrialFunction(V), ufl.TestFunction(V)
        self.k, self.f, self.g = (fem.Constant(self.mesh, value) for value in (1.0, -4.0, -0.1))
        below, above = (
            mesh.locate_entities_boundary(self.mesh, 1, lambda x, z=z: np.isclose(x[1], z))
            for z in (0.0, 1.0)
        )
        self.below = below
        held = fem.Function(V)
        held.x.array[:] = 0.2
        self.bcs = [fem.dirichletbc(held, fem.locate_dofs_topological(V, 1, above))]
        self.a = self.k * ufl.inner(ufl.grad(self.u), ufl.grad(self.v)) * ufl.dx
        self.L = self.f * self.v * ufl.dx
        self.problem = self.posed()

    def posed(self):
        obstacle = self.g + 0.0 * ufl.SpatialCoordinate(self.mesh)[0]
        given = {"contact": self.below, "obstacle": obstacle, "bcs": self.bcs}
        return SignoriniProblem(self.a, self.L, **given)

    def check(self):
        """Compare a solve with that of a problem that is posed anew."""
        fresh = self.posed()
        found, expected = self.problem.solve(rtol=1e-12), fresh.solve(rtol=1e-12)
        assert found.x.array == pytest.approx(expected.x.array, abs=1e-9)
        assert self.problem.force == pytest.approx(fresh.force, abs=1e-9)
        assert len(self.problem.active) == len(fresh.active)
        fresh.destroy()


@pytest.fixture
def membrane(comm):
    made = Membrane(comm)
    made.problem.solve(rtol=1e-12)
    yield made
    made.problem.destroy()


def refuse(membrane, change):
    """Make a change while the obstacle is none, and mend the obstacle."""
    good, membrane.g.value = float(membrane.g.value), np.nan
    with pytest.raises(InputError, match="obstacle"):
        change()
    membrane.g.value = good


def test_a_mesh_that_has_moved_is_remembered(membrane):
    membrane.mesh.geometry.x[:, 0] *= 2.0
    refuse(membrane, lambda: membrane.problem.update(matrix=True))
    membrane.check()


def test_a_zone_that_is_kept_sees_each_solve(comm):
    """Gap, active set and pressure of a boundary that is kept over changes of mesh and data."""
    domain = mesh.create_unit_square(comm, 6, 6)
    V = fem.functionspace(domain, ("Lagrange", 1))
    u, v, g = ufl.TrialFunction(V), ufl.TestFunction(V), fem.Constant(domain, -0.2)
    below = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    problem = ObstacleProblem(
        (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx,
        -3.0 * v * ufl.dx,
        lower=-0.5,
        contact=below,
        obstacle=g + 0.0 * ufl.SpatialCoordinate(domain)[0],
    )
    kept = problem.boundary
    tags = mesh.meshtags(domain, 1, np.sort(below), np.ones(len(below), dtype=np.int32))
    ds = ufl.Measure("ds", domain, subdomain_data=tags)
    with pytest.raises(InputError, match="not been solved"):
        _ = kept.gap
    for stretch in (1.0, 2.0):
        domain.geometry.x[:, 0] *= stretch
        problem.update(matrix=True)
        problem.solve(rtol=1e-12)
        whole = comm.allreduce(fem.assemble_scalar(fem.form(kept.pressure * ds(1))))
        assert whole == pytest.approx(kept.force, rel=1e-9) and kept.force > 0.1
        assert np.abs(kept.gap.x.array[kept.active]).max(initial=0.0) == 0.0
    g.value = -0.3
    problem.update()
    for name in ("gap", "active", "force", "pressure"):
        with pytest.raises(InputError, match="not been solved"):
            getattr(kept, name)
    problem.destroy()


def test_a_mesh_that_has_moved_is_noticed(membrane):
    """Alone, with a value of the load, and by what refuses data of another solve."""
    terms = EnergyTerms(load=-4.0, dirichlet=[(None, _above(membrane.mesh))])
    energy_bound(membrane.problem, terms)
    membrane.mesh.geometry.x[:, :2] *= 1.5
    with pytest.raises(InputError, match="changed since it was solved"):
        energy_bound(membrane.problem, terms)
    membrane.check()
    membrane.mesh.geometry.x[:, 0] *= -1.0
    membrane.f.value = -3.0
    membrane.check()
    membrane.k.value = 2.0
    membrane.check()


def _above(domain):
    top = domain.comm.allreduce(domain.geometry.x[:, 1].max(initial=-np.inf), op=MPI.MAX)
    return mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], top))


def test_a_direction_whose_values_change_is_refused(comm):
    domain = mesh.create_unit_square(comm, 6, 6)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, v, d = ufl.TrialFunction(V), ufl.TestFunction(V), fem.Constant(domain, (0.0, -1.0))
    bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    dofs = fem.locate_dofs_topological(V, 1, _above(domain))
    problem = ContactProblem(
        elasticity(u, v, young=1.0, poisson=0.3),
        ufl.inner(fem.Constant(domain, (0.0, -1.0)), v) * ufl.dx,
        contact=bottom,
        gap=0.1,
        direction=ufl.as_vector([d[0], d[1]]),
        bcs=[fem.dirichletbc(np.zeros(2), dofs, V)],
    )
    problem.solve()
    force = problem.force
    d.value = (0.6, -0.8)
    for _ in range(2):
        with pytest.raises(InputError, match="keeps the directions") as caught:
            problem.solve()
        assert caught.value.subject == "direction"
    d.value = (0.0, -1.0)
    problem.solve()
    assert problem.force == pytest.approx(force)
    problem.destroy()
