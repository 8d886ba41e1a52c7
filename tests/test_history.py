"""Guesses from earlier solutions: the ends of a contact set that moves steadily."""

from types import SimpleNamespace

import numpy as np
import pytest

from dolfinx_signorini.solvers.history import History

places = np.linspace(0.0, 1.0, 201)


def solved(end, slope=1.0):
    """A made-up solution that is in contact up to an end: a system, and its solution.

    The force is like the root of the distance to the end, and the gap like its power 3/2.
    """
    gap = slope * np.maximum(places - end, 0.0) ** 1.5
    force = slope * np.sqrt(np.maximum(end - places, 0.0))
    system = SimpleNamespace(
        contact_dofs=np.arange(len(places)),
        obstacle=np.zeros(len(places)),
        touching=lambda x: x.array_r <= 0.0,
        multiplier=lambda x: force,
    )
    return system, SimpleNamespace(array_r=gap)


@pytest.mark.parametrize("step", [-0.1, -0.03])
def test_an_end_that_recedes_steadily_is_foreseen_to_the_dof(step):
    history = History()
    assert history.guesses(solved(0.5)[0]) == []
    for end in (0.5001, 0.5001 + step):
        history.add(*solved(end))
    (_, last), (_, following) = history.guesses(solved(0.0)[0])
    assert np.array_equal(last, places < 0.5001 + step)
    assert np.count_nonzero(following != (places < 0.5001 + 2.0 * step)) <= 1


@pytest.mark.parametrize("step", [0.1, 0.03])
def test_no_dof_is_forgotten_where_an_end_advances(step):
    history = History()
    for end in (0.5001, 0.5001 + step):
        history.add(*solved(end))
    _, (values, held) = history.guesses(solved(0.0)[0])
    assert held[places < 0.5001 + 2.0 * step].all()
    assert not held[values >= 0.0][places[values >= 0.0] > 0.5001 + 2.0 * step].any()


def test_values_are_extrapolated_linearly_and_what_penetrates_is_held():
    history = History()
    for end, slope in ((0.5, 2.0), (0.5, 1.8)):
        history.add(*solved(end, slope))
    system, third = solved(0.5, 1.6)
    (last, _), (values, held) = history.guesses(system)
    assert np.array_equal(last, solved(0.5, 1.8)[1].array_r)
    assert values == pytest.approx(third.array_r, abs=1e-14)
    assert np.array_equal(held, places <= 0.5)
    system.obstacle = np.where(places > 0.9, 0.5, 0.0)  # above the extrapolation
    _, (values, held) = history.guesses(system)
    assert held[values < system.obstacle].all() and (values < system.obstacle).any()


def test_only_the_last_two_solutions_count():
    history = History()
    for end in (0.9, 0.4, 0.45):
        history.add(*solved(end))
    _, (values, _) = history.guesses(solved(0.5)[0])
    expected = 2.0 * solved(0.45)[1].array_r - solved(0.4)[1].array_r
    assert values == pytest.approx(expected, abs=1e-14)
