"""Algebraic multigrid of PETSc on matrices of many kinds: which options a contact solve is to have.

    ./with-dolfinx python3 benchmarks/amg.py
    ./with-dolfinx mpirun -n 2 python3 benchmarks/amg.py --shapes plate cube

CG from zero to a residual of 1e-8, the set-up apart from the iterations: for plain problems, a
diffusion that jumps by 1e6 in a chequered pattern, and one that is 100 times larger along the first
axis, with degree 1, and for plain problems of the degrees 2 to 4 in the Bernstein basis.
"""

from statistics import median
from typing import Any

import ufl
from common import cg_solve, parser, report
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc
from shapes import SHAPES, TRIED, Shape, mesh_of

from dolfinx_signorini import bernstein_space
from dolfinx_signorini.solvers.linear.algebraic import CLASSICAL, HYPRE

COLUMNS = (
    *("shape", "problem", "unknowns", "options", "set-up MB"),
    *("set-up s", "CG s", "iterations", "total s"),
)
DEGREES = (2, 3, 4)
AGGRESSIVE = {"pc_hypre_boomeramg_agg_nl": 1, "pc_hypre_boomeramg_agg_num_paths": 1}
# Of PETSc, as people who know its algebraic multigrid set it up; the first ones are its defaults.
AMG: dict[str, dict[str, Any]] = {
    "BoomerAMG": {"pc_type": "hypre"},
    "GAMG": {"pc_type": "gamg"},
    "one sweep": CLASSICAL,
    "HMIS": HYPRE | {"pc_hypre_boomeramg_agg_nl": 0},
    "HMIS, one path": HYPRE | AGGRESSIVE,
    "HMIS, one path, 0.5": HYPRE | AGGRESSIVE | {"pc_hypre_boomeramg_strong_threshold": 0.5},
    "HMIS, two paths": HYPRE,
}


def system(domain: Any, degree: int, kind: str) -> tuple[PETSc.Mat, PETSc.Vec]:
    """The matrix and the load of a problem without Dirichlet data."""
    space = bernstein_space(domain, degree)
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    form = ufl.inner(ufl.grad(u), ufl.grad(v))
    if kind == "contrast":
        positive = ufl.gt(ufl.sin(9 * x[0]) * ufl.sin(7 * x[1]), 0.0)
        form = ufl.conditional(positive, 1.0, 1e6) * form
    if kind == "anisotropic":
        form += 99.0 * u.dx(0) * v.dx(0)
    A = fem_petsc.assemble_matrix(fem.form((form + u * v) * ufl.dx))
    A.assemble()
    load = (1.0 + x[0]) * ufl.sin(5 * x[1]) * v * ufl.dx(metadata={"quadrature_degree": 4})
    b = fem_petsc.assemble_vector(fem.form(load))
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    return A, b


def cases(comm: MPI.Comm, shape: Shape, size: float) -> Any:
    """The problems on a shape: their kind, matrix and load."""
    domain = mesh_of(comm, shape, size)
    for kind in ("plain", "contrast", "anisotropic"):
        yield kind, *system(domain, 1, kind)
    for degree in DEGREES:
        domain = mesh_of(comm, shape, degree * size)
        yield f"degree {degree}", *system(domain, degree, "plain")


def main() -> None:
    options = parser(__doc__ or "", None, repeats=3)
    known = SHAPES | TRIED
    default = ["plate", "graded to a side", "cube", "thin plate"]
    options.add_argument("--shapes", nargs="+", default=default, choices=list(known))
    options.add_argument("--size", type=float, default=1.0, help="times the sizes of cells")
    args = options.parse_args()
    comm, rows = MPI.COMM_WORLD, []
    for name in args.shapes:
        for kind, A, b in cases(comm, known[name], args.size):
            for way, chosen in AMG.items():
                runs = [cg_solve(A, b, chosen) for _ in range(args.repeats)]
                size, setup, iterating, count = map(median, zip(*runs, strict=True))
                figures = size / 1e6, setup, iterating, count, setup + iterating
                rows.append([name, kind, A.getSize()[0], way, *figures])
                if comm.rank == 0:
                    print(*rows[-1], sep="  ", flush=True)
            A.destroy()
            b.destroy()
    report(comm, "amg", "algebraic multigrid", COLUMNS, rows, {"rows": rows})


if __name__ == "__main__":
    main()
