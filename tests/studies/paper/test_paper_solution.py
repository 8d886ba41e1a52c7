"""The paper's solution (28): against 50 digits, on the boundary, and where it vanishes."""

import basix
import dolfinx
import mpmath
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.base import compat
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, facet_cells, owned_cells
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.references import interpolated
from dolfinx_signorini.studies.paper.solution import christof_haubner

RADIUS = 0.45


def polynomial(radius):
    """psi from its ten conditions, ascending coefficients."""
    matrix, rhs = mpmath.matrix(10, 10), mpmath.matrix(10, 1)
    rhs[0] = 1
    for row in range(5):
        for k in range(row, 10):
            factor = mpmath.mpf(1)
            for i in range(row):
                factor *= k - i
            matrix[row, k] = factor * (1 if k == row else 0)
            matrix[5 + row, k] = factor * mpmath.mpf(radius) ** (k - row)
    return [mpmath.mpf(1), *[mpmath.mpf(0)] * 4, *list(mpmath.lu_solve(matrix, rhs))[5:]]


def reference(x, y, radius):
    """u, its gradient and -Laplace u + u at a point relative to the detachment point."""
    psi = polynomial(radius)
    x, y = mpmath.mpf(x), mpmath.mpf(y)
    r, theta = mpmath.hypot(x, y), mpmath.atan2(y, x)
    if r == 0 or r >= radius:
        return [mpmath.mpf(0)] * 4

    def derivative(order):
        value = mpmath.mpf(0)
        for k in range(order, 10):
            factor = mpmath.mpf(1)
            for i in range(order):
                factor *= k - i
            value += psi[k] * factor * r ** (k - order)
        return value

    p, dp, ddp = derivative(0), derivative(1), derivative(2)
    # u = F(r) S(theta)
    root = mpmath.sqrt(r)
    f = -10 * p * r * root
    df = -10 * (dp * r * root + p * 3 * root / 2)
    s, ds = mpmath.sin(3 * theta / 2), 3 * mpmath.cos(3 * theta / 2) / 2
    cos, sin = mpmath.cos(theta), mpmath.sin(theta)
    laplace = -10 * (ddp * r + 4 * dp) * root * s  # r^{3/2} S is harmonic
    return [
        f * s,
        df * s * cos - f * ds * sin / r,
        df * s * sin + f * ds * cos / r,
        -laplace + f * s,
    ]


def compiled_values(points, sizes, detachment):
    """Positions and [u, u_x, u_y, f] of the compiled closed form near given points.

    Each point is a corner of a triangle of the given size, so that what is evaluated is the code
    that assembles; the other two corners come for free.
    """
    points, sizes = np.asarray(points, dtype=float), np.asarray(sizes, dtype=float)
    x = np.repeat(points, 3, axis=0)
    x[1::3, 0] += sizes
    x[2::3, 1] += sizes
    cells = np.arange(len(x), dtype=np.int64).reshape(-1, 3)
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    domain = dolfinx.mesh.create_mesh(MPI.COMM_SELF, cells, x=x, e=element)
    exact = christof_haubner(domain, detachment=detachment, radius=RADIUS)
    position = ufl.SpatialCoordinate(domain)
    vector = ufl.as_vector([position[0], position[1], exact.u, *exact.grad, exact.load])
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    expression = fem.Expression(vector, corners, comm=MPI.COMM_SELF)
    values = expression.eval(domain, owned_cells(domain)).reshape(-1, 6)
    return values[:, :2], values[:, 2:]


def assert_accurate(positions, values, detachment):
    with mpmath.workdps(50):
        for position, got in zip(positions, values, strict=True):
            x, y = (
                mpmath.mpf(p) - mpmath.mpf(d) for p, d in zip(position, detachment, strict=True)
            )
            want = reference(x, y, RADIUS)
            r = mpmath.hypot(x, y)
            t = min(r / mpmath.mpf(RADIUS), mpmath.mpf(1))
            # What rounding t costs: psi and its derivatives are powers of q = 1 - t.
            condition = 1 + (10 / (1 - t) if t < 1 else 0)
            q, root = 1 - t, mpmath.sqrt(r)
            psi = q**5 * (1 + t * (5 + t * (15 + t * (35 + t * 70))))
            slope = 630 * t**4 * q**4 / mpmath.mpf(RADIUS)
            bend = 2520 * t**3 * q**3 * 2 / mpmath.mpf(RADIUS) ** 2
            sizes = [psi * r * root, *[psi * root + slope * r * root] * 2, (bend + psi) * r * root]
            for have, exact, size in zip(got, want, sizes, strict=True):
                assert np.isfinite(have)
                assert abs(have - exact) <= 1e-14 * condition * 10 * size + 1e-300, position


def test_values_gradient_and_load_agree_with_50_digits():
    angles, radii = np.linspace(0.0, np.pi, 9), [1e-3, 0.05, 0.2, 0.3, 0.44, 0.4499]
    points = [(0.5 + r * np.cos(a), abs(r * np.sin(a))) for r in radii for a in angles]
    positions, values = compiled_values(points, [1e-3] * len(points), (0.5, 0.0))
    assert np.abs(values).max() > 1.0
    assert_accurate(positions, values, (0.5, 0.0))


