"""Extremes of the data: their scales, coefficients, loads, and the tolerances asked for."""

import numpy as np
import pytest
import ufl
from cases import (
    Case,
    attained,
    digits_of,
    humps,
    reach,
    right_or_refused,
    square,
    waves,
    worst,
)
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini import InputError, NotConvergedError, SignoriniProblem

TIGHT = 1e-13
SCALES = (1e-250, 1e-150, 1e-20, 1e20, 1e150, 1e250)
UP = tuple(10.0**k for k in (0, 50, 100, 150, 200, 250, 280, 289, 295, 300, 307))
DOWN = (*(1.0 / s for s in UP[:-1]), 1e-307, 1e-320)


def scaled(load, obstacle, operator=1.0, domain=None):
    """The model problem with load, obstacle and operator in other units."""
    return Case(
        square() if domain is None else domain,
        operator,
        operator,
        load=lambda x: load * waves(x),
        obstacle=lambda x: obstacle * humps(x),
    )


KINDS = {
    "load and obstacle times s": lambda s: scaled(s, s),
    "load times s, obstacle of size 0.02": lambda s: scaled(s, 1.0),
    "obstacle times s, load of size 1": lambda s: scaled(1.0, s),
    "form a and load times s": lambda s: scaled(s, 1.0, operator=s),
}


@pytest.mark.parametrize("kind", KINDS)
def test_scales(kind, record):
    """u keeps its digits in every unit; numbers near the ends of the range are refused."""

    def attempt(s):
        return attained(KINDS[kind](s), rtol=TIGHT)

    digits = worst(SCALES, attempt)
    assert digits >= 12
    stops = f"upwards {reach(UP, attempt, 12)}; downwards {reach(DOWN, attempt, 12)}"
    record("scales", f"{kind}, s = 1e-250 ... 1e250", "50 digits, N = 4", digits, stops)


@pytest.mark.parametrize("method", ["bncg", "bqnls", "bntr"])
def test_scales_with_tao_alone(method, record):
    digits = worst(SCALES, lambda s: attained(scaled(s, s), method))
    assert digits >= 7
    case = f"the same with {method.upper()} at its default rtol 1e-8"
    record("scales", case, "50 digits, N = 4", digits)


@pytest.mark.parametrize("method", ["cascade", "bqnls"])
def test_powers_of_two_change_no_bit(method, comm, record):
    """In units that are powers of two all steps are the same, rounding included."""
    solutions, domain = [], square()
    for k in (0, -830, 830):
        problem = scaled(2.0**k, 2.0**k, domain=domain).problem()
        solutions.append(problem.solve(method).x.array / 2.0**k)
        problem.destroy()
    if comm.size > 1:  # the order in which ranks add to each other's rows is not fixed
        assert solutions[1] == pytest.approx(solutions[0], rel=1e-6, abs=1e-9)
        return
    assert (solutions[0] == solutions[1]).all() and (solutions[0] == solutions[2]).all()
    case = f"load and obstacle times 2^-830 and 2^830, {method}"
    record("scales", case, "scaling: the same u times 2^k", "every bit")


@pytest.mark.parametrize("method,rtol,least", [("cascade", TIGHT, 13), ("bqnls", 1e-8, 7)])
def test_scales_with_dirichlet_data(method, rtol, least, record):
    """Dirichlet rows have no unit of their own: form a and load times s change nothing."""
    domain = square(8)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    f = fem.Function(space)
    f.interpolate(waves)
    fixed = fem.locate_dofs_geometrical(space, lambda x: x[0] < 1e-9)
    contact = mesh.locate_entities_boundary(domain, 1, lambda x: x[0] > 1.0 - 1e-9)

    def solution(s):
        factor = fem.Constant(domain, s)
        problem = SignoriniProblem(
            factor * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
            factor * f * v * ufl.dx,
            contact=contact,
            obstacle=humps,
            bcs=[fem.dirichletbc(0.01, fixed, space)],
        )
        values = problem.solve(method, rtol=rtol).x.array
        problem.destroy()
        return values

    reference = solution(1.0)

    def attempt(s):
        local = np.array([np.abs(v).max(initial=0.0) for v in (solution(s) - reference, reference)])
        error, size = np.max(domain.comm.allgather(local), axis=0)
        return digits_of(error, size)

    digits = worst((1e-250, 1e-12, 1e12, 1e250), attempt)
    assert digits >= least
    case = f"form a and load times s with Dirichlet data, s = 1e-250 ... 1e250, {method}"
    record("scales", case, "scaling: the u of s = 1", digits)


PAIRS = [(1e12, 1.0), (1e-12, 1.0), (1.0, 1e12), (1.0, 1e-12), (1e12, 1e-12), (1e-12, 1e12)]
NOWHERE = -1e30


@pytest.mark.parametrize("diffusion,reaction", PAIRS)
def test_coefficients(diffusion, reaction, record):
    digits = attained(Case(square(), diffusion, reaction), rtol=TIGHT)
    assert digits >= 12
    case = f"diffusion {diffusion:g}, reaction {reaction:g}, some contact"
    record("coefficients", case, "50 digits, N = 4", digits)


