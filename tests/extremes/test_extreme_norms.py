"""Extremes of what is measured: exponents, errors of rounding size, singular points and loads."""

import math

import numpy as np
import pytest
import ufl
from cases import digits_of, square, stretched
from dolfinx import fem
from mpi4py import MPI
from mpmath import mp, mpf

from dolfinx_signorini import (
    ManufacturedSolution,
    QuadratureRule,
    SignoriniProblem,
    christof_haubner,
    error_norms,
    friedrichs_keller,
)
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.studies.paper.solution import AMPLITUDE, SUPPORT_RADIUS

TIGHT = 1e-13
FINE = QuadratureRule("default", 20)
EXPONENTS = ("1", "1.000001", "2", "1000", "inf")


def linear(n):
    """The function 1 + x on a square with n cells per side."""
    function = fem.Function(
        fem.functionspace(friedrichs_keller(MPI.COMM_WORLD, n), ("Lagrange", 1))
    )
    function.interpolate(lambda x: 1.0 + x[0])
    return function


def known_power(p):
    """The L^p norm of 1 + x on the unit square, and the sum of powers of its W^{1,p} norm."""
    mp.dps = 50
    total = (mpf(2) ** (p + 1) - 1) / (p + 1)
    return total ** (1 / p), (total + 1) ** (1 / p)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_exponents(exponent, record):
    digits = min(_digits_of_norms(exponent, scale) for scale in (1e-300, 1.0, 1e300))
    assert digits >= 13
    name = f"L{exponent}" if exponent == "inf" else f"L{exponent} and W1_{exponent}"
    case = f"{name} of s (1 + x), s = 1e-300, 1 and 1e300"
    record("exponents", case, "the integral with 50 digits", digits)


def _digits_of_norms(exponent, scale):
    function = linear(32)
    function.x.array[:] *= scale
    have = error_norms(function, None, (f"L{exponent}", f"W1_{exponent}"), FINE)
    if exponent == "inf":
        exact = 2 * mpf(scale)
        return min(digits_of(abs(mpf(value) - exact), exact) for value in have.values())
    known = [value * mpf(scale) for value in known_power(mpf(exponent))]
    pairs = zip(have.values(), known, strict=True)
    return min(digits_of(abs(mpf(value) - exact), exact) for value, exact in pairs)


def test_exponents_approach_the_maximum(record):
    """p = 1000 is within a factor 2 ||1||^(1/p) of the maximum, and p = 1 + 1e-6 next to p = 1."""
    have = error_norms(linear(32), None, ("L1", "L1.000001", "L1000", "Linf"), FINE)
    values = [have[name] for name in ("L1", "L1.000001", "L1000", "Linf")]
    assert values == sorted(values)
    assert values[1] - values[0] < 1e-6
    text = ", ".join(f"{value:.9g}" for value in values)
    record("exponents", "p = 1, 1 + 1e-6, 1000, inf of 1 + x", "monotone in p", text)


VOLUME = ("L1", "L1.000001", "L2", "L4", "L1000", "Linf", "W1_1", "W1_4", "W1_1000", "W1_inf")
BOUNDARY = ("L2_boundary", "H1_2_boundary", "H1_2_boundary_spectral")


@pytest.mark.parametrize("degree", [1, 2])
def test_exact_solution_in_the_space(degree, record):
    """u = 1 + 2 x - y with its own load and fluxes: only rounding is left to measure."""
    domain = square(16)
    space = fem.functionspace(domain, ("Lagrange", degree))
    x, normal = ufl.SpatialCoordinate(domain), ufl.FacetNormal(domain)
    known = 1.0 + 2.0 * x[0] - x[1]
    exact = ManufacturedSolution(domain, known, (ufl.as_ufl(2.0), ufl.as_ufl(-1.0)), known)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    flux = 2.0 * normal[0] - normal[1]
    problem = SignoriniProblem(
        a, known * v * ufl.dx + flux * v * ufl.ds, contact=boundary_facets(domain), obstacle=-3.0
    )
    u = problem.solve(rtol=TIGHT)
    problem.destroy()
    errors = error_norms(u, exact, (*VOLUME, *BOUNDARY))
    assert all(0.0 <= value < 1e-10 for value in errors.values())
    assert errors["L1"] <= errors["L2"] * (1 + 1e-9) <= errors["L4"] * (1 + 1e-9)
    nothing = error_norms(fem.Function(space), None, (*VOLUME, *BOUNDARY))
    assert set(nothing.values()) == {0.0}
    text = f"L2 {errors['L2']:.0e}, L1000 {errors['L1000']:.0e}, W1_1000 {errors['W1_1000']:.0e}"
    case = f"u = 1 + 2 x - y, N = 16, degree {degree}, errors in {len(errors)} norms"
    record("rounding", case, "errors 0", text)


