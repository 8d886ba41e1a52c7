"""The identity of the error, and problems in which one of its terms alone is the error."""

from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from known import values_at
from mpi4py import MPI

from dolfinx_signorini import SignoriniProblem, bernstein_space
from dolfinx_signorini.accuracy.boundary_defects import data_between_nodes
from dolfinx_signorini.accuracy.derivatives import left_by_derivatives
from dolfinx_signorini.accuracy.estimates import Estimator
from dolfinx_signorini.accuracy.indicators import indicators
from dolfinx_signorini.accuracy.marking import SAFETY
from dolfinx_signorini.accuracy.predicted_error import predicted_error
from dolfinx_signorini.accuracy.targets import size, target
from dolfinx_signorini.accuracy.terms import (
    TERMS,
    Solution,
    Solved,
    algebra,
    assembled,
    caught,
    difference,
    dual_solution,
    held,
    met,
    quadrature,
    released,
    residuals,
)
from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, boundary_facets, owned_cells
from dolfinx_signorini.norms.power_sums import total
from dolfinx_signorini.problem.dirichlet import dirichlet

IDENTITY = (residuals, released, held, caught, met)


def posed(sided, degree, load=0.0, data=0.0, obstacle=-1e3, rule=None, flat=False):
    """-div grad u = load, u = data on all sides but the bottom, which is the contact boundary."""
    domain, space = sided.mesh, bernstein_space(sided.mesh, degree)
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(sided.mesh)
    dx = ufl.dx(metadata={} if rule is None else {"quadrature_degree": rule})
    bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    rest = np.setdiff1d(boundary_facets(domain), bottom).astype(np.int32)
    source = load(x) if callable(load) else fem.Constant(domain, load)
    problem = SignoriniProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * dx,
        source * v * dx,
        contact=bottom,
        obstacle=obstacle(x) if callable(obstacle) else obstacle,
        bcs=[dirichlet(space, rest, data(x) if callable(data) else data)],
    )
    problem.solve(rtol=1e-12)
    return problem


@pytest.fixture
def compared(comm):
    """Return two solutions that are to be compared, from what is posed."""
    problems = []

    def compare(degree, n=4, asked="L2", **given):
        sided = SidedMesh(mesh.create_unit_square(comm, n, n), {})
        division = refined(sided)
        problems.extend(posed(part, degree, **given) for part in (sided, division.sided))
        coarse = Solution(problems[-2].u, problems[-2].forces)
        return Solved(coarse, problems[-1], division.parents, target(asked))

    yield compare
    for problem in problems:
        problem.destroy()


def mean(v):
    return v * ufl.dx


def sums(solved, terms, functional=mean):
    """The dual solution, and the sums over all cells of the terms with their signs."""
    space = solved.fine.space
    dual = dual_solution(solved, assembled(functional(ufl.TestFunction(space)), space))
    found = [term(solved, dual) for term in terms]
    assert all((np.abs(signed) <= sizes * (1.0 + 1e-12) + 1e-300).all() for signed, sizes in found)
    return dual, [solved.fine.comm.allreduce(float(signed.sum())) for signed, _ in found]


