"""Hertz's contact in space: the closed form by itself, and what finite elements find of it."""

import dolfinx
import hertz_space as hertz
import numpy as np
import pytest
import ufl
from dolfinx import fem
from elastic_reference import gathered, nodes_of
from mpi4py import MPI

from dolfinx_signorini import ContactProblem, elasticity

COMM = MPI.COMM_WORLD
SIDE = 0.2


def test_the_numbers_of_the_closed_form():
    assert pytest.approx(0.1) == hertz.A
    assert pytest.approx(0.0293040, abs=5e-8) == hertz.FORCE
    assert pytest.approx(1.399164, abs=5e-7) == hertz.P0
    assert pytest.approx(2.0 / 3.0 * np.pi * hertz.A**2 * hertz.P0) == hertz.FORCE


def test_the_closed_form_is_the_integral_of_point_forces():
    rng = np.random.default_rng(0)
    x = np.stack([*rng.uniform(-0.2, 0.2, (2, 12)), rng.uniform(0.04, 0.3, 12)])
    x[:2, 0] = 0.0  # on the axis
    exact = hertz.by_quadrature(x)
    assert hertz.displacement(x) == pytest.approx(exact, abs=1e-10 * np.abs(exact).max())


def test_the_closed_form_touches_the_paraboloid():
    """On z = 0 where r <= a, and nowhere beyond."""
    x = np.stack([np.linspace(0.0, 0.3, 301), np.zeros(301), np.zeros(301)])
    gap = hertz.gap(x) + hertz.displacement(x)[2]
    touches = x[0] < hertz.A - 1e-9
    assert np.abs(gap[touches]).max() <= 1e-15
    assert gap[x[0] > hertz.A + 1e-9].min() > 0.0


def solved(n, degree):
    """The problem on a quarter of a block with n cubes a side, solved."""
    domain = dolfinx.mesh.create_box(COMM, [(0.0, 0.0, 0.0), (SIDE,) * 3], [n] * 3)
    space = fem.functionspace(domain, ("Lagrange", degree, (3,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    data = fem.Function(space)
    data.interpolate(hertz.displacement)

    def side(axis, end):
        return dolfinx.mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[axis], end))

    far = np.concatenate([side(axis, SIDE) for axis in range(3)])
    bcs = [fem.dirichletbc(data, fem.locate_dofs_topological(space, 2, far))]
    for axis in range(2):  # planes of symmetry
        part = space.sub(axis)
        dofs = fem.locate_dofs_topological(part, 2, side(axis, 0.0))
        bcs.insert(0, fem.dirichletbc(0.0, dofs, part))
    zero = fem.Constant(domain, (0.0,) * 3)
    problem = ContactProblem(
        elasticity(u, v, young=hertz.E, poisson=hertz.NU),
        ufl.inner(zero, v) * ufl.dx,
        contact=side(2, 0.0),
        gap=hertz.gap,
        direction=(0.0, 0.0, -1.0),
        bcs=bcs,
    )
    problem.solve(rtol=1e-10)
    return problem


def errors(n, degree):
    """The relative errors of energy norm, force and largest pressure, and the contact radius."""
    problem = solved(n, degree)
    domain = problem.space.mesh
    fine = fem.Function(fem.functionspace(domain, ("Lagrange", degree + 1, (3,))))
    fine.interpolate(hertz.displacement)

    def energy(w):
        form = elasticity(w, w, young=hertz.E, poisson=hertz.NU)
        return np.sqrt(COMM.allreduce(fem.assemble_scalar(fem.form(form))))

    error = energy(problem.u - fine) / energy(fine)
    x, gap, pressure = nodes_of(problem.space), gathered(problem.gap), gathered(problem.pressure)
    below = np.isclose(x[2], 0.0) & (x[:2].max(axis=0) < SIDE - 1e-9)
    radius = np.hypot(*x[:2, below & (gap == 0.0)]).max()
    peak = pressure[below & (np.hypot(x[0], x[1]) < 1e-9)][0]
    force = 4.0 * problem.force[2]
    problem.destroy()
    return error, force / hertz.FORCE - 1.0, peak / hertz.P0 - 1.0, radius


@pytest.mark.parametrize("degree, sizes, least", [(1, (8, 16), 0.85), (2, (4, 8), 1.2)])
def test_orders(degree, sizes, least):
    coarse, fine = (errors(n, degree) for n in sizes)
    assert np.log2(coarse[0] / fine[0]) >= least, (coarse, fine)
    # Forces are dual to displacements: better than the error, as energies are its square.
    for error, force, _, radius in (coarse, fine):
        assert abs(force) <= error
        assert abs(radius - hertz.A) <= 1.5 * SIDE / (sizes[0] if error == coarse[0] else sizes[1])
    assert abs(fine[2]) <= 2.0 * fine[0]