@pytest.mark.parametrize("exponent", [-5, -16, -40, -100, -154, -162, -200, -300])
def test_accurate_down_to_1e_300_from_the_singular_point(exponent):
    size = 10.0**exponent
    points = [(0, 0), (size, 0), (0, size), (-size, 0), (-size, 3 * size), (2 * size, 5 * size)]
    positions, values = compiled_values(points, [size] * len(points), (0.0, 0.0))
    assert_accurate(positions, values, (0.0, 0.0))
    # On the way to the bottom edge through x = 1/2, where y alone can be tiny.
    positions, values = compiled_values([(0.5, size)], [size], (0.5, 0.0))
    assert_accurate(positions, values, (0.5, 0.0))


def test_zero_and_finite_at_the_singular_point():
    positions, values = compiled_values([(0.5, 0.0)], [0.25], (0.5, 0.0))
    at = (positions == (0.5, 0.0)).all(axis=1)
    assert at.sum() == 1
    assert (values[at] == 0.0).all()


def test_reference_gradient_and_load_are_derivatives():
    # The 50-digit reference itself, by numerical differentiation of u alone.
    with mpmath.workdps(50):
        for x, y in ((0.1, 0.2), (-0.3, 0.05), (0.2, 0.35), (-0.01, 0.002)):
            x, y = mpmath.mpf(x), mpmath.mpf(y)
            u, ux, uy, load = reference(x, y, RADIUS)

            def value(a, b):
                return reference(a, b, RADIUS)[0]

            assert mpmath.almosteq(mpmath.diff(value, (x, y), (1, 0)), ux, 1e-15)
            assert mpmath.almosteq(mpmath.diff(value, (x, y), (0, 1)), uy, 1e-15)
            laplace = mpmath.diff(value, (x, y), (2, 0)) + mpmath.diff(value, (x, y), (0, 2))
            assert mpmath.almosteq(u - laplace, load, 1e-12)


@pytest.mark.parametrize(("detachment", "radius"), [((0.5, 0.0), 0.45), ((0.625, 0.0), 0.25)])
def test_signorini_conditions_on_the_whole_boundary(comm, detachment, radius):
    # Conditions (29): u >= 0, du/dn >= 0, u du/dn = 0.
    domain = friedrichs_keller(comm, 40)
    exact = christof_haubner(domain, detachment=detachment, radius=radius)
    normal = ufl.FacetNormal(domain)
    flux = ufl.dot(ufl.as_vector(exact.grad), normal)
    points = np.linspace(0.0, 1.0, 9)[:, None]
    position = ufl.SpatialCoordinate(domain)
    expression = fem.Expression(ufl.as_vector([exact.u, flux, position[0]]), points, comm=comm)
    facets = facet_cells(domain, boundary_facets(domain))
    u, du, x = compat.evaluate(expression, domain, facets).reshape(-1, 3).T
    assert (u >= 0.0).all()
    assert (du >= 0.0).all()
    assert (u * du == 0.0).all()
    positive = comm.allreduce(np.array([(u > 1e-3).sum(), (du > 1e-3).sum()]))
    assert positive.min() > 0  # both regimes are there
    # Positive to the left of the detachment point, in contact to the right.
    assert (x[u > 0.0] < detachment[0]).all()
    assert (x[du > 0.0] > detachment[0]).all()


@pytest.mark.parametrize("n", [7, 37])
def test_support_cells_hold_everything_that_is_not_zero(comm, n):
    domain = friedrichs_keller(comm, n)
    exact = christof_haubner(domain)
    lattice = basix.create_lattice(basix.CellType.triangle, 6, basix.LatticeType.equispaced, True)
    cells = owned_cells(domain)
    expression = fem.Expression(ufl.as_vector([exact.u, exact.load]), lattice, comm=comm)
    values = expression.eval(domain, cells).reshape(len(cells), -1)
    nonzero = cells[(values != 0.0).any(axis=1)]
    support = exact.support_cells()
    assert set(nonzero) <= set(support) <= set(cells)
    counts = np.array(comm.allreduce(np.array([len(nonzero), len(support), len(cells)])))
    assert counts[0] > 0
    if n == 37:  # and little else: the half disk has 32 % of the square
        assert counts[1] < 0.4 * counts[2]


def test_interpolated_solution_differs_by_h_to_three_halves(comm):
    differences, widths = {"Linf": [], "L2": [], "H1": []}, []
    for n in (15, 45, 135):  # odd: the detachment point lies in the middle of a cell
        exact = christof_haubner(friedrichs_keller(comm, n))
        errors = error_norms(interpolated(exact, 3).u, exact, list(differences))
        widths.append(1.0 / n)
        for name, values in differences.items():
            values.append(errors[name])
    slopes = {k: np.diff(np.log(v)) / np.diff(np.log(widths)) for k, v in differences.items()}
    assert slopes["Linf"][-1] == pytest.approx(1.5, abs=0.02)
    assert slopes["H1"][-1] == pytest.approx(1.5, abs=0.05)
    assert slopes["L2"][-1] == pytest.approx(2.5, abs=0.1)
    # The difference that the interpolated solution makes is small against the errors measured.
    assert differences["Linf"][-1] < 1e-3


@pytest.mark.parametrize("degree", [1, 3])
def test_interpolated_solution_keeps_values_at_nodes_and_the_load(comm, degree):
    exact = christof_haubner(friedrichs_keller(comm, 12))
    inner = interpolated(exact, degree)
    assert inner.load is exact.load
    space = inner.u.function_space
    assert space.element.basix_element.degree == degree
    points = compat.interpolation_points(space.element)
    expression = fem.Expression(exact.u, points, comm=comm)
    cells = owned_cells(exact.mesh)
    want = expression.eval(exact.mesh, cells)
    have = inner.u.x.array[space.dofmap.list[cells]]
    assert np.abs(have - want).max(initial=0.0) <= 1e-14
