"""The driver of the cascade: what each level is given, and what is freed."""

import pytest
from mpi4py import MPI

from dolfinx_signorini.base.errors import NotConvergedError
from dolfinx_signorini.solvers.cascade import solve_cascade


class Recorded:
    """Notes what is done with the problem of a level."""

    comm = MPI.COMM_SELF

    def __init__(self, level, log, fails):
        self.level, self.log, self.fails = level, log, fails

    def solve(self, method="cascade", *, coarse=None, rtol=None):
        self.log.append((self.level, method, coarse, rtol))
        if self.fails:
            raise NotConvergedError("no", 1.0, "made up")

    def contact_state(self):
        return f"state {self.level}"

    def destroy(self):
        self.log.append(f"destroyed {self.level}")


def run(levels, fails=None, **options):
    log, coarser = [], []

    def make(level, problem):
        coarser.append(None if problem is None else problem.level)
        return Recorded(level, log, level == fails)

    try:
        solve_cascade(make, levels, **options)
    except NotConvergedError:
        log.append("failed")
    return log, coarser


def test_each_level_starts_from_the_state_of_the_one_before():
    log, coarser = run([3, 9, 27], rtol=1e-9, coarse_rtol=1e-4)
    assert log == [
        (3, "cascade", None, 1e-4),
        "destroyed 3",
        (9, "cascade", "state 3", 1e-4),
        "destroyed 9",
        (27, "cascade", "state 9", 1e-9),
    ]
    assert coarser == [None, 3, 9]


def test_one_tolerance_for_all_levels_and_a_given_first_state():
    log, _ = run([3, 9], rtol=1e-9, coarse="given")
    assert [entry for entry in log if isinstance(entry, tuple)] == [
        (3, "cascade", "given", 1e-9),
        (9, "cascade", "state 3", 1e-9),
    ]


def test_another_method_is_that_of_the_last_level_and_starts_from_nothing():
    log, _ = run([3, 9], method="bntr")
    assert log[0] == (3, "cascade", None, None)
    assert log[-1] == (9, "bntr", None, None)


@pytest.mark.parametrize("fails", [3, 9, 27])
def test_all_problems_are_freed_where_a_level_fails(fails):
    log, _ = run([3, 9, 27], fails=fails)
    made = [entry[0] for entry in log if isinstance(entry, tuple)]
    assert made[-1] == fails and log[-1] == "failed"
    assert {f"destroyed {level}" for level in made} <= set(log)
