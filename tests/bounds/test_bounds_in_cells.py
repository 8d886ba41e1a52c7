"""The bound of the energy error for obstacles in the domain, against exact solutions."""

import math

import numpy as np
import pytest
import scipy.sparse as sp
import ufl
from dolfinx import fem, mesh
from scipy.optimize import nnls

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.bounds import better_fluxes, cell_pressure, nearer
from dolfinx_signorini.bounds.energy_bound import energy_bound
from dolfinx_signorini.bounds.interior_point import QuadraticProgram
from dolfinx_signorini.bounds.reference_flux import reference_flux
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.meshes.box_meshes import box_mesh
from dolfinx_signorini.meshes.elements import bernstein_space
from dolfinx_signorini.meshes.polynomials import polynomials
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.dirichlet import dirichlet
from dolfinx_signorini.problem.obstacle import ObstacleProblem

A, HEIGHT = 0.697965148223372, 0.680259411891713  # see tests/problem/test_obstacle.py


def posed(domain, degree, load, reaction=0.0, fixed=None, bernstein=False, **obstacles):
    """-Laplace u + c u = f, with Dirichlet data on some facets."""
    space = fem.functionspace(domain, ("Lagrange", degree))
    space = bernstein_space(domain, degree) if bernstein else space
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    bcs = [dirichlet(space, facets, data) for data, facets in fixed or []]
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + reaction * u * v) * ufl.dx
    L = load * v * ufl.dx(metadata={"quadrature_degree": 2 * degree + 6})
    return ObstacleProblem(a, L, bcs=bcs, **obstacles)


def box(comm, low, high, n, d=2):
    """A mesh of a square or cube."""
    return box_mesh(comm, [np.linspace(low, high, n + 1)] * d)


def bowl(comm, degree, n, d=2, sign=1.0, **options):
    """Nochetto, Siebert and Veeser, Numer. Math. 95 (2003) 163-195, Section 7.2."""
    domain = box(comm, -1.0, 1.0, n, d)
    x, facets = ufl.SpatialCoordinate(domain), boundary_facets(domain)
    s = ufl.inner(x, x) - 0.49
    inside, outside = -3.92 * (1.0 - s), -4.0 * (2.0 * (s + 0.49) + d * s)
    load = sign * ufl.conditional(ufl.lt(s, 0.0), inside, outside)
    fixed = [(lambda x: sign * np.maximum((x**2).sum(axis=0) - 0.49, 0.0) ** 2, facets)]
    obstacle = {"lower": 0.0} if sign > 0.0 else {"upper": 0.0}
    problem = posed(domain, degree, load, fixed=fixed, **obstacle, **options)
    terms = EnergyTerms(load=load, dirichlet=[(sign * s**2, facets)])
    return problem, terms, 0.0, 0.0, sign * 4.0 * ufl.max_value(s, 0.0) * x


def ball(comm, degree, n, **options):
    """The hemisphere, continued by its tangent, see tests/problem/test_obstacle.py."""
    domain = box(comm, -2.0, 2.0, n)
    x, facets = ufl.SpatialCoordinate(domain), boundary_facets(domain)
    r2 = ufl.inner(x, x)

    def lower(x):
        r, h = np.hypot(x[0], x[1]), np.sqrt(1.0 - 0.81)
        return np.where(r < 0.9, np.sqrt(np.maximum(1.0 - r * r, 0.0)), h - 0.9 / h * (r - 0.9))

    fixed = [(lambda x: HEIGHT * np.log(2.0 / np.hypot(x[0], x[1])), facets)]
    load = fem.Constant(domain, 0.0)
    problem = posed(domain, degree, load, fixed=fixed, lower=lower, **options)
    terms = EnergyTerms(dirichlet=[(HEIGHT * (math.log(2.0) - 0.5 * ufl.ln(r2)), facets)])
    near, away = -x / ufl.sqrt(ufl.max_value(1.0 - r2, 0.01)), -HEIGHT * x / ufl.max_value(r2, 0.01)
    return problem, terms, 0.0, 0.0, ufl.conditional(ufl.lt(r2, A**2), near, away)


def ramp(comm, degree, n, d=2, c=0.0, free=False, some=False):
    """From -1 to 1 along x, in contact with a lower and an upper obstacle at both ends."""
    domain, b = box(comm, -1.0, 1.0, n, d), 0.55
    x = ufl.SpatialCoordinate(domain)
    t = x[0] / b

    def parts(inner, low, high):
        return ufl.conditional(x[0] < -b, low, ufl.conditional(x[0] > b, high, inner))

    u = parts(1.5 * t - 0.5 * t**3, -1.0, 1.0)
    load = parts(3.0 * t / b**2 + c * u, -c - 2.0, c + 2.0)
    slope = ufl.as_vector([parts((1.5 - 1.5 * t**2) / b, 0.0, 0.0)] + [0.0] * (d - 1))
    ends = mesh.locate_entities_boundary(domain, d - 1, lambda x: np.isclose(np.abs(x[0]), 1.0))
    fixed = [] if free else [(lambda x: np.sign(x[0]), ends)]
    away = {"cells": mesh.locate_entities(domain, d, lambda x: np.abs(x[0]) > 0.4)} if some else {}
    problem = posed(domain, degree, load, c, fixed, lower=-1.0, upper=1.0, **away)
    terms = EnergyTerms(load=load, reaction=c, dirichlet=[] if free else [(None, ends)])
    return problem, terms, c, u, slope


