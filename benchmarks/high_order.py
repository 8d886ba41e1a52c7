"""What degree pays: the paper's scene in degrees 2 to 4 on adapted meshes.

    ./with-dolfinx python3 benchmarks/high_order.py equal    # against P1 with N = 1001, in turn
    ./with-dolfinx python3 benchmarks/high_order.py reach    # how small errors can be made

All times are from nothing to the solution, after a run that compiles the forms. True errors are
those of the exact solution, which the adaptive loop is not told; sup norms are maxima. Orders by
degree and mesh, with diagrams: `dolfinx-signorini tradeoff`.
"""

from collections.abc import Callable, Iterator
from functools import partial

from common import Part, Row, run_part, timed
from mpi4py import MPI

from dolfinx_signorini import (
    ManufacturedSolution,
    SidedMesh,
    SignoriniProblem,
    christof_haubner,
    coarse_levels,
    error_norms,
    friedrichs_keller,
    solve_adaptively,
    solve_cascade,
)
from dolfinx_signorini.paper.solution import paper_problem

COMM = MPI.COMM_WORLD
FIRST = 4  # squares per side of the first mesh of the adaptive loop
N = 1001
# Errors of uniform P1 with N = 1001; in sup norms those that the paper samples, a little less.
EQUAL = {"L4": 6.0e-6, "Linf": 6.7e-5, "W1_4": 1.34e-2, "W1_inf": 0.344}
REACH = {"L4": (1e-6, 1e-7, 1e-8, 1e-9), "Linf": (1e-6, 1e-7, 1e-8), "W1_inf": (1e-2, 1e-3)}

Solved = tuple[SignoriniProblem, ManufacturedSolution]


def uniform(degree: int, n: int) -> Solved:
    """Solve on a uniform mesh, by the cascade."""
    posed: list[Solved] = []

    def pose(level: int) -> SignoriniProblem:
        exact = christof_haubner(friedrichs_keller(COMM, level))
        posed[:] = [(paper_problem(exact, degree), exact)]
        return posed[0][0]

    solve_cascade(lambda level, _: pose(level), [*coarse_levels(n), n])
    return posed[0]


def adapted(degree: int, norm: str, accuracy: float) -> Solved:
    """Solve on adapted meshes, to an accuracy."""
    posed: list[ManufacturedSolution] = []

    def pose(sided: SidedMesh) -> SignoriniProblem:
        posed[:] = [christof_haubner(sided.mesh)]
        return paper_problem(posed[0], degree)

    first = SidedMesh(friedrichs_keller(COMM, FIRST), {})
    found = solve_adaptively(pose, first, norm=norm, accuracy=accuracy)
    return found.problem, posed[0]


def measured(solve: Callable[[], Solved], norm: str) -> tuple[int, float, float, float]:
    """Return unknowns, the true error, and the seconds of the solution from nothing.

    The last number is the seconds of posing the last problem again on its mesh, and of solving the
    problem with the contact state at hand: no loop takes less time to its answer.
    """
    seconds, (problem, exact) = timed(COMM, solve)
    error = error_norms(problem.u, exact, [norm])[norm]
    degree = problem.space.element.basix_element.degree

    def again() -> SignoriniProblem:
        last = paper_problem(christof_haubner(problem.space.mesh), degree)
        last.solve(coarse=problem.contact_state())
        return last

    alone, last = timed(COMM, again)
    result = problem.unknowns, error, seconds, alone
    problem.destroy()
    last.destroy()
    return result


def equal() -> Iterator[Row]:
    """Seconds for the errors of uniform P1 with N = 1001, beside its own."""
    for norm, error in EQUAL.items():
        for degree in (2, 3, 4):
            measured(partial(adapted, degree, norm, error), norm)  # compiles the forms
            unknowns, found, seconds, alone = measured(partial(adapted, degree, norm, error), norm)
            _, peer, other, _ = measured(partial(uniform, 1, N), norm)
            ratios = seconds, other / seconds, alone, other / alone
            yield [norm, peer, f"P{degree}", unknowns, found, *ratios]


def reach() -> Iterator[Row]:
    """Unknowns and seconds for ever smaller errors in degree 4."""
    for norm, accuracies in REACH.items():
        for accuracy in accuracies:
            measured(partial(adapted, 4, norm, accuracy), norm)
            yield [norm, accuracy, *measured(partial(adapted, 4, norm, accuracy), norm)]


PARTS: dict[str, Part] = {
    "equal": (
        equal,
        [
            *("norm", "error of P1", "adapted", "unknowns", "true error", "s", "times as fast"),
            *("last solve alone s", "times as fast"),
        ],
    ),
    "reach": (reach, ["norm", "asked", "unknowns", "true error", "s", "last solve alone s"]),
}

if __name__ == "__main__":
    run_part(COMM, "high_order", __doc__, PARTS)