PROBLEMS = [
    {"load": 1.0},
    {"data": lambda x: ufl.sin(3.0 * x[0]) * x[1]},
    {"load": -1.0, "obstacle": lambda x: -0.1 + 0.05 * x[0]},
]


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("given", PROBLEMS)
def test_the_terms_add_up_to_the_difference(compared, degree, given):
    solved = compared(degree, **given)
    dual, parts = sums(solved, IDENTITY)
    assert dual.value == pytest.approx(
        solved.fine.comm.allreduce(fem.assemble_scalar(fem.form(mean(solved.error)))), rel=1e-8
    )
    size = sum(map(abs, parts))
    assert size > 0.0 and abs(sum(parts) - dual.value) <= 1e-7 * size


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("given", PROBLEMS)
def test_without_divisions_the_predicted_error_is_the_difference(compared, degree, given):
    """But for what follows from data that both solutions meet."""
    solved = compared(degree, **given)
    of_data = solved.error.copy()
    of_data.x.array[~solved.met] = 0.0
    load = solved.acting(of_data)
    load.x.array[:] *= -1.0
    moved, _ = solved.fine.solve_linearised(load)
    of_data.x.array[:] += moved.x.array
    found = predicted_error(solved, np.ones(solved.count))
    beside = difference(difference(solved.error, of_data), found)
    assert size(beside, target("H1")) <= 0.02 * size(solved.error, target("H1"))


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("given", PROBLEMS)
def test_functionals_of_the_predicted_error_are_sums_of_what_cells_leave(compared, degree, given):
    """Each cell leaves another share of its part of the identity of the error."""
    solved = compared(degree, **given)
    space = solved.fine.space
    x = mesh.compute_midpoints(space.mesh, 2, owned_cells(space.mesh))
    shares = np.zeros(solved.count)
    np.maximum.at(shares, solved.parents, np.floor(4.0 * x[:, 0]) % 2)
    dual = dual_solution(solved, assembled(mean(ufl.TestFunction(space)), solved.fine.space))
    parts = np.sum([term(solved, dual) for term in TERMS], axis=0)
    left, sizes = solved.fine.comm.allreduce((parts * shares).sum(axis=1))
    found = compiled.integral(mean(predicted_error(solved, shares)))
    assert sizes > 0.0 and found == pytest.approx(left, abs=2e-3 * sizes)


def test_residuals_alone(compared):
    dual, parts = sums(compared(1, load=1.0), IDENTITY)
    assert parts[1] == 0.0 and abs(parts[2]) <= 1e-3 * dual.value
    assert parts[0] == pytest.approx(dual.value, rel=1e-3)


def test_dirichlet_data_between_the_nodes_of_one_mesh_are_in_the_forces(compared):
    """The data oscillate on all nodes of the finer mesh, and vanish at those of the other one."""
    solved = compared(1, data=lambda x: 1.0 - ufl.cos(8.0 * np.pi * x[0]) * (1.0 + 0.0 * x[1]))
    assert np.abs(solved.coarse.u.x.array).max() <= 1e-12
    dual, parts = sums(solved, IDENTITY)
    assert sum(map(abs, parts[:-1])) <= 1e-9
    assert parts[-1] == pytest.approx(dual.value, rel=1e-6) and dual.value > 0.01


@pytest.mark.parametrize(
    ("term", "n", "bend"), [(released, 6, 1.3), (held, 5, 2.3), (caught, 5, 0.9)]
)
def test_released_held_and_caught_dofs(compared, term, n, bend):
    """An obstacle whose contact set ends elsewhere on each mesh: dofs change, and are not met."""
    solved = compared(1, n=n, load=-10.0, obstacle=lambda x: -0.05 - bend * x[0] ** 2)
    dual, (part,) = sums(solved, [term])
    assert solved.fine.comm.allreduce(len(solved.fine.active)) > 0
    assert abs(part) > 1e-2 * abs(dual.value)


@pytest.mark.parametrize("name", ["L2", "L4", "Linf", "H1", "W1_4"])
def test_dirichlet_data_between_all_nodes(compared, name):
    """The data vanish at all nodes of both meshes: the error is (1 - cos kx) sinh(ky)/sinh(k)."""
    k = 16.0 * np.pi  # twice the number of the finer nodes
    top = ufl.conditional
    solved = compared(
        1, asked=name, data=lambda x: top(x[1] > 1.0 - 1e-9, 1 - ufl.cos(k * x[0]), 0)
    )
    norm = target(name).norm
    assert np.abs(solved.fine.u.x.array).max() <= 1e-12
    estimator = Estimator(solved.coarse.u.function_space, target(name))
    estimator.compare(solved)
    # The trace of the error on the top is known, and so is what reaches inside like exp(-k y).
    if norm.derivatives:
        size = (
            k * (3.0 / 8.0 / (4.0 * k)) ** 0.25 if norm.p == 4.0 else k * (0.5 / (2.0 * k)) ** 0.5
        )
    else:
        size = 2.0 if np.isinf(norm.p) else (3.0 / 8.0 / (norm.p * k)) ** (1.0 / norm.p)
    assert 0.9 * size <= estimator.estimate / SAFETY


