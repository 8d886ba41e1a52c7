"""(p) What elastic contact costs: all of it over one linear solve, and others beside.

    ./with-dolfinx python3 benchmarks/elastic.py [--squares 256 512] [--cubes 24 40]
    ./with-dolfinx python3 benchmarks/elastic.py --squares 64 --cubes 8 --degrees 1 2 --repeats 1
    ./with-dolfinx python3 benchmarks/elastic.py --squares --cubes --shapes plate cube --size 2

A body rests with its lower side on a paraboloid and is pressed down by its upper side. The
numerator is everything that the contact problem needs beyond its assembled matrix: mesh, assembly
and solve of all coarse levels, prediction, linear solves and TAO's check on the finest, to a
natural residual of 1e-8; "cold" is without coarser meshes. Meshes of gmsh are not nested. The
denominators are one linear solve from zero of the same matrix without obstacle, to a residual of
1e-8, by the preconditioner of this package, and by GAMG with the rigid motions, as users of DOLFINx
set it up. The peer is SNES vinewtonrsls with the same CG and GAMG, from zero; it solves with
submatrices, to which PETSc hands no rigid motions: what a step would cost with them is in the
column of GAMG. The solvers run in turn, some times over; one process.
"""

import argparse
import functools
import itertools
from typing import Any

import numpy as np
import ufl
from common import coarse_state, spread, timed, write_json
from dolfinx import fem, mesh
from grid_sequence import MARGIN, MAX_STEPS, VI, options_of
from mpi4py import MPI
from petsc4py import PETSc
from shapes import SHAPES, TRIED, mesh_of

from dolfinx_signorini import ContactProblem, box_mesh, coarse_levels, elasticity
from dolfinx_signorini.base.tables import markdown_table
from dolfinx_signorini.meshes.sided_meshes import box
from dolfinx_signorini.solvers.cascade import RATIO
from dolfinx_signorini.solvers.linear.iterative import IterativeSolver
from dolfinx_signorini.solvers.motions import attach_motions, motions_of
from dolfinx_signorini.solvers.residual import NaturalResidual
from dolfinx_signorini.solvers.system import System

COMM = MPI.COMM_WORLD
RTOL = 1e-8
FEW = 20_000  # unknowns that need no coarser mesh
GAMG = {"ksp_type": "cg", "pc_type": "gamg", "mg_levels_ksp_type": "chebyshev"}
COLUMNS = (
    *("mesh", "degree", "unknowns", "linear s", "GAMG s", "cold s", "contact s"),
    *("/ linear", "/ GAMG"),
    *("solves by level", "iterations", "SNES s", "steps of SNES", "lead"),
)


def structured(n: int, dimension: int) -> Any:
    """The unit square or cube, n cells across."""
    return box_mesh(COMM, [np.linspace(0.0, 1.0, n + 1)] * dimension)


