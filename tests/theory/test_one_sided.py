"""One-sided approximation: the linear program, its cases, the inequality (9)."""

import itertools
import math

import numpy as np
import pytest
from mpi4py import MPI

from dolfinx_signorini.errors import NotConvergedError
from dolfinx_signorini.paper.theory.discretisation import difference
from dolfinx_signorini.paper.theory.one_sided import (
    EdgeData,
    count_cases,
    edge_data,
    one_sided_approximation,
    sampling_error,
    solve_linear_program,
)
from dolfinx_signorini.paper.theory.proven import supercloseness_order
from dolfinx_signorini.paper.theory.ritz import supercloseness

COMM = MPI.COMM_WORLD


def along(nodal, t):
    return nodal[:, None] * (1.0 - t) + np.roll(nodal, -1)[:, None] * t


def sampled(u, slope, count=4, samples=64):
    """Edge data of a function of the arc length of a closed curve of length `count`."""
    t = np.linspace(0.0, 1.0, samples + 1)
    s = np.arange(count)[:, None] + t
    return EdgeData(t, u(s), slope(s), np.ones(count))


def wave():
    w = 2.0 * np.pi / 4.0
    return sampled(lambda s: 1.0 - np.cos(w * s), lambda s: w * np.sin(w * s))


@pytest.mark.parametrize("name", ["paper", "smooth", "2.5", "16"])
@pytest.mark.parametrize("n", [15, 25, 75])
def test_lemma_3_4(discretisation, name, n):
    # (9) holds for every h, not just for small ones.
    d = discretisation(name, n)
    assert supercloseness(d) <= one_sided_approximation(d).norm


@pytest.mark.parametrize("name", ["2.5", "3", "8", "paper"])
def test_lemma_3_5(discretisation, name):
    coarse, fine = (one_sided_approximation(discretisation(name, n)).norm for n in (25, 75))
    order = math.log(coarse / fine) / math.log(3.0)
    p = math.inf if name == "paper" else float(name)
    assert order >= supercloseness_order(p).value - 0.05


def test_admissible_along_every_edge(discretisation):
    # At points of its own, finer than those of the program, within the bound that it states.
    d = discretisation("paper", 25)
    found = one_sided_approximation(d)
    curve = d.curve
    t = np.linspace(0.0, 1.0, 640, dtype=np.float64)
    u = curve.samples([d.exact.u], t)[:, :, 0]
    w_h, ritz = along(curve.values(found.w_h), t), along(curve.values(d.ritz), t)
    violation = float((ritz - u - w_h).max())
    assert violation <= found.sampling_error * (1.0 + 1e-6) + 1e-12
    assert found.sampling_error < 1e-3 * found.norm
    assert float((w_h - ritz).max()) <= 1e-10


def test_every_node_is_of_a_case(discretisation):
    for name, n in itertools.product(("paper", "smooth", "3"), (15, 25, 75)):
        cases = one_sided_approximation(discretisation(name, n)).cases
        assert sum(cases) == 4 * n
        assert cases[3] == 0
        assert min(cases[:3]) > 0


def test_a_solution_that_could_be_lower_has_nodes_of_no_case():
    data = wave()
    y = solve_linear_program(COMM, data, np.ones(4))
    assert count_cases(data, y)[3] == 0
    lifted = np.where(data.u[:, 0] > 0.5, 0.5 * y, y)
    assert count_cases(data, lifted)[3] > 0


def test_the_harmonic_extension_is_the_smallest(discretisation):
    d = discretisation("paper", 25)
    w_h = one_sided_approximation(d).w_h
    other = d.curve.function(d.curve.values(w_h))  # zero inside
    assert d.norm(w_h) < d.norm(other)
    # Orthogonal to every function that vanishes on the boundary.
    bubble = difference(w_h, other)
    assert abs(d.product(w_h, bubble)) < 1e-9 * d.norm(w_h) * d.norm(bubble)


def test_no_node_of_a_minimiser_can_be_lowered():
    data = wave()
    y = solve_linear_program(COMM, data, np.ones(4))
    assert (y <= 1e-12).all()
    assert (along(y, data.t) + data.u).min() >= -1e-9
    for i in range(4):
        lower = y.copy()
        lower[i] -= 0.2
        assert (along(lower, data.t) + data.u).min() < -1e-3


def test_exact_where_u_vanishes_at_a_node():
    # Next to a zero of u with a horizontal tangent y cannot be negative, between samples neither.
    y = solve_linear_program(COMM, wave(), np.ones(4))
    assert abs(y[[0, 1, 3]]).max() < 1e-12
    assert y[2] == pytest.approx(-2.0)  # case 1: u(2) itself


def test_a_program_without_a_solution():
    # Without the upper bound and with the negative cost the program has no solution.
    with pytest.raises(NotConvergedError, match="linear program"):
        solve_linear_program(COMM, wave(), -np.ones(4), bounded=False)


def test_sampling_error_is_a_bound():
    # y touches u at the samples and dives below between them, as u is convex.
    samples = 8
    data = sampled(lambda s: 1.0 + 0.5 * (s - 2.0) ** 2, lambda s: s - 2.0, samples=samples)
    y = np.full(4, -data.u[1, -1])  # u is smallest there: -y is above u nowhere but there
    y[1] = -data.u[1, -2] * samples + data.u[1, -1] * (samples - 1)  # through the sample before
    s = np.linspace(0.0, 1.0, 8001)
    exact = 1.0 + 0.5 * (s - 1.0) ** 2
    violation = float((-(y[1] * (1.0 - s) + y[2] * s) - exact).max())
    assert 0.0 < violation <= sampling_error(data, y)
    assert sampling_error(data, np.zeros(4)) == 0.0


def test_edge_data_have_exact_zeros(discretisation):
    data = edge_data(discretisation("paper", 25))
    at_contact = data.u[13:25]  # the bottom edges to the right of the detachment point
    assert (at_contact == 0.0).all()
    assert (data.u >= 0.0).all()
    assert data.u[:12].max() > 0.1
