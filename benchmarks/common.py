"""What the benchmarks share: three scenes, one plain linear solve, medians, and a JSON file.

Times are wall-clock seconds, the largest over the ranks, after a warm-up that compiles all forms.
"""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini import SignoriniProblem, christof_haubner, friedrichs_keller, paper_problem
from dolfinx_signorini.meshes import boundary_facets
from dolfinx_signorini.paper.study import coarse_levels
from dolfinx_signorini.records import versions
from dolfinx_signorini.solvers.active_set import DEFAULT_OPTIONS, LINEAR_FRACTION
from dolfinx_signorini.solvers.cascade import solve_contact
from dolfinx_signorini.solvers.pressure import ContactState
from dolfinx_signorini.solvers.residual import SolveResult

RESULTS = Path(__file__).parent / "results"


def paper(comm: MPI.Comm, n: int) -> SignoriniProblem:
    """The paper's problem: on most of the contact set the pressure is zero."""
    return paper_problem(christof_haubner(friedrichs_keller(comm, n)))


def pressed(comm: MPI.Comm, n: int) -> SignoriniProblem:
    """A load that presses a third of the boundary down hard, and lifts the rest."""
    return _square(comm, n, load=lambda x: 40.0 * (0.35 - x[0] + 0.2 * x[1]), obstacle=0.0)


def wavy(comm: MPI.Comm, n: int) -> SignoriniProblem:
    """A wavy obstacle under a uniform load: half of the boundary in contact, in several arcs."""
    return _square(
        comm,
        n,
        load=lambda x: -4.0 + 0.0 * x[0],
        obstacle=lambda x: 0.3 * np.cos(3.0 * np.pi * x[0]) * np.cos(2.0 * np.pi * x[1]),
    )


SCENES: dict[str, Callable[[MPI.Comm, int], SignoriniProblem]] = {
    "paper": paper,
    "pressed": pressed,
    "wavy": wavy,
}


def _square(
    comm: MPI.Comm, n: int, load: Callable[[Any], Any], obstacle: float | Callable[[Any], Any]
) -> SignoriniProblem:
    domain = friedrichs_keller(comm, n)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    right = load(x) * v * ufl.dx(metadata={"quadrature_degree": 3})
    return SignoriniProblem(a, right, contact=boundary_facets(domain), obstacle=obstacle)


def timed(comm: MPI.Comm, action: Callable[..., Any], *args: Any) -> tuple[float, Any]:
    """Return the seconds of a call, the largest over the ranks, and what it returned."""
    comm.barrier()
    start = time.perf_counter()
    value = action(*args)
    return comm.allreduce(time.perf_counter() - start, op=MPI.MAX), value


def linear_solve(problem: SignoriniProblem, rtol: float, tuned: bool = False) -> int:
    """Solve A x = b by CG with BoomerAMG from zero, and return the iterations.

    The relative residual is the one that the contact solve asks of its linear solves. BoomerAMG
    runs as PETSc sets it up, or tuned: as the contact solve does.
    """
    x = problem.A.createVecRight()
    ksp = PETSc.KSP().create(problem.comm)
    ksp.setOptionsPrefix("benchmark_")
    database = PETSc.Options()
    settings = DEFAULT_OPTIONS if tuned else {"ksp_type": "cg", "pc_type": "hypre"}
    for key, value in settings.items():
        database["benchmark_" + key] = value
    ksp.setFromOptions()
    for key in settings:
        database.delValue("benchmark_" + key)
    ksp.setOperators(problem.A)
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    ksp.setTolerances(rtol=rtol * LINEAR_FRACTION, atol=0.0)
    ksp.solve(problem.b, x)
    iterations = ksp.getIterationNumber()
    ksp.destroy()
    x.destroy()
    return int(iterations)


def coarse_state(
    comm: MPI.Comm, scene: str, n: int, rtol: float
) -> tuple[ContactState | None, list[int]]:
    """Solve all levels below n, and return the last one's contact state and their solves."""
    state, solves = None, []
    for level in coarse_levels(n):
        problem = SCENES[scene](comm, level)
        result = solve_contact(problem, state, rtol=rtol)
        state = problem.contact_state(result.u)
        problem.destroy()
        solves.append(result.linear_solves)
    return state, solves


def contact_solve(
    problem: SignoriniProblem, scene: str, n: int, rtol: float
) -> tuple[SolveResult, list[int]]:
    """Solve by the cascade: mesh, assembly and solve of all coarse levels, solve of the finest."""
    state, solves = coarse_state(problem.comm, scene, n, rtol)
    result = solve_contact(problem, state, rtol=rtol)
    return result, [*solves, result.linear_solves]


def child(*arguments: str, ranks: int = 0) -> dict[str, Any] | None:
    """Run a Python script in a process of its own, and return the JSON of its last line.

    Args:
        arguments: The script, and its arguments.
        ranks: Run it under mpirun with so many ranks; 0 for without.

    Returns:
        What it printed; None where its alarm clock ended it.
    """
    launcher = ["mpirun", "-n", str(ranks)] if ranks else []
    done = subprocess.run(
        [*launcher, sys.executable, *arguments], stdout=subprocess.PIPE, text=True
    )
    if done.returncode == -signal.SIGALRM:
        return None
    if done.returncode:
        raise SystemExit(f"{' '.join(arguments)}: exit code {done.returncode}")
    return dict(json.loads(done.stdout.splitlines()[-1]))


def spread(values: Sequence[float]) -> dict[str, float]:
    """Return minimum, median and maximum."""
    return {"min": min(values), "median": median(values), "max": max(values)}


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return a table for the terminal."""
    cells = [list(columns)] + [
        [f"{cell:.3g}" if isinstance(cell, float) else str(cell) for cell in row] for row in rows
    ]
    widths = [max(len(line[i]) for line in cells) for i in range(len(columns))]
    lines = ["  ".join(c.rjust(w) for c, w in zip(line, widths, strict=True)) for line in cells]
    return "\n".join([title, lines[0], "-" * len(lines[0]), *lines[1:], ""])


def write_json(comm: MPI.Comm, name: str, content: Mapping[str, Any]) -> None:
    """Write results to a JSON file in the results folder, on rank 0."""
    if comm.rank == 0:
        RESULTS.mkdir(exist_ok=True)
        text = json.dumps({"versions": versions(), "ranks": comm.size} | dict(content), indent=1)
        (RESULTS / f"{name}.json").write_text(text + "\n")