def checked(case, most, rtol=1e-10):
    """The bound of a problem, never below the error, and at most a multiple of the error."""
    problem, terms, c, u, slope = case
    problem.solve(rtol=rtol)
    bound, e, g = energy_bound(problem, terms), problem.u - u, ufl.grad(problem.u) - slope
    degree = 24 if problem.space.mesh.topology.dim == 2 else 14
    dx = ufl.dx(problem.space.mesh, metadata={"quadrature_degree": degree})
    square = fem.assemble_scalar(fem.form((ufl.inner(g, g) + c * e * e) * dx))
    error = math.sqrt(problem.comm.allreduce(square))
    assert error <= bound.total <= most * error
    squares = problem.comm.allreduce(float((bound.cells**2).sum()))
    assert math.sqrt(squares) == pytest.approx(bound.total, rel=1e-9)
    return bound


# The cases with the largest multiple of the error that was measured, and 5 % more.
CASES = {
    "bowl": (bowl, 16, {}, (1.25, 1.36, 2.0)),
    "bowl from above": (bowl, 16, {"sign": -1.0}, (1.25, 1.36, 2.0)),
    "bowl, Bernstein": (bowl, 16, {"bernstein": True}, (1.25, 1.32, 1.53)),
    "ball": (ball, 16, {}, (1.5, 1.5, 1.9)),
    "ball, Bernstein": (ball, 16, {"bernstein": True}, (1.5, 1.32, 1.42)),
    "ramp": (ramp, 8, {}, (1.25, 2.6, 3.8)),
    "ramp, Neumann": (ramp, 8, {"free": True}, (1.25, 2.6, 4.55)),
    "ramp, some cells": (ramp, 8, {"some": True}, (1.27, 2.6, 3.8)),
    "ramp, reaction": (ramp, 8, {"c": 1.0, "free": True}, (1.25, 2.6, 3.8)),
    "ramp, layers": (ramp, 8, {"c": 1e4}, (2.8, 1.65, 2.1)),
}


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("name", CASES)
def test_plane(name, degree, comm):
    make, n, options, most = CASES[name]
    checked(make(comm, degree, n, **options), most[degree - 1])


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("name", ["bowl", "ramp"])
@pytest.mark.parametrize("rtol", [1e-2, 1e-4])
def test_a_problem_that_is_hardly_solved(rtol, name, degree, comm):
    make, n, options, most = CASES[name]
    checked(make(comm, degree, n, **options), 1.5 * most[degree - 1], rtol)


SPACE = [
    (bowl, 1, 4, 1.4),
    (bowl, 2, 4, 1.47),
    (bowl, 3, 3, 3.64),
    (ramp, 1, 4, 1.5),
    (ramp, 2, 4, 3.0),
]


@pytest.mark.parametrize(("make", "degree", "n", "most"), SPACE)
def test_space(make, degree, n, most, comm):
    checked(make(comm, degree, n, d=3), most)


@pytest.mark.parametrize(("degree", "d", "most"), [(1, 2, 1.5), (2, 2, 7.0), (1, 3, 2.5)])
def test_a_free_boundary_that_is_too_large_for_a_program(degree, d, most, monkeypatch, comm):
    """The bound is a bound, but farther from the error."""
    for module in (better_fluxes, nearer):
        monkeypatch.setattr(module, "MOST_ENTRIES", {2: 0, 3: 0})
    checked(bowl(comm, degree, 16 if d == 2 else 6, d), most)


@pytest.mark.parametrize("equations", [0, 2])
def test_quadratic_programs(equations):
    """The conditions of Karush, Kuhn and Tucker hold."""
    rng = np.random.default_rng(equations)
    root, C, E = (rng.standard_normal(shape) for shape in ((12, 12), (equations, 12), (20, 12)))
    H, h, z = root @ root.T, rng.standard_normal(12), rng.standard_normal(12)
    c, e = C @ z, E @ z - np.maximum(rng.standard_normal(20), 0.0)
    matrices = sp.csc_matrix(H), h, sp.csc_matrix(C), c, sp.csr_matrix(E), e
    z = QuadraticProgram(*matrices).solution(np.ones(20))
    active = E @ z - e < 1e-5
    assert (E @ z >= e - 1e-7).all() and np.abs(C @ z - c).max(initial=0.0) < 1e-8
    # Multipliers of the equations may have any sign, those of the inequalities are not negative.
    held = np.vstack((C, -C, E[active]))
    assert active.any() and nnls(held.T, H @ z - h)[1] < 1e-4


# On one rank.
ALONE = {1: 1.42470018, 2: 0.183684183}


