"""(o) What obstacles in the domain cost: a solve from nothing over one linear solve, SNES beside.

    ./with-dolfinx python3 benchmarks/obstacle.py [--squares 512 1024] [--cubes 48 80]
    ./with-dolfinx python3 benchmarks/obstacle.py --squares 128 --cubes 16 --repeats 1

The numerator is everything that the contact problem needs beyond its assembled matrix: coarse
problems, rough steps, linear solves and TAO's check, to a natural residual of 1e-8 ("tight"), and
to the default of 1e-7. The denominator is one linear solve from zero of the same matrix without
obstacle, to a residual of 1e-8, by the same multigrid with its set-up. The peer is SNES
vinewtonrsls with CG and BoomerAMG through a sequence of grids, each with half of the width, which
starts from the interpolated solution; matrices, loads and bounds of its levels are assembled
beforehand and cost no time. The solvers run in turn, some times over; one process.
"""

import argparse
import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import ufl
from common import spread, timed, write_json
from dolfinx import fem, mesh
from grid_sequence import BOOMERAMG, LINEAR, MARGIN, MAX_STEPS, VI, options_of
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini import ObstacleProblem, boundary_facets, box_mesh
from dolfinx_signorini.base.tables import markdown_table
from dolfinx_signorini.problem.dirichlet import dirichlet
from dolfinx_signorini.solvers.linear.iterative import IterativeSolver
from dolfinx_signorini.solvers.residual import NaturalResidual

COMM = MPI.COMM_WORLD
RTOL = 1e-8
COARSEST = {2: 16, 3: 8}  # cells across of the first grid of the peer, at least
Pose = Callable[[int], ObstacleProblem]
COLUMNS = (
    *("case", "N", "unknowns", "linear s", "tight s", "/ linear", "range", "default / linear"),
    *("set-ups", "iterations", "SNES s", "steps of SNES", "lead"),
)


def box(low: float, high: float, n: int, dimension: int = 2) -> mesh.Mesh:
    """A square or a cube, n cells across."""
    return box_mesh(COMM, [np.linspace(low, high, n + 1)] * dimension)


def posed(domain: mesh.Mesh, f: Any, data: Any = 0.0, **obstacles: Any) -> ObstacleProblem:
    """-Laplace u = f with Dirichlet data on all of the boundary."""
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    f = fem.Constant(domain, f) if isinstance(f, float) else f
    bcs = [dirichlet(space, boundary_facets(domain), data)]
    stiffness = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    return ObstacleProblem(stiffness, f * v * ufl.dx, bcs=bcs, **obstacles)


def ball(n: int) -> ObstacleProblem:
    """A hemisphere, continued by its tangent: PETSc's snes ex9."""
    a, height = 0.697965148223372, 0.680259411891713
    h = np.sqrt(1.0 - 0.81)

    def lower(x: Any) -> Any:
        r = np.hypot(x[0], x[1])
        return np.where(r < 0.9, np.sqrt(np.maximum(1.0 - r * r, 0.0)), h - 0.9 / h * (r - 0.9))

    def exact(x: Any) -> Any:
        r = np.maximum(np.hypot(x[0], x[1]), a)
        return height * np.log(2.0 / r)

    return posed(box(-2.0, 2.0, n), 0.0, exact, lower=lower)


def spiral(n: int) -> ObstacleProblem:
    """Graeser and Kornhuber, J. Comput. Math. 27 (2009) 1-44, Section 7.1.1."""

    def lower(x: Any) -> Any:
        r, angle = np.hypot(x[0], x[1]), np.arctan2(x[1], x[0])
        s = np.maximum(r, 1e-8)
        wave = np.sin(2.0 * np.pi / s + 0.5 * np.pi - angle)
        return np.where(r < 1e-8, 3.6, wave + s * (s + 1.0) / (s - 2.0) - 3.0 * s + 3.6)

    return posed(box(-1.0, 1.0, n), 0.0, lower=lower)


def steps(n: int) -> ObstacleProblem:
    """Four steps on quadrilaterals: deal.II's step-41."""

    def lower(x: Any) -> Any:
        return np.select([x[0] < -0.5, x[0] < 0.0, x[0] < 0.5], [-0.2, -0.4, -0.6], -0.8)

    corners, kind = [[-1.0, -1.0], [1.0, 1.0]], mesh.CellType.quadrilateral
    return posed(mesh.create_rectangle(COMM, corners, [n, n], kind), -10.0, lower=lower)


def bearing(n: int) -> ObstacleProblem:
    """A journal bearing of eccentricity 0.9: TAO's jbearing2."""
    domain = box_mesh(COMM, [np.linspace(0.0, 2.0 * np.pi, n + 1), np.linspace(0.0, 20.0, n + 1)])
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    dx = ufl.dx(metadata={"quadrature_rule": "vertex", "quadrature_degree": 1})
    film = (1.0 + 0.9 * ufl.cos(x[0])) ** 3
    return ObstacleProblem(
        film * ufl.inner(ufl.grad(u), ufl.grad(v)) * dx,
        0.9 * ufl.sin(x[0]) * v * dx,
        lower=0.0,
        bcs=[dirichlet(space, boundary_facets(domain), 0.0)],
    )


