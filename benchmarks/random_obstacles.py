"""Loops with random obstacles in the domain: iterations of each step, and contact conditions.

    ./with-dolfinx python3 benchmarks/random_obstacles.py [--loops 40] [--seed 0] [--cells 0]

A loop poses a problem with a lower obstacle, and by chance an upper one, on a random mesh of the
unit square or cube with a reaction between 1e-3 and 100. A load of random strength and width grows,
falls and wanders, slowly or in leaps, and in some loops the last solution is the next obstacle. The
natural residual of each step is formed here from matrix, load and obstacles. The exit code is 1 if
a residual is too large.
"""

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import ufl
from common import spread
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini import ObstacleProblem, bernstein_space, box_mesh
from dolfinx_signorini.base.tables import text_table

COMM = MPI.COMM_WORLD
STEPS, WORST = 12, 1e-6


def random_mesh(generator: np.random.Generator, cells: int) -> mesh.Mesh:
    """A lattice with coarser ones, or a mesh of DOLFINx without, of one of two kinds of cells."""
    dimension = 2 if generator.random() < 0.7 else 3
    across = int(generator.integers(60, 160) if dimension == 2 else generator.integers(12, 24))
    across, kind = cells or across, int(generator.integers(3))
    if kind == 0:
        return box_mesh(COMM, [np.linspace(0.0, 1.0, across + 1)] * dimension)
    square = (mesh.CellType.quadrilateral, mesh.CellType.triangle)
    cube = (mesh.CellType.hexahedron, mesh.CellType.tetrahedron)
    if dimension == 2:
        return mesh.create_unit_square(COMM, across, across, square[kind - 1])
    return mesh.create_unit_cube(COMM, across, across, across, cube[kind - 1])


@dataclass
class Loop:
    """A loop of a seed, and what its steps took."""

    seed: int
    cells: int
    iterations: list[int] = field(default_factory=list)
    residual: float = 0.0
    unknowns: int = 0
    seconds: float = 0.0

    def run(self) -> None:
        """Make the steps."""
        generator = np.random.default_rng(self.seed)
        domain = random_mesh(generator, self.cells)
        simplices = domain.topology.cell_type in (mesh.CellType.triangle, mesh.CellType.tetrahedron)
        nodal = generator.random() < 0.6 or not simplices
        space = fem.functionspace(domain, ("Lagrange", 1)) if nodal else bernstein_space(domain, 2)
        u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
        dimension = domain.geometry.dim
        strength = fem.Constant(domain, 0.0)
        place = fem.Constant(domain, (0.5,) * dimension)
        width, reaction = 10.0 ** generator.uniform(0.5, 2.0), 10.0 ** generator.uniform(-3.0, 2.0)
        near = ufl.exp(-width * ufl.inner(x - place, x - place))
        lower = fem.Function(space)
        upper = {"upper": 1.0} if generator.random() < 0.4 else {}
        problem = ObstacleProblem(
            (ufl.inner(ufl.grad(u), ufl.grad(v)) + reaction * u * v) * ufl.dx,
            (strength * near - 5.0 * generator.random()) * v * ufl.dx,
            lower=lower if nodal else 0.0,
            **upper,
        )
        speed, size = 10.0 ** generator.uniform(-3.0, -0.5), 10.0 ** generator.uniform(0.0, 2.5)
        keeps = nodal and generator.random() < 0.4
        axes = np.arange(1, dimension + 1)
        for step in range(STEPS):
            strength.value = size * np.sin(3.0 * speed * (step + 1) + 0.3)
            place.value[:] = 0.5 + 0.3 * np.cos(speed * step * axes)
            if keeps:
                lower.x.array[:] = np.minimum(problem.u.x.array, 0.9)
            began = time.perf_counter()
            problem.solve()
            self.seconds += time.perf_counter() - began
            self.iterations.append(problem.result.linear_iterations)
            self.residual = max(self.residual, residual(problem, lower, upper.get("upper", np.inf)))
        self.unknowns = problem.unknowns
        problem.destroy()


def residual(problem: ObstacleProblem, lower: fem.Function, upper: float) -> float:
    """The natural residual relative to the load, formed anew; 0 without a load."""
    A = problem.A
    x, forces = A.createVecRight(), A.createVecLeft()
    owned = slice(len(x.array_r))
    x.array_w[:] = problem.u.x.array[owned]
    A.mult(x, forces)
    forces.axpy(-1.0, problem.b)
    diagonal = A.getDiagonal().array_r
    moved = np.clip(x.array_r - forces.array_r / diagonal, lower.x.array[owned], upper)
    forces.array_w[:] = diagonal * (x.array_r - moved)
    return float(forces.norm() / (problem.b.norm() or 1.0))


def loops(first: int, count: int, cells: int) -> Iterator[Loop]:
    """Run loops, and print each on rank 0."""
    for seed in range(first, first + count):
        loop = Loop(seed, cells)
        loop.run()
        if COMM.rank == 0:
            print(loop, flush=True)
        yield loop


def main() -> None:
    """Run and print."""
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("--loops", type=int, default=40)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--cells", type=int, default=0, help="across; by chance by default")
    args = options.parse_args()
    found = list(loops(args.seed, args.loops, args.cells))
    counts: Any = [count for loop in found for count in loop.iterations if count]
    rows = [("iterations of steps with any", *spread(counts).values())]
    rows.append(("seconds of loops", *spread([loop.seconds for loop in found]).values()))
    rows.append(("residuals", *spread([loop.residual for loop in found]).values()))
    if COMM.rank == 0:
        print(text_table(["", "min", "median", "max"], rows, f"{len(found)} loops"))
    sys.exit(int(not all(loop.residual <= WORST for loop in found)))


if __name__ == "__main__":
    main()