def test_where_coefficients_stop(record):
    """Without contact only the reaction holds u: the ratio of the coefficients costs digits."""

    def free(ratio):
        return attained(Case(square(), ratio, obstacle=lambda x: NOWHERE + 0 * x[0]), rtol=1e-7)

    def dominated(ratio):
        return attained(Case(square(), 1.0, ratio), rtol=TIGHT)

    assert worst((1.0, 1e4), free) >= 7
    assert worst((1e12, 1e24), dominated) >= 12
    record(
        "coefficients",
        "diffusion over reaction, no contact anywhere, rtol 1e-7",
        "50 digits, N = 4",
        worst((1.0, 1e4), free),
        reach([10.0**k for k in range(0, 25, 2)], free, 4),
    )
    record(
        "coefficients",
        "reaction over diffusion, some contact",
        "50 digits, N = 4",
        worst((1e12, 1e24), dominated),
        reach([10.0**k for k in range(0, 101, 20)], dominated, 12),
    )


@pytest.mark.parametrize("diffusion", [1e6, 1e12])
def test_stiff_operators_with_first_order_methods(diffusion, record):
    """The load is a tiny part of what lifting the body over the obstacle would take."""
    text, stops = right_or_refused(Case(square(), diffusion), "bqnls", 7)
    case = f"diffusion {diffusion:g}, reaction 1, BQNLS at its default rtol 1e-8"
    record("coefficients", case, "50 digits, N = 4", text, stops)


def jump(x):
    return np.where(x[0] + x[1] < 0.9, 1.0, -1.0) * np.where(x[0] < 0.5, 3.0, 1.0)


def point(x0, force):
    """The whole force in one cell of the square with 4 cells per side."""

    def load(x):
        distance = np.hypot(x[0] - x0[0], x[1] - x0[1])
        return np.where(distance < 0.01, force * 32.0, 0.0)

    return load


LOADS = {
    "load 3, 1, -1, -3, constant on cells": (jump, humps),
    "a force 1 up in one inner cell": (point((7 / 12, 5 / 12), 1.0), humps),
    "a force 1 down in one inner cell": (point((7 / 12, 5 / 12), -1.0), lambda x: 0 * x[0]),
    "a force 1 down in one cell at the boundary": (point((7 / 12, 1 / 6), -1.0), humps),
}


@pytest.mark.parametrize("name", LOADS)
def test_rough_loads(name, record):
    load, obstacle = LOADS[name]
    case = Case(square(), load=load, obstacle=obstacle, cell_load=True)
    digits = attained(case, rtol=TIGHT)
    assert digits >= 13
    record("loads", name, "50 digits, N = 4", digits)


@pytest.mark.parametrize("force", [1e-200, 1e200])
def test_a_point_load_next_to_an_ordinary_one(force, record):
    """A spike of any size takes no digit from what it dominates."""
    pointed = point((7 / 12, 5 / 12), force)
    case = Case(square(), load=lambda x: pointed(x) + jump(x), cell_load=True)
    digits = attained(case, rtol=TIGHT)
    assert digits >= 13
    record("loads", f"a force {force:g} in one cell and a jumping load", "50 digits, N = 4", digits)


@pytest.mark.parametrize("method", ["cascade", "bqnls"])
@pytest.mark.parametrize("rtol", [0.0, -1.0, 1.0, float("nan")])
def test_hopeless_tolerances_are_refused(rtol, method, record):
    problem = Case(square()).problem()
    with pytest.raises(InputError, match="rtol"):
        problem.solve(method, rtol=rtol)
    problem.destroy()
    if rtol == 0.0:
        record("tolerances", f"rtol 0, {method}", "an `InputError` that names rtol", "refused")


@pytest.mark.parametrize("method", ["cascade", "bqnls", "bntr"])
def test_a_tolerance_below_rounding(method, record):
    """The residual asked for is reached or the solver says that it was not."""
    problem = Case(square()).problem()
    try:
        problem.solve(method, rtol=1e-16)
        residual = problem.result.natural_residual
        assert residual <= 1e-16
        stops = "reached"
    except NotConvergedError as error:
        residual, stops = error.residual, "refused: `NotConvergedError`"
        assert residual > 1e-16
    problem.destroy()
    assert residual <= 2e-15
    case = f"rtol 1e-16, {method}"
    record("tolerances", case, "its own residual", f"residual {residual:.1e}", stops)


@pytest.mark.parametrize("method", ["cascade", "bqnls", "bntr"])
def test_a_loose_tolerance(method, record):
    problem = Case(square()).problem()
    problem.solve(method, rtol=0.5)
    result = problem.result
    problem.destroy()
    assert result.natural_residual <= 0.5
    digits = attained(Case(square()), method, rtol=0.5)
    attained_text = f"residual {result.natural_residual:.1e}, {digits:.1f} digits"
    record("tolerances", f"rtol 0.5, {method}", "50 digits, N = 4", attained_text)


@pytest.mark.parametrize("kind", ["triangle", "quadrilateral"])
def test_the_unit_of_the_form_in_degree_3(kind):
    """Two materials: contact sets that are corrected around their ends do not feel the unit."""
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 8, 8, getattr(mesh.CellType, kind))
    space = fem.functionspace(domain, ("Lagrange", 3))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    stiff = fem.Function(fem.functionspace(domain, ("DG", 0)))
    stiff.interpolate(lambda x: np.where(x[0] < 0.5, 101.0, 1.0))
    floor = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    top = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 1.0))
    bc = fem.dirichletbc(0.0, fem.locate_dofs_topological(space, 1, top), space)
    forces = []
    for unit in (1.0, 1e-14, 1e-16, 1e-30):
        factor = fem.Constant(domain, unit)
        problem = SignoriniProblem(
            factor * stiff * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
            -2.0 * factor * v * ufl.dx,
            contact=floor,
            obstacle=-0.1,
            bcs=[bc],
        )
        problem.solve()
        forces.append(problem.force / unit)
        problem.destroy()
    assert forces == pytest.approx([forces[0]] * 4, rel=1e-5)
    assert forces[0] > 0.1
