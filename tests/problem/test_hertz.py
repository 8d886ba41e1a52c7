"""Hertz's contact in the plane: the closed form by itself, and what finite elements find of it."""

import basix.ufl
import dolfinx
import hertz
import numpy as np
import pytest
import ufl
from dolfinx import fem
from elastic_reference import gathered, nodes_of
from mpi4py import MPI

from dolfinx_signorini import ContactProblem

COMM = MPI.COMM_WORLD


def test_the_numbers_of_the_closed_form():
    assert pytest.approx(0.680778, abs=1e-6) == hertz.A
    assert pytest.approx(9.351351, abs=1e-6) == hertz.P0
    x = np.linspace(-hertz.A, hertz.A, 200_001)
    force = np.sum(hertz.pressure(np.stack([x, 0.0 * x]))) * (x[1] - x[0])
    assert force == pytest.approx(hertz.FORCE, rel=1e-6)


def test_the_closed_form_is_in_equilibrium():
    """By differences: the gradient of the displacement, and a stress without divergence."""
    rng, step = np.random.default_rng(0), 1e-5
    x = np.stack([rng.uniform(-2.0, 2.0, 200), rng.uniform(0.05, 2.0, 200)])

    def slopes(function):
        ends = [(x + step * unit[:, None], x - step * unit[:, None]) for unit in np.eye(2)]
        return [(function(high) - function(low)) / (2.0 * step) for high, low in ends]

    (along_x, along_y), gradient = slopes(hertz.displacement), hertz.gradient(x)
    found = np.stack([along_x[0], along_y[0], along_x[1], along_y[1]])
    assert found == pytest.approx(gradient, abs=1e-8 * np.abs(gradient).max())
    (xx, _, xy), (_, yy, yx) = slopes(hertz.stress)
    assert np.abs([xx + yx, xy + yy]).max() <= 1e-8 * np.abs(xx).max()


def test_the_closed_form_solves_the_contact_problem():
    """On y = 0: no shear, the pressure of Hertz, and the parabola is touched for |x| <= a only."""
    x = np.stack([np.linspace(-2.0, 2.0, 401), np.zeros(401)])
    _, normal, shear = hertz.stress(x)
    assert normal == pytest.approx(-hertz.pressure(x), abs=1e-12)
    assert np.abs(shear).max() <= 1e-12
    gap = hertz.gap(x) + hertz.displacement(x)[1]
    touches = np.abs(x[0]) < hertz.A
    assert np.abs(gap[touches]).max() <= 1e-15 and gap[~touches].min() > 0.0


def solved(n, degree):
    """The problem on a block of 4 x 2 with 2 n x n squares, solved."""
    corners = [(-2.0, 0.0), (2.0, 2.0)]
    domain = dolfinx.mesh.create_rectangle(
        COMM, corners, (2 * n, n), dolfinx.mesh.CellType.triangle
    )
    space = fem.functionspace(domain, ("Lagrange", degree, (2,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    data, zero = fem.Function(space), fem.Constant(domain, (0.0, 0.0))
    data.interpolate(hertz.displacement)
    bottom, others = (
        dolfinx.mesh.locate_entities_boundary(domain, 1, where)
        for where in (
            lambda x: np.isclose(x[1], 0.0),
            lambda x: np.isclose(np.abs(x[0]), 2.0) | np.isclose(x[1], 2.0),
        )
    )
    bc = fem.dirichletbc(data, fem.locate_dofs_topological(space, 1, others))
    strain = ufl.sym(ufl.grad(u))
    stress = 2.0 * hertz.MU * strain + hertz.LAMBDA * ufl.tr(strain) * ufl.Identity(2)
    a = ufl.inner(stress, ufl.sym(ufl.grad(v))) * ufl.dx
    L = ufl.inner(zero, v) * ufl.dx
    problem = ContactProblem(a, L, contact=bottom, gap=hertz.gap, bcs=[bc])
    problem.solve(rtol=1e-11)
    return problem


def energy_norm(domain, gradient):
    """The energy norm of a displacement whose gradient is given."""
    strain = ufl.sym(gradient)
    density = 2.0 * hertz.MU * ufl.inner(strain, strain) + hertz.LAMBDA * ufl.tr(strain) ** 2
    over = ufl.dx(metadata={"quadrature_degree": 8, "quadrature_rule": "default"})
    square = fem.assemble_scalar(fem.form(density * over, dtype=np.float64))
    return np.sqrt(domain.comm.allreduce(square))


def errors(n, degree):
    """The relative energy error, and those of p0, the force and the contact radius."""
    problem = solved(n, degree)
    domain = problem.space.mesh
    element = basix.ufl.quadrature_element("triangle", value_shape=(2, 2), degree=8)
    exact = fem.Function(fem.functionspace(domain, element))
    exact.interpolate(hertz.gradient)
    error = energy_norm(domain, ufl.grad(problem.u) - exact) / energy_norm(domain, exact)
    x, pressure, gap = nodes_of(problem.space), gathered(problem.pressure), gathered(problem.gap)
    bottom = np.isclose(x[1], 0.0) & (np.abs(x[0]) < 2.0 - 1e-9)
    middle = bottom & np.isclose(x[0], 0.0)
    radius = np.abs(x[0, bottom & (gap == 0.0)]).max()
    force = problem.force
    problem.destroy()
    assert abs(force[0]) <= 1e-12 * force[1]  # the obstacle pushes up, and has no friction
    return error, pressure[middle][0] / hertz.P0 - 1.0, force[1] / hertz.FORCE - 1.0, radius


@pytest.mark.parametrize("degree, least", [(1, 0.9), (2, 1.35)])
def test_orders(degree, least):
    """The solution is in H^s for s < 5/2: the energy error has order 1, and 3/2 for degree 2.

    The contact has ends between two nodes, so that the orders of two meshes vary; the mean counts.
    """
    sizes = np.array([16, 32, 64]) // degree
    found = np.array([errors(n, degree) for n in sizes])
    energy, peak, force, radius = found.T
    assert np.log2(energy[0] / energy[-1]) / 2.0 >= least, energy
    # Forces are dual to displacements: better than the error, as energies are its square.
    assert (np.abs(force) <= energy).all(), found
    assert np.abs(peak[-1]) <= 1e-2 and (np.abs(peak) <= 2.0 * energy).all(), found
    # The contact ends within one cell of the exact end.
    assert (np.abs(radius - hertz.A) <= 2.0 / sizes).all(), radius


def test_nearly_incompressible(monkeypatch):
    """Degree 1 locks and degree 2 does not, on the same unknowns: docs/howto/elastic.md says so."""
    names = ("NU", "MU", "LAMBDA", "KAPPA", "E_STAR", "A", "P0")
    usual = {degree: errors(32 // degree, degree)[0] for degree in (1, 2)}
    for name, value in zip(names, hertz.constants(0.499), strict=True):
        monkeypatch.setattr(hertz, name, value)
    found = {degree: errors(32 // degree, degree) for degree in (1, 2)}
    assert found[1][0] > 5.0 * usual[1] and found[1][2] > 0.1  # far too stiff
    assert found[2][0] < 5.0 * usual[2] and abs(found[2][2]) < 0.01
    finer = errors(32, 2)
    assert np.log2(found[2][0] / finer[0]) >= 1.25 and abs(finer[2]) < 2e-3
