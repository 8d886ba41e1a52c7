"""What the checks rest on: triangulations, discrete second derivatives, enclosures, problem (3)."""

import itertools
import math

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.bounds.energy_bound import energy_bound
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.orders import approximation_order, eoc
from dolfinx_signorini.studies.paper.theory import triangulations
from dolfinx_signorini.studies.paper.theory.enclosures import dual_force_bound, enclosures
from dolfinx_signorini.studies.paper.theory.errors import second_seminorms
from dolfinx_signorini.studies.paper.theory.examples import levels_of_bumps
from dolfinx_signorini.studies.paper.theory.families import solved
from dolfinx_signorini.studies.paper.theory.mixed import PowerProblem
from dolfinx_signorini.studies.paper.theory.proven import power_exponents

COMM = MPI.COMM_WORLD


def area(domain):
    one = fem.Constant(domain, 1.0)
    return COMM.allreduce(float(fem.assemble_scalar(fem.form(one * ufl.dx(domain)))))


@pytest.mark.parametrize(
    ("make", "angle"),
    [
        (triangulations.unstructured, 60.0),
        (triangulations.obtuse, 100.0),
        (triangulations.graded, 90.0),
    ],
)
def test_triangulations_fill_the_square(make, angle):
    shapes = []
    for n in (10, 20):
        domain = make(COMM, n)
        assert area(domain) == pytest.approx(1.0)
        assert triangulations.largest_angle(domain) > angle
        shapes.append(triangulations.shape(domain))
    # Quasi-uniform, but for the graded one, whose cells are smaller by 1/n at the point.
    assert (shapes[1] > 1.5 * shapes[0]) == (make is triangulations.graded)


def test_shapes_of_right_triangles():
    domain = friedrichs_keller(COMM, 3)
    # Hypotenuse over the diameter of the inscribed circle, 2 - sqrt(2).
    assert triangulations.shape(domain) == pytest.approx(math.sqrt(2.0) / (2.0 - math.sqrt(2.0)))
    assert triangulations.largest_angle(domain) == pytest.approx(90.0)


@pytest.mark.parametrize(
    ("a", "p", "order"), [(0.5, 2.0, -0.5), (1.5, 16.0, -0.375), (2.0, 2.0, 0.0)]
)
def test_second_derivatives_of_powers(a, p, order):
    values = []
    for n in (21, 41, 81):
        space = fem.functionspace(friedrichs_keller(COMM, n), ("Lagrange", 1))
        v = fem.Function(space)
        v.interpolate(lambda x: np.hypot(x[0] - 0.5, x[1] - 0.5) ** a)
        (value,) = second_seminorms(v, (p,)).values()
        values.append(value)
    assert eoc([1 / 41, 1 / 81], values[1:])[0] == pytest.approx(order, abs=0.05)


def test_second_derivatives_of_a_parabola():
    # x^2 on squares of side h: the slope jumps by 2h across the n (n - 1) upright edges, and not
    # across the diagonals, as both triangles of a square have one slope.
    n = 8
    space = fem.functionspace(friedrichs_keller(COMM, n), ("Lagrange", 1))
    v = fem.Function(space)
    v.interpolate(lambda x: x[0] ** 2)
    found = second_seminorms(v, (2.0,))["2"]
    # J = 2h on upright edges: |E|^2 (J/|E|)^2 = 4 h^2 for n (n - 1) edges.
    assert found**2 == pytest.approx(4.0 * n * (n - 1) / n**2, rel=1e-10)


def test_enclosures_enclose_and_wrong_bounds_do_not(discretisation):
    d = discretisation("paper", 25)
    sup = error_norms(d.u_h, d.exact, ["Linf", "W1_inf"])
    found = enclosures(d, sup["Linf"], sup["W1_inf"])
    assert 0.4 < found.outer <= 0.5 <= found.inner < 0.6
    assert enclosures(d, 1e9, 1e9).outer == 0.0
    assert enclosures(d, 1e9, 1e9).inner == 1.0
    # A bound that is none: the first positive node lies beyond the point.
    assert enclosures(d, -1.0, sup["W1_inf"]).outer > 0.5


def test_the_force_is_bounded_by_a_dual_solution(discretisation):
    d = discretisation("paper", 25)
    sup = error_norms(d.u_h, d.exact, ["Linf"])["Linf"]
    energy = energy_bound(d, EnergyTerms(reaction=1.0, load=d.exact.load)).total
    x = d.system.vector_of(d.u_h)
    force = COMM.allreduce(float(d.system.multiplier(x).sum()))
    x.destroy()
    # The flux of the exact solution into the square, -du/dy on the bottom, by a rule in r^{1/2}.
    nodes, weights = np.polynomial.legendre.leggauss(40)
    s = 0.5 * math.sqrt(0.45) * (nodes + 1.0)
    t = s * s / 0.45
    psi = (1.0 - t) ** 5 * (1.0 + 5.0 * t + 15.0 * t**2 + 35.0 * t**3 + 70.0 * t**4)
    exact = 0.5 * math.sqrt(0.45) * float(weights @ (10.0 * psi * 1.5 * s * 2.0 * s))
    bound = dual_force_bound(d, sup, energy)
    assert abs(exact - force) < bound < 0.3 * energy
    assert dual_force_bound(d, 2.0 * sup, energy) > bound


@pytest.mark.parametrize("p", [2.5, math.inf])
def test_problem_3_has_the_orders_of_its_singularity(p):
    exponent = min(power_exponents(p))
    coarse, fine = ({}, {})
    for n, errors in ((25, coarse), (51, fine)):
        problem = solved(COMM, lambda domain: PowerProblem(domain, p), n)
        errors.update(error_norms(problem.u, problem.exact, ["Linf", "W1_inf"]))
        problem.destroy()
    for norm in coarse:
        order = eoc([1 / 25, 1 / 51], [coarse[norm], fine[norm]])[0]
        assert order == pytest.approx(approximation_order(norm, exponent=exponent), abs=0.02)


def test_levels_of_bumps_lie_side_by_side():
    levels = levels_of_bumps(3.0, 3, 8)
    for level, following in itertools.pairwise(levels):
        assert following.start == pytest.approx(level.start + level.count * level.width)
        # In W^{2,p}: the p-th power of a level is like its length, 1/k^2.
        assert following.amplitude / level.amplitude == pytest.approx(0.5 ** (2.0 - 1.0 / 3.0))
    assert levels[-1].start + levels[-1].count * levels[-1].width < 0.95
