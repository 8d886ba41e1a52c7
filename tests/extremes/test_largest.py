"""Extremes at 512 cells per side by the whole cascade, against solutions that are known in V_h.

For a function w of V_h, an obstacle that touches w where a wave is negative, and forces there, the
load b = A w - forces makes w the solution, whatever the matrix is. No solver is needed to know it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from large import Large, checkerboard, digits_against, owned, posed, rotated, waves
from large_meshes import corner, largest_angle, obtuse, slit, stretched, unit_cube, unit_square

from dolfinx_signorini import coarse_levels, solve_cascade

pytestmark = pytest.mark.slow
RTOL = 1e-11
N = 512


@dataclass(frozen=True)
class Known:
    """A problem on each level of a cascade, with its known solution.

    Attributes:
        topic: Of the row.
        name: Of the row.
        mesh: Makes the mesh of a level.
        data: Of `Large`.
        n: The finest level.
        parts: How many waves the contact has along one side.
        force: The unit of the contact force, next to the width of a cell.
        height: Of the domain.
        alone: Whether the finest level is solved alone, without coarser ones.
        dimension: Of space.
    """

    topic: str
    name: str
    mesh: Any = unit_square
    data: Any = None
    n: int = N
    parts: float = 1.0
    force: float = 1.0
    height: float = 1.0
    alone: bool = False
    dimension: int = 2

    def wave(self, x):
        return np.cos(2.0 * np.pi * self.parts * (x[0] + x[1] / self.height) + 0.3)

    def w(self, x):
        y = x[1] / self.height
        return 0.02 * waves((x[0], y)) + 0.3 * np.sin(3.0 * x[0] + y) * np.cos(2.0 * y)

    def obstacle(self, x):
        return self.w(x) - np.maximum(self.wave(x), 0.0) ** 1.5

    def problem(self, n):
        """The problem of a level, and its solution."""
        problem = Large(self.mesh(n), obstacle=self.obstacle, **(self.data or {})).problem()
        unit = self.force / n ** (self.dimension - 1)
        return problem, posed(
            problem, self.w, lambda x: unit * np.maximum(-self.wave(x), 0.0) ** 0.5
        )


CASES = [
    Known("coefficients", "diffusion 1, reaction 1"),
    Known("coefficients", "diffusion 1e12, reaction 1", data={"diffusion": 1e12}, force=1e12),
    Known("coefficients", "diffusion 1e-12, reaction 1", data={"diffusion": 1e-12}),
    Known("coefficients", "diffusion 1, reaction 1e12", data={"reaction": 1e12}, force=1e10),
    Known("coefficients", "diffusion 1, reaction 1e-12", data={"reaction": 1e-12}),
    *(
        Known(
            "coefficients",
            f"diffusion 1 and {small:g} along axes rotated by 30 degrees",
            data={"diffusion": rotated(small)},
        )
        for small in (1e-3, 1e-6)
    ),
    *(
        Known(
            "coefficients",
            f"a checkerboard of {squares} x {squares} squares, contrast {contrast:g}",
            data={"diffusion": checkerboard(contrast, squares)},
            alone=squares == N,
        )
        for contrast in (1e4, 1e8)
        for squares in (8, N)
    ),
    *(
        Known("shape", f"rectangle of 1 x {height:g}", stretched(height), height=height)
        for height in (1e3, 1e6)
    ),
    Known(
        "shape",
        "30000 random nodes, flattened to a height of 0.1",
        lambda n: obtuse(30000, 0.1),
        force=1.0 / N,
        alone=True,
    ),
    Known(
        "shape",
        "10000 random nodes, flattened to a height of 0.01",
        lambda n: obtuse(10000, 0.01),
        force=1.0 / N,
        alone=True,
    ),
    Known("cells", "degree 2", data={"degree": 2}, n=N // 2),
    Known("cells", "degree 3", data={"degree": 3}, n=170),
    Known("cells", "degree 4", data={"degree": 4}, n=N // 4),
    Known("cells", "the unit cube, degree 1", unit_cube, n=40, dimension=3),
    Known("cells", "the unit cube, degree 2", unit_cube, {"degree": 2}, n=16, dimension=3),
    Known("contact", "200 contact parts", parts=50.0),
    Known("contact", "around a re-entrant corner", corner),
    Known("contact", "around the square and on both faces of a slit", slit),
]


@pytest.mark.parametrize("case", CASES, ids=[case.name for case in CASES])
def test_against_a_known_solution(case, comm, record):
    known = {}

    def make_problem(level, coarser):
        problem, known["solution"] = case.problem(level)
        return problem

    levels = [] if case.alone else coarse_levels(case.n, case.dimension)
    problem = solve_cascade(make_problem, [*levels, case.n], rtol=RTOL)
    digits = digits_against(comm, owned(problem.u), known["solution"])
    result = problem.result
    problem.destroy()
    assert digits >= 7
    assert problem.unknowns > 10_000
    name = case.name
    if "random" in name:
        name += f" (angles to {largest_angle(problem.space.mesh):.1f} degrees)"
    else:
        name += f", N = {case.n}"
    row = f"{name}: {problem.unknowns} unknowns, rtol {RTOL:g}"
    text = (
        f"{digits:.1f} digits, {result.active_dofs} active dofs; "
        f"linear solves {result.linear_solves}, CG iterations {result.linear_iterations}"
    )
    record(case.topic, row, "the known u in V_h", text)
