"""How error and time of one kind of mesh depend on its size, fitted on the runs so far."""

import math
from dataclasses import dataclass

import numpy as np

from dolfinx_signorini.accuracy.runs import Configuration

SLOWEST = 0.2  # the lowest order of convergence that is believed


@dataclass(frozen=True)
class Trial:
    """What one run cost and gave.

    Attributes:
        configuration: The configuration.
        unknowns: Its dofs.
        seconds: Wall-clock seconds, all levels included.
        error: The error in the norm asked for.
    """

    configuration: Configuration
    unknowns: int
    seconds: float
    error: float


@dataclass(frozen=True)
class Choice:
    """A configuration with what is expected of it.

    Attributes:
        configuration: The configuration.
        error, seconds, unknowns: The predictions.
    """

    configuration: Configuration
    error: float
    seconds: float
    unknowns: float


@dataclass(frozen=True)
class Model:
    """How error and time of one kind of mesh and elements depend on the cells across.

    Attributes:
        trials: Runs of this kind with different numbers of cells across, in their order.
        dimension: Of space.
    """

    trials: tuple[Trial, ...]
    dimension: int

    def order(self, n: float) -> float:
        """Return the order of convergence about n cells across."""
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
        """Return the cells across that an error is predicted to need."""
        below = [trial for trial in self.trials if trial.error <= error]
        near = below[0] if below else self.trials[-1]
        edge = near.configuration.n * (1.0 - 1e-9 if below else 1.0 + 1e-9)
        return near.configuration.n * (near.error / error) ** (1.0 / self.order(edge))

    def unknowns(self, n: float) -> float:
        """Return the number of dofs predicted for n cells across."""
        last = self.trials[-1]
        return last.unknowns * (n / last.configuration.n) ** self.dimension

    def seconds(self, n: float) -> float:
        """Return the seconds predicted for n cells across: linear in the number of dofs.

        They are no more than a finer mesh has taken: times vary, and the dofs of small problems
        say little about them.
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
        """Return a configuration of this kind with what is expected of it."""
        n = configuration.n
        return Choice(configuration, self.error(n), self.seconds(n), self.unknowns(n))

    def cells_within(self, seconds: float) -> float:
        """Return the cells across that are predicted to take some seconds."""
        last = self.trials[-1]
        per_dof = (self.seconds(2 * last.configuration.n) - last.seconds) / (
            (2**self.dimension - 1) * last.unknowns
        )
        unknowns = max(last.unknowns + (seconds - last.seconds) / per_dof, 1.0)
        return last.configuration.n * float(unknowns / last.unknowns) ** (1.0 / self.dimension)


def rounded(n: float, graded: bool) -> int:
    """Return the next number of cells across that suits a mesh.

    Uniform ones keep to even numbers: a detachment point then lies in cells in the same way.
    Graded ones are halved as a whole in the end, as often as 2 divides the number.
    """
    unit = 1 if graded and n < 16 else 2
    while graded and unit < n / 20:
        unit *= 2
    return max(unit * math.ceil(n / unit - 1e-9), 2)