def torsion(n: int) -> ObstacleProblem:
    """A twisted bar that yields: u is between minus and plus the distance to the boundary."""
    domain = box(0.0, 1.0, n)
    x = ufl.SpatialCoordinate(domain)

    def distance(x: Any) -> Any:
        return np.min([x[0], 1.0 - x[0], x[1], 1.0 - x[1]], axis=0)

    load = 200.0 * ufl.sin(3.0 * ufl.pi * x[0]) * ufl.cos(2.0 * x[1])
    return posed(domain, load, lower=lambda x: -distance(x), upper=distance)


def nsv(n: int) -> ObstacleProblem:
    """Nochetto, Siebert and Veeser, Numer. Math. 95 (2003) 163-195, Section 7.2, in space."""
    domain = box(-1.0, 1.0, n, 3)
    x = ufl.SpatialCoordinate(domain)
    s = ufl.inner(x, x) - 0.49
    f = ufl.conditional(ufl.lt(s, 0.0), -3.92 * (1.0 - s), -4.0 * (2.0 * (s + 0.49) + 3.0 * s))
    return posed(domain, f, lambda x: np.maximum((x**2).sum(axis=0) - 0.49, 0.0) ** 2, lower=0.0)


PLANE: dict[str, Pose] = {each.__name__: each for each in (ball, spiral, steps, bearing, torsion)}
SPACE: dict[str, Pose] = {"nsv": nsv}


def contact_solve(problem: ObstacleProblem, rtol: float | None) -> None:
    """Solve from nothing."""
    problem.solve(rtol=rtol, warm_start=False)


def linear_solve(problem: ObstacleProblem, names: Any) -> int:
    """Solve from zero without any contact, by the multigrid of this package; the iterations."""
    system = problem.system
    if system.b.norm() == 0.0:  # of the spiral: any load will do
        load = system.b.duplicate()
        load.set(1.0)
        load.array_w[system.fixed_dofs] = 0.0
        system = replace(system, b=load)
    solver, x = IterativeSolver(system, f"benchmark_{next(names)}_", {}), system.A.createVecRight()
    x.set(0.0)
    x.array_w[system.fixed_dofs] = system.fixed_values
    held = np.zeros(len(system.contact_dofs), dtype=bool)
    solver.solve(system, x, held, RTOL * system.b.norm())
    iterations = int(solver.iterations)
    solver.destroy()
    x.destroy()
    return iterations


