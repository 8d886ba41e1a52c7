"""Forms that are integrated piece by piece are the forms that were given."""

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.data.interfaces.piecewise_forms import BY_DATA, by_data
from dolfinx_signorini.problem.elasticity import stress

COMM = MPI.COMM_WORLD
EXACT = {"quadrature_degree": 40}


def positive(t):
    return ufl.conditional(ufl.gt(t, 0.0), t, 0.0)


def circle(x):
    return (x[0] - 0.1) ** 2 + (x[1] - 0.45) ** 2 - 0.12


def jump(x):
    return ufl.conditional(x[0] + 0.7 * x[1] > 0.631, 3.0, -1.0)


# Functions of v, u, x and n, the kind of the integral, and whether the data are read.
SUMMANDS = {
    "load": (lambda v, u, x, n: jump(x) * v, "dx", True),
    "load with a kink": (lambda v, u, x, n: positive(circle(x)) * v, "dx", True),
    "flux of a gradient": (
        lambda v, u, x, n: positive(circle(x)) * ufl.inner(ufl.grad(circle(x)), n) * v,
        "ds",
        True,
    ),
    "flux of a component": (lambda v, u, x, n: jump(x) * n[1] * v, "ds", True),
    "flux with and without normals": (
        lambda v, u, x, n: jump(x) * n[0] * v + positive(x[1] - 0.3) * v + x[0] * n[1] * v,
        "ds",
        True,
    ),
    "flux that is no linear function of the normal": (
        lambda v, u, x, n: jump(x) * (n[0] ** 2 + 2.0 * n[1]) * v,
        "ds",
        False,
    ),
    "slope along the normal": (lambda v, u, x, n: jump(x) * ufl.dot(ufl.grad(v), n), "ds", False),
    "reaction": (lambda v, u, x, n: positive(circle(x)) * u * v, "dx", True),
    "springs": (lambda v, u, x, n: (2.0 + jump(x)) * n[1] * u * v, "ds", True),
    "diffusion": (
        lambda v, u, x, n: (2.0 + jump(x)) * ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v,
        "dx",
        True,
    ),
    "flux on both sides of a facet": (
        lambda v, u, x, n: ufl.avg(positive(circle(x))) * ufl.jump(ufl.grad(v), n),
        "dS",
        False,
    ),
}


def assembled(form):
    """Return the values of a linear or bilinear form for fixed random functions."""
    rng, values = np.random.default_rng(3), []
    for _ in range(4):
        functions = {}
        for argument in form.arguments():
            waves, phase = rng.uniform(-3.0, 3.0, size=3), rng.uniform(0.0, 6.0)
            f = functions[argument] = fem.Function(argument.ufl_function_space())
            f.interpolate(lambda x, waves=waves, phase=phase: np.cos(waves @ x + phase))
        scalar = fem.form(ufl.replace(form, functions))
        values.append(COMM.allreduce(fem.assemble_scalar(scalar)))
    return np.array(values)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", SUMMANDS)
def test_the_form_is_the_one_that_was_given(name, dim):
    n = {2: 8, 3: 4}[dim]
    domain = (dolfinx.mesh.create_unit_square if dim == 2 else dolfinx.mesh.create_unit_cube)(
        COMM, *dim * [n]
    )
    space = fem.functionspace(domain, ("Lagrange", 2))
    v, u = ufl.TestFunction(space), ufl.TrialFunction(space)
    x, normal = ufl.SpatialCoordinate(domain), ufl.FacetNormal(domain)
    summand, kind, read = SUMMANDS[name]
    measures = {"dx": ufl.dx, "ds": ufl.ds, "dS": ufl.dS}
    given = summand(v, u, x, normal) * measures[kind](domain)
    found = by_data(given, pieces=True)
    assert (found is not given) == read
    if not read:
        return
    exact = assembled(summand(v, u, x, normal) * measures[kind](domain, metadata=EXACT))
    # Where the data jump by 4, the rule of 21 points is wrong by 4 / 21 of one facet at most.
    assert assembled(found) == pytest.approx(exact, abs=4.0 / 21.0 / n)
    left_open = summand(v, u, x, normal) * measures[kind](domain, metadata=BY_DATA)
    # The same projections, which all of these rules integrate exactly beside smooth data.
    assert assembled(by_data(left_open)) == pytest.approx(assembled(found), rel=1e-9)