@pytest.mark.parametrize("name", ["L1_boundary", "L2_boundary", "L4_boundary", "H1_2_boundary"])
def test_dirichlet_data_between_all_nodes_in_norms_of_the_boundary(compared, name):
    """The solutions vanish, and 1 - cos(k x) on the top is the trace of the error."""
    k = 16.0 * np.pi
    top = ufl.conditional
    solved = compared(
        1, asked=name, data=lambda x: top(x[1] > 1.0 - 1e-9, 1 - ufl.cos(k * x[0]), 0)
    )
    estimator = Estimator(solved.coarse.u.function_space, target(name))
    estimator.compare(solved)
    whole = np.sqrt(1.5)
    size = {
        "L1_boundary": 1.0,
        "L2_boundary": whole,
        "L4_boundary": (35.0 / 8.0) ** 0.25,
        "H1_2_boundary": np.sqrt(whole * (whole + k / np.sqrt(2.0))),
    }[name]
    assert 0.9 * size <= estimator.estimate / SAFETY <= 2.0 * size


@pytest.mark.parametrize(
    ("name", "load", "power"),
    [("L1", 1.5, 1.0), ("L2", 6.0, 1.0), ("W1_4", 30.0, 4.0), ("L4_boundary", 30.0, 4.0)],
)
def test_what_no_comparison_shows_is_added(compared, name, load, power):
    """Data that vanish at all nodes, and a load that moves a side without data, alone and both."""
    k = 16.0 * np.pi

    def data(x):
        return ufl.conditional(x[1] > 1.0 - 1e-9, 0.1 * (1.0 - ufl.cos(k * x[0])), 0)

    found = []
    for given in ({"data": data}, {"load": load}, {"data": data, "load": load}):
        solved = compared(1, asked=name, obstacle=-9.0, **given)
        estimator = Estimator(solved.coarse.u.function_space, target(name))
        estimator.compare(solved)
        found.append(estimator.estimate)
    assert min(found[:2]) > 0.2 * max(found[:2])
    both = (found[0] ** power + found[1] ** power) ** (1.0 / power)
    assert found[2] >= 0.9 * both  # data move what a dual solution sees, too


@pytest.mark.parametrize("p", [1, 2, 4, 16])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_an_estimate_in_l_p_is_no_less_than_the_error_of_a_bump(compared, degree, p):
    """The dual solution looks where the bump is, and unresolved cells beside count."""

    def exact(x):
        return ufl.exp(-40.0 * ((x[0] - 0.3) ** 2 + (x[1] ** 2 - 0.3) ** 2)) + ufl.sin(6 * x[0])

    def load(x):
        return -ufl.div(ufl.grad(exact(x)))

    solved = compared(degree, n=8, asked=f"L{p}", load=load, data=exact, obstacle=-9.0, rule=16)
    estimator = Estimator(solved.coarse.u.function_space, target(f"L{p}"))
    estimator.compare(solved)
    w, domain = solved.fine.u, solved.fine.space.mesh
    e = (w - exact(ufl.SpatialCoordinate(domain))) / 1e-3  # powers stay in the range of numbers
    form = fem.form(abs(e) ** p * ufl.dx(metadata={"quadrature_degree": 20}))
    error = 1e-3 * solved.fine.comm.allreduce(fem.assemble_scalar(form)) ** (1.0 / p)
    assert error <= estimator.estimate <= 6.0 * error


