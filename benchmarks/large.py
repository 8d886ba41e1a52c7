"""(k) Large problems: do they go through, and what does an unknown cost?

    ./with-dolfinx python3 benchmarks/large.py [--squares 1001 2001 4001] [--cubes 47 79 158]

Degree 1 on squares (4001 cells across are 16 million unknowns) and on cubes (158 are 4 million), in
contact with a wavy obstacle, in a process of its own each, from nothing: coarse levels, mesh,
assembly and solve, to a natural residual of 1e-7. The memory is the largest resident set of the
process. Above --gigabytes of address space the process gets no more and fails.
"""

import argparse
import json
import resource
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from common import child, coarse_state, report
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini import SignoriniProblem, boundary_facets, box_mesh, coarse_levels
from dolfinx_signorini.base.timing import Phases
from dolfinx_signorini.problem.signorini import DEFAULT_RTOL

COMM, MICRO = MPI.COMM_WORLD, 1e6
COLUMNS = ("N", "dim", "unknowns", "coarse", "mesh", "assembly", "solve", "us/unknown", "solves")


def pose(domain: mesh.Mesh) -> SignoriniProblem:
    """A body with reaction 1 under a load, above a wavy obstacle around its whole boundary."""
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    load = (-1.0 - 0.5 * x[0]) * v * ufl.dx

    def obstacle(x: Any) -> Any:
        return -0.3 + 0.1 * np.cos(5.0 * x[0]) * np.cos(4.0 * x[1])

    return SignoriniProblem(a, load, contact=boundary_facets(domain), obstacle=obstacle)


def domain_of(n: int, dimension: int) -> mesh.Mesh:
    """The unit square or cube with n cells across."""
    return box_mesh(COMM, [np.linspace(0.0, 1.0, n + 1)] * dimension)


def measure(n: int, dimension: int, gigabytes: float) -> dict[str, Any]:
    """Solve one problem from nothing, and return its seconds, solves and gigabytes."""
    limit = int(gigabytes * 1e9)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    pose(domain_of(6, dimension)).solve()  # compiles the forms
    phases = Phases(COMM)
    with phases("coarse"):
        levels = coarse_levels(n, dimension)
        coarse, solves = coarse_state(lambda m: pose(domain_of(m, dimension)), levels, DEFAULT_RTOL)
    with phases("mesh"):
        domain = domain_of(n, dimension)
    with phases("assembly"):
        problem = pose(domain)
    with phases("solve"):
        problem.solve(coarse=coarse, rtol=DEFAULT_RTOL)
    return {
        "unknowns": problem.unknowns,
        "seconds": phases.seconds,
        "solves": [*solves, problem.result.linear_solves],
        "residual": problem.result.natural_residual,
        "gigabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9,
    }


def main() -> None:
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--squares", type=int, nargs="*", default=[1001, 2001, 4001])
    options.add_argument("--cubes", type=int, nargs="*", default=[47, 79, 158])
    options.add_argument("--gigabytes", type=float, default=20.0)
    options.add_argument("--measure", type=int, nargs=2, help=argparse.SUPPRESS)
    args = options.parse_args()
    if args.measure:
        print(json.dumps(measure(*args.measure, args.gigabytes)))
        return
    rows, results = [], []
    for n, dimension in [(n, 2) for n in args.squares] + [(n, 3) for n in args.cubes]:
        case = (str(Path(__file__)), "--measure", str(n), str(dimension))
        run = child(*case, f"--gigabytes={args.gigabytes}")
        assert run is not None
        results.append({"n": n, "dimension": dimension} | run)
        seconds, solves = run["seconds"].values(), "+".join(map(str, run["solves"]))
        cost = MICRO * (run["seconds"]["coarse"] + run["seconds"]["solve"]) / run["unknowns"]
        rows.append((n, dimension, run["unknowns"], *seconds, cost, solves, run["gigabytes"]))
        print(*rows[-1], flush=True)
    title = "seconds of each phase; microseconds of coarse levels and solve per unknown"
    report(COMM, "large", title, (*COLUMNS, "GB"), rows, {"results": results})


main()
