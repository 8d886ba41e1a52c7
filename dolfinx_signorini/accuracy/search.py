"""One dial: an accuracy, or a time, in place of mesh, degree and tolerance.

Cheap coarse runs of the problem at hand, with every kind of mesh and elements, tell how its error
and its time depend on the number of cells. The kind that is predicted to be the cheapest is
refined in steps, each of which corrects the prediction, until the error measured is the one asked
for. Where the solution is not known, the error is measured against a finer solution and enlarged
by what that is estimated to lack itself.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.accuracy.family import Family
from dolfinx_signorini.accuracy.model import Choice, Model, Trial, rounded
from dolfinx_signorini.accuracy.runs import (
    Configuration,
    Run,
    exact_solution,
    solve_configuration,
)
from dolfinx_signorini.errors import InputError
from dolfinx_signorini.norms import error_norms, parse_norm

CALIBRATION = (10, 16, 26)  # cells across of the coarse runs
CALIBRATION_3D = (3, 5, 8)
AIM = 0.72  # of the accuracy asked for: as far from it as from its half
STEP = 3  # from one mesh to the next at the most, in cells across
ATTEMPTS = 12
MAX_UNKNOWNS = 1_000_000
RTOL = 1e-5  # the loosest tolerance
ALGEBRAIC = 0.01  # of the accuracy is left to the algebraic error
TIGHT = 1e-10
RESERVE = 1.3  # how much longer than predicted a run may take
TRIALS = 0.3  # of a budget goes into coarse runs at the most


@dataclass(frozen=True)
class Outcome:
    """A solution of the accuracy asked for.

    Attributes:
        run: The solution with its problem.
        norm: The norm.
        accuracy, budget: Which of the two was asked for, and how much.
        error: Its error in this norm.
        predicted: What was expected of the run.
        trials: All runs, in their order, this one included; it need not be the last.
        estimated: Whether errors are against finer solutions, for want of a known one.
        seconds: Wall-clock seconds of everything.
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