@pytest.mark.parametrize(("asked", "narrow"), [("L16", 100.0), ("Linf", 5.0)])
def test_an_estimate_is_no_less_than_what_the_worst_cell_leaves_by_itself(compared, asked, narrow):
    """Here no other estimate is larger: the dual solution hardly sees the worst cell."""

    def load(x):
        bump = ufl.exp(-narrow * ((x[0] - 0.3) ** 2 + (x[1] - 0.6) ** 2))
        return 50.0 * bump + ufl.sin(6 * x[0])

    solved = compared(3, n=6, asked=asked, load=load, obstacle=-9.0, rule=20)
    parts = left_by_derivatives(solved.detail, 0.0, solved.target.norm.p)
    estimator = Estimator(solved.coarse.u.function_space, solved.target)
    estimator.compare(solved)
    parts = np.where(estimator.prediction.singular, 0.0, solved.collected(parts))
    worst = highest(solved.fine.comm, parts)
    assert worst > 0.0 and estimator.estimate == pytest.approx(SAFETY * worst, rel=0.01)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_at_a_singular_point_that_was_seen_twice_the_whole_difference_counts(compared, degree):
    """Errors of other cells have moved both solutions there: here in the least bent cell."""
    solved = compared(degree, asked="Linf", load=lambda x: 50.0 * ufl.exp(9 * x[0]), obstacle=-99.0)
    estimator, rho = Estimator(solved.coarse.u.function_space, solved.target), 2.0**-0.5
    estimator.compare(solved)
    apart, cells = solved.norms(solved.error), estimator.found.cells
    excess = np.where(cells > 0.0, apart - 2.0 * cells, -np.inf)
    here = excess == highest(solved.fine.comm, excess)
    estimator.rates.values[:] = np.where(here, 0.5, degree + 1.0)
    estimator.rates._measured[:] = estimator.rates._confirmed[:] = True
    estimator.compare(solved)
    worst = highest(solved.fine.comm, apart[here]) * rho / (1.0 - rho**2)
    assert estimator.estimate >= (1.0 - 1e-9) * SAFETY * worst > 0.0


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_in_sup_norms_of_the_boundary_a_cell_counts_with_its_facets(compared, degree):
    """The solutions vanish on three sides, and on the bottom they are free.

    Cells inside of the domain count with what reaches the boundary of the difference.
    """

    def load(x):
        return 50.0 * (1.0 + ufl.sin(5.0 * x[0]) * ufl.cos(4.0 * x[1]))

    solved = compared(degree, asked="Linf_boundary", load=load, obstacle=-9.0)
    domain, whole = solved.coarse.u.function_space.mesh, replace(solved, target=target("Linf"))
    inside, found = whole.norms(solved.detail), solved.felt(solved.detail)
    x = domain.geometry.x[domain.geometry.dofmap[owned_cells(domain)]]
    ends = [np.abs(x - end) < 1e-9 for end in (0.0, 1.0)]
    facets = [both[:, :, k].sum(axis=1) > 1 for both in ends for k in range(2)]
    bottom, at = facets[1], np.any(facets, axis=0)
    assert (solved.norms(solved.detail)[~at] == 0.0).all() and (solved.reach[at] == 1.0).all()
    values = fem.Function(fem.functionspace(solved.fine.space.mesh, ("Lagrange", 6)))
    values.interpolate(solved.error)
    on_bottom = values.function_space.tabulate_dof_coordinates()[:, 1] < 1e-9
    parts = values.x.array[on_bottom], values.x.array
    below, most = (max(domain.comm.allgather(np.abs(v).max(initial=0.0))) for v in parts)
    assert 0.0 < below < 0.9 * most
    assert found[~at] == pytest.approx(below / most * inside[~at], rel=0.05)
    assert (found[at & ~bottom] <= 1e-14).all()
    fine, largest = solved.fine.space.mesh, np.zeros(len(found))
    for cell, corners in enumerate(fine.geometry.x[fine.geometry.dofmap[owned_cells(fine)]]):
        here = corners[corners[:, 1] < 1e-9]
        if len(here) == 2:
            line = here[0] + np.linspace(0.0, 1.0, 41)[:, None] * (here[1] - here[0])
            values = np.abs(solved.detail.eval(line, np.full(41, cell, dtype=np.int32)))
            largest[solved.parents[cell]] = max(largest[solved.parents[cell]], values.max())
    assert found[bottom] == pytest.approx(largest[bottom], rel=0.02)
    assert (found[bottom] < 0.9 * inside[bottom]).any() or not bottom.any()