@pytest.mark.parametrize("degree", ALONE)
def test_the_ranks_do_not_show(degree, comm):
    bound = checked(bowl(comm, degree, 8), 2.0, 1e-12)
    assert bound.total == pytest.approx(ALONE[degree], rel=1e-6)


def stuck(comm, degree):
    """A problem with u = 0 on the obstacle in place of the solution, which the load lifts."""
    domain = box(comm, 0.0, 1.0, 6)
    facets = boundary_facets(domain)
    fixed = [(0.0, facets)] if degree == 1 else [(lambda x: 0.0 * x[0], facets)]
    problem = posed(domain, degree, fem.Constant(domain, 1.0), fixed=fixed, lower=0.0)
    problem.solve()
    problem.u.x.array[:] = 0.0
    return problem, EnergyTerms(load=1.0, dirichlet=[(0.0, facets)])


# The square of the energy norm of the solution of -Laplace u = 1 on the unit square: the integral
# of u, from the series of sines.
TORSION = sum(
    64.0 / math.pi**6 / ((m * k) ** 2 * (m**2 + k**2))
    for m in range(1, 200, 2)
    for k in range(1, 200, 2)
)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_an_obstacle_does_not_pull(degree, comm):
    bound = energy_bound(*stuck(comm, degree))
    assert math.sqrt(TORSION) <= bound.total <= 1.2 * math.sqrt(TORSION)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_an_obstacle_that_pulls_is_noticed_here(degree, monkeypatch, comm):
    """With pressures of any sign, u = 0 would seem to be a solution."""
    monkeypatch.setattr(cell_pressure, "_nowhere_negative", lambda wanted, reference: wanted)
    monkeypatch.setattr(cell_pressure, "_pulled", lambda data, moments, ends: ends & False)
    monkeypatch.setattr(better_fluxes, "_pulled", lambda data, *_: data.sides > 7)
    assert energy_bound(*stuck(comm, degree)).total < 0.5 * math.sqrt(TORSION)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("degree", [1, 2, 4])
def test_pressures_are_nowhere_negative(degree, dimension):
    rng = np.random.default_rng(degree)
    reference = reference_flux(dimension, degree)
    wanted = rng.standard_normal((200, math.comb(degree + dimension, dimension)))
    wanted[:100, 0] += 2.0
    pressure = cell_pressure._nowhere_negative(wanted, reference)
    points = rng.dirichlet(np.ones(dimension + 1), 500)[:, 1:]
    values = pressure @ polynomials(dimension, degree, points)
    assert values.min() >= -1e-12
    assert pressure[:, 0] == pytest.approx(np.maximum(wanted[:, 0], 0.0))
    assert np.abs(pressure[:, 1:]).max() > 0.05


def test_what_is_sampled_is_called_so(comm):
    domain = box(comm, 0.0, 1.0, 4)
    facets = boundary_facets(domain)
    x = ufl.SpatialCoordinate(domain)
    load, known = fem.Constant(domain, -20.0), {"load": -20.0, "dirichlet": [(0.0, facets)]}
    at_points = (-ufl.exp(x[0]), False), (lambda x: -np.exp(x[0]), True)
    for obstacle, sampled in ((-0.5, False), (-0.5 - x[0], False), *at_points):
        problem = posed(domain, 1, load, fixed=[(0.0, facets)], lower=obstacle)
        problem.solve()
        bound = energy_bound(problem, EnergyTerms(**known))
        assert bound.sampled == sampled and any("obstacle" in n for n in bound.notes) == sampled


def test_a_bound_is_of_the_data_of_the_solve(comm):
    """A step that begins with the last solution as obstacle is another problem."""
    domain = mesh.create_unit_square(comm, 8, 8)
    V = fem.functionspace(domain, ("Lagrange", 1))
    u, v, g = ufl.TrialFunction(V), ufl.TestFunction(V), fem.Function(V)
    facets = boundary_facets(domain)
    g.x.array[:] = -0.05
    f, held = fem.Constant(domain, -8.0), fem.Constant(domain, 0.0)
    dofs = fem.locate_dofs_topological(V, 1, facets)
    a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    problem = ObstacleProblem(a, f * v * ufl.dx, lower=g, bcs=[fem.dirichletbc(held, dofs, V)])
    terms = EnergyTerms(diffusion=1.0, load=f, dirichlet=[(held, facets)])
    problem.solve(rtol=1e-10)
    total = energy_bound(problem, terms).total
    for data, value in ((g, None), (f, -7.0), (held, 0.1)):
        numbers = data.x.array if value is None else data.value
        before = numbers.copy()
        numbers[...] = problem.u.x.array if value is None else value
        for _ in range(2):
            with pytest.raises(InputError, match="changed since it was solved"):
                energy_bound(problem, terms)
        problem.solve(rtol=1e-10)
        assert energy_bound(problem, terms).total > 0.0
        numbers[...] = before
        problem.solve(rtol=1e-10)
        assert energy_bound(problem, terms).total == pytest.approx(total, rel=1e-6)
    problem.destroy()
