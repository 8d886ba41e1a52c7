"""(i) What geometric multigrid and p-multigrid cost, over BoomerAMG on the same matrix.

    ./with-dolfinx python3 benchmarks/multigrid.py [--squares 1001 1024] [--cubes 64] [--degrees 64]

All figures are CPU seconds of one process. Each row is a matrix with some dofs held at the obstacle
and CG to a residual of 1e-8: BoomerAMG as PETSc sets it up, BoomerAMG with the settings of this
package, and the default of this package, which looks for lower degrees and coarser meshes first.
Set-up and solve count together. The second table has the whole contact solve, with mesh and
assembly of all coarse levels, over the first and the third way; the contact solve goes to its
default stop, at 1/50 of the estimated discretisation error.
"""

import argparse
import itertools
import time
from collections.abc import Callable, Mapping
from statistics import median
from typing import Any

import numpy as np
import ufl
from common import contact_solve, report
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini import SignoriniProblem, boundary_facets, box_mesh, friedrichs_keller
from dolfinx_signorini.meshes.elements import bernstein_space, nodal_space
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, owned_cells
from dolfinx_signorini.problem.signorini import DEFAULT_RTOL
from dolfinx_signorini.solvers.active_set import REACHED
from dolfinx_signorini.solvers.linear.algebraic import AMG
from dolfinx_signorini.solvers.linear.iterative import IterativeSolver

COMM = MPI.COMM_WORLD
# PETSc's own settings, where those of this package differ.
FROM_PETSC = {
    "pc_hypre_boomeramg_relax_type_down": "symmetric-SOR/Jacobi",
    "pc_hypre_boomeramg_relax_type_up": "symmetric-SOR/Jacobi",
    "pc_hypre_boomeramg_max_coarse_size": 9,
}
WAYS: dict[str, Mapping[str, Any]] = {"PETSc's": FROM_PETSC, "tuned": AMG, "default": {}}
COLUMNS = ("mesh", "unknowns", *WAYS, "iterations", "/ PETSc's", "/ tuned")
CONTACT = ("mesh", "contact s", "/ PETSc's", "/ default", "solves by level")


