"""Marks, and the meshes that follow from them, for errors that are known."""

import math
from dataclasses import replace

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI

from dolfinx_signorini.accuracy import marking
from dolfinx_signorini.accuracy.cells import volumes
from dolfinx_signorini.accuracy.marking import Marks, Prediction, mark, mark_for_all
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, owned_cells

N = 8


def prediction(remaining, rates, singular, power=2.0, exponent=None, places=None):
    exponent = power if exponent is None else exponent
    places = np.full((len(rates), 3), np.inf) if places is None else places
    factors = 2.0**-rates
    deepest = marking.DEEP
    return Prediction(remaining, factors, singular, singular, deepest, power, exponent, places)


def corners(sided):
    domain = sided.mesh
    return domain.geometry.x[domain.geometry.dofmap[owned_cells(domain)]]


def square(comm):
    sided = SidedMesh(friedrichs_keller(comm, N), {})
    return sided, corners(sided).mean(axis=1)


def count(comm, sided):
    return comm.allreduce(len(owned_cells(sided.mesh)))


def deepest_level(comm, marks):
    return comm.allreduce(int(marks.levels.max(initial=0)), op=MPI.MAX)


def test_all_cells_are_divided_once(comm):
    sided, _ = square(comm)
    cells = len(owned_cells(sided.mesh))
    divided = Marks(np.ones(cells), np.full((cells, 3), np.inf)).apply(sided)
    assert count(comm, divided.sided) == 4 * 2 * N**2
    assert divided.levels == pytest.approx(1.0)
    assert not divided.away.any()


@pytest.mark.parametrize("dimension", [2, 3])
def test_cells_are_as_small_as_their_marks_say_and_hardly_smaller(comm, dimension):
    if dimension == 2:
        sided, _middle = square(comm)
    else:
        sided = SidedMesh(mesh.create_unit_cube(comm, 4, 4, 4), {})
    middle = corners(sided).mean(axis=1)
    size, cells = volumes(sided.mesh), len(owned_cells(sided.mesh))
    bisections = np.rint(2 * dimension * np.clip(1.2 - 2.0 * np.linalg.norm(middle, axis=1), 0, 1))
    marks = Marks(bisections / dimension, np.full((cells, 3), np.inf))
    divided = marks.apply(sided)
    halvings = np.log2(divided.owners.of(size) / volumes(divided.sided.mesh))
    assert divided.levels == pytest.approx(halvings / dimension, abs=1e-3)
    asked = divided.owners.of(bisections)
    assert (halvings > asked - 1e-9).all()
    parts = comm.allreduce(float((2.0**bisections).sum()))
    assert parts <= count(comm, divided.sided) <= (1.4 if dimension == 2 else 2.0) * parts
    # Cells around a whole division become smaller, and not all cells by the next whole division.
    assert comm.allreduce(np.count_nonzero(np.abs(halvings - asked) < 1e-9)) > 0.3 * parts


@pytest.mark.parametrize("power", [1.0, 2.0, np.inf])
def test_cells_with_the_error_are_divided(comm, power):
    sided, middle = square(comm)
    bad = np.hypot(*(middle[:, :2] - 0.5).T) < 0.2
    values = np.where(bad, 1.0, 1e-4)
    smooth = np.zeros(len(bad), bool)
    marks = mark(sided, prediction(values, np.full(len(bad), 3.0), smooth, power), 0.2, 3.0)
    assert (marks.levels[bad] >= 1).all()
    assert (marks.levels[~bad] == 0).all()
    divided = marks.apply(sided)
    parts = divided.collected(np.ones(len(divided.levels)), 1.0)
    assert (parts[bad] >= 4).all()
    assert (parts[np.hypot(*(middle[:, :2] - 0.5).T) > 0.4] == 1).all()


def test_the_error_that_is_asked_for_is_aimed_at(comm):
    sided, middle = square(comm)
    values = 10.0 ** (-3.0 * middle[:, 0])
    rates, smooth = np.full(len(values), 2.0), np.zeros(len(values), bool)
    for goal in (0.9, 0.6, 0.3):
        marks = mark(sided, prediction(values, rates, smooth), goal, 100.0)
        after = comm.allreduce((values**2 * 4.0 ** (-2.0 * marks.levels)).sum())
        share = np.sqrt(after / comm.allreduce((values**2).sum()))
        # Half of the error's square is reduced in any case.
        assert 0.4 * goal <= share <= goal


def test_steps_to_an_aim_have_one_ratio_of_cells(comm):
    """Four times the cells in two steps are twice as many in each, and not three and then 4/3."""
    sided, middle = square(comm)
    values, smooth = np.exp(-middle[:, 0]), np.zeros(len(middle), bool)
    foreseen = prediction(values, np.full(len(middle), 2.0), smooth)
    whole = mark(sided, foreseen, 0.25, 100.0).growth
    assert 3.0 < whole < 9.0
    assert 0.8 * np.sqrt(whole) < mark(sided, foreseen, 0.25, 3.0).growth <= np.sqrt(whole)


