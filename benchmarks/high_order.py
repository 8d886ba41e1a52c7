"""What degree pays: the paper's scene in degrees 2 to 4 on adapted meshes.

    ./with-dolfinx python3 benchmarks/high_order.py equal    # against P1 with N = 1001, in turn
    ./with-dolfinx python3 benchmarks/high_order.py reach    # how small errors can be made
    ./with-dolfinx python3 benchmarks/high_order.py unknowns # beside those of the best meshes

All times are from nothing to the solution, after a run that compiles the forms. True errors are
those of the exact solution, which the adaptive loop is not told; sup norms are maxima. The best
meshes were marked by the true error, with another code and the contact set known. Orders by degree
and mesh, with diagrams: `dolfinx-signorini tradeoff`.
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
from dolfinx_signorini.studies.paper.solution import paper_problem

COMM = MPI.COMM_WORLD
FIRST = 4  # squares per side of the first mesh of the adaptive loop
N = 1001
# Errors of uniform P1 with N = 1001; in sup norms those that the paper samples, a little less.
EQUAL = {"L4": 6.0e-6, "Linf": 6.7e-5, "W1_4": 1.34e-2, "W1_inf": 0.344}
REACH = {"L4": (1e-6, 1e-7, 1e-8, 1e-9), "Linf": (1e-6, 1e-7, 1e-8), "W1_inf": (1e-2, 1e-3)}
BEST = {  # unknowns of degrees 2, 3 and 4; None where only a lower limit is known
    ("L4", 6e-6): (14_460, 5_512, 3_661),
    ("L4", 1e-7): (None, 34_735, 15_659),
    ("Linf", 6.7e-5): (9_958, 4_996, 2_903),
    ("Linf", 1e-6): (None, 32_857, 14_011),
    ("W1_4", 1e-3): (56_899, 8_215, 4_675),
    ("W1_inf", 1e-2): (38_460, 9_739, None),
    ("H1", 1e-4): (None, 24_205, 9_039),
}

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


def adapted(degree: int, norm: str, accuracy: float, read_data: bool = True) -> Solved:
    """Solve on adapted meshes, to an accuracy."""
    posed: list[ManufacturedSolution] = []

    def pose(sided: SidedMesh) -> SignoriniProblem:
        posed[:] = [christof_haubner(sided.mesh)]
        return paper_problem(posed[0], degree)

    first = SidedMesh(friedrichs_keller(COMM, FIRST), {})
    found = solve_adaptively(pose, first, norm=norm, accuracy=accuracy, read_data=read_data)
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
            _, _, unread, _ = measured(partial(adapted, degree, norm, error, False), norm)
            ratios = seconds, other / seconds, unread, other / unread, alone, other / alone
            yield [norm, peer, f"P{degree}", unknowns, found, *ratios]


def reach() -> Iterator[Row]:
    """Unknowns and seconds for ever smaller errors in degree 4."""
    for norm, accuracies in REACH.items():
        for accuracy in accuracies:
            measured(partial(adapted, 4, norm, accuracy), norm)
            yield [norm, accuracy, *measured(partial(adapted, 4, norm, accuracy), norm)]


def unknowns() -> Iterator[Row]:
    """The unknowns of the loop beside those of the best meshes of the same degree."""
    for (norm, accuracy), counts in BEST.items():
        for degree, best in zip((2, 3, 4), counts, strict=True):
            if best is not None:
                problem, exact = adapted(degree, norm, accuracy)
                error, count = error_norms(problem.u, exact, [norm])[norm], problem.unknowns
                problem.destroy()
                yield [norm, accuracy, f"P{degree}", count, best, count / best, error / accuracy]


PARTS: dict[str, Part] = {
    "equal": (
        equal,
        [
            *("norm", "error of P1", "adapted", "unknowns", "true error", "s", "times as fast"),
            *("data not read s", "times as fast"),
            *("last solve alone s", "times as fast"),
        ],
    ),
    "reach": (reach, ["norm", "asked", "unknowns", "true error", "s", "last solve alone s"]),
    "unknowns": (
        unknowns,
        ["norm", "asked", "adapted", "unknowns", "best mesh", "ratio", "true error over asked"],
    ),
}

if __name__ == "__main__":
    run_part(COMM, "high_order", __doc__, PARTS)
