"""Guesses from earlier solutions: their values, the ends of a moving contact set, their doubts."""

from types import SimpleNamespace

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.solvers.history import KEPT, History

places = np.linspace(0.0, 1.0, 201)


def solved(end, inner=(0.0,), obstacle=0.0):
    """A made-up system of the identity, its solution, in contact up to an end, and its multiplier.

    The force is like the root of the distance to the end, and the gap like its power 3/2. The inner
    values are those of the dofs that are not at the contact boundary.
    """
    gap = np.maximum(places - end, 0.0) ** 1.5
    force = np.sqrt(np.maximum(end - places, 0.0))
    count = len(places)
    values = np.concatenate((obstacle + gap, inner))
    multiplier = np.concatenate((force, np.zeros(len(inner))))
    system = SimpleNamespace(
        comm=MPI.COMM_SELF,
        b=SimpleNamespace(array_r=values - multiplier),
        A=SimpleNamespace(getLocalSize=lambda: (len(values), len(values))),
        contact_dofs=np.arange(count),
        signs=np.ones(count),
        contact_diagonal=np.ones(count),
        obstacle=np.full(count, obstacle),
        touching=lambda x: x.array_r[:count] <= obstacle,
        scaled_gap=lambda values: values - obstacle,
        assembled=1,
    )
    return system, SimpleNamespace(array_r=values), SimpleNamespace(array_r=multiplier)


def guessed(*earlier, following):
    history = History()
    for each in earlier:
        history.add(*each)
    return history.guess(following[0])


def test_before_the_first_solution_nothing_is_guessed():
    assert History().guess(solved(0.5)[0]) is None


@pytest.mark.parametrize("step", [-0.1, -0.03])
def test_an_end_that_recedes_steadily_is_foreseen_to_the_dof(step):
    ends = 0.5001 + step * np.arange(3)
    inner = [(100.0,), (200.0,), (300.0,)]  # the load there tells how far to go
    *earlier, following = (solved(end, value) for end, value in zip(ends, inner, strict=True))
    guess = guessed(*earlier, following=following)
    assert np.count_nonzero(guess.held != (places < ends[2])) <= 1
    moved = (places > ends[2]) & (places < ends[0])
    assert guess.doubtful[moved].all()
    assert not guess.doubtful[(places < ends[2] - 0.01) | (places > ends[0])].any()


@pytest.mark.parametrize("step", [0.1, 0.03])
def test_no_dof_is_forgotten_where_an_end_advances(step):
    ends = 0.4001 + step * np.arange(3)
    *earlier, following = (solved(end, (value,)) for value, end in enumerate(ends))
    guess = guessed(*earlier, following=following)
    assert (guess.values[: len(places)] < 0.0).any()  # values alone would hold too many
    assert np.array_equal(guess.held, places < ends[2])


@pytest.mark.parametrize("degree", range(KEPT))
def test_polynomials_in_time_are_continued_exactly(degree):
    rng = np.random.default_rng(1)
    factors = rng.standard_normal((degree + 1, 50))

    def at(time):
        return solved(0.5001, sum(c * time**k for k, c in enumerate(factors)))

    guess = guessed(*(at(time) for time in np.arange(KEPT) / 10.0), following=at(KEPT / 10.0))
    assert guess.values == pytest.approx(at(KEPT / 10.0)[1].array_r, abs=1e-9)
    assert not guess.doubtful.any()


def test_an_obstacle_that_rises_is_followed():
    # No load and no force tells of the rise.
    earlier = (solved(2.0, obstacle=height) for height in (0.0, 0.1, 0.3))
    guess = guessed(*earlier, following=solved(2.0, obstacle=0.45))
    assert guess.values[:-1] == pytest.approx(0.45)
    assert guess.held.all()


def test_only_the_last_solutions_count():
    inner = np.eye(KEPT + 2)
    earlier = [solved(0.5, row) for row in inner[:-1]]
    # The first of the solutions would explain the load.
    guess = guessed(*earlier, following=solved(0.5, inner[0]))
    forgotten = guess.values[len(places)]
    assert forgotten == pytest.approx(0.0, abs=1e-12)


def heated():
    """A square over an obstacle, with factors of the load and of the form to change."""
    domain = friedrichs_keller(MPI.COMM_WORLD, 20)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    load, stiffness = fem.Constant(domain, 1.0), fem.Constant(domain, 1.0)
    problem = SignoriniProblem(
        (stiffness * ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx,
        load * 10.0 * (load * x[0] - 0.9) * v * ufl.dx,
        contact=boundary_facets(domain),
    )
    return problem, load, stiffness


def test_a_load_that_stays_or_returns_is_solved_for_without_a_linear_solve():
    problem, load, _ = heated()
    counts = []
    for value, rtol in ((1.0, 1e-10), (2.0, 1e-10), (2.0, 1e-8), (1.0, 1e-8)):
        load.value = value
        problem.solve(rtol=rtol)
        counts.append(problem.result.linear_solves)
    problem.destroy()
    assert min(counts[:2]) > 0
    assert counts[2:] == [0, 0]


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_the_guess_sees_the_present_matrix(factor):
    """Proportional form and load have one solution: the guess is exact if it sees both."""
    problem, load, stiffness = heated()
    for value in (1.0, 1.2):
        load.value = value
        first = problem.solve(rtol=1e-9).x.array.copy()
    problem.update(matrix=True)
    problem.solve(rtol=1e-9)
    assert problem.result.linear_solves == 0
    stiffness.value = factor
    found = problem.solve(rtol=1e-9).x.array.copy()
    other, load, stiffness = heated()
    load.value, stiffness.value = 1.2, factor
    assert found == pytest.approx(other.solve(rtol=1e-9).x.array, abs=1e-6)
    assert (np.abs(found - first).max() > 1e-3) == (factor > 1.0)
    for item in (problem, other):
        item.destroy()
