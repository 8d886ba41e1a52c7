"""Solves at many tolerances: where TAO takes a step on what the active set method has accepted.

mpirun -n 3 python3 tests/extremes/one_stop.py 2

The argument k takes every k-th of the tolerances.
"""

import json
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[2])]

import numpy as np  # noqa: E402
from large import Large, checkerboard, posed  # noqa: E402
from large_meshes import unit_square  # noqa: E402
from mpi4py import MPI  # noqa: E402

from dolfinx_signorini import NotConvergedError, SignoriniProblem  # noqa: E402

TOLERANCES = tuple(10.0 ** (-0.5 * k) for k in range(6, 27))  # 1e-3 ... 1e-13


def onset(n: int) -> SignoriniProblem:
    """A biactive half of the boundary."""
    problem = Large(unit_square(n), obstacle=lambda x: 0.0 * x[0]).problem()
    posed(problem, lambda x: np.maximum(x[0] - 0.5, 0.0) ** 2.5, lambda x: 0.0 * x[0])
    return problem


def nearly_balanced(x):
    """A load without reaction that presses with 1e-4 of its size."""
    return np.cos(2.0 * np.pi * x[0]) * np.cos(np.pi * x[1]) - 1e-4


def parts(x):
    """An obstacle of 32 waves."""
    return 0.02 * np.cos(16.0 * np.pi * (x[0] + x[1]))


PROBLEMS: dict[str, Callable[[int], SignoriniProblem]] = {
    "a contrast of 1e6": lambda n: Large(unit_square(n), checkerboard(1e6)).problem(),
    "many contact parts": lambda n: Large(unit_square(n), obstacle=parts).problem(),
    "a biactive half": onset,
    "diffusion 1e4": lambda n: Large(unit_square(n), 1e4).problem(),
    "a load in balance": lambda n: Large(
        unit_square(n), reaction=0.0, load=nearly_balanced, obstacle=lambda x: 0.0 * x[0]
    ).problem(),
    "degree 2": lambda n: Large(unit_square(n // 2), degree=2).problem(),
}


def steps_of_tao(n: int, tolerances: Iterable[float]) -> tuple[int, list[str]]:
    """Solve each problem at each tolerance, each time from nothing.

    Args:
        n: The number of cells per side.
        tolerances: The tolerances.

    Returns:
        The number of solves that reached their tolerance, and those in which TAO took a step.
    """
    count, steps = 0, []
    for name, make in PROBLEMS.items():
        problem = make(n)
        for rtol in tolerances:
            try:
                problem.solve(rtol=rtol, warm_start=False)
            except NotConvergedError:
                continue
            count += 1
            if problem.result.iterations:
                steps.append(f"{name}, rtol {rtol:.1e}: {problem.result.iterations} iterations")
        problem.destroy()
    return count, steps


def main() -> None:
    """Print the counts."""
    count, steps = steps_of_tao(40, TOLERANCES[1 :: int(sys.argv[1])])
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps({"count": count, "steps": steps}))


if __name__ == "__main__":
    main()
