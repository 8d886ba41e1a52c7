"""The dial: the error that comes out lies between a half and the whole of the one asked for."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
from mpi4py import MPI

from dolfinx_signorini import InputError
from dolfinx_signorini.accuracy.family import Family
from dolfinx_signorini.accuracy.kinds import UNIFORM_P1
from dolfinx_signorini.accuracy.model import Model, Trial, rounded
from dolfinx_signorini.accuracy.runs import Configuration, solve_configuration
from dolfinx_signorini.accuracy.search import MAX_UNKNOWNS, Outcome, solve_to
from dolfinx_signorini.norms import error_norms
from dolfinx_signorini.paper.solution import paper_family
from dolfinx_signorini.scenes import load_scene
from dolfinx_signorini.scenes.posing import scene_family

SCENES = Path(__file__).parents[2] / "demos" / "scenes"


def family(comm: MPI.Comm, name: str) -> Family:
    if name == "paper":
        return paper_family()
    return scene_family(load_scene(SCENES / f"{name}.toml", comm))


def remeasured(comm: MPI.Comm, posed: Family, outcome: Outcome) -> float:
    """The error of a fresh run of what was chosen, against the exact solution."""
    run = solve_configuration(comm, posed, outcome.run.configuration)
    assert run.posed.exact is not None
    value = error_norms(run.u, run.posed.exact, [outcome.norm])[outcome.norm]
    run.destroy()
    return value


QUICK = [("paper", "L4", 1e-3), ("mixed", "W1_inf", 0.05), ("polygon", "W1_4", 5e-3)]
TARGETS = {
    "paper": {
        "L4": (1e-2, 1e-3, 3e-4, 1e-4, 3e-5),
        "W1_4": (0.5, 0.2, 0.1, 0.05, 0.02),
        "W1_inf": (2.0, 1.0, 0.6, 0.34, 0.15),
    },
    "mixed": {
        "L4": (1e-3, 1e-4, 3e-5, 1e-5, 2e-6),
        "W1_4": (5e-2, 2e-2, 1e-2, 5e-3, 2e-3),
        "W1_inf": (0.3, 0.2, 0.1, 0.05, 0.02),
    },
    "polygon": {
        "L4": (1e-3, 1e-4, 3e-5, 1e-5, 2e-6),
        "W1_4": (5e-2, 2e-2, 1e-2, 5e-3, 2e-3),
        "W1_inf": (0.3, 0.2, 0.1, 0.05, 0.02),
    },
}
ALL = [
    pytest.param(scene, norm, target, marks=pytest.mark.slow)
    for scene, norms in TARGETS.items()
    for norm, targets in norms.items()
    for target in targets
    if (scene, norm, target) not in QUICK
]


@pytest.mark.parametrize(("scene", "norm", "target"), [*QUICK, *ALL])
def test_the_error_lands_within_a_factor_two_below(
    comm: MPI.Comm, scene: str, norm: str, target: float
) -> None:
    posed = family(comm, scene)
    outcome = solve_to(comm, posed, norm, accuracy=target)
    assert 0.5 * target <= outcome.error <= target
    assert not outcome.estimated
    assert 0.3 * target <= outcome.predicted.error <= 1.5 * target
    assert math.isclose(remeasured(comm, posed, outcome), outcome.error, rel_tol=0.01)
    assert outcome.run.unknowns <= MAX_UNKNOWNS
    assert outcome.error in [trial.error for trial in outcome.trials]
    outcome.run.destroy()


def test_an_estimated_error_is_not_below_the_true_one(comm: MPI.Comm) -> None:
    known = paper_family((0.47123, 0.0))
    hidden = replace(
        known, pose=lambda sided, degree: replace(known.pose(sided, degree), exact=None)
    )
    outcome = solve_to(comm, hidden, "W1_4", accuracy=0.1)
    outcome.run.destroy()
    assert outcome.estimated
    assert outcome.error <= 0.1
    truth = remeasured(comm, known, outcome)
    assert 0.5 * outcome.error <= truth <= outcome.error


def test_what_is_out_of_reach_is_refused_with_the_best(comm: MPI.Comm) -> None:
    with pytest.raises(InputError, match=r"out of reach with 20000 unknowns; the best would be"):
        solve_to(comm, paper_family(), "W1_inf", accuracy=1e-6, max_unknowns=20_000)


def test_a_budget_that_is_too_small_is_refused(comm: MPI.Comm) -> None:
    with pytest.raises(InputError, match=r"budget: 1e-06 s are too few"):
        solve_to(comm, paper_family(), "L4", budget=1e-6)


def test_a_budget_buys_accuracy(comm: MPI.Comm) -> None:
    outcome = solve_to(comm, paper_family(), "L4", budget=60.0, max_unknowns=20_000)
    outcome.run.destroy()
    assert outcome.error == min(trial.error for trial in outcome.trials)
    assert outcome.error < 1e-4
    assert outcome.run.unknowns <= 1.3 * 20_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"norm": "L0.5", "accuracy": 1.0}, "norm"),
        ({"norm": "L2"}, "either"),
        ({"norm": "L2", "accuracy": 1.0, "budget": 1.0}, "either"),
        ({"norm": "L2", "accuracy": -1.0}, "accuracy: must be a positive number"),
        ({"norm": "L2", "accuracy": math.nan}, "accuracy: must be a positive number"),
        ({"norm": "L2", "budget": math.inf}, "budget: must be a positive number"),
        ({"norm": "L2", "budget": 1.0, "max_unknowns": 0}, "max_unknowns: must be positive"),
    ],
)
def test_nonsense_is_refused_before_any_work(
    comm: MPI.Comm, arguments: dict[str, float], message: str
) -> None:
    def pose(*_: object) -> object:
        raise AssertionError("work was done")

    nothing = replace(paper_family(), make=pose)
    with pytest.raises(InputError, match=message):
        solve_to(comm, nothing, **arguments)


def power_law(order: float, constant: float = 3.0) -> Model:
    """A model of runs that follow error = constant n^-order, seconds = 0.01 + 1e-5 unknowns."""
    trials = []
    for n in (10, 16, 26):
        unknowns = n**2
        error = constant * n**-order
        trials.append(Trial(Configuration(UNIFORM_P1, n), unknowns, 0.01 + 1e-5 * unknowns, error))
    return Model(tuple(trials), 2)


@pytest.mark.parametrize("order", [0.5, 1.0, 3.0])
def test_the_model_continues_a_power_law(order: float) -> None:
    model = power_law(order)
    for n in (5.0, 12.0, 26.0, 300.0):
        assert math.isclose(model.error(n), 3.0 * n**-order, rel_tol=1e-9)
        assert math.isclose(model.cells(3.0 * n**-order), n, rel_tol=1e-9)
        assert math.isclose(model.unknowns(n), n**2, rel_tol=1e-9)
    for n in (26.0, 100.0):
        assert math.isclose(model.seconds(n), 0.01 + 1e-5 * n**2, rel_tol=1e-9)
        assert math.isclose(model.cells_within(model.seconds(n)), n, rel_tol=1e-9)


def test_a_coarser_mesh_is_not_predicted_to_take_longer_than_a_finer_one_did() -> None:
    trials = power_law(1.0).trials
    quick = replace(trials[0], configuration=Configuration(UNIFORM_P1, 14), unknowns=14**2)
    quick = replace(quick, seconds=0.5 * trials[0].seconds)
    model = Model((trials[0], quick, *trials[1:]), 2)
    assert model.seconds(13.0) <= quick.seconds
    assert model.seconds(15.0) > quick.seconds


def test_the_model_does_not_believe_in_errors_that_grow() -> None:
    trials = power_law(1.0).trials
    worse = replace(trials[-1], error=2.0 * trials[-2].error)
    model = Model((*trials[:-1], worse), 2)
    assert model.error(1000.0) < worse.error


@pytest.mark.parametrize("graded", [False, True])
def test_cells_are_rounded_up_by_little(graded: bool) -> None:
    for wanted in (2.0, 7.3, 16.0, 39.5, 41.0, 99.9, 517.0):
        n = rounded(wanted, graded)
        assert wanted <= n <= max(1.12 * wanted, wanted + 2.0)
        assert rounded(n, graded) == n or graded
