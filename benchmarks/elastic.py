"""(p) What elastic contact costs: the whole cascade over one linear solve, and others beside.

    ./with-dolfinx python3 benchmarks/elastic.py [--squares 256 512] [--cubes 24 40]
    ./with-dolfinx python3 benchmarks/elastic.py --squares 64 --cubes 8 --repeats 1

A block rests with its lower side on a paraboloid and is pressed down by its upper side. The
numerator is everything that the contact problem needs beyond its assembled matrix: mesh, assembly
and solve of all coarse levels, prediction, linear solves and TAO's check on the finest, to a
natural residual of 1e-8. The denominators are one linear solve from zero of the same matrix without
obstacle, to a residual of 1e-8, by the same multigrid, and by GAMG with the rigid motions, as users
of DOLFINx set it up. The peer is SNES vinewtonrsls with the same CG and GAMG, from zero. The
solvers run in turn, some times over; one process.
"""

import argparse
import itertools
from typing import Any

import numpy as np
import ufl
from common import contact_solve, spread, timed, write_json
from dolfinx import fem, mesh
from grid_sequence import MARGIN, MAX_STEPS, VI, options_of
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini import ContactProblem, box_mesh, elasticity
from dolfinx_signorini.base.tables import markdown_table
from dolfinx_signorini.solvers.linear.iterative import IterativeSolver
from dolfinx_signorini.solvers.motions import attach_motions, motions_of
from dolfinx_signorini.solvers.residual import NaturalResidual
from dolfinx_signorini.solvers.system import System

COMM = MPI.COMM_WORLD
RTOL = 1e-8
GAMG = {"ksp_type": "cg", "pc_type": "gamg", "mg_levels_ksp_type": "chebyshev"}
COLUMNS = (
    *("dimension", "N", "unknowns", "linear s", "GAMG s", "contact s", "/ linear", "/ GAMG"),
    *("solves by level", "iterations", "SNES s", "steps of SNES", "lead"),
)


def block(n: int, dimension: int) -> ContactProblem:
    """A block on a paraboloid, whose upper side moves down."""
    domain = box_mesh(COMM, [np.linspace(0.0, 1.0, n + 1)] * dimension)
    space = fem.functionspace(domain, ("Lagrange", 1, (dimension,)))
    u, v, last = ufl.TrialFunction(space), ufl.TestFunction(space), dimension - 1
    below, above = (
        mesh.locate_entities_boundary(domain, last, lambda x, z=z: np.isclose(x[last], z))
        for z in (0.0, 1.0)
    )
    down = np.zeros(dimension)
    down[last] = -0.02
    bc = fem.dirichletbc(down, fem.locate_dofs_topological(space, last, above), space)
    weight = fem.Constant(domain, 10.0 * down)
    return ContactProblem(
        elasticity(u, v, young=200.0, poisson=0.3),
        ufl.inner(weight, v) * ufl.dx,
        contact=below,
        gap=lambda x: 0.2 * ((x[:last] - 0.45) ** 2).sum(axis=0),
        bcs=[bc],
    )


def linear_solve(system: System, names: Any) -> int:
    """Solve from zero without any contact, by the multigrid of this package; the iterations."""
    solver, x = IterativeSolver(system, f"benchmark_{next(names)}_", {}), start(system)
    held = np.zeros(len(system.contact_dofs), dtype=bool)
    solver.solve(system, x, held, RTOL * system.b.norm())
    iterations = int(solver.iterations)
    solver.destroy()
    x.destroy()
    return iterations


def start(system: System) -> PETSc.Vec:
    """Zero with the Dirichlet data."""
    x = system.A.createVecRight()
    x.set(0.0)
    x.array_w[system.fixed_dofs] = system.fixed_values
    return x


def gamg_solve(system: System) -> int:
    """Solve from zero without any contact, by CG and GAMG; the iterations."""
    ksp = PETSc.KSP().create(COMM)
    ksp.setOperators(system.A)
    options_of(ksp, GAMG)
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    ksp.setTolerances(rtol=1e-12, atol=RTOL * system.b.norm())
    x = start(system)
    ksp.setInitialGuessNonzero(True)
    ksp.solve(system.b, x)
    iterations = int(ksp.getIterationNumber())
    ksp.destroy()
    x.destroy()
    return iterations


