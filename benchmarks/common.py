"""What the benchmarks share: scenes, a plain linear solve, the contact solve, and the report.

Times are wall-clock seconds, the largest over the ranks, after a warm-up that compiles all forms.
"""

import argparse
import ctypes
import json
import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini import (
    ContactState,
    SignoriniProblem,
    boundary_facets,
    christof_haubner,
    coarse_levels,
    friedrichs_keller,
    solve_cascade,
)
from dolfinx_signorini.base.records import versions
from dolfinx_signorini.base.tables import markdown_table, text_table
from dolfinx_signorini.base.timing import Phases
from dolfinx_signorini.problem.signorini import DEFAULT_RTOL
from dolfinx_signorini.solvers.active_set import REACHED
from dolfinx_signorini.solvers.linear.algebraic import DEFAULT_OPTIONS
from dolfinx_signorini.solvers.linear.options import options_set
from dolfinx_signorini.studies.paper.solution import paper_problem

RESULTS = Path(__file__).parent / "results"

Row = list[Any]
Part = tuple[Callable[[], Iterator[Row]], Sequence[str]]  # makes the rows; the heads of the columns


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


def parser(description: str, cells: Any, repeats: int = 5) -> argparse.ArgumentParser:
    """Return a parser of the options that most benchmarks have.

    Args:
        description: The docstring of the benchmark, whose first line is shown.
        cells: The default of --cells, one number or a list of numbers.
        repeats: The default of --repeats.
    """
    options = argparse.ArgumentParser(description=description.splitlines()[0])
    options.add_argument(
        "--cells", type=int, nargs="+" if isinstance(cells, list) else None, default=cells
    )
    options.add_argument("--repeats", type=int, default=repeats)
    return options


def timed(comm: MPI.Comm, action: Callable[..., Any], *args: Any) -> tuple[float, Any]:
    """Return the seconds of a call until the last rank has done it, and what the call returned."""
    phases = Phases(comm)
    with phases("call"):
        value = action(*args)
    return phases.total, value


def heap() -> int:
    """The bytes that this process has in use, as glibc counts them; zero with another C library."""
    try:
        count = ctypes.CDLL("libc.so.6").mallinfo2
    except (OSError, AttributeError):
        return 0

    class Counts(ctypes.Structure):
        _fields_ = [(name, ctypes.c_size_t) for name in "abcdefghij"]

    count.restype = Counts
    found = count()
    return int(found.e + found.h)  # mapped, and in use of what is not mapped


def cg_solve(
    A: PETSc.Mat,
    b: PETSc.Vec,
    options: Mapping[str, Any],
    rtol: float = 1e-8,
    solution: PETSc.Vec | None = None,
) -> tuple[int, float, float, float]:
    """Solve A x = b by CG from zero.

    Args:
        A, b: The matrix and the load.
        options: The options of PETSc.
        rtol: The residual to reach, relative to the load.
        solution: Overwritten by the solution.

    Returns:
        The bytes of the set-up on all ranks, the seconds of the set-up and of the iterations on
        the slowest rank, and the number of iterations, infinite after 1,000.
    """
    x, ksp = A.createVecRight(), PETSc.KSP().create(A.comm)
    ksp.setOptionsPrefix("benchmark_")
    with options_set("benchmark_", {"ksp_type": "cg"} | dict(options)):
        ksp.setOperators(A)
        ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        ksp.setTolerances(rtol=rtol, atol=0.0, max_it=1000)
        ksp.setFromOptions()
        before, start = heap(), time.perf_counter()
        ksp.setUp()
        ready, taken = time.perf_counter(), heap() - before
        ksp.solve(b, x)
        done = time.perf_counter()
    iterations = ksp.getIterationNumber() if ksp.getConvergedReason() > 0 else math.inf
    if solution is not None:
        x.copy(solution)
    for item in (ksp, x):
        item.destroy()
    comm = A.comm.tompi4py()
    seconds = (comm.allreduce(spent, op=MPI.MAX) for spent in (ready - start, done - ready))
    return comm.allreduce(taken), *seconds, iterations


