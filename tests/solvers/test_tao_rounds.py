"""Rounds of TAO share their limits, and go on until the residual is reached."""

import pytest
from mpi4py import MPI

from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.solvers.residual import NaturalResidual
from dolfinx_signorini.solvers.tao import FIRST_ORDER, METHODS, TaoRounds
from dolfinx_signorini.studies.paper.solution import christof_haubner, paper_problem

COMM = MPI.COMM_WORLD


def run(method, rtol, n=16, **limits):
    """The rounds of a method from zero, and the residual that they reached."""
    problem = paper_problem(christof_haubner(friedrichs_keller(COMM, n)))
    system = problem.system
    rounds, measure, x = (
        TaoRounds(system, method, **limits),
        NaturalResidual(system),
        system.start(),
    )
    residual = rounds.run(x, measure, rtol)
    for item in (rounds, measure, x):
        item.destroy()
    problem.destroy()
    return rounds, residual


@pytest.mark.parametrize("method", FIRST_ORDER)
@pytest.mark.parametrize("limit", [3, 25, 60])
def test_all_rounds_together_keep_to_the_limit_on_iterations(method, limit):
    rounds, residual = run(method, 1e-12, max_iterations=limit)
    assert rounds.iterations == limit and rounds.exhausted
    assert residual > 1e-12


@pytest.mark.parametrize("method", FIRST_ORDER)
@pytest.mark.parametrize("limit", [4, 50])
def test_all_rounds_together_keep_to_the_limit_on_evaluations(method, limit):
    rounds, residual = run(method, 1e-12, max_evaluations=limit)
    assert rounds.exhausted and residual > 1e-12
    assert rounds.evaluations <= limit + 30  # the line search that is under way ends first


@pytest.mark.parametrize("method", METHODS)
def test_rounds_go_on_down_to_rounding(method):
    rounds, residual = run(method, 1e-13)
    assert residual <= 1e-13 and not rounds.exhausted
