"""One-sided approximation: the linear program, its cases, the inequality (9)."""

import itertools
import math

import numpy as np
import pytest

from dolfinx_signorini.accuracy.terms import difference
from dolfinx_signorini.base.errors import NotConvergedError
from dolfinx_signorini.studies.paper.theory.errors import supercloseness
from dolfinx_signorini.studies.paper.theory.one_sided import (
    EdgeData,
    count_cases,
    edge_data,
    nearest,
    one_sided_approximation,
    smallest_one_sided,
    solve_linear_program,
)
from dolfinx_signorini.studies.paper.theory.proven import supercloseness_order


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


@pytest.mark.parametrize(("name", "n"), [("paper", 25), ("2.5", 25)])
def test_admissible_along_every_edge(discretisation, name, n):
    # At points of its own, ten times as fine as those of the program.
    d = discretisation(name, n)
    found = one_sided_approximation(d)
    t = np.linspace(0.0, 1.0, 641, dtype=np.float64)
    u = d.curve.samples([d.exact.u], t)[:, :, 0]
    w_h, ritz = along(d.curve.values(found.w_h), t), along(d.curve.values(d.ritz), t)
    assert float((ritz - u - w_h).max()) <= 1e-15
    assert float((w_h - ritz).max()) <= 1e-15
    assert found.outside == 0.0


def test_without_the_lowering_w_h_would_not_be_admissible(discretisation):
    d = discretisation("paper", 25)
    y = solve_linear_program(edge_data(d), np.ones(len(d.curve.s)))
    t = np.linspace(0.0, 1.0, 641, dtype=np.float64)
    assert float((-along(y, t) - d.curve.samples([d.exact.u], t)[:, :, 0]).max()) > 1e-7


@pytest.mark.parametrize("name", ["paper", "2.5"])
def test_the_infimum_of_lemma_3_4(discretisation, name):
    d = discretisation(name, 15)
    infimum, found = smallest_one_sided(d), one_sided_approximation(d)
    assert supercloseness(d) <= infimum <= found.norm * (1.0 + 1e-9)
    # An u_h that is 2.8 times as far off would be noticed.
    assert 2.8 * supercloseness(d) > infimum


def test_the_nearest_point_of_a_polyhedron():
    matrix, vector = np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([-1.0, 0.3])
    rows, lower = np.array([[1.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]), np.array([-0.4, -0.3, 0.2])
    y = nearest(matrix, vector, rows, lower)
    grid = np.linspace(-1.0, 1.0, 801)
    points = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    feasible = points[(points @ rows.T >= lower - 1e-9).all(axis=1)]

    def value(p):
        return 0.5 * ((p @ matrix) * p).sum(axis=-1) + p @ vector

    assert (rows @ y >= lower - 1e-9).all()
    assert value(y) == pytest.approx(value(feasible).min(), abs=1e-4)


def test_every_node_is_of_a_case(discretisation):
    for name, n in itertools.product(("paper", "smooth", "3"), (15, 25, 75)):
        cases = one_sided_approximation(discretisation(name, n)).cases
        assert sum(cases) == 4 * n
        assert cases[3] == 0
        assert min(cases[:3]) > 0


def test_a_solution_that_could_be_lower_has_nodes_of_no_case():
    data = wave()
    y = solve_linear_program(data, np.ones(4))
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
    y = solve_linear_program(data, np.ones(4))
    assert (y <= 1e-12).all()
    assert (along(y, data.t) + data.u).min() >= -1e-9
    for i in range(4):
        lower = y.copy()
        lower[i] -= 0.2
        assert (along(lower, data.t) + data.u).min() < -1e-3


def test_a_program_without_a_solution():
    # Without the upper bound and with the negative cost the program has no solution.
    with pytest.raises(NotConvergedError, match="linear program"):
        solve_linear_program(wave(), -np.ones(4), bounded=False)


def test_lowered_data_lie_below_u():
    # A convex u lies below its chords: the chords of the lowered data lie below u.
    samples = 8
    data = sampled(lambda s: 1.0 + 0.5 * (s - 2.0) ** 2, lambda s: s - 2.0, samples=samples)
    t = np.linspace(0.0, 1.0, 8001)
    for edge in range(4):
        exact = 1.0 + 0.5 * (edge + t - 2.0) ** 2
        assert (np.interp(t, data.t, data.u[edge]) > exact + 1e-4).any()
        assert (np.interp(t, data.t, data.lowered().u[edge]) <= exact).all()


def test_edge_data_have_exact_zeros(discretisation):
    data = edge_data(discretisation("paper", 25))
    at_contact = data.u[13:25]  # the bottom edges to the right of the detachment point
    assert (at_contact == 0.0).all()
    assert (data.u >= 0.0).all()
    assert data.u[:12].max() > 0.1
