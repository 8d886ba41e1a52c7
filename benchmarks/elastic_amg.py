"""Algebraic multigrid of PETSc for bodies that bend, on meshes of gmsh without coarser levels.

    ./with-dolfinx python3 benchmarks/elastic_amg.py
    ./with-dolfinx python3 benchmarks/elastic_amg.py --shapes "cube, P2" --size 2 --poisson 0.49

A body whose upper side is held, and every second node of the contact on its lower side: CG from
zero to a residual of 1e-8, in CPU seconds with the set-up, the best of some. With degree 2 the
options are those of the matrix of degree 1 below it. "motions" tells whether the matrix knows its
rigid motions. BoomerAMG with interpolation vectors (pc_hypre_boomeramg_vec_interp_variant 2 and 3)
is left out: hypre ends with its error 12 on some of these meshes, and fails from then on.
"""

import time
from typing import Any

import dolfinx
import numpy as np
import ufl
from common import parser, report
from dolfinx import fem
from mpi4py import MPI
from shapes import SHAPES, TRIED, Shape, mesh_of

from dolfinx_signorini import ContactProblem, elasticity
from dolfinx_signorini.meshes.sided_meshes import box
from dolfinx_signorini.solvers.linear import iterative, multigrid
from dolfinx_signorini.solvers.linear.algebraic import CLASSICAL, GAMG, HYPRE, VECTORS
from dolfinx_signorini.solvers.linear.iterative import IterativeSolver

COMM = MPI.COMM_WORLD
COLUMNS = ("shape", "unknowns", "options", "motions", "CPU s", "iterations")
NODAL = {"pc_hypre_boomeramg_nodal_coarsen": 4}
TRIALS: dict[str, tuple[dict[str, Any], bool]] = {
    "BoomerAMG of scalars": (HYPRE, True),
    "BoomerAMG, classical": (CLASSICAL, True),
    "BoomerAMG, nodal": (CLASSICAL | NODAL, True),
    "GAMG without motions": (GAMG, False),
    "GAMG": (GAMG, True),
    "GAMG, sweeps": (VECTORS, True),
    "GAMG, sweeps, threshold": (VECTORS | {"pc_gamg_threshold": 0.02}, True),
    "GAMG, sweeps, aggressive": (VECTORS | {"pc_gamg_aggressive_coarsening": 2}, True),
}


def body(shape: Shape, factor: float, poisson: float) -> ContactProblem:
    """A body whose upper side is held, with contact below."""
    domain = mesh_of(COMM, shape, factor)
    size = domain.geometry.dim
    low, high = box(COMM, domain.geometry.x)[:, size - 1]
    space = fem.functionspace(domain, ("Lagrange", shape.degree, (size,)))
    above, below = (
        dolfinx.mesh.locate_entities_boundary(
            domain, size - 1, lambda x, z=z: np.isclose(x[size - 1], z)
        )
        for z in (high, low)
    )
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    dofs = fem.locate_dofs_topological(space, size - 1, above)
    down = fem.Constant(domain, (0.0,) * (size - 1) + (-1.0,))
    return ContactProblem(
        elasticity(u, v, young=200.0, poisson=poisson),
        ufl.inner(down, v) * ufl.dx,
        contact=below,
        bcs=[fem.dirichletbc(np.zeros(size), dofs, space)],
    )


def seconds(
    problem: ContactProblem, options: dict[str, Any], motions: bool, prefix: str
) -> tuple[float, int]:
    """The CPU seconds of a solve, and its iterations."""
    system, x = problem.system, problem.system.start()
    held = np.zeros(len(system.contact_dofs), dtype=bool)
    held[::2] = True
    saved = iterative.amg_options, iterative.attach_motions
    iterative.amg_options = lambda *_, **__: options
    if not motions:
        iterative.attach_motions = multigrid.attach_motions = lambda *_: None
    start = time.process_time()
    try:
        solver = IterativeSolver(system, prefix)
        solver.solve(system, x, held, 1e-8 * system.b.norm())
    finally:
        iterative.amg_options, iterative.attach_motions = saved
        multigrid.attach_motions = saved[1]
    taken, count = time.process_time() - start, int(solver.iterations)
    solver.destroy()
    x.destroy()
    return taken, count


def main() -> None:
    """Measure and print."""
    options = parser(__doc__ or "", None, repeats=2)
    known = SHAPES | TRIED
    default = ["plate", "cube", "plate, P2", "cube, P2"]
    options.add_argument("--shapes", nargs="+", default=default, choices=list(known))
    options.add_argument("--size", type=float, default=1.0, help="times the sizes of cells")
    options.add_argument("--poisson", type=float, default=0.3)
    args, rows = options.parse_args(), []
    for name in args.shapes:
        problem = body(known[name], args.size, args.poisson)
        for way, (chosen, motions) in TRIALS.items():
            runs = [
                seconds(problem, chosen, motions, f"trial_{len(rows)}_{k}_")
                for k in range(args.repeats)
            ]
            rows.append([name, problem.unknowns, way, motions, min(runs)[0], runs[0][1]])
            if COMM.rank == 0:
                print(*rows[-1], sep="  ", flush=True)
        problem.destroy()
    title = "algebraic multigrid for vectors"
    report(COMM, "elastic_amg", title, COLUMNS, rows, {"rows": rows})


if __name__ == "__main__":
    main()