def test_lumps_with_small_parts_are_divided_with_the_others(comm):
    """Two lumps e of an error, of which one is a third as large, have parts e^4 in its L^4 norm."""
    sided, middle = square(comm)
    left, right = middle[:, 0] < 0.2, middle[:, 0] > 0.8
    lumps = np.where(left, 1.0, np.where(right, 0.3, 0.0))
    rates, smooth = np.full(len(lumps), 2.0), np.zeros(len(lumps), bool)
    marks = mark(sided, prediction(lumps**4, rates, smooth, 1.0, 4.0), 0.27, 100.0)
    after = lumps * 4.0 ** (-1.0 * marks.levels)
    assert (marks.levels[right] > 0).all()
    error = comm.allreduce(np.array([(after**4).sum(), (lumps**4).sum()])) ** 0.25
    assert error[0] <= 0.27 * error[1]
    # Parts that fell like the error itself would leave the smaller lump as it is.
    marks = mark(sided, prediction(lumps**4, rates, smooth, 1.0), 0.27, 100.0)
    assert (marks.levels[right] == 0).all()


def test_meshes_grow_no_more_than_allowed(comm):
    sided, middle = square(comm)
    values = 10.0 ** (-3.0 * middle[:, 0] - 0.3 * middle[:, 1])
    rates, smooth = np.full(len(values), 2.0), np.zeros(len(values), bool)
    for growth in (1.5, 2.0, 3.0):
        marks = mark(sided, prediction(values, rates, smooth), 0.0, growth)
        wanted = comm.allreduce((4.0**marks.levels).sum()) / (2 * N**2)
        assert 0.6 * growth <= wanted <= 1.1 * growth


def test_a_slow_cell_in_a_sup_norm_takes_so_many_others_along_that_the_step_is_worth_it(comm):
    """The largest value hardly falls in one step, and the others are to fall to the aim as well."""
    sided, middle = square(comm)
    values = 10.0 ** (-12.0 * middle[:, 0])
    slow = np.linalg.norm(middle, axis=1) < 0.2
    rates = np.where(slow, 0.1, 3.0)
    aim = 0.01
    marks = mark(sided, prediction(values, rates, np.zeros_like(slow), np.inf), aim, 3.0)
    largest = comm.allreduce(values.max(initial=0.0), op=MPI.MAX)
    assert (marks.levels[values < aim * largest] == 0.0).all()
    cells = comm.allreduce(np.array([(4.0**marks.levels).sum(), len(values)]))
    assert marking.SAFETY <= cells[0] / cells[1] <= 3.0


@pytest.mark.parametrize("deepest", [1, 2, 3])
def test_rates_are_believed_for_so_many_divisions(comm, deepest):
    sided, middle = square(comm)
    values, rates = 10.0 ** (-6.0 * middle[:, 0]), np.full(len(middle), 2.0)
    foreseen = prediction(values, rates, np.zeros(len(middle), dtype=bool))
    marks = mark(sided, replace(foreseen, deepest=deepest), 1e-4, math.inf)
    assert deepest_level(comm, marks) == deepest


def at_centre(sided):
    return np.linalg.norm(corners(sided) - (0.5, 0.5, 0.0), axis=2).min(axis=1) < 1e-9


def test_a_cell_is_divided_towards_its_singular_point(comm):
    sided, _middle = square(comm)
    at = at_centre(sided)
    values, rates = np.where(at, 1.0, 1e-4), np.where(at, 0.5, 3.0)
    marks = mark(sided, prediction(values, rates, at), 0.05, 5.0)
    assert (marks.singular == at).all()
    assert np.abs(marks.points[at] - (0.5, 0.5, 0.0)).max(initial=0.0) < 1e-9
    assert (marks.levels[at] >= 5).all()
    divided = marks.apply(sided)
    there = at_centre(divided.sided)
    size = volumes(divided.sided.mesh)
    deepest = deepest_level(comm, marks)
    assert size[there] == pytest.approx(4.0**-deepest / N**2, rel=1e-9)
    assert count(comm, divided.sided) < 2 * N**2 + 100 * deepest
    assert (divided.away == (divided.owners.of(at) & ~there)).all()


