"""Two promises of the dial that are cheap to test: where it aims, and what it adds to an error."""

from dataclasses import replace

import pytest
from mpi4py import MPI

from dolfinx_signorini.accuracy.kinds import GRADED_P2, UNIFORM_P1, UNIFORM_P2
from dolfinx_signorini.accuracy.model import Model, Trial
from dolfinx_signorini.accuracy.runs import Configuration, exact_solution
from dolfinx_signorini.accuracy.search import _choice
from dolfinx_signorini.accuracy.trials import Trials
from dolfinx_signorini.norms import error_norms
from dolfinx_signorini.paper.solution import christof_haubner, paper_family

COMM = MPI.COMM_WORLD


@pytest.mark.parametrize("kind", [UNIFORM_P1, UNIFORM_P2], ids=str)
@pytest.mark.parametrize("accuracy", [1e-4, 3e-5, 1e-5])
def test_an_untried_mesh_is_chosen_well_inside_of_the_target(kind, accuracy):
    trials = [Trial(Configuration(kind, n), n * n, 1e-5 * n * n, n**-2.0) for n in (10, 16, 26)]
    choice = _choice(Model(tuple(trials), 2), accuracy)
    assert 0.6 * accuracy <= choice.error <= 0.85 * accuracy
    assert choice.error == pytest.approx(choice.configuration.n**-2.0)


@pytest.mark.parametrize("kind", [GRADED_P2, UNIFORM_P2], ids=str)
def test_an_estimate_allows_for_the_error_of_its_reference(kind):
    # By the triangle inequality the error is at most the difference plus the reference's error.
    known = paper_family((0.47123, 0.0))
    hidden = replace(
        known, pose=lambda sided, degree: replace(known.pose(sided, degree), exact=None)
    )
    trials = Trials(COMM, hidden, "H1", lambda trial: None)
    run, trial = trials.run(Configuration(kind, 26))
    reference = trials._reference
    assert reference is not None
    errors = []
    for u, exact in (
        (run.u, exact_solution(run, reference)),
        (reference.u, christof_haubner(reference.u.function_space.mesh, (0.47123, 0.0))),
    ):
        errors.append(error_norms(u, exact, ["H1"])["H1"])
    run.destroy()
    trials.destroy()
    assert sum(errors) <= trial.error <= 2.0 * sum(errors)


@pytest.mark.parametrize("order", [0.5, 1.0, 2.5])
@pytest.mark.parametrize("kind", [UNIFORM_P1, GRADED_P2], ids=str)
def test_a_power_law_is_predicted_exactly_between_and_beyond_the_trials(kind, order):
    trials = [
        Trial(Configuration(kind, n), n * n, 1e-5 * n * n, 3.0 * n**-order) for n in (10, 20, 40)
    ]
    model = Model(tuple(trials), 2)
    for n in (5, 10, 13, 25, 40, 100):
        assert model.error(n) == pytest.approx(3.0 * n**-order, rel=1e-9)
        assert model.cells(3.0 * n**-order) == pytest.approx(n, rel=1e-6)