def test_fluxes_that_jump_are_exact_up_to_rounding():
    """The flux max(y - 0.3, 0) n_x of a square: an integral over both sides, of both signs."""
    domain = dolfinx.mesh.create_unit_square(COMM, 8, 8)
    space = fem.functionspace(domain, ("Lagrange", 2))
    v, x = ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    form = positive(x[1] - 0.3) * ufl.FacetNormal(domain)[0] * v * ufl.ds
    f = fem.Function(space)
    for where, sign in ((0.0, -1.0), (1.0, 1.0)):
        f.interpolate(lambda x, where=where: np.isclose(x[0], where).astype(float))
        total = fem.assemble_scalar(fem.form(ufl.replace(by_data(form, pieces=True), {v: f})))
        assert COMM.allreduce(total) == pytest.approx(sign * 0.5 * 0.7**2, rel=1e-12)


def degrees_of_rules(form):
    return [integral.metadata()["quadrature_degree"] for integral in by_data(form).integrals()]


def test_rules_that_follow_data_have_as_many_points_as_polynomials_ask_for():
    domain = dolfinx.mesh.create_unit_square(COMM, 3, 3)
    space = fem.functionspace(domain, ("Lagrange", 2))
    v, u, x = ufl.TestFunction(space), ufl.TrialFunction(space), ufl.SpatialCoordinate(domain)
    dx = ufl.dx(domain, metadata=BY_DATA)
    gradients = ufl.inner(ufl.grad(u), ufl.grad(v))
    assert degrees_of_rules(3.0 * gradients * dx + x[0] * u * v * dx(degree=9)) == [2, 9]
    assert degrees_of_rules(x[0] ** 2 * gradients * dx + (u * v) * dx) == [4, 4]
    assert degrees_of_rules((gradients + x[1] * u * v) * dx) == [5]
    assert degrees_of_rules(x[0] * v * dx + ufl.exp(x[0]) * v * dx) == [3, 7]
    unread = fem.Function(space)
    assert degrees_of_rules(unread * u * v * dx) == [8]
    named = x[0] * v * ufl.dx(domain)
    assert by_data(named) is named


@pytest.mark.parametrize("degree", [1, 2])
def test_the_stiffness_of_a_body_that_jumps_inside_cells(degree):
    """The energy is the sum of the energies of both parts, on meshes of their own."""

    def energy(domain, young, poisson, integrated):
        space = fem.functionspace(domain, ("Lagrange", degree, (2,)))
        w, v, u = fem.Function(space), ufl.TestFunction(space), ufl.TrialFunction(space)
        w.interpolate(lambda x: np.stack((x[0] ** degree - x[1], x[0] * x[1] ** (degree - 1))))
        a = ufl.inner(stress(u, young, poisson), ufl.sym(ufl.grad(v)))
        a = integrated(a * ufl.dx(domain, metadata=BY_DATA))
        return COMM.allreduce(fem.assemble_scalar(fem.form(ufl.replace(a, {u: w, v: w}))))

    exact = 0.0
    for ends, young, poisson in (((0.0, 0.37), 20.0, 0.1), ((0.37, 1.0), 3.0, 0.4)):
        corners = [[ends[0], 0.0], [ends[1], 1.0]]
        part = dolfinx.mesh.create_rectangle(COMM, corners, [3, 3])
        exact += energy(part, young, poisson, by_data)
    whole = dolfinx.mesh.create_unit_square(COMM, 7, 7)
    left = ufl.lt(ufl.SpatialCoordinate(whole)[0], 0.37)
    data = ufl.conditional(left, 20.0, 3.0), ufl.conditional(left, 0.1, 0.4)
    assert energy(whole, *data, by_data) == pytest.approx(exact, rel=1e-12)


def test_rules_of_one_kernel_do_not_disturb_each_other():
    domain = dolfinx.mesh.create_unit_square(COMM, 9, 9)
    space = fem.functionspace(domain, ("Lagrange", 1))
    v, u, x = ufl.TestFunction(space), ufl.TrialFunction(space), ufl.SpatialCoordinate(domain)
    (v_x, v_y), (u_x, u_y) = ufl.grad(v), ufl.grad(u)
    dx = ufl.dx(domain, metadata=BY_DATA)
    one = ufl.conditional(x[0] < 0.37, 2.0, 4.0)
    other = ufl.conditional(x[0] + x[1] < 0.71, 3.0, 1.0)
    a = (one * u_x * v_x + 0.5 * x[0] * (u_x * v_y + u_y * v_x) + other * u_y * v_y) * dx
    a += (abs(x[0] - 0.43) + ufl.conditional(x[1] < 0.37, 2.0, 4.0)) * u * v * dx
    whole = by_data(a)
    parts = [fem.assemble_matrix(fem.form(ufl.Form([part]))) for part in whole.integrals()]
    together = fem.assemble_matrix(fem.form(whole))
    assert together.data == pytest.approx(sum(part.data for part in parts), abs=1e-12)