@pytest.mark.parametrize("asked", ["L2_boundary", "Linf_boundary"])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_data_that_both_solutions_meet_count_once(compared, degree, asked):
    """On sides with data and in contact with an obstacle the error of w is that of the data."""

    def data(x):
        return ufl.sin(3.0 * x[0]) * (1.0 + x[1])

    solved = compared(degree, asked=asked, data=data, obstacle=data, load=-50.0)
    comm, parts = solved.fine.comm, 400
    held = (comm.allreduce(len(n)) for n in (solved.fine.active, solved.fine.contact_dofs))
    assert next(held) == next(held) > 0
    estimator = Estimator(solved.coarse.u.function_space, target(asked))
    estimator.compare(solved)
    # The sides are x = 0 and 1, where data are linear, and y = 0 and 1: the middles of small parts.
    middles = (np.arange(parts) + 0.5) / parts
    squares = largest = 0.0
    for y in (0.0, 1.0):
        at = np.column_stack([middles, np.full(parts, y), np.zeros(parts)])
        found = values_at(solved.fine.u, at)[:, 0]
        off = found - np.sin(3.0 * middles) * (1.0 + y)
        squares, largest = squares + np.mean(off**2), max(largest, np.abs(off).max())
    error = {"L2_boundary": np.sqrt(squares), "Linf_boundary": largest}[asked]
    assert 0.95 <= estimator.estimate / (SAFETY * error) <= 1.05


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_in_sup_norms_data_that_are_met_are_known_and_not_extrapolated(compared, degree):
    """Rates that are not measured yet are slow near a pole outside of the domain."""

    def data(x):
        return ((x[0] - 0.4) ** 2 + (x[1] - 1.1) ** 2) ** -0.5

    solved = compared(degree, asked="Linf_boundary", data=data, obstacle=data, load=-50.0)
    estimator = Estimator(solved.coarse.u.function_space, target("Linf_boundary"))
    estimator.compare(solved)
    x = np.linspace(0.0, 1.0, 2_001)
    found = values_at(solved.fine.u, np.column_stack([x, np.ones(len(x)), np.zeros(len(x))]))
    error = np.abs(found[:, 0] - ((x - 0.4) ** 2 + 0.01) ** -0.5).max()
    assert 0.95 <= estimator.estimate / (SAFETY * error) <= 1.05


def test_the_mean_of_dirichlet_data_between_nodes_moves_the_functional(compared):
    """u - w has the mean 1 on the top, as far as a functional can tell, and 0 elsewhere."""
    k = 16.0 * np.pi
    top = ufl.conditional

    def waves(x):
        return top(x[1] > 1.0 - 1e-9, 1.0 - ufl.cos(k * x[0]), 0.0)

    solved = compared(1, asked=mean, data=waves)
    other = compared(1, data=lambda x: top(x[1] > 1.0 - 1e-9, 1.0, 0.0))
    _, (found,) = sums(solved, [data_between_nodes])
    wanted = solved.fine.comm.allreduce(fem.assemble_scalar(fem.form(mean(other.fine.u))))
    # At the upper corners the data jump within one cell.
    assert found == pytest.approx(wanted, rel=0.1)