class Grid:
    """A level of the peer, row by row: matrix, load and bounds, the size of the data."""

    def __init__(self, pose: Pose, n: int):
        problem = pose(n)
        self.n, self.dimension = n, problem.space.mesh.topology.dim
        x = problem.space.tabulate_dof_coordinates()
        low, high = x.min(axis=0), x.max(axis=0)
        lattice = np.rint((x - low) / np.maximum(high - low, 1e-30) * n)
        self.order = np.lexsort(lattice.T).astype(np.int32)
        places = PETSc.IS().createGeneral(self.order, comm=PETSc.COMM_SELF)
        self.A = problem.A.permute(places, places)
        lower, upper = problem.system.bounds
        lower = np.where(np.isfinite(lower), lower, PETSc.NINFINITY)
        upper = np.where(np.isfinite(upper), upper, PETSc.INFINITY)
        self.b, self.lower, self.upper = (
            PETSc.Vec().createWithArray(values[self.order].copy(), comm=PETSc.COMM_SELF)
            for values in (problem.b.array_r, lower, upper)
        )
        self.atol = MARGIN * RTOL * NaturalResidual(problem.system).scale
        problem.destroy()

    def lattice(self) -> PETSc.DMDA:
        """The nodes as PETSc's structured grid, for interpolation."""
        return PETSc.DMDA().create(
            (self.n + 1,) * self.dimension,
            stencil_type=PETSc.DMDA.StencilType.BOX,
            stencil_width=1,
            comm=PETSc.COMM_SELF,
            setup=True,
        )

    def solve(self, x: PETSc.Vec) -> int:
        """Solve by SNES vinewtonrsls, and return its steps."""

        def residual(snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
            self.A.mult(x, f)
            f.axpy(-1.0, self.b)

        snes = PETSc.SNES().create(PETSc.COMM_SELF)
        snes.setType("vinewtonrsls")
        snes.setFunction(residual, self.b.duplicate())
        snes.setJacobian(lambda snes, x, J, P: None, self.A)
        snes.setVariableBounds(self.lower, self.upper)
        snes.setTolerances(rtol=0.0, stol=0.0, atol=self.atol, max_it=MAX_STEPS)
        snes.getKSP().setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        snes.getKSP().setTolerances(rtol=1e-12, atol=LINEAR * self.atol)
        options_of(snes, {**VI, **BOOMERAMG})
        snes.solve(None, x)
        taken = snes.getIterationNumber() if snes.getConvergedReason() > 0 else -MAX_STEPS
        snes.destroy()
        return int(taken)


def grids(pose: Pose, n: int, dimension: int) -> list[Grid]:
    """The levels of the peer, coarsest first."""
    found = [n]
    while found[0] % 2 == 0 and found[0] // 2 >= COARSEST[dimension]:
        found.insert(0, found[0] // 2)
    return [Grid(pose, m) for m in found]


def snes_solve(levels: list[Grid]) -> tuple[Any, list[int]]:
    """Solve on one grid after the other; the values on the last one, and the steps of each."""
    x, taken = levels[0].b.duplicate(), []
    x.set(0.0)
    for coarse, grid in zip([None, *levels], levels, strict=False):
        if coarse is not None:
            one, other = coarse.lattice(), grid.lattice()
            interpolation, _ = one.createInterpolation(other)
            last, x = x, grid.b.duplicate()
            interpolation.mult(last, x)
        x.pointwiseMax(x, grid.lower)
        x.pointwiseMin(x, grid.upper)
        taken.append(grid.solve(x))
    values = np.empty(len(x.array_r))
    values[levels[-1].order] = x.array_r
    return values, taken


def measure(name: str, pose: Pose, n: int, repeats: int, peer: bool) -> dict[str, Any]:
    """Measure the solvers in turn, some times over."""
    problem, names = pose(n), itertools.count()
    levels = grids(pose, n, problem.space.mesh.topology.dim) if peer else []
    found: dict[str, list[float]] = {key: [] for key in ("linear", "tight", "default", "snes")}
    taken: list[int] = []
    apart = 0.0
    for _ in range(repeats):
        seconds, linear_iterations = timed(COMM, linear_solve, problem, names)
        found["linear"].append(seconds)
        found["default"].append(timed(COMM, contact_solve, problem, None)[0])
        found["tight"].append(timed(COMM, contact_solve, problem, RTOL)[0])
        if peer:
            seconds, (values, taken) = timed(COMM, snes_solve, levels)
            found["snes"].append(seconds)
            apart = float(np.abs(values - problem.u.x.array).max())
    result = problem.result
    ratios = {
        key: spread([c / x for c, x in zip(found[key], found["linear"], strict=True)])
        for key in ("tight", "default")
    }
    row = {
        "case": name,
        "n": n,
        "unknowns": problem.unknowns,
        "seconds": {key: spread(values) for key, values in found.items() if values},
        "ratio": ratios,
        "setups": result.setups,
        "iterations": [linear_iterations, result.linear_iterations],
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
    tight = r["ratio"]["tight"]
    peer = ("", "", "")
    if "snes" in seconds:
        failed = min(r["steps_of_snes"]) < 0
        steps = "not converged" if failed else "+".join(map(str, r["steps_of_snes"]))
        peer = (f"{seconds['snes']:.2f}", steps, f"{seconds['snes'] / seconds['tight']:.1f}")
    return (
        *(r["case"], r["n"], r["unknowns"], f"{seconds['linear']:.3f}", f"{seconds['tight']:.3f}"),
        *(f"{tight['median']:.2f}", f"{tight['min']:.2f}-{tight['max']:.2f}"),
        f"{r['ratio']['default']['median']:.2f}",
        *(r["setups"], "/".join(map(str, r["iterations"]))),
        *peer,
    )


def main() -> None:
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--squares", type=int, nargs="*", default=[512, 1024])
    options.add_argument("--cubes", type=int, nargs="*", default=[48, 80])
    options.add_argument("--cases", nargs="+", default=[*PLANE, *SPACE], choices=[*PLANE, *SPACE])
    options.add_argument("--repeats", type=int, default=3)
    options.add_argument("--no-peer", action="store_true", help="leave SNES out")
    args = options.parse_args()
    peer = COMM.size == 1 and not args.no_peer
    results = []
    for name in args.cases:
        pose = (PLANE | SPACE)[name]
        sizes = args.squares if name in PLANE else args.cubes
        contact_solve(pose(20), RTOL)  # compiles the forms
        for n in sizes:
            results.append(measure(name, pose, n, args.repeats, peer))
            if COMM.rank == 0:
                print(*results[-1]["ratio"].items(), name, n, flush=True)
    if COMM.rank == 0:
        print(markdown_table(COLUMNS, [cells(r) for r in results]), end="")
    write_json(COMM, "obstacle", {"repeats": args.repeats, "rtol": RTOL, "results": results})


if __name__ == "__main__":
    main()
