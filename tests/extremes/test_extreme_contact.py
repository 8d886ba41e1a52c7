"""Extremes of the contact set: all, none, one node, every second node, nothing to decide by."""

import numpy as np
import pytest
import ufl
from cases import Case, digits_of, square
from dolfinx import fem
from mpi4py import MPI
from mpmath import mpf

from dolfinx_signorini import (
    SignoriniProblem,
    christof_haubner,
    error_norms,
    friedrichs_keller,
)
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.studies.paper.solution import paper_problem

TIGHT = 1e-13


def constant(value):
    return lambda x: value + 0 * x[0]


def spike(x0):
    """An obstacle that sticks out at one node of the bottom edge only."""
    return lambda x: np.where(np.hypot(x[0] - x0, x[1]) < 1e-9, 0.5, -10.0)


def comb(n):
    """An obstacle that sticks out at every second node of the boundary."""
    return lambda x: np.where(np.rint(n * (x[0] + x[1])) % 2 == 0, 0.5, -10.0)


def left_bottom(x):
    """The facet of the bottom edge next to the left corner."""
    return (x[1] < 1e-9) & (x[0] < 0.25 + 1e-9)


CASES = {
    "everywhere: load -1, obstacle 0": (
        Case(square(), load=constant(-1.0), obstacle=constant(0.0)),
        16,
    ),
    "nowhere: load 1, obstacle -1": (
        Case(square(), load=constant(1.0), obstacle=constant(-1.0)),
        0,
    ),
    "nowhere: obstacle -1e300": (Case(square(), obstacle=constant(-1e300)), 0),
    "at one node": (Case(square(), obstacle=spike(0.5)), 1),
    "at a corner of two cells": (Case(square(), obstacle=spike(0.0)), 1),
    "at a corner of one cell": (Case(square(), obstacle=spike(1.0)), 1),
    "at every second node": (Case(square(), load=constant(0.0), obstacle=comb(4)), 8),
    "contact boundary of one facet": (
        Case(square(), load=constant(-1.0), obstacle=constant(0.0), where=left_bottom),
        2,
    ),
}


@pytest.mark.parametrize("method", ["cascade", "bqnls"])
@pytest.mark.parametrize("name", CASES)
def test_contact_sets(name, method, record):
    case, active = CASES[name]
    problem = case.problem()
    u = problem.solve(method, rtol=TIGHT if method == "cascade" else None)
    result = problem.result
    problem.destroy()
    values, held, nodes = case.solution(problem.space)
    pairs = zip(u.x.array.tolist(), nodes.of_dof, strict=True)
    local = max((abs(mpf(v) - values[k]) for v, k in pairs), default=mpf(0))
    error = max(case.domain.comm.allgather(local))
    digits = digits_of(error, max(map(abs, values)))
    assert len(held) == active
    assert result.active_dofs == active
    assert digits >= (13 if method == "cascade" else 6.5)
    if method == "cascade":
        text = f"{digits:.1f} digits, {result.active_dofs} active dofs as there"
        record("contact", name, "50 digits, N = 4", text)


def test_a_singular_form_held_at_one_node(record):
    """Without reaction only contact holds the body: here one node does."""
    case = Case(square(), reaction=0.0, load=constant(-1.0), obstacle=spike(0.5))
    problem = case.problem()
    u = problem.solve(rtol=TIGHT)
    problem.destroy()
    values, held, nodes = case.solution(problem.space)
    pairs = zip(u.x.array.tolist(), nodes.of_dof, strict=True)
    local = max((abs(mpf(v) - values[k]) for v, k in pairs), default=mpf(0))
    digits = digits_of(max(case.domain.comm.allgather(local)), max(map(abs, values)))
    assert len(held) == problem.result.active_dofs == 1
    assert digits >= 12
    record("contact", "no reaction, held at one node", "50 digits, N = 4", digits)


def solve_functional(domain, functional):
    """Solve the paper's problem with a load of its own, obstacle 0 on the whole boundary."""
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)

    def a(w, v):
        return (ufl.inner(ufl.grad(w), ufl.grad(v)) + w * v) * ufl.dx

    problem = SignoriniProblem(
        a(u, v), functional(a, space, v), contact=boundary_facets(domain), obstacle=0.0
    )
    u = problem.solve(rtol=TIGHT)
    problem.destroy()
    return u