def snes_solve(problem: ContactProblem) -> tuple[Any, int]:
    """Solve by SNES vinewtonrsls from zero; the values, and the steps or -50."""
    system = problem.system
    measure = NaturalResidual(system)
    atol = MARGIN * RTOL * measure.scale
    measure.destroy()
    bounds = []
    for values, none in zip(system.bounds, (PETSc.NINFINITY, PETSc.INFINITY), strict=True):
        bound = system.A.createVecRight()
        bound.array_w[:] = np.where(np.isfinite(values), values, none)
        bounds.append(bound)

    def residual(snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        system.A.mult(x, f)
        f.axpy(-1.0, system.b)

    snes = PETSc.SNES().create(COMM)
    snes.setType("vinewtonrsls")
    snes.setFunction(residual, system.b.duplicate())
    snes.setJacobian(lambda snes, x, J, P: None, system.A)
    snes.setVariableBounds(*bounds)
    snes.setTolerances(rtol=0.0, stol=0.0, atol=atol, max_it=MAX_STEPS)
    snes.getKSP().setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    snes.getKSP().setTolerances(rtol=1e-12, atol=0.1 * atol)
    options_of(snes, {**VI, **GAMG})
    x = start(system)
    snes.solve(None, x)
    taken = snes.getIterationNumber() if snes.getConvergedReason() > 0 else -MAX_STEPS
    values = x.array_r.copy()
    snes.destroy()
    return values, int(taken)


def measure(n: int, dimension: int, repeats: int, peer: bool) -> dict[str, Any]:
    """Measure the solvers in turn, some times over."""
    problem, names = block(n, dimension), itertools.count()
    layout = problem.system.layout
    attach_motions(problem.A, motions_of(layout), layout.fixed_dofs)
    found: dict[str, list[float]] = {key: [] for key in ("linear", "gamg", "contact", "snes")}
    apart, taken = 0.0, 0
    for _ in range(repeats):
        seconds, iterations = timed(COMM, linear_solve, problem.system, names)
        found["linear"].append(seconds)
        seconds, others = timed(COMM, gamg_solve, problem.system)
        found["gamg"].append(seconds)
        pose = lambda m: block(m, dimension)  # noqa: E731
        seconds, solves = timed(COMM, contact_solve, problem, pose, n, RTOL)
        found["contact"].append(seconds)
        if peer:
            seconds, (values, taken) = timed(COMM, snes_solve, problem)
            found["snes"].append(seconds)
            own = problem.system.vector_of(problem.u)
            apart = float(np.abs(values - own.array_r).max() / np.abs(values).max())
            own.destroy()
    result = problem.result
    row = {
        "dimension": dimension,
        "n": n,
        "unknowns": problem.unknowns,
        "seconds": {key: spread(values) for key, values in found.items() if values},
        "solves_by_level": solves,
        "iterations": [iterations, result.linear_iterations, others],
        "preconditioner": result.preconditioner,
        "natural_residual": result.natural_residual,
        "steps_of_snes": taken,
        "apart": apart,
    }
    problem.destroy()
    return row


def cells(r: dict[str, Any]) -> tuple[Any, ...]:
    """A row of the table."""
    seconds = {key: values["median"] for key, values in r["seconds"].items()}
    contact = seconds["contact"]
    peer = ("", "", "")
    if "snes" in seconds:
        steps = "not converged" if r["steps_of_snes"] < 0 else str(r["steps_of_snes"])
        peer = (f"{seconds['snes']:.2f}", steps, f"{seconds['snes'] / contact:.1f}")
    return (
        *(r["dimension"], r["n"], r["unknowns"]),
        *(f"{seconds[key]:.2f}" for key in ("linear", "gamg", "contact")),
        *(f"{contact / seconds[key]:.2f}" for key in ("linear", "gamg")),
        *("+".join(map(str, r["solves_by_level"])), "/".join(map(str, r["iterations"]))),
        *peer,
    )


def main() -> None:
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--squares", type=int, nargs="*", default=[256, 512])
    options.add_argument("--cubes", type=int, nargs="*", default=[24, 40])
    options.add_argument("--repeats", type=int, default=3)
    options.add_argument("--no-peer", action="store_true")
    args = options.parse_args()
    results = []
    for dimension, sizes in ((2, args.squares), (3, args.cubes)):
        block(4, dimension).solve()  # compiles the forms
        for n in sizes:
            results.append(measure(n, dimension, args.repeats, not args.no_peer))
            if COMM.rank == 0:
                print(*cells(results[-1]), flush=True)
    if COMM.rank == 0:
        print(markdown_table(COLUMNS, [cells(r) for r in results]), end="")
    write_json(COMM, "elastic", {"repeats": args.repeats, "rtol": RTOL, "results": results})


if __name__ == "__main__":
    main()
