"""The contact pressure: its total is the resultant force, and its density tends to du/dn."""

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.box_meshes import friedrichs_keller
from dolfinx_signorini.elements import control_points
from dolfinx_signorini.meshes import boundary_facets
from dolfinx_signorini.paper.solution import AMPLITUDE, christof_haubner, paper_problem
from dolfinx_signorini.problem import SignoriniProblem

COMM = MPI.COMM_WORLD


def integral(form):
    return float(COMM.allreduce(fem.assemble_scalar(fem.form(form))))


def smallest(values):
    return float(COMM.allreduce(float(np.min(values, initial=np.inf)), op=MPI.MIN))


def uneven(n):
    """The unit square with cells that are narrower on the left."""
    domain = friedrichs_keller(COMM, n)
    domain.geometry.x[:, 0] **= 1.5
    return domain


def cube(n):
    return dolfinx.mesh.create_unit_cube(COMM, n, n, n)


@pytest.mark.parametrize(
    ("domain", "degree"),
    [
        (friedrichs_keller(COMM, 6), 1),
        (friedrichs_keller(COMM, 6), 2),
        (uneven(7), 1),
        (cube(3), 1),
    ],
    ids=["P1", "P2", "uneven P1", "cube P1"],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_body_pulled_down_evenly_presses_evenly(domain, degree, sign):
    # u = -3 h at the height h is harmonic, lies on the floor 0 and presses with 3 everywhere.
    force, top = 3.0, domain.geometry.dim - 1
    space = fem.functionspace(domain, ("Lagrange", degree))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    lid, floor = (
        dolfinx.mesh.locate_entities_boundary(domain, top, lambda x, h=h: np.isclose(x[top], h))
        for h in (1.0, 0.0)
    )
    dofs = fem.locate_dofs_topological(space, top, lid)
    problem = SignoriniProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        fem.Constant(domain, 0.0) * v * ufl.dx,
        contact=floor,
        bound="lower" if sign > 0.0 else "upper",
        bcs=[fem.dirichletbc(fem.Constant(domain, -sign * force), dofs, space)],
    )
    problem.solve(rtol=1e-12)
    pressure = problem.pressure
    assert pressure.x.array[problem.contact_dofs] == pytest.approx(force, rel=1e-9)
    tags = dolfinx.mesh.meshtags(domain, top, np.sort(floor), np.ones(len(floor), dtype=np.int32))
    ds = ufl.Measure("ds", domain, subdomain_data=tags)(1)
    assert integral(pressure * ds) == pytest.approx(force * integral(1.0 * ds), rel=1e-9)
    problem.destroy()


@pytest.mark.parametrize("n", [16, 33])
def test_the_total_pressure_is_the_resultant_of_load_and_reaction(n):
    exact = christof_haubner(friedrichs_keller(COMM, n))
    problem = paper_problem(exact)
    u = problem.solve(rtol=1e-12)
    load = COMM.allreduce(float(problem.b.array_r.sum()))
    force = integral(problem.pressure * ufl.ds)
    assert force > 1.0
    assert force == pytest.approx(integral(u * ufl.dx) - load, rel=1e-8)
    problem.destroy()


@pytest.mark.parametrize("degree", [1, 2])
def test_the_density_converges_to_the_normal_derivative(degree):
    errors = []
    for n in (40, 80):
        exact = christof_haubner(friedrichs_keller(COMM, n))
        problem = paper_problem(exact, degree)
        problem.solve(rtol=1e-10)
        x, y = control_points(problem.space)[problem.contact_dofs, :2].T
        pressure = problem.pressure.x.array[problem.contact_dofs]
        # du/dn = 10 psi(r) 3/2 r^{1/2} on the bottom to the right of the detachment point.
        r = x - 0.5
        t = r / 0.45
        psi = (1.0 - t) ** 5 * (1.0 + t * (5.0 + t * (15.0 + t * (35.0 + t * 70.0))))
        seen = (y < 1e-12) & (r > 0.1) & (t < 1.0)
        flux = 1.5 * AMPLITUDE * psi[seen] * np.sqrt(r[seen])
        worst = float(np.abs(pressure[seen] - flux).max(initial=0.0))
        largest = float(flux.max(initial=0.0))
        worst, largest = (COMM.allreduce(v, op=MPI.MAX) for v in (worst, largest))
        errors.append(worst / largest)
        problem.destroy()
    assert errors[1] < 0.02
    assert errors[1] < 0.6 * errors[0]


def test_the_pressure_is_not_negative_where_a_loose_solve_leaves_a_pull():
    # Pushed down but for a strip at the bottom: what is held there is not released any more.
    domain = friedrichs_keller(COMM, 10)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    strip = ufl.And(ufl.lt(x[1], 0.15), ufl.lt(abs(x[0] - 0.5), 0.2))
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    load = ufl.conditional(strip, 4.0, -1.0) * v * ufl.dx(metadata={"quadrature_degree": 4})
    problem = SignoriniProblem(a, load, contact=boundary_facets(domain))
    problem.solve(rtol=0.9)
    vector = problem.system.vector_of(problem.u)
    forces = problem.system.multiplier(vector)[problem.system.touching(vector)]
    vector.destroy()
    assert smallest(forces) < 0.0  # else there is nothing to see
    assert smallest(problem.pressure.x.array) == 0.0
    problem.destroy()
