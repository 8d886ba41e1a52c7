"""Functions that users give: what one rank raises is raised on all, and no rank waits for ever."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini import (
    InputError,
    SidedMesh,
    SignoriniProblem,
    bernstein_space,
    boundary_facets,
    friedrichs_keller,
    solve_adaptively,
    solve_cascade,
)
from dolfinx_signorini.base.errors import together
from dolfinx_signorini.problem.values import called

FAILURES = (IndexError, KeyError, RuntimeError, ZeroDivisionError, TypeError, ValueError)


def pose(domain, contact=None, make_space=None, **options):
    make_space = make_space or (lambda domain: fem.functionspace(domain, ("Lagrange", 1)))
    space = make_space(domain)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    load = -fem.Constant(domain, 1.0) * v * ufl.dx
    contact = boundary_facets(domain) if contact is None else contact
    return SignoriniProblem(a, load, contact=contact, **options)


def fails_on(rank, comm, error):
    if comm.rank == rank:
        raise error


@pytest.mark.parametrize("failure", FAILURES)
@pytest.mark.parametrize("first", [True, False])
def test_what_an_obstacle_raises_on_one_rank_is_refused_on_all(comm, failure, first):
    """The first rank fails, or the last one."""
    rank = 0 if first else comm.size - 1

    def obstacle(x):
        fails_on(rank, comm, failure("no table"))
        return -0.1 + 0.0 * x[0]

    for make_space in (None, lambda domain: bernstein_space(domain, 2)):
        with pytest.raises(InputError, match=f"obstacle: .*{failure.__name__}.*no table"):
            pose(friedrichs_keller(comm, 8), make_space=make_space, obstacle=obstacle)


def test_what_an_obstacle_raises_in_a_later_step_is_refused_on_all(comm):
    table = {0.0: -0.1, 2.0: -0.2}
    now = [0.0]

    def obstacle(x):
        return table[now[0] if comm.rank == comm.size - 1 else 0.0] + 0.0 * x[0]

    problem = pose(friedrichs_keller(comm, 8), obstacle=obstacle)
    problem.solve()
    now[0] = 1.0
    with pytest.raises(InputError, match=r"obstacle: .*KeyError: 1\.0"):
        problem.solve()


@pytest.mark.parametrize(
    "obstacle",
    [
        lambda x: -0.1 + 0.0 * x[0][0],
        lambda x: -0.1 * x[0].min() / x[0].min() if x[0].min() else -0.1,
        lambda x: -0.1 * x.shape[1] / x.shape[1] + 0.0 * x[0],
    ],
)
def test_an_obstacle_is_called_where_a_rank_has_points_only(comm, obstacle):
    """Contact is on one side, of which some ranks have no part: they have no first point."""
    domain = friedrichs_keller(comm, 8)
    side = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], 0.0))
    given, known = (pose(domain, side, obstacle=data).solve() for data in (obstacle, -0.1))
    assert np.array_equal(given.x.array, known.x.array)


class Ended(Exception):
    """An exception of a user, who leaves a loop."""


def test_a_rank_keeps_its_own_exception(comm):
    own = InputError if comm.rank else Ended
    with pytest.raises(own, match="enough"), together(comm, "on_step"):
        fails_on(0, comm, Ended("enough"))
    with pytest.raises(Ended), together(comm, "on_step"):  # on all ranks
        raise Ended("enough")
    with together(comm, "on_step"):
        pass


@pytest.mark.parametrize("argument", ["on_step", "norm", "pose"])
def test_what_a_function_of_the_loop_raises_on_one_rank_is_raised_on_all(comm, argument):
    last = comm.size - 1

    def fail(*given):
        fails_on(last, comm, Ended("no file"))
        return given[0] * ufl.dx if argument == "norm" else None

    def posed(sided):
        problem = pose(sided.mesh, sided.sides["all"])
        if argument == "pose":  # behind what communicates
            fail()
        return problem

    domain = friedrichs_keller(comm, 4)
    sided = SidedMesh(domain, {"all": boundary_facets(domain)})
    functions = {} if argument == "pose" else {argument: fail}
    own = Ended if comm.rank == last and argument != "norm" else InputError
    with pytest.raises(own, match="no file"):
        solve_adaptively(posed, sided, accuracy=1e-6, **functions)


def test_what_is_raised_after_a_level_of_a_cascade_is_raised_on_all(comm):
    last = comm.size - 1
    with pytest.raises(Ended if comm.rank == last else InputError, match="no file"):
        solve_cascade(
            lambda n, _: pose(friedrichs_keller(comm, n)),
            [4, 8],
            on_level=lambda problem: fails_on(last, comm, Ended("no file")),
        )


def test_a_callable_without_points_is_not_called():
    """What a rank without contact dofs does; the callable would take the first of its points."""
    found = called(MPI.COMM_SELF, lambda x: x[0][0] + 0.0 * x[0], np.zeros((3, 0)))
    assert found.shape == (0,)


class Recording:
    """A communicator of one rank that counts how often it was asked what the others have."""

    asked = 0

    def allgather(self, item):
        self.asked += 1
        return [item]


def test_a_rank_whose_function_raises_tells_the_others_first():
    """The others wait for what this rank has to say: without an answer they wait for ever."""
    comm = Recording()
    with pytest.raises(KeyError), together(comm, "on_step"):
        raise KeyError("no such time")
    assert comm.asked == 1
