"""Rates of cells, on indicators that fall by known rates."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from hypothesis import given
from hypothesis.strategies import floats
from mpi4py import MPI

from dolfinx_signorini.accuracy.derivatives import lost_order
from dolfinx_signorini.accuracy.marking import Marks
from dolfinx_signorini.accuracy.rates import SINGULAR, SLOWEST, Rates
from dolfinx_signorini.accuracy.targets import target
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.refinement import Transfer, refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, owned_cells

ORDER = 3  # of the derivatives of smooth solutions, with elements of this degree


def rates_of(power, count):
    return Rates(target(f"W1_{power:.0f}"), ORDER, count, 2)


@pytest.mark.parametrize(("power", "rate"), [(1.0, 0.5), (2.0, 0.5), (2.0, 2.0), (4.0, 1.0)])
def test_what_remains_is_the_sum_of_all_later_differences(power, rate):
    rates = rates_of(power, 3)
    rates.values[:] = rate
    cells = np.array([1.0, 2.0, 0.0])
    later = 2.0 ** (-rate * np.arange(1, 200))
    # Differences add up as they are, or in squares where they are orthogonal.
    expected = later.sum() if power == 1.0 else np.sqrt((later**2).sum())
    prediction = rates.prediction(cells)
    assert prediction.remaining == pytest.approx(cells * expected, rel=1e-12)
    assert prediction.factors == pytest.approx(2.0**-rate)
    assert (prediction.singular == (rate < SINGULAR * ORDER)).all()


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("exponent", [1.12, 1.37, 1.66])
def test_slopes_at_a_singular_vertex_leave_what_the_rates_say(comm, degree, exponent):
    """Interpolants of r^s cos(s phi), whose largest errors of slopes are at the vertex."""

    vertices, found = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), []
    for size in (1.0, 0.5):
        domain = mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
        domain.geometry.x[:] *= size
        w = fem.Function(fem.functionspace(domain, ("Lagrange", degree)))
        w.interpolate(lambda x: np.real((x[0] + 1j * x[1]) ** exponent))
        slopes = fem.Expression(ufl.grad(w), vertices).eval(domain, np.zeros(1, dtype=np.int32))
        corners = domain.geometry.x[domain.geometry.dofmap[0]]
        found.append(slopes.reshape(3, 2)[np.linalg.norm(corners, axis=1).argmin()])
    apart, error = np.linalg.norm(found[1] - found[0]), np.linalg.norm(found[1])
    rates = Rates(target("W1_inf"), degree, 1, 2)
    rates.values[:] = exponent - 1.0
    assert rates.prediction(np.array([apart])).remaining[0] == pytest.approx(error, rel=1e-9)


@pytest.mark.parametrize("p", [1, 4, 16])
@pytest.mark.parametrize("exponent", [0.4, 0.6])
def test_norms_fall_at_a_singular_vertex_as_the_energy_tells(p, exponent):
    """Interpolation errors of r^s cos(s phi) on a cell at the origin, and on one half as wide."""
    energies, norms = [], []
    for size in (1.0, 0.5):
        domain = mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
        domain.geometry.x[:] *= size
        w, fine = (fem.Function(fem.functionspace(domain, ("Lagrange", k))) for k in (2, 6))
        for f in (w, fine):
            f.interpolate(lambda x: np.real((x[0] + 1j * x[1]) ** exponent))
        e = fine - w
        energy = ufl.inner(ufl.grad(e), ufl.grad(e)) * ufl.dx
        energies.append(fem.assemble_scalar(fem.form(energy)) ** 0.5)
        dx = ufl.dx(metadata={"quadrature_degree": 30})
        norms.append(fem.assemble_scalar(fem.form(abs(e) ** p * dx)) ** (1.0 / p))
    rates = Rates(target(f"L{p}"), 2, 1, 2)
    rates.values[:] = 2.0 * np.log2(energies[0] / energies[1])
    one = np.ones(1)
    factor = rates.local_prediction(one, one, float(p), one).factors[0]
    assert factor == pytest.approx(max(norms[1] / norms[0], 2.0**-3), rel=1e-9)


@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0, 3.0])
def test_at_singular_points_norms_tell_what_cells_leave_and_elsewhere_derivatives(rate):
    rates, norms, left = Rates(target("L4"), 2, 1, 2), np.array([7.0]), np.array([0.1])
    rates.values[:] = rate
    found = rates.local_prediction(norms, left, 4.0, np.zeros(1))
    rho = found.factors[0]
    expected = 7.0 * rho / (1.0 - rho) if rate < 1.5 else 0.1
    assert found.remaining == pytest.approx(expected, rel=1e-12)


def all_of_them(sided, count):
    """All cells are divided once."""
    return Marks(np.ones(count), np.full((count, 3), np.inf))


def after_division(comm, power, marks):
    """Return rates, division and indicators of a mesh before the divided cells are measured."""
    sided = SidedMesh(friedrichs_keller(comm, 4), {})
    count = len(owned_cells(sided.mesh))
    divided = marks(sided, count).apply(sided)
    name = power if isinstance(power, str) else f"W1_{power:.0f}"
    rates = Rates(target(name), ORDER, count, 2)
    before = np.full(count, 7.0)
    rates.refine(sided.mesh, before, marks(sided, count), divided)
    return rates, divided, before


@pytest.mark.parametrize("power", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("rate", [1.0, 2.0, ORDER])
def test_the_rate_of_a_divided_cell_is_measured(comm, power, rate):
    rates, divided, before = after_division(comm, power, all_of_them)
    share = 4.0 ** (-1.0 / power)
    rates.measure(divided.owners.of(before) * 2.0**-rate * share)
    assert rates.values == pytest.approx(rate, rel=1e-9)


def test_norms_fall_by_one_order_more_than_the_energy_of_smooth_parts(comm):
    """As those of interpolation errors of polynomials: h^s in the energy, h^(s + 1) in L^p."""
    rates, divided, before = after_division(comm, "L16", all_of_them)
    rate, count = 1.25, len(divided.levels)
    rates.measure(divided.owners.of(before) * 2.0**-rate / 2.0)  # the root of four squares
    one = np.ones(count)
    factors = rates.local_prediction(one, one, 16.0, 0.0 * one).factors
    assert factors == pytest.approx(2.0 ** -(rate + 1.0), rel=1e-9)


@pytest.mark.parametrize(("lost", "order"), [(0.0, 4.0), (0.75, 3.25), (9.0, 2.0), (np.inf, 2.0)])
def test_the_rate_of_a_cell_that_was_not_measured_is_assumed_of_the_norm(lost, order):
    """The same one for what a dual solution weighs, and for what cells leave by themselves."""
    rates, lost = Rates(target("L16"), ORDER, 3, 2), np.full(3, lost)
    rates.assume(lost)
    by_themselves = rates.local_prediction(np.ones(3), np.ones(3), 16.0, lost).factors
    assert by_themselves == pytest.approx(rates.prediction(np.ones(3)).factors, rel=1e-12)
    assert by_themselves == pytest.approx(2.0**-order, rel=1e-12)


def lost_by(comm, f, degree):
    """The order that interpolants of a function lose, and the vertices of the cells."""
    sided = SidedMesh(friedrichs_keller(comm, 4), {})
    division = refined(sided)
    coarse, fine = (
        fem.functionspace(domain, ("Lagrange", degree))
        for domain in (sided.mesh, division.sided.mesh)
    )
    transfer, w, detail = Transfer(coarse, fine, division.parents), *map(fem.Function, (fine, fine))
    w.interpolate(f)
    detail.x.array[:] = w.x.array - transfer.prolong(transfer.restrict(w)).x.array
    vertices = sided.mesh.geometry.x[sided.mesh.geometry.dofmap[owned_cells(sided.mesh)]]
    return lost_order(w, detail, sided.mesh, division.parents), vertices


@pytest.mark.parametrize(
    ("degree", "exponent"), [(1, 0.4), (1, 0.6), (2, 0.6), (2, 1.5), (3, 0.4), (3, 1.5), (4, 1.5)]
)
def test_derivatives_tell_the_rate_at_a_vertex_before_any_division(comm, degree, exponent):
    """Interpolants of r^a: the derivatives of order k grow by about 2^(k - a)."""
    lost, x = lost_by(comm, lambda x: np.real((x[0] + 1j * x[1]) ** exponent), degree)
    at, beside = (np.linalg.norm(x, axis=2).min(axis=1) < width for width in (1e-9, 0.3))
    assert comm.allreduce(int(at.sum())) == 2
    assert (lost[beside] >= 0.9 * (degree - exponent)).all()
    assert lost[at] == pytest.approx(degree - exponent, abs=0.25)
    for name in ("H1", "L2", "L16", "H1_2_boundary"):
        rates = Rates(target(name), degree, len(lost), 2)
        rates.assume(lost)
        theory = float(target(name).singular_order(exponent, exponent))
        expected = np.clip(theory, SINGULAR * rates.order, rates.order)
        assert rates.values[at] == pytest.approx(expected, abs=0.3)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_smooth_solutions_lose_the_less_the_smaller_the_cells_are(comm, degree):
    found = []
    for wave in (2.0, 1.0):  # as if cells were half as wide
        lost, _ = lost_by(comm, lambda x, wave=wave: np.exp(wave * (x[0] + 0.3 * x[1])), degree)
        found.append(comm.allreduce(lost.max(initial=0.0), op=MPI.MAX))
    assert found[0] < 0.5
    assert 1.6 < found[0] / found[1] < 2.4


@pytest.mark.parametrize(
    ("name", "gain"), [("L1", 1), ("L16", 1), ("L2_boundary", 1), ("H1_2_boundary", 0.5), ("H1", 0)]
)
@given(order=floats(0.0, 9.0), dual=floats(0.0, 9.0))
def test_the_dual_solution_of_a_norm_adds_what_the_norm_gains(name, gain, order, dual):
    wanted, own = target(name), np.array(order)
    added = float(wanted.order_of_products(own, np.array(dual))) - order
    assert added == pytest.approx(min(dual, gain))
    assert float(wanted.order_of_products(np.array(3.0), np.array(3.0))) == wanted.order(3)
    back = wanted.order_in_energy(wanted.order_of_products(own, own))
    assert float(back) == pytest.approx(order)


def test_rates_are_those_of_smooth_solutions_at_most(comm):
    rates, divided, before = after_division(comm, 2.0, all_of_them)
    rates.measure(divided.owners.of(before) * 2.0**-9.0)
    assert rates.values == pytest.approx(ORDER, rel=1e-12)
    rates.measure(divided.owners.of(before) * 2.0**9.0)
    assert rates.values == pytest.approx(SLOWEST, rel=1e-12)


@pytest.mark.parametrize("power", [1.0, 2.0, np.inf])
def test_towards_a_singular_point_the_cells_at_the_point_tell(comm, power):
    levels = 3

    def marks(sided, count):
        """Cells at the origin are divided three times towards the origin."""
        domain = sided.mesh
        x = domain.geometry.x[domain.geometry.dofmap[owned_cells(domain)]]
        at = np.linalg.norm(x, axis=2).min(axis=1) < 1e-9
        points = np.where(at[:, None], 0.0, np.full((count, 3), np.inf))
        return Marks(np.where(at, levels, 0), points)

    rates, divided, before = after_division(comm, power, marks)
    towards = marks(SidedMesh(friedrichs_keller(comm, 4), {}), len(before)).singular
    tips = np.flatnonzero(divided.owners.of(towards) & ~divided.away)
    assert comm.allreduce(len(tips)) == comm.allreduce(int(towards.sum()))
    cells = np.full(len(divided.levels), 1e-9)
    cells[tips] = 7.0 * 2.0 ** (-0.5 * levels)
    rates.measure(cells)
    assert rates.values[tips] == pytest.approx(0.5, rel=1e-3)
    assert (rates.values[divided.owners.of(towards) & divided.away] == ORDER).all()


@pytest.mark.parametrize("slow", [0.4, 1.2])
@pytest.mark.parametrize("singular", [0.0, 0.05, 1.0])
def test_at_a_corner_the_singular_part_lasts(comm, slow, singular):
    """A smooth part of the size 1 and one of r^s leave what their geometric series have."""
    rates, divided, before = after_division(comm, 1.0, all_of_them)
    rates.corners = np.full(len(divided.levels), slow)
    falls = 2.0**-ORDER, 2.0**-slow
    parts = falls[0], singular * falls[1]
    now = divided.owners.of(before) / 7.0 * sum(parts) / 4.0
    before[:] = 1.0 + singular
    rates.measure(now)
    left = sum(part * fall / (1.0 - fall) for part, fall in zip(parts, falls, strict=True)) / 4.0
    assert rates.prediction(now).remaining == pytest.approx(left, rel=1e-9)


@pytest.mark.parametrize("slow", [0.4, 0.9])
def test_at_a_corner_a_rate_slower_than_that_of_theory_counts(comm, slow):
    """Theory knows the data that were read, and others may be rougher."""
    rates, divided, before = after_division(comm, 1.0, all_of_them)
    rates.corners = np.full(len(divided.levels), 1.2)
    rates.measure(divided.owners.of(before) * 2.0**-slow / 4.0)
    assert rates.values == pytest.approx(slow, rel=1e-9)


def test_a_product_with_a_singular_dual_solution_falls_as_slowly(comm):
    """In energy squares add up, where a small singular part is hidden; the product has it whole."""
    rates, divided, before = after_division(comm, "L2", all_of_them)
    fall = 2.0 ** (-4.0 / 3.0)  # of the products, and of the squares
    rates.corners = np.full(len(divided.levels), 4.0 / 3.0)
    smooth, corner = 4.0**-ORDER, 0.01 * fall
    before[:] = np.sqrt(1.0 + 0.01)
    rates.measure(np.full(len(divided.levels), np.sqrt(smooth + corner) / 2.0))
    left = np.sqrt(corner / (smooth + corner)) * fall / (1.0 - fall)
    assert (rates.prediction(np.ones(len(divided.levels))).remaining > left).all()
    assert (rates.prediction(np.ones(len(divided.levels))).remaining < left + 0.2).all()