def known_solution(x, y):
    """u and its gradient of the paper's solution that detaches at 0, with 50 digits."""
    x, y = mpf(x), mpf(y)
    r, theta = mp.hypot(x, y), mp.atan2(y, x)
    t = r / mpf(SUPPORT_RADIUS)
    if t >= 1:
        return mpf(0), mpf(0), mpf(0)
    psi = (1 - t) ** 5 * (1 + 5 * t + 15 * t**2 + 35 * t**3 + 70 * t**4)
    slope = -630 * t**4 * (1 - t) ** 4 / mpf(SUPPORT_RADIUS)
    w = r ** mpf(1.5) * mp.sin(theta * 3 / 2)
    root = mp.sqrt(r) * mpf(1.5)
    wx, wy = root * mp.sin(theta / 2), root * mp.cos(theta / 2)
    direction = (x / r, y / r)
    return (
        -AMPLITUDE * psi * w,
        *(-AMPLITUDE * (psi * d + w * slope * e) for d, e in zip((wx, wy), direction, strict=True)),
    )


@pytest.mark.parametrize("distance", [1e-3, 1e-100, 1e-200, 1e-300])
def test_near_the_singular_point(distance, record):
    """Value and gradient at points of a tiny triangulation around the detachment point."""
    domain = stretched(square(8), (2.0 * distance, distance))
    domain.geometry.x[:, 0] -= distance
    exact = christof_haubner(domain, (0.0, 0.0))
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    expression = fem.Expression(ufl.as_vector([exact.u, *exact.grad]), corners, comm=domain.comm)
    cells = np.arange(domain.topology.index_map(2).size_local, dtype=np.int32)
    values = expression.eval(domain, cells).reshape(-1, 3)
    points = domain.geometry.x[domain.geometry.dofmap[: len(cells)]].reshape(-1, 3)[:, :2]
    mp.dps = 50
    worst = [16.0, 16.0]
    assert np.isfinite(values).all()
    for point, have in zip(points.tolist(), values.tolist(), strict=True):
        if point == [0.0, 0.0]:
            assert have == [0.0, 0.0, 0.0]
            continue
        u, *gradient = known_solution(*point)
        length = mp.hypot(*gradient)
        if abs(u) > 1e-290:  # below it is less than the smallest numbers
            # sin(3/2 theta) has a zero at 120 degrees: relative to its size elsewhere.
            worst[0] = min(
                worst[0], digits_of(abs(have[0] - u), AMPLITUDE * mp.hypot(*point) ** 1.5)
            )
        change = mp.hypot(*(a - b for a, b in zip(have[1:], gradient, strict=True)))
        worst[1] = min(worst[1], digits_of(change, length))
    worst = [min(domain.comm.allgather(digits)) for digits in worst]
    assert min(worst) >= 14
    value = f"u {worst[0]:.1f}, " if distance**1.5 > 1e-290 else "u underflows to 0, "
    case = f"distances up to {distance:g}, the point itself included"
    record(
        "singular", case, "the closed form with 50 digits", value + f"grad u {worst[1]:.1f} digits"
    )


@pytest.mark.parametrize("power", [0.5, 0.25])
def test_loads_that_are_hardly_integrable(power, record):
    """u = r^power from a corner, pressed to its own height on the far sides.

    Its load is like r^(power - 2): in L^p for p < 2 / (2 - power) only.
    """
    errors = {}
    for n in (16, 32, 64):
        domain = friedrichs_keller(MPI.COMM_WORLD, n)
        space = fem.functionspace(domain, ("Lagrange", 1))
        x = ufl.SpatialCoordinate(domain)
        r = ufl.sqrt(x[0] * x[0] + x[1] * x[1])
        grad = tuple(power * r ** (power - 2.0) * x[i] for i in (0, 1))
        load = -(power**2) * r ** (power - 2.0) + r**power
        exact = ManufacturedSolution(domain, r**power, grad, load)
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
        measure = ufl.dx(domain, metadata=QuadratureRule("Gauss-Jacobi", 15).metadata)

        def far(x):
            height = np.hypot(x[0], x[1]) ** power
            return np.where(np.maximum(x[0], x[1]) > 1.0 - 1e-9, height, -10.0)

        problem = SignoriniProblem(
            a, load * v * measure, contact=boundary_facets(domain), obstacle=far
        )
        u = problem.solve(rtol=1e-10)
        problem.destroy()
        assert problem.result.active_dofs == 2 * n + 1
        errors[n] = error_norms(u, exact, ["H1", "L2"])
    orders = {name: math.log2(errors[32][name] / errors[64][name]) for name in ("H1", "L2")}
    assert orders["H1"] == pytest.approx(power, abs=0.08)
    text = ", ".join(
        f"{name} error {errors[64][name]:.1e}, order {o:.2f}" for name, o in orders.items()
    )
    case = f"u = r^{power}, f in L^p for p < {2 / (2 - power):.3g} only, contact on two sides"
    stops = "quadrature misses part of the load in the corner: L2 is no better than H1"
    assert orders["L2"] == pytest.approx(power, abs=0.08)
    record("integrable", case, f"the exact u; order {power} in H1", text, stops)
