"""One dial: an accuracy, or a time, in place of mesh, degree and tolerance.

Cheap runs of the problem on coarse meshes of every kind show how its error and its time depend on
the number of cells. The kind that is predicted to be the cheapest is refined in steps, each of
which corrects the prediction, until the error is between 50 % and 100 % of the accuracy asked for,
or smaller at no extra cost. Where the solution is not known, errors are measured against a finer
solution, and enlarged by the estimated error of that solution.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from mpi4py import MPI

from dolfinx_signorini.accuracy.family import Family
from dolfinx_signorini.accuracy.kinds import (
    GRADED_P1,
    GRADED_P2,
    UNIFORM_P1,
    UNIFORM_P2,
    Kind,
)
from dolfinx_signorini.accuracy.model import Choice, Model, Trial, rounded
from dolfinx_signorini.accuracy.runs import (
    TIGHT,
    Configuration,
    Run,
    algebraic_errors,
    solve_configuration,
)
from dolfinx_signorini.accuracy.trials import Trials
from dolfinx_signorini.errors import InputError
from dolfinx_signorini.norms import parse_norm

AIM = 0.72  # error aimed at over accuracy: a factor of 1.4 from either end of the target
STEP = 3  # largest ratio of the cells across from one mesh to the next
ATTEMPTS = 12
MAX_UNKNOWNS = 1_000_000
LOOSEST = 1e-5  # the loosest tolerance of a solve
ALGEBRAIC = 0.01  # share of the accuracy that is left to the algebraic error
RESERVE = 1.3  # how much longer than predicted a run may take
TRIALS = 0.3  # largest share of a budget that goes into coarse runs


@dataclass(frozen=True)
class Outcome:
    """A solution of the accuracy asked for:

        outcome = solve_to(comm, family, "L4", accuracy=1e-3)
        print(outcome.error, outcome.run.configuration)

    Attributes:
        run: The solution with its problem.
        norm: The norm of the errors.
        accuracy: The accuracy asked for, or None.
        budget: The budget asked for in seconds, or None.
        error: The error of the solution.
        predicted: The predictions for the run.
        trials: All runs of the search in their order; the chosen one need not be the last.
        estimated: Whether errors are against finer solutions, because no solution is known.
        seconds: Wall-clock seconds of the whole search.
    """

    run: Run
    norm: str
    accuracy: float | None
    budget: float | None
    error: float
    predicted: Choice
    trials: tuple[Trial, ...]
    estimated: bool
    seconds: float


_Answer = tuple[Run, Trial, Choice]


def solve_to(
    comm: MPI.Comm,
    family: Family,
    norm: str,
    *,
    accuracy: float | None = None,
    budget: float | None = None,
    max_unknowns: int = MAX_UNKNOWNS,
    on_trial: Callable[[Trial], None] = lambda trial: None,
) -> Outcome:
    """Solve a problem to an accuracy, or as accurately as a time allows.

    Args:
        comm: The communicator that shares the meshes.
        family: The problem.
        norm: The norm of the error, see `norms.parse_norm`.
        accuracy: The largest error allowed, in the unit of the norm; the error reached is
            normally at least half of the accuracy.
        budget: In place of an accuracy, wall-clock seconds for the coarse runs and the solution.
            Neither the evaluation of errors is counted nor the first run of each kind, which
            compiles the forms.
        max_unknowns: Limit on the predicted number of dofs. Coarse runs, with a few thousand dofs,
            are made in any case.
        on_trial: Called with every run when the run is done.

    Raises:
        InputError: An argument makes no sense, or the request is out of reach; the message names
            the best configuration that the search can predict.
    """
    began = time.perf_counter()
    _check(norm, accuracy, budget, max_unknowns)
    trials = Trials(comm, family, norm, on_trial)
    try:
        if accuracy is not None:
            _calibrate(trials)
            run, trial, predicted = _reach(trials, accuracy, max_unknowns)
        else:
            assert budget is not None
            _calibrate(trials, TRIALS * budget)
            run, trial, predicted = _spend(trials, budget, max_unknowns)
    finally:
        trials.destroy()
    return Outcome(
        run=run,
        norm=norm,
        accuracy=accuracy,
        budget=budget,
        error=trial.error,
        predicted=predicted,
        trials=tuple(trials.done),
        estimated=run.posed.exact is None,
        seconds=comm.bcast(time.perf_counter() - began),
    )


def _check(norm: str, accuracy: float | None, budget: float | None, max_unknowns: int) -> None:
    try:
        parse_norm(norm)
    except ValueError as error:
        raise InputError(str(error), "norm") from None
    if (accuracy is None) == (budget is None):
        raise InputError("give either an accuracy or a budget", "accuracy")
    for name, value in (("accuracy", accuracy), ("budget", budget)):
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise InputError(f"must be a positive number, not {value}", name)
    if max_unknowns < 1:
        raise InputError(f"must be positive, not {max_unknowns}", "max_unknowns")


def _calibrate(trials: Trials, seconds: float = math.inf) -> None:
    """Run all kinds on coarse meshes, the most promising first, as long as the seconds last."""
    for kind in (GRADED_P2, UNIFORM_P2, GRADED_P1, UNIFORM_P1):
        if not kind.suits(trials.family.dimension):
            continue
        first = Configuration(kind, trials.sizes[0])
        solve_configuration(trials.comm, trials.family, first).destroy()  # compiles the forms
        for n in trials.sizes:
            run, trial = trials.run(Configuration(kind, n))
            run.destroy()
            seconds -= trial.seconds
            if seconds < 0.0:
                return


def _reach(trials: Trials, accuracy: float, max_unknowns: int) -> _Answer:
    """Refine until the error is at most the accuracy; coarsen where it is less than half of it."""
    loosest: dict[Kind, float] = {}
    found: _Answer | None = None
    for _ in range(ATTEMPTS):
        choices = [_choice(model, accuracy) for model in trials.models().values()]
        feasible = [choice for choice in choices if choice.unknowns <= max_unknowns]
        if found is not None:
            # Meshes that are too accurate, or would cost clearly more, are no candidates.
            most = 1.5 * found[0].total_seconds
            feasible = [c for c in feasible if c.error >= 0.5 * accuracy and c.seconds <= most]
        if not feasible:
            break
        choice = min(feasible, key=lambda c: (c.seconds, c.unknowns))
        c = choice.configuration
        if c.kind not in loosest:
            loosest[c.kind] = _loosest_error(trials, replace(c, n=trials.sizes[-1]))
        share = ALGEBRAIC * accuracy / max(loosest[c.kind], 1e-300)
        c = replace(c, rtol=max(LOOSEST * min(1.0, share), TIGHT))
        model = trials.models()[c.kind]
        largest = rounded(STEP * model.trials[-1].configuration.n, c.kind.graded)
        step = replace(c, n=min(c.n, largest))
        predicted, (run, trial) = model.predicted(step), trials.run(step)
        if trial.error > accuracy or (step != c and trial.error < 0.5 * accuracy):
            run.destroy()
            continue
        if found is not None:
            found[0].destroy()
        found = run, trial, predicted
        if trial.error >= 0.5 * accuracy:
            break
    if found is None:
        raise InputError(_refusal(trials, accuracy, max_unknowns), "accuracy")
    return found


def _choice(model: Model, accuracy: float) -> Choice:
    """The mesh of a kind for an accuracy: a mesh that was measured to fit, or an untried one."""
    c = model.trials[-1].configuration
    tried = {trial.configuration.n: trial.error for trial in model.trials}
    fitting = [n for n, error in tried.items() if 0.5 * accuracy <= error <= accuracy]
    n = rounded(min(max(model.cells(AIM * accuracy), 2.0), 1e7), c.kind.graded)
    while tried.get(n, 0.0) > accuracy:
        n = rounded(n + 1, c.kind.graded)
    return model.predicted(replace(c, n=min([n, *fitting])))


def _spend(trials: Trials, budget: float, max_unknowns: int) -> _Answer:
    """Run the configuration that is predicted to be the most accurate in the time left."""
    spent = sum(trial.seconds for trial in trials.done)
    left = (budget - spent) / RESERVE
    best = min(trials.done, key=lambda trial: trial.error)
    if left < best.seconds:
        raise InputError(
            f"{budget:g} s are too few: coarse runs of this problem took {spent:.2g} s, and the "
            f"best of them, {best.configuration}, takes {best.seconds:.2g} s more for an error of "
            f"{best.error:.2g} in {trials.norm}",
            "budget",
        )
    choices = [Choice(best.configuration, best.error, best.seconds, best.unknowns)]
    for model in trials.models().values():
        c = model.trials[-1].configuration
        most = c.n * (max_unknowns / model.trials[-1].unknowns) ** (1.0 / model.dimension)
        wanted = min(model.cells_within(left), most)
        n = rounded(wanted, c.kind.graded)
        while n > 4 and (model.seconds(n) > left or model.unknowns(n) > max_unknowns):
            wanted *= 0.95
            n = rounded(wanted, c.kind.graded)
        choices.append(model.predicted(replace(c, n=n)))
    choice = min(choices, key=lambda c: (c.error, c.seconds))
    return (*trials.run(choice.configuration), choice)


def _loosest_error(trials: Trials, configuration: Configuration) -> float:
    """The algebraic error of the loosest tolerance on a coarse mesh."""
    loose = solve_configuration(trials.comm, trials.family, replace(configuration, rtol=LOOSEST))
    error = algebraic_errors(loose, [trials.norm])[trials.norm]
    loose.destroy()
    return error


def _refusal(trials: Trials, accuracy: float, max_unknowns: int) -> str:
    """The message about an accuracy that is out of reach."""
    reachable = []
    for model in trials.models().values():
        c = model.trials[-1].configuration
        n = c.n * (max_unknowns / model.trials[-1].unknowns) ** (1.0 / model.dimension)
        reachable.append(model.predicted(replace(c, n=int(n))))
    best = min(reachable, key=lambda choice: choice.error)
    measured = min(trials.done, key=lambda trial: trial.error)
    return (
        f"{accuracy:g} in {trials.norm} is out of reach with {max_unknowns} unknowns; "
        f"the best would be {best.configuration}, with an error of about {best.error:.2g} after "
        f"about {best.seconds:.2g} s; measured so far: {measured.error:.2g} with "
        f"{measured.configuration} in {measured.seconds:.2g} s"
    )
