"""Forms that are not positive definite are refused at assembly; those that are, never."""

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.contact import ContactProblem
from dolfinx_signorini.problem.elasticity import elasticity
from dolfinx_signorini.problem.signorini import SignoriniProblem

COMM = MPI.COMM_WORLD


def problem_with(a, domain, degree=1, clamped=None):
    """A problem whose whole boundary, without a clamped part, is pressed against an obstacle.

    The form is made by a(u, v, x).
    """
    space = fem.functionspace(domain, ("Lagrange", degree))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    facets, bcs = boundary_facets(domain), []
    if clamped is not None:
        tdim = domain.topology.dim
        middle = dolfinx.mesh.compute_midpoints(domain, tdim - 1, facets)
        dofs = fem.locate_dofs_topological(space, tdim - 1, facets[clamped(middle.T)])
        bcs = [fem.dirichletbc(PETSc.ScalarType(0.0), dofs, space)]
    L = fem.Constant(domain, -1.0) * v * ufl.dx
    return SignoriniProblem(a(u, v, ufl.SpatialCoordinate(domain)), L, contact=facets, bcs=bcs)


def with_reaction(c):
    """-Laplace u + c u, c a function of x."""
    return lambda u, v, x: (ufl.inner(ufl.grad(u), ufl.grad(v)) + c(x) * u * v) * ufl.dx


