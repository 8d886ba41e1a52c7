"""Predictions of error and time for one kind of mesh and elements, fitted to earlier runs."""

import math
from dataclasses import dataclass

import numpy as np

from dolfinx_signorini.accuracy.runs import Configuration

SLOWEST = 0.2  # the lowest order of convergence that a prediction assumes


@dataclass(frozen=True)
class Trial:
    """Cost and error of one run:

        Trial(run.configuration, run.unknowns, run.total_seconds, error)

    Attributes:
        configuration: The configuration of the run.
        unknowns: The number of dofs.
        seconds: Wall-clock seconds, all levels included.
        error: The error in the norm asked for.
    """

    configuration: Configuration
    unknowns: int
    seconds: float
    error: float


@dataclass(frozen=True)
class Choice:
    """A configuration with predictions for its run:

        choice = model.predicted(Configuration(UNIFORM_P1, 200))

    Attributes:
        configuration: The configuration.
        error: The predicted error in the norm asked for.
        seconds: The predicted wall-clock seconds.
        unknowns: The predicted number of dofs.
    """

    configuration: Configuration
    error: float
    seconds: float
    unknowns: float


@dataclass(frozen=True)
class Model:
    """Error, unknowns and seconds of one kind of mesh and elements, as functions of cells across:

        Model(trials, dimension=2).error(200)

    Attributes:
        trials: Runs of this kind with different numbers of cells across, increasing.
        dimension: The dimension of space.
    """

    trials: tuple[Trial, ...]
    dimension: int

    def order(self, n: float) -> float:
        """Return the order of convergence near n cells across."""
        m = [trial.configuration.n for trial in self.trials]
        if len(m) == 1:
            return 1.0
        i = min(int(np.searchsorted(m, n)), len(m) - 1)
        i = max(i, 1)
        first = max(i - 2, 0) if i == len(m) - 1 and n > m[-1] and len(m) == 3 else i - 1
        errors = [max(self.trials[k].error, 1e-300) for k in (first, i)]
        return max(SLOWEST, math.log(errors[0] / errors[1]) / math.log(m[i] / m[first]))

    def error(self, n: float) -> float:
        """Return the error predicted for n cells across."""
        near = min(self.trials, key=lambda trial: abs(math.log(trial.configuration.n / n)))
        return near.error * (n / near.configuration.n) ** -self.order(n)

    def cells(self, error: float) -> float:
        """Return the cells across that are predicted to give an error."""
        below = [trial for trial in self.trials if trial.error <= error]
        near = below[0] if below else self.trials[-1]
        edge = near.configuration.n * (1.0 - 1e-9 if below else 1.0 + 1e-9)
        try:
            return near.configuration.n * (near.error / error) ** (1.0 / self.order(edge))
        except OverflowError:
            return math.inf

    def unknowns(self, n: float) -> float:
        """Return the number of dofs predicted for n cells across."""
        last = self.trials[-1]
        return last.unknowns * (n / last.configuration.n) ** self.dimension

    def seconds(self, n: float) -> float:
        """Return the seconds predicted for n cells across, linear in the number of dofs.

        The prediction is at most the time of any run on a finer mesh, because times vary and
        depend little on the number of dofs of small problems.
        """
        last = self.trials[-1]
        slope = last.seconds / last.unknowns
        if len(self.trials) > 1:
            before = self.trials[-2]
            rise = (last.seconds - before.seconds) / (last.unknowns - before.unknowns)
            slope = max(rise, 0.2 * slope)
        shortest = min(trial.seconds for trial in self.trials)
        finer = (trial.seconds for trial in self.trials if trial.configuration.n >= n)
        linear = last.seconds + slope * (self.unknowns(n) - last.unknowns)
        return min([max(linear, 0.5 * shortest), *finer])

    def predicted(self, configuration: Configuration) -> Choice:
        """Return a configuration of this kind with the predictions for its run."""
        n = configuration.n
        return Choice(configuration, self.error(n), self.seconds(n), self.unknowns(n))

    def cells_within(self, seconds: float) -> float:
        """Return the cells across for which a time in seconds is predicted."""
        last = self.trials[-1]
        per_dof = (self.seconds(2 * last.configuration.n) - last.seconds) / (
            (2**self.dimension - 1) * last.unknowns
        )
        unknowns = max(last.unknowns + (seconds - last.seconds) / per_dof, 1.0)
        return last.configuration.n * float(unknowns / last.unknowns) ** (1.0 / self.dimension)


def rounded(n: float, graded: bool) -> int:
    """Return a number of cells across that suits a mesh, the next one from n on.

    Uniform meshes have even numbers, so that a detachment point lies in the cells of all of them
    in the same way. All cells of a graded mesh are halved in the end, as often as the number of
    cells across can be divided by 2.

    Args:
        n: The cells across that are wanted.
        graded: Whether the mesh is graded.
    """
    unit = 1 if graded and n < 16 else 2
    while graded and unit < n / 20:
        unit *= 2
    return max(unit * math.ceil(n / unit - 1e-9), 2)