def test_all_slow_cells_at_a_known_point_are_divided_towards_the_point(comm):
    """Also those that have little of the error, and as often as it takes, although seen once."""
    sided, middle = square(comm)
    at, place = at_centre(sided), (0.5, 0.5, 0.0)
    values = np.where(at, 10.0 ** (-3.0 * N * np.abs(middle[:, 0] - 0.5)), 1e-9)
    places = np.where(at[:, None], place, np.full((len(at), 3), np.inf))
    once, rates = np.zeros(len(at), dtype=bool), np.where(at, 0.5, 3.0)
    foreseen = Prediction(values, 2.0**-rates, at, once, 1, 2.0, 2.0, places)
    marks = mark(sided, foreseen, 1e-5, math.inf)
    assert (marks.singular == at).all() and not marking.apart(sided, marks.points).any()
    assert np.abs(marks.points[at] - place).max(initial=0.0) == 0.0
    assert (marks.levels[at] > marking.DEEP).all()
    assert count(comm, marks.apply(sided).sided) < 2 * N**2 + 300 * deepest_level(comm, marks)
    smooth = mark(sided, replace(foreseen, singular=once), 1e-5, math.inf)
    assert not smooth.singular.any()


@pytest.mark.parametrize("place", [0.5 + 0.3 / N, 0.5 + 0.5 / N, 0.5 + 0.02 / N])
def test_cells_are_divided_towards_an_end_of_contact_between_their_vertices(comm, place):
    sided, _middle = square(comm)
    end = np.array([place, 0.0, 0.0])
    at = np.linalg.norm(corners(sided) - end, axis=2).min(axis=1) < 0.7 / N
    values, rates = np.where(at, 1.0, 1e-4), np.where(at, 0.5, 3.0)
    ends = np.where(at[:, None], end, np.inf)
    unseen = np.zeros(len(at), dtype=bool)
    foreseen = Prediction(values, 2.0**-rates, at, unseen, 2, 2.0, 2.0, ends)
    marks = mark(sided, foreseen, 0.05, 5.0)
    assert (marks.levels[at] == marking.LOCATED).all() and (marks.singular == at).all()
    divided = marks.apply(sided)
    x, size = corners(divided.sided), volumes(divided.sided.mesh)
    # Cells with the end, or as near to the end as their size, are as small as the marks say.
    near = np.linalg.norm(x - end, axis=2).min(axis=1) < 0.7 * np.sqrt(size)
    assert comm.allreduce(int(near.sum())) > 0
    assert size[near] == pytest.approx(4.0**-marking.LOCATED / N**2, rel=1e-9)
    assert count(comm, divided.sided) < 2 * N**2 + 40 * marking.LOCATED
    assert not divided.away[near].any()


@pytest.mark.parametrize("away", [0.7, 1.5, 4.0])
@pytest.mark.parametrize("level", [0.5, 1.0, 3.0])
def test_a_marked_cell_is_divided_however_far_away_its_point_is(comm, level, away):
    """Otherwise a loop with this cell alone would make the same mesh again and again."""
    sided, _middle = square(comm)
    levels, points = (
        np.zeros(len(owned_cells(sided.mesh))),
        np.full((len(corners(sided)), 3), np.inf),
    )
    if len(levels):
        levels[0] = level
        points[0] = corners(sided)[0].mean(axis=0) + np.array([away / N, 0.1 / N, 0.0])
    divided = Marks(levels, points).apply(sided)
    parts = divided.collected(np.ones(len(divided.levels)), 1.0)
    assert (parts[levels > 0.0] > 1.0).all()
    assert count(comm, divided.sided) < count(comm, sided) + 40 * comm.size


def test_cells_at_the_limit_of_rounding_are_not_divided(comm, monkeypatch):
    sided, _middle = square(comm)
    at = at_centre(sided)
    values, rates = np.where(at, 1.0, 1e-4), np.where(at, 0.5, 3.0)
    for smallest, deepest in ((0.02, 3), (0.2, 0)):  # for cells of the size 1/8 at 1/2
        monkeypatch.setattr(marking, "ROUNDING", smallest)
        marks = mark(sided, prediction(values, rates, at), 0.05, 5.0)
        assert deepest_level(comm, marks) == deepest


@pytest.mark.parametrize(("smallest", "deepest"), [(0.02, 2), (0.2, 0)])
def test_no_cell_becomes_smaller_than_it_may(comm, smallest, deepest):
    sided, _middle = square(comm)
    at = at_centre(sided)
    values, rates = np.where(at, 1.0, 1e-4), np.where(at, 0.5, 3.0)
    marks = mark_for_all(sided, [prediction(values, rates, at)], 0.05, 5.0, smallest)
    assert deepest_level(comm, marks) == deepest


def test_a_singular_line_is_no_point(comm):
    sided, middle = square(comm)
    bottom = (corners(sided)[:, :, 1] < 1e-9).sum(axis=1) == 2
    values, rates = np.where(bottom, 1.0, 1e-4), np.where(bottom, 0.5, 3.0)
    marks = mark(sided, prediction(values, rates, bottom), 0.5, 5.0)
    inner = bottom & (np.abs(middle[:, 0] - 0.5) < 0.3)
    assert not marks.singular[inner].any()