def with_diffusion(k):
    return lambda u, v, x: (ufl.inner(k(x) * ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx


def everywhere(x):
    return np.full(x.shape[1], True)


def box(x, side, inside, outside):
    far = ufl.max_value(abs(x[0] - 0.5), abs(x[1] - 0.5))
    return ufl.conditional(ufl.lt(far, side / 2), inside, outside)


INDEFINITE = {
    "right half": (with_reaction(lambda x: ufl.conditional(ufl.gt(x[0], 0.5), -10.0, 11.0)), None),
    "left half": (with_reaction(lambda x: ufl.conditional(ufl.lt(x[0], 0.5), -6.0, 6.5)), None),
    "a corner": (
        with_reaction(lambda x: ufl.conditional(ufl.lt(x[0] + x[1], 0.5), -50.0, 20.0)),
        None,
    ),
    "a box": (with_reaction(lambda x: box(x, 0.4, -150.0, 40.0)), None),
    "waves": (with_reaction(lambda x: 40.0 * ufl.cos(2.0 * ufl.pi * x[0]) + 1.0), None),
    "slope": (with_reaction(lambda x: 30.0 * (x[1] - 0.45)), None),
    "constants": (with_reaction(lambda x: -1.0), None),
    "clamped": (with_reaction(lambda x: -40.0), everywhere),
    "nearly": (with_reaction(lambda x: -20.5), everywhere),
    "clamped on one side": (with_reaction(lambda x: -3.0), lambda x: x[1] > 1 - 1e-9),
    "clamped below": (with_reaction(lambda x: -200.0 * x[0] ** 4), lambda x: x[0] < 1e-9),
    "a negative direction": (
        lambda u, v, x: (u.dx(0) * v.dx(0) - 0.1 * u.dx(1) * v.dx(1) + u * v) * ufl.dx,
        None,
    ),
    "negative diffusion": (with_diffusion(lambda x: box(x, 0.5, -1.0, 1.0)), None),
    "a tensor": (
        with_diffusion(lambda x: ufl.as_matrix([[1.0, 1.2], [1.2, 1.0]])),
        None,
    ),
    "Robin": (
        lambda u, v, x: (
            with_reaction(lambda x: 1.0)(u, v, x)
            - ufl.conditional(ufl.gt(x[0], 1 - 1e-9), 9.0, 0.0) * u * v * ufl.ds
        ),
        None,
    ),
}
DEFINITE = {
    "constants": (with_reaction(lambda x: 0.0 * x[0]), None),
    "tiny": (with_reaction(lambda x: 1e-12), None),
    "large": (with_reaction(lambda x: 1e12), None),
    "half": (with_reaction(lambda x: ufl.conditional(ufl.gt(x[0], 0.5), -2.0, 11.0)), None),
    "clamped": (with_reaction(lambda x: -19.7), everywhere),
    "checkers": (
        lambda u, v, x: box(x, 0.5, 1e8, 1.0) * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        None,
    ),
    "a tensor": (
        with_diffusion(lambda x: 1e6 * ufl.as_matrix([[1.0, 1.0], [1.0, 1.0 + 1e-9]])),
        None,
    ),
}


@pytest.mark.parametrize("n", [16, 40])
@pytest.mark.parametrize("name", INDEFINITE)
def test_an_indefinite_form_is_refused_also_where_contact_holds_everything(name, n):
    a, clamped = INDEFINITE[name]
    with pytest.raises(InputError, match="form a: not positive definite"):
        problem_with(a, friedrichs_keller(COMM, n), clamped=clamped).destroy()


@pytest.mark.parametrize(("n", "degree"), [(7, 1), (64, 1), (9, 3)])
@pytest.mark.parametrize("name", DEFINITE)
def test_a_semidefinite_form_is_not_refused(name, n, degree):
    a, clamped = DEFINITE[name]
    problem_with(a, friedrichs_keller(COMM, n), degree, clamped).destroy()


def test_an_indefinite_form_in_space():
    cube = mesh.create_unit_cube(COMM, 8, 8, 8)
    c = with_reaction(lambda x: ufl.conditional(ufl.gt(x[2], 0.5), -10.0, 11.0))
    with pytest.raises(InputError, match="form a: not positive definite"):
        problem_with(c, cube)
    problem_with(with_reaction(lambda x: 0.0 * x[0]), cube).destroy()
    problem_with(with_reaction(lambda x: -29.0), cube, clamped=everywhere).destroy()


@pytest.mark.parametrize("direction", [(0.0, -1.0), (0.6, -0.8)])
@pytest.mark.parametrize(("factor", "indefinite"), [(0.2, False), (1.0, True), (3.0, True)])
def test_a_body_that_bends_for_less_than_nothing(factor, indefinite, direction):
    """A cantilever with - k (u, v), whose least eigenvalue is 0.015, -0.002 and -0.05."""
    beam = mesh.create_rectangle(COMM, [(0.0, 0.0), (4.0, 1.0)], (24, 6))
    space = fem.functionspace(beam, ("Lagrange", 1, (2,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    left, below = (
        mesh.locate_entities_boundary(beam, 1, lambda x, k=k: np.isclose(x[k], 0.0)) for k in (0, 1)
    )
    clamped = fem.dirichletbc(fem.Function(space), fem.locate_dofs_topological(space, 1, left))
    a = elasticity(u, v, 200.0, 0.3) - factor * ufl.inner(u, v) * ufl.dx
    load = ufl.inner(fem.Constant(beam, (0.0, -3.0)), v) * ufl.dx
    keywords = {"contact": below, "gap": 1e-3, "direction": direction, "bcs": [clamped]}
    if not indefinite:
        ContactProblem(a, load, **keywords).destroy()
        return
    with pytest.raises(InputError, match="form a: not positive definite"):
        ContactProblem(a, load, **keywords)


def test_a_form_on_a_mesh_thinner_than_wide():
    thin = friedrichs_keller(COMM, 16)
    thin.geometry.x[:, 1] *= 1e-3
    problem_with(with_reaction(lambda x: 0.0 * x[0]), thin).destroy()
    c = with_reaction(lambda x: ufl.conditional(ufl.gt(x[0], 0.5), -10.0, 11.0))
    with pytest.raises(InputError, match="form a: not positive definite"):
        problem_with(c, thin)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cells", [7, 300])
def test_on_the_line(cells, degree, comm):
    """-u'' + k u = -1 on (0, 1) with contact at both ends: u = cosh(x - 1/2) / cosh(1/2) - 1."""
    domain = mesh.create_unit_interval(comm, cells)
    space = fem.functionspace(domain, ("Lagrange", degree))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    k = fem.Constant(domain, 1.0)
    a = (u.dx(0) * v.dx(0) + k * u * v) * ufl.dx
    facets = boundary_facets(domain)
    problem = SignoriniProblem(a, -v * ufl.dx, contact=facets)
    problem.solve(rtol=1e-10)
    x = ufl.SpatialCoordinate(domain)[0]
    exact = ufl.cosh(x - 0.5) / np.cosh(0.5) - 1.0
    error = comm.allreduce(fem.assemble_scalar(fem.form((problem.u - exact) ** 2 * ufl.dx)))
    assert np.sqrt(error) < 0.1 * cells ** -(degree + 1.0)
    forces = comm.allreduce(problem.forces.x.array[problem.contact_dofs].sum())
    assert forces == pytest.approx(2.0 * np.tanh(0.5), rel=0.2 * cells**-2.0)
    with pytest.raises(InputError, match="plane"):
        problem.plot()
    problem.destroy()
    k.value = -3.0  # below -pi^2/4, the least eigenvalue with u = 0 at one end
    left = fem.locate_dofs_geometrical(space, lambda x: np.isclose(x[0], 0.0))
    bcs = [fem.dirichletbc(0.0, left, space)]
    with pytest.raises(InputError, match="definite"):
        SignoriniProblem(a, -v * ufl.dx, contact=facets, bcs=bcs)
