"""The runs of a search, with errors against the exact solution or a finer one."""

from collections.abc import Callable

from mpi4py import MPI

from dolfinx_signorini.accuracy.family import Family
from dolfinx_signorini.accuracy.kinds import GRADED_P2, UNIFORM_P2, Kind
from dolfinx_signorini.accuracy.model import Model, Trial, rounded
from dolfinx_signorini.accuracy.runs import (
    Configuration,
    Run,
    exact_solution,
    solve_configuration,
)
from dolfinx_signorini.norms import error_norms, parse_norm

CALIBRATION = {2: (10, 16, 26), 3: (3, 5, 8)}  # cells across of the coarse runs, by dimension


class Trials:
    """The runs of a search so far:

        trials = Trials(comm, family, "L4", print)
        run, trial = trials.run(Configuration(UNIFORM_P1, 16))

    Args:
        comm: The communicator that shares the meshes.
        family: The problem.
        norm: The norm of the errors.
        on_trial: Called with every run when the run is done.

    Attributes:
        done: The runs so far, in their order.
        sizes: Cells across of the coarse runs that a search begins with.
    """

    def __init__(
        self, comm: MPI.Comm, family: Family, norm: str, on_trial: Callable[[Trial], None]
    ):
        self.comm, self.family, self.norm, self.on_trial = comm, family, norm, on_trial
        self.done: list[Trial] = []
        self.sizes = CALIBRATION[family.dimension]
        self._reference: Run | None = None

    def run(self, configuration: Configuration) -> tuple[Run, Trial]:
        """Run a configuration and measure its error."""
        run = solve_configuration(self.comm, self.family, configuration)
        enlarge = 1.0
        if run.posed.exact is None:
            enlarge = self._refer(configuration)
        exact = exact_solution(run, self._reference)
        error = enlarge * error_norms(run.u, exact, [self.norm])[self.norm]
        trial = Trial(configuration, run.unknowns, run.total_seconds, error)
        self.done.append(trial)
        self.on_trial(trial)
        return run, trial

    def models(self) -> dict[Kind, Model]:
        """Return a model of every kind that was run, from the last run of each mesh."""
        kinds: dict[Kind, dict[int, Trial]] = {}
        for trial in self.done:
            c = trial.configuration
            kinds.setdefault(c.kind, {})[c.n] = trial
        return {
            kind: Model(tuple(found[n] for n in sorted(found)), self.family.dimension)
            for kind, found in kinds.items()
        }

    def destroy(self) -> None:
        """Free the PETSc objects of the reference solution."""
        if self._reference is not None:
            self._reference.destroy()

    def _refer(self, configuration: Configuration) -> float:
        """Make a reference solution if there is none fine enough; return a factor for errors.

        The factor enlarges the difference to the reference solution by the share of the error
        that the reference solution has itself.
        """
        kind = GRADED_P2 if GRADED_P2.suits(self.family.dimension) else UNIFORM_P2
        degree = configuration.kind.degree
        n = max(configuration.n * degree, 2 * self.sizes[-1])
        if self._reference is None or self._reference.configuration.n < n:
            self.destroy()
            finer = Configuration(kind, rounded(n, kind.graded))
            self._reference = solve_configuration(self.comm, self.family, finer)
        if degree == 1:
            return 1.0
        # The expected order of P2, less a half.
        order = (2.5 if kind.graded else 1.5) - parse_norm(self.norm).derivatives
        return 1.0 / (1.0 - (configuration.n / self._reference.configuration.n) ** order)