def body(domain: Any, degree: int) -> ContactProblem:
    """A body on a paraboloid, whose upper side moves down."""
    dimension, last = domain.geometry.dim, domain.geometry.dim - 1
    low, high = box(COMM, domain.geometry.x)[:, last]
    space = fem.functionspace(domain, ("Lagrange", degree, (dimension,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    below, above = (
        mesh.locate_entities_boundary(domain, last, lambda x, z=z: np.isclose(x[last], z))
        for z in (low, high)
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


def posed(shape: str, dimension: int, degree: int, m: Any) -> ContactProblem:
    """The problem with m cells across, or on a shape of gmsh with cells of the size m."""
    if shape:
        return body(mesh_of(COMM, (SHAPES | TRIED)[shape], m), degree)
    return body(structured(m, dimension), degree)


def all_of_contact(problem: ContactProblem, pose: Any, levels: list[Any]) -> list[int]:
    """Solve on coarser meshes, which are made anew, and then the problem; the linear solves."""
    state, solves = coarse_state(pose, levels, RTOL)
    problem.solve(coarse=state, rtol=RTOL, warm_start=False)
    return [*solves, problem.result.linear_solves]


def coarser(problem: ContactProblem, size: float) -> list[float]:
    """The sizes of the cells of coarser meshes of gmsh, by the ratios of a cascade."""
    dimension, unknowns = problem.space.mesh.geometry.dim, problem.unknowns
    found: list[float] = []
    while unknowns > FEW:
        size, unknowns = size * RATIO[dimension], unknowns // RATIO[dimension] ** dimension
        found.insert(0, size)
    return found


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


def measure(name: str, pose: Any, size: float, n: int, args: Any) -> dict[str, Any]:
    """Measure the solvers in turn, some times over.

    Args:
        name: Of the mesh.
        pose: Poses the problem on the mesh with so many cells across, or of a size of cells.
        size: Of the cells, where n is 0.
        n: The cells across.
        args: Of the command line.
    """
    problem, names = pose(n or size), itertools.count()
    layout, dimension = problem.system.layout, problem.space.mesh.geometry.dim
    levels = coarse_levels(n, dimension) if n else coarser(problem, size)
    attach_motions(problem.A, motions_of(layout), layout.fixed_dofs)
    keys = ("linear", "gamg", "contact", "cold", "snes")
    found: dict[str, list[float]] = {key: [] for key in keys}
    apart, taken = 0.0, 0
    for _ in range(args.repeats):
        seconds, iterations = timed(COMM, linear_solve, problem.system, names)
        found["linear"].append(seconds)
        seconds, others = timed(COMM, gamg_solve, problem.system)
        found["gamg"].append(seconds)
        seconds, cold = timed(COMM, all_of_contact, problem, pose, [])
        found["cold"].append(seconds)
        seconds, solves = timed(COMM, all_of_contact, problem, pose, levels)
        found["contact"].append(seconds)
        if not args.no_peer:
            seconds, (values, taken) = timed(COMM, snes_solve, problem)
            found["snes"].append(seconds)
            own = problem.system.vector_of(problem.u)
            apart = float(np.abs(values - own.array_r).max() / np.abs(values).max())
            own.destroy()
    result = problem.result
    row = {
        "mesh": name,
        "degree": problem.space.element.basix_element.degree,
        "unknowns": problem.unknowns,
        "seconds": {key: spread(values) for key, values in found.items() if values},
        "solves_by_level": solves,
        "solves_from_nothing": cold[0],
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
        *(r["mesh"], r["degree"], r["unknowns"]),
        *(f"{seconds[key]:.2f}" for key in ("linear", "gamg", "cold", "contact")),
        *(f"{contact / seconds[key]:.2f}" for key in ("linear", "gamg")),
        *("+".join(map(str, r["solves_by_level"])), "/".join(map(str, r["iterations"]))),
        *peer,
    )


def main() -> None:
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--squares", type=int, nargs="*", default=[256, 512])
    options.add_argument("--cubes", type=int, nargs="*", default=[24, 40])
    options.add_argument("--shapes", nargs="*", default=[], choices=list(SHAPES | TRIED))
    options.add_argument("--size", type=float, default=1.0, help="times the sizes of cells")
    options.add_argument("--degrees", type=int, nargs="+", default=[1])
    options.add_argument("--repeats", type=int, default=3)
    options.add_argument("--no-peer", action="store_true")
    args = options.parse_args()
    results = []
    meshes = [(f"{n} squares", 2, n) for n in args.squares]
    meshes += [(f"{n} cubes", 3, n) for n in args.cubes]
    meshes += [(name, (SHAPES | TRIED)[name].dimension, 0) for name in args.shapes]
    for name, dimension, n in meshes:
        for degree in args.degrees:
            body(structured(2, dimension), degree).solve()  # compiles the forms

            pose = functools.partial(posed, "" if n else name, dimension, degree)
            size = args.size * degree
            results.append(measure(name, pose, size, n // degree, args))
            if COMM.rank == 0:
                print(*cells(results[-1]), flush=True)
    if COMM.rank == 0:
        print(markdown_table(COLUMNS, [cells(r) for r in results]), end="")
    write_json(COMM, "elastic", {"repeats": args.repeats, "rtol": RTOL, "results": results})


if __name__ == "__main__":
    main()