@dataclass
class _Search:
    """The runs so far, and what they were measured against."""

    comm: MPI.Comm
    family: Family
    norm: str
    on_trial: Callable[[Trial], None]
    trials: list[Trial] = field(default_factory=list)
    reference: Run | None = None

    @property
    def sizes(self) -> tuple[int, ...]:
        return CALIBRATION if self.family.dimension == 2 else CALIBRATION_3D

    def run(self, configuration: Configuration) -> tuple[Run, Trial]:
        run = solve_configuration(self.comm, self.family, configuration)
        enlarge = 1.0
        if run.posed.exact is None:
            enlarge = self._refer(configuration)
        error = (
            enlarge
            * error_norms(run.u, exact_solution(run, self.reference), [self.norm])[self.norm]
        )
        trial = Trial(configuration, run.unknowns, run.total_seconds, error)
        self.trials.append(trial)
        self.on_trial(trial)
        return run, trial

    def models(self) -> dict[tuple[bool, int], Model]:
        kinds: dict[tuple[bool, int], dict[int, Trial]] = {}
        for trial in self.trials:
            c = trial.configuration
            kinds.setdefault((c.graded, c.degree), {})[c.n] = trial
        return {
            kind: Model(tuple(found[n] for n in sorted(found)), self.family.dimension)
            for kind, found in kinds.items()
        }

    def _refer(self, configuration: Configuration) -> float:
        """Make a finer solution if there is none; return how much of the error it may hide."""
        n = configuration.n * (2 if configuration.degree == 2 else 1)
        n = max(n, 2 * self.sizes[-1])
        graded = self.family.dimension == 2
        if self.reference is None or self.reference.configuration.n < n:
            if self.reference is not None:
                self.reference.destroy()
            finer = Configuration(graded, rounded(n, graded), degree=2)
            self.reference = solve_configuration(self.comm, self.family, finer)
        if configuration.degree == 1:
            return 1.0
        # The order that is to be expected of P2, less a half.
        order = (2.5 if graded else 1.5) - parse_norm(self.norm).derivatives
        return 1.0 / (1.0 - (configuration.n / self.reference.configuration.n) ** order)

    def destroy(self) -> None:
        if self.reference is not None:
            self.reference.destroy()


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
        accuracy: The largest error, in the unit of the norm; the one reached is normally not
            smaller than half of it.
        budget: In place of an accuracy, wall-clock seconds for the coarse runs and the solution.
            Compilation, with the first run of each kind that does it, and the evaluation of errors
            are not counted.
        max_unknowns: Limit on the dofs, as predicted. Coarse runs, of some thousand dofs, are made
            in any case.
        on_trial: Is told of every run when it is done.

    Raises:
        InputError: An argument makes no sense, or the request is out of reach; the message says
            what the best would be.
    """
    began = time.perf_counter()
    _check(norm, accuracy, budget, max_unknowns)
    search = _Search(comm, family, norm, on_trial)
    try:
        if accuracy is not None:
            _calibrate(search)
            run, trial, predicted = _reach(search, accuracy, max_unknowns)
        else:
            assert budget is not None
            _calibrate(search, TRIALS * budget)
            run, trial, predicted = _spend(search, budget, max_unknowns)
    finally:
        search.destroy()
    return Outcome(
        run=run,
        norm=norm,
        accuracy=accuracy,
        budget=budget,
        error=trial.error,
        predicted=predicted,
        trials=tuple(search.trials),
        estimated=run.posed.exact is None,
        seconds=comm.bcast(time.perf_counter() - began),
    )


def _check(norm: str, accuracy: float | None, budget: float | None, max_unknowns: int) -> None:
    try:
        parse_norm(norm)
    except ValueError as error:
        raise InputError(f"norm: {error}") from None
    if (accuracy is None) == (budget is None):
        raise InputError("accuracy: give either an accuracy or a budget")
    for name, value in (("accuracy", accuracy), ("budget", budget)):
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise InputError(f"{name}: must be a positive number, not {value}")
    if max_unknowns < 1:
        raise InputError(f"max_unknowns: must be positive, not {max_unknowns}")


def _calibrate(search: _Search, seconds: float = math.inf) -> None:
    """Run all kinds on coarse meshes, the most promising first, as long as the seconds last."""
    for graded, degree in ((True, 2), (False, 2), (True, 1), (False, 1)):
        if graded and search.family.dimension != 2:
            continue
        kind = Configuration(graded, search.sizes[0], degree)
        solve_configuration(search.comm, search.family, kind).destroy()  # compiles the forms
        for n in search.sizes:
            run, trial = search.run(replace(kind, n=n))
            run.destroy()
            seconds -= trial.seconds
            if seconds < 0.0:
                return


def _reach(search: _Search, accuracy: float, max_unknowns: int) -> _Answer:
    """Refine until the error is the one asked for; coarsen where it is less than half of that."""
    loosest: dict[tuple[bool, int], float] = {}
    found: _Answer | None = None
    for _ in range(ATTEMPTS):
        choices = [_choice(model, accuracy) for model in search.models().values()]
        feasible = [choice for choice in choices if choice.unknowns <= max_unknowns]
        if found is not None:
            # What is known to be too accurate is out, and what would cost clearly more.
            most = 1.5 * found[0].total_seconds
            feasible = [c for c in feasible if c.error >= 0.5 * accuracy and c.seconds <= most]
        if not feasible:
            break
        choice = min(feasible, key=lambda c: (c.seconds, c.unknowns))
        c = choice.configuration
        kind = (c.graded, c.degree)
        if kind not in loosest:
            loosest[kind] = _algebraic_error(search, replace(c, n=search.sizes[-1]))
        share = ALGEBRAIC * accuracy / max(loosest[kind], 1e-300)
        model = search.models()[kind]
        c = replace(c, rtol=max(RTOL * min(1.0, share), TIGHT))
        step = replace(c, n=min(c.n, rounded(STEP * model.trials[-1].configuration.n, c.graded)))
        predicted = model.predicted(step)
        run, trial = search.run(step)
        if trial.error > accuracy or (step != c and trial.error < 0.5 * accuracy):
            run.destroy()
            continue
        if found is not None:
            found[0].destroy()
        found = run, trial, predicted
        if trial.error >= 0.5 * accuracy:
            break
    if found is None:
        raise InputError(_refusal(search, accuracy, max_unknowns))
    return found


def _choice(model: Model, accuracy: float) -> Choice:
    """The mesh of a kind that an accuracy needs: one known to fit, or none known not to do."""
    c = model.trials[-1].configuration
    tried = {trial.configuration.n: trial.error for trial in model.trials}
    fitting = [n for n, error in tried.items() if 0.5 * accuracy <= error <= accuracy]
    n = rounded(min(max(model.cells(AIM * accuracy), 2.0), 1e7), c.graded)
    while tried.get(n, 0.0) > accuracy:
        n = rounded(n + 1, c.graded)
    return model.predicted(replace(c, n=min([n, *fitting])))


def _spend(search: _Search, budget: float, max_unknowns: int) -> _Answer:
    """Run what is predicted to be the most accurate in the time that is left."""
    spent = sum(trial.seconds for trial in search.trials)
    left = (budget - spent) / RESERVE
    best = min(search.trials, key=lambda trial: trial.error)
    if left < best.seconds:
        raise InputError(
            f"budget: {budget:g} s are too few: coarse runs of this problem took {spent:.2g} s, "
            f"and the best of them, {best.configuration}, takes {best.seconds:.2g} s more for an "
            f"error of {best.error:.2g} in {search.norm}"
        )
    choices = [Choice(best.configuration, best.error, best.seconds, best.unknowns)]
    for model in search.models().values():
        c = model.trials[-1].configuration
        most = c.n * (max_unknowns / model.trials[-1].unknowns) ** (1.0 / model.dimension)
        wanted = min(model.cells_within(left), most)
        n = rounded(wanted, c.graded)
        while n > 4 and (model.seconds(n) > left or model.unknowns(n) > max_unknowns):
            wanted *= 0.95
            n = rounded(wanted, c.graded)
        choices.append(model.predicted(replace(c, n=n)))
    choice = min(choices, key=lambda c: (c.error, c.seconds))
    return (*search.run(choice.configuration), choice)


def _algebraic_error(search: _Search, configuration: Configuration) -> float:
    """The error, in the norm, that the loosest tolerance leaves on a coarse mesh."""
    loose = solve_configuration(search.comm, search.family, replace(configuration, rtol=RTOL))
    problem = loose.posed.problem
    tight = problem.solve(coarse=loose.state, rtol=TIGHT)
    difference = fem.Function(problem.space)
    difference.x.array[:] = tight.u.x.array - loose.result.u.x.array
    loose.destroy()
    return error_norms(difference, None, [search.norm])[search.norm]


def _refusal(search: _Search, accuracy: float, max_unknowns: int) -> str:
    """What to say about an accuracy that is out of reach."""
    reachable = []
    for model in search.models().values():
        c = model.trials[-1].configuration
        n = c.n * (max_unknowns / model.trials[-1].unknowns) ** (1.0 / model.dimension)
        reachable.append(model.predicted(replace(c, n=int(n))))
    best = min(reachable, key=lambda choice: choice.error)
    measured = min(search.trials, key=lambda trial: trial.error)
    return (
        f"accuracy: {accuracy:g} in {search.norm} is out of reach with {max_unknowns} unknowns; "
        f"the best would be {best.configuration}, with an error of about {best.error:.2g} after "
        f"about {best.seconds:.2g} s; measured so far: {measured.error:.2g} with "
        f"{measured.configuration} in {measured.seconds:.2g} s"
    )