def linear_solve(problem: SignoriniProblem, rtol: float, tuned: bool = False) -> int:
    """Solve A x = b by CG with BoomerAMG from zero, and return the iterations.

    Args:
        problem: The problem, of which matrix and load are used.
        rtol: The tolerance of a contact solve; the relative residual of the linear solve is the
            one that such a contact solve asks of its linear solves.
        tuned: Whether BoomerAMG has the settings of the contact solve, and not those of PETSc.
    """
    options = DEFAULT_OPTIONS if tuned else {"pc_type": "hypre"}
    return int(cg_solve(problem.A, problem.b, options, rtol * REACHED)[-1])


def coarse_state(
    pose: Callable[[int], SignoriniProblem], levels: Sequence[int], rtol: float | None
) -> tuple[ContactState | None, list[int]]:
    """Solve coarse levels, and return the last contact state and each level's linear solves.

    Args:
        pose: Poses the problem on the mesh with so many cells across.
        levels: The cells across, see `coarse_levels`.
        rtol: The tolerance of all levels; None for the default stop.
    """
    solves: list[int] = []
    if not levels:
        return None, solves
    problem = solve_cascade(
        lambda n, _: pose(n),
        levels,
        rtol=rtol,
        on_level=lambda problem: solves.append(problem.result.linear_solves),
    )
    state = problem.contact_state()
    problem.destroy()
    return state, solves


def contact_solve(
    problem: SignoriniProblem,
    pose: Callable[[int], SignoriniProblem],
    n: int,
    rtol: float | None = DEFAULT_RTOL,
) -> list[int]:
    """Solve from nothing: all coarse levels with their meshes and assembly, then the problem.

    Args:
        problem: The problem on the finest mesh.
        pose: Poses the problem on the mesh with so many cells across.
        n: Cells across of the finest mesh.
        rtol: The tolerance of all levels; None for the default stop.

    Returns:
        The linear solves of each level.
    """
    levels = coarse_levels(n, problem.space.mesh.topology.dim)
    state, solves = coarse_state(pose, levels, rtol)
    problem.solve(coarse=state, rtol=rtol, warm_start=False)
    return [*solves, problem.result.linear_solves]


def child(*arguments: str, ranks: int = 0) -> dict[str, Any] | None:
    """Run a Python script in a process of its own, and return the JSON of its last line.

    Args:
        arguments: The script, and its arguments.
        ranks: The number of ranks under mpirun; 0 for a run without mpirun.

    Returns:
        The content of the JSON; None where the alarm clock of the process ended it.
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


def report(
    comm: MPI.Comm,
    name: str,
    title: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[Any]],
    content: Mapping[str, Any],
) -> None:
    """Print results as a table and write them to a JSON file in the results folder, on rank 0.

    Args:
        comm: The communicator.
        name: The name of the file, without its ending.
        title: A line above the table.
        columns: The heads of the columns.
        rows: The cells of each row.
        content: The content of the file, to which versions and number of ranks are added.
    """
    if comm.rank == 0:
        print(text_table(columns, rows, title))
        write_json(comm, name, content)


def run_part(comm: MPI.Comm, name: str, description: str, parts: Mapping[str, Part]) -> None:
    """Run the part of a benchmark that the command line names.

    Each row is printed on rank 0 when the row is there, then the table in Markdown, and the results
    are written to a JSON file.

    Args:
        comm: The communicator.
        name: The name of the benchmark, with which that of the file begins.
        description: The docstring of the benchmark, whose first line is shown.
        parts: For each part what makes its rows, and the heads of the columns.
    """
    options = argparse.ArgumentParser(description=description.splitlines()[0])
    options.add_argument("part", choices=parts)
    part = options.parse_args().part
    make, columns = parts[part]
    rows = []
    for row in make():
        rows.append(row)
        if comm.rank == 0:
            print(*row, sep="  ", file=sys.stderr, flush=True)
    if comm.rank == 0:
        print(markdown_table(columns, rows), end="")
    write_json(comm, f"{name}_{part}", {"columns": columns, "rows": rows})


def write_json(comm: MPI.Comm, name: str, content: Mapping[str, Any]) -> None:
    """Write results to a JSON file in the results folder, on rank 0; see `report`."""
    if comm.rank == 0:
        RESULTS.mkdir(exist_ok=True)
        text = json.dumps({"versions": versions(), "ranks": comm.size} | dict(content), indent=1)
        (RESULTS / f"{name}.json").write_text(text + "\n")