@pytest.mark.parametrize("degree", [1, 2])
def test_what_the_iterations_leave_alone(compared, degree):
    """An iterate that is off by e, 0 on the Dirichlet sides, is off by J(e) in the functional.

    The dual problem is solved to 1e-3 by default.
    """
    solved = compared(degree, load=1.0)
    u = solved.fine.u
    off = fem.Function(solved.fine.space)
    off.interpolate(lambda x: 1e-3 * x[0] * (1.0 - x[0]) * (1.0 - x[1]) * np.cos(9.0 * x[1]))
    off.x.array[solved.fine.fixed_dofs] = 0.0
    off.x.scatter_forward()
    u.x.array[:] += off.x.array
    value = solved.fine.comm.allreduce(fem.assemble_scalar(fem.form(mean(off))))
    _, (found,) = sums(solved, [algebra])
    assert found == pytest.approx(-value, rel=1e-3)


@pytest.mark.parametrize("rule", [1, 2])
def test_quadrature_alone(compared, rule):
    """A load that a rule of a low degree sees at wrong places; the same load with 20 degrees."""

    def load(x):
        return 1.0 + ufl.sin(25.0 * x[0]) * ufl.cos(23.0 * x[1])

    coarse, exact = compared(1, load=load, rule=rule), compared(1, load=load, rule=20)
    _, (found,) = sums(coarse, [quadrature])
    missed = exact.fine.u.x.array - coarse.fine.u.x.array
    error = fem.Function(coarse.fine.space)
    error.x.array[:] = missed
    wanted = coarse.fine.comm.allreduce(fem.assemble_scalar(fem.form(mean(error))))
    assert wanted != 0.0 and found == pytest.approx(wanted, rel=0.02)
    _, (none,) = sums(compared(1, load=1.0), [quadrature])
    assert none == 0.0


def test_what_quadrature_leaves_in_a_functional_has_a_sign(compared):
    """The rule misses a wave, with one sign in a cell and the other in the next one."""

    def load(x):
        return 1.0 + ufl.sin(25.0 * x[0]) * ufl.cos(23.0 * x[1])

    solved, exact = (compared(1, n=16, load=load, rule=rule, asked=mean) for rule in (1, 20))
    J = assembled(mean(ufl.TestFunction(solved.fine.space)), solved.fine.space)
    signed, sizes = quadrature(solved, dual_solution(solved, J))
    comm = solved.fine.comm
    cells, found = (comm.allreduce(float(np.abs(each).sum())) for each in (signed, sizes))
    values = [
        comm.allreduce(fem.assemble_scalar(fem.form(mean(s.fine.u)))) for s in (solved, exact)
    ]
    wanted = abs(values[1] - values[0])
    assert 0.95 * wanted <= found <= max(1.05 * wanted, 0.2 * cells)


@pytest.mark.parametrize("name", ["L2", "Linf", "H1"])
def test_an_estimate_knows_of_quadrature(compared, name):
    def load(x):
        return 1.0 + 30.0 * ufl.sin(50.0 * x[0]) ** 2 * ufl.cos(47.0 * x[1]) ** 2

    solved, exact = (compared(1, load=load, rule=rule, asked=name) for rule in (1, 24))
    estimator = Estimator(solved.coarse.u.function_space, target(name))
    estimator.rates.values[:] = estimator.rates.order
    estimator.compare(solved)
    error = fem.Function(solved.fine.space)
    error.x.array[:] = exact.fine.u.x.array - solved.fine.u.x.array
    power = target(name).power
    unseen = total(estimator.found.unseen, power, solved.fine.comm)
    assert unseen >= 0.8 * size(error, target(name)) > 0.0


@pytest.mark.parametrize("asked", ["L4", "L1000", "L1e8"])
def test_powers_of_any_exponent_are_numbers(compared, asked):
    """J(w - u_h) is the norm, and its terms have at least this size; one of w is the largest."""
    solved = compared(2, asked=asked, load=lambda x: 100.0 * ufl.sin(7.0 * x[0]) * x[1])
    found, comm = indicators(solved), solved.fine.comm
    whole = total(found.cells, 1.0, comm)
    assert (1.0 - 1e-6) * solved.distance <= whole < 100.0 * solved.distance
    largest = comm.allreduce(float(np.abs(solved.error.x.array).max()), op=MPI.MAX)
    assert 0.01 * largest < solved.distance < 2.0 * largest