def bump(x):
    return x[0] * (1 - x[0]) * x[1] * (1 - x[1]) * np.exp(x[0])


def half(x):
    """Positive on part of the boundary; on the rest it vanishes without any pressure."""
    return np.maximum(x[0] - 0.5, 0.0) ** 2 + bump(x)


@pytest.mark.parametrize("n", [4, 64])
@pytest.mark.parametrize("shape", [bump, half])
def test_biactive(shape, n, record):
    """b = A w with w >= 0, so that w solves the problem with no pressure anywhere."""
    known = []

    def functional(a, space, v):
        w = fem.Function(space)
        w.interpolate(shape)
        known.append(w)
        return a(w, v)

    u = solve_functional(friedrichs_keller(MPI.COMM_WORLD, n), functional)
    comm, w = MPI.COMM_WORLD, known[0].x.array
    error = comm.allreduce(np.abs(u.x.array - w).max(initial=0.0), op=MPI.MAX)
    digits = digits_of(error, comm.allreduce(np.abs(w).max(initial=0.0), op=MPI.MAX))
    assert digits >= 11
    where = "the whole boundary" if shape is bump else "the left half of the boundary"
    stops = "which of these dofs count as active is rounding; u is not"
    record("biactive", f"{where}, N = {n}", "the known u in V_h", digits, stops)


def test_no_data_at_all(record):
    """f = 0 and g = 0: the solution is zero to the last bit, biactive everywhere."""
    u = solve_functional(square(), lambda a, space, v: fem.Constant(space.mesh, 0.0) * v * ufl.dx)
    assert (u.x.array == 0.0).all()
    record("biactive", "load 0, obstacle 0", "u = 0", "every bit")


SHIFTS = (1e-14, -1e-14, 3e-16)


@pytest.mark.parametrize("n,where", [(64, "on a node"), (63, "in the middle of a cell")])
def test_detachment_point(n, where, record):
    """The solution depends continuously on where it detaches, also when that is a node."""
    solutions = []
    domain = friedrichs_keller(MPI.COMM_WORLD, n)
    for shift in (0.0, *SHIFTS):
        exact = christof_haubner(domain, (0.5 + shift, 0.0))
        problem = paper_problem(exact)
        u = problem.solve(rtol=TIGHT)
        problem.destroy()
        solutions.append((u.x.array, error_norms(u, exact, ["L4", "W1_4", "Linf"])))
    comm = MPI.COMM_WORLD
    reference, errors = solutions[0]
    size = comm.allreduce(np.abs(reference).max(initial=0.0), op=MPI.MAX)
    for shift, (values, moved) in zip(SHIFTS, solutions[1:], strict=True):
        change = comm.allreduce(np.abs(values - reference).max(initial=0.0), op=MPI.MAX)
        digits = digits_of(change, size)
        assert digits >= 11.5
        assert moved == pytest.approx(errors, rel=1e-9)
        case = f"{shift:g} from the point 0.5, {where} (N = {n})"
        record("detachment", case, "continuity: u for 0.5", digits)


@pytest.mark.parametrize("n", [64, 63])
def test_detachment_orders(n, record):
    """On a node or between two, the errors go down at the paper's orders."""
    errors = []
    for cells in (n, 2 * n + n % 2):
        exact = christof_haubner(friedrichs_keller(MPI.COMM_WORLD, cells))
        problem = paper_problem(exact)
        u = problem.solve(rtol=1e-10)
        problem.destroy()
        errors.append((cells, error_norms(u, exact, ["L4", "W1_4"])))
    (coarse, first), (fine, second) = errors
    order = {k: np.log(first[k] / second[k]) / np.log(fine / coarse) for k in first}
    assert order["L4"] == pytest.approx(2.0, abs=0.1)
    assert order["W1_4"] == pytest.approx(1.0, abs=0.05)
    text = f"orders L4 {order['L4']:.2f}, W1_4 {order['W1_4']:.2f}"
    parity = "on a node" if n % 2 == 0 else "between nodes"
    record("detachment", f"{parity}, N = {coarse} to {fine}", "refinement: orders 2 and 1", text)
