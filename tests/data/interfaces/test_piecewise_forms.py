"""Forms that are integrated piece by piece are the forms that were given."""

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.data.interfaces.piecewise_forms import piecewise

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
    found = piecewise(given, domain)
    assert (found is not None) == read
    if found is None:
        return
    exact = assembled(summand(v, u, x, normal) * measures[kind](domain, metadata=EXACT))
    # Where the data jump by 4, the rule of 21 points is wrong by 4 / 21 of one facet at most.
    assert assembled(found) == pytest.approx(exact, abs=4.0 / 21.0 / n)


def test_fluxes_that_jump_are_exact_up_to_rounding():
    """The flux max(y - 0.3, 0) n_x of a square: an integral over both sides, of both signs."""
    domain = dolfinx.mesh.create_unit_square(COMM, 8, 8)
    space = fem.functionspace(domain, ("Lagrange", 2))
    v, x = ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    form = positive(x[1] - 0.3) * ufl.FacetNormal(domain)[0] * v * ufl.ds
    f = fem.Function(space)
    for where, sign in ((0.0, -1.0), (1.0, 1.0)):
        f.interpolate(lambda x, where=where: np.isclose(x[0], where).astype(float))
        total = fem.assemble_scalar(fem.form(ufl.replace(piecewise(form, domain), {v: f})))
        assert COMM.allreduce(total) == pytest.approx(sign * 0.5 * 0.7**2, rel=1e-12)