def loaded(domain: mesh.Mesh, degree: int = 1, contrast: float = 1.0) -> SignoriniProblem:
    """A body above a wavy obstacle, with a coefficient that jumps between cells."""
    space = bernstein_space(domain, degree)
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    k: Any = 1.0
    if contrast > 1.0:
        k = fem.Function(fem.functionspace(domain, ("DG", 0)))
        k.interpolate(lambda x: np.where(np.sin(9 * x[0]) * np.sin(7 * x[1]) > 0, contrast, 1.0))
    a = (k * ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    load = (-1.0 - 0.5 * x[0]) * v * ufl.dx
    obstacle = -0.3 + 0.1 * ufl.cos(5 * x[0]) * ufl.cos(4 * x[1])
    return SignoriniProblem(a, load, contact=boundary_facets(domain), obstacle=obstacle)


def adapted(domain: mesh.Mesh, steps: int) -> mesh.Mesh:
    """Refine a mesh towards a point on its boundary."""
    for step in range(steps):
        middles = mesh.compute_midpoints(domain, domain.topology.dim, owned_cells(domain))
        near = np.linalg.norm(middles - np.array([0.45, 0.0, 0.0]), axis=1) < 0.55**step
        domain = refined(SidedMesh(domain, {}), np.flatnonzero(near).astype(np.int32)).sided.mesh
    return domain


def cpu(action: Callable[..., Any], *args: Any) -> tuple[float, Any]:
    """Return the CPU seconds of a call on the slowest rank, and its value."""
    start = time.process_time()
    value = action(*args)
    return COMM.allreduce(time.process_time() - start, op=MPI.MAX), value


def solve(problem: SignoriniProblem, options: Mapping[str, Any], names: Any) -> int:
    """Solve from zero with the low side held, and return the iterations."""
    system = problem.system
    points = nodal_space(problem.space).tabulate_dof_coordinates()[system.contact_dofs]
    held = points[:, 1] < 1e-9
    solver, x = IterativeSolver(system, f"benchmark_{next(names)}_", options), system.start()
    system.project(x)
    solver.solve(system, x, held, DEFAULT_RTOL * REACHED * system.b.norm())
    iterations = solver.iterations
    solver.destroy()
    x.destroy()
    return iterations


def linear(problem: SignoriniProblem, repeats: int) -> dict[str, tuple[float, int]]:
    """Measure the three ways in turn; the median of the seconds, and the iterations."""
    names, found = itertools.count(), {name: [] for name in WAYS}  # type: dict[str, list[Any]]
    for _ in range(repeats):
        for name, options in WAYS.items():
            found[name].append(cpu(solve, problem, options, names))
    return {name: (median(s for s, _ in runs), runs[0][1]) for name, runs in found.items()}


def contact(problem: SignoriniProblem, make: Callable[[int], mesh.Mesh], n: int) -> list[int]:
    """Solve from nothing, with all coarse levels; return the linear solves of each level."""
    return contact_solve(problem, lambda m: loaded(make(m)), n, None)


def cube(n: int) -> mesh.Mesh:
    """The unit cube, n cells across."""
    return box_mesh(COMM, [np.linspace(0.0, 1.0, n + 1)] * 3)


def square(n: int) -> mesh.Mesh:
    """The unit square, n cells across."""
    return friedrichs_keller(COMM, n)


def main() -> None:
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--squares", type=int, nargs="*", default=[1001, 1024])
    options.add_argument("--cubes", type=int, nargs="*", default=[64])
    options.add_argument("--degrees", type=int, default=64, help="cells across; 0 for none")
    options.add_argument("--repeats", type=int, default=3)
    args = options.parse_args()
    rows, contacts = [], []
    structured = [("square", square, n) for n in args.squares]
    structured += [("cube", cube, n) for n in args.cubes]
    for make in {make for _, make, _ in structured}:
        loaded(make(20)).solve()  # compiles the forms
    for name, make, n in structured:
        problem = loaded(make(n))
        found = linear(problem, args.repeats)
        rows.append(row(f"{name}, N = {n}", problem, found))
        runs = [cpu(contact, problem, make, n) for _ in range(args.repeats)]
        seconds = median(s for s, _ in runs)
        ratios = (seconds / found["PETSc's"][0], seconds / found["default"][0])
        contacts.append((f"{name}, N = {n}", seconds, *ratios, "+".join(map(str, runs[0][1]))))
        problem.destroy()
    if args.degrees:
        n = args.degrees
        cases = [("uniform", square(n), 1.0), ("adapted", adapted(square(n // 4), 8), 1.0)]
        cases += [(f"{name}, contrast 1e6", domain, 1e6) for name, domain, _ in cases]
        for (name, domain, contrast), degree in itertools.product(cases, (1, 2, 3, 4)):
            problem = loaded(domain, degree, contrast)
            found = linear(problem, args.repeats)
            rows.append(row(f"{name}, degree {degree}", problem, found))
            problem.destroy()
    title = f"CG to 1e-8 with held dofs, set-up and solve, CPU seconds, medians of {args.repeats}"
    report(COMM, "multigrid", title, COLUMNS, rows, {"rows": rows, "contact": contacts})
    title = "contact over a linear solve, CPU seconds"
    report(COMM, "multigrid_contact", title, CONTACT, contacts, {"rows": contacts})


def row(name: str, problem: SignoriniProblem, found: Mapping[str, tuple[float, int]]) -> Any:
    """Return a row of the table."""
    seconds = [found[way][0] for way in WAYS]
    iterations = "/".join(str(found[way][1]) for way in WAYS)
    ratios = (seconds[2] / seconds[0], seconds[2] / seconds[1])
    return (name, problem.unknowns, *seconds, iterations, *ratios)


main()
