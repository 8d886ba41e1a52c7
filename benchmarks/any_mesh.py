"""What contact costs on meshes from gmsh that have no coarser levels, from nothing.

    python3 benchmarks/any_mesh.py                      # ten meshes, some minutes
    python3 benchmarks/any_mesh.py --shapes plate cube --size 0.3 --seed 7
    python3 benchmarks/any_mesh.py --peers              # SNES and TAO with the same AMG as well

The numerator is the first `solve` of a problem: all that contact needs beyond the assembled matrix.
The denominator is the fastest of some CG solves of the same matrix from zero to a residual of 1e-8,
each with another algebraic multigrid of PETSc, its set-up included. Obstacles and loads are random
smooth functions of a seed. "free" is the same problem with the obstacle out of reach.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

import gmsh
import numpy as np
import ufl
from common import parser, report, spread, timed
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini import SignoriniProblem, bernstein_space, boundary_facets
from dolfinx_signorini.base.compat import gmsh_mesh
from dolfinx_signorini.solvers.linear.options import options_set

COLUMNS = (
    *("shape", "degree", "unknowns", "touching", "contact s", "linear s", "best AMG"),
    *("ratio", "free ratio", "solves", "iterations", "set-ups"),
)
# Algebraic multigrid of PETSc, as people who know it set it up.
HMIS = {
    "pc_type": "hypre",
    "pc_hypre_boomeramg_strong_threshold": 0.5,
    "pc_hypre_boomeramg_coarsen_type": "HMIS",
    "pc_hypre_boomeramg_interp_type": "ext+i",
    "pc_hypre_boomeramg_P_max": 4,
    "pc_hypre_boomeramg_agg_nl": 1,
}
SWEEPS = {
    "pc_hypre_boomeramg_relax_type_down": "l1-Gauss-Seidel",
    "pc_hypre_boomeramg_relax_type_up": "backward-l1-Gauss-Seidel",
}
AMG: dict[str, dict[str, Any]] = {
    "BoomerAMG": {"pc_type": "hypre"},
    "BoomerAMG, one sweep": {"pc_type": "hypre"} | SWEEPS,
    "HMIS": HMIS,
    "HMIS, one sweep": HMIS | SWEEPS,
    "GAMG": {"pc_type": "gamg"},
}


@dataclass(frozen=True)
class Shape:
    """A geometry of gmsh with sizes of cells.

    Attributes:
        draw: Draws the geometry, and returns the function of the sizes or None.
        dimension: Of space.
        size: Of the cells.
        degree: Of the elements.
    """

    draw: Callable[[], Callable[[float, float, float], float] | None]
    dimension: int
    size: float
    degree: int = 1


def _plate(holes: list[tuple[float, float, float]], width: float = 2.0) -> Callable[[], None]:
    def draw() -> None:
        occ = gmsh.model.occ
        body = [(2, occ.addRectangle(0.0, 0.0, 0.0, width, 1.0))]
        cut = [(2, occ.addDisk(x, y, 0.0, r, r)) for x, y, r in holes]
        if cut:
            occ.cut(body, cut)

    return draw


def _airfoil() -> Callable[[float, float, float], float]:
    """A box around a thick symmetric profile, with small cells at its nose."""
    occ, t = gmsh.model.occ, 0.18
    xs = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, 24)))
    half = (
        5.0
        * t
        * (0.2969 * np.sqrt(xs) - 0.126 * xs - 0.3516 * xs**2 + 0.2843 * xs**3 - 0.1036 * xs**4)
    )
    upper = [occ.addPoint(x, y, 0.0) for x, y in zip(xs, half, strict=True)]
    lower = [occ.addPoint(x, -y, 0.0) for x, y in zip(xs[1:-1], half[1:-1], strict=True)]
    curves = [occ.addSpline(upper), occ.addSpline([upper[0], *lower, upper[-1]])]
    profile = occ.addPlaneSurface([occ.addCurveLoop(curves)])
    occ.cut([(2, occ.addRectangle(-1.0, -1.0, 0.0, 3.0, 2.0))], [(2, profile)])
    return lambda x, y, z: 0.15 + min(math.hypot(x, y), 1.5)


def _graded() -> Callable[[float, float, float], float]:
    gmsh.model.occ.addRectangle(0.0, 0.0, 0.0, 1.0, 1.0)
    return lambda x, y, z: 0.04 + y


def _ball_cut_out() -> None:
    occ = gmsh.model.occ
    occ.cut([(3, occ.addBox(0, 0, 0, 1, 1, 1))], [(3, occ.addSphere(0.55, 0.5, 0.45, 0.3))])


def _bracket() -> None:
    occ = gmsh.model.occ
    occ.fuse([(3, occ.addBox(0, 0, 0, 1, 0.3, 1))], [(3, occ.addBox(0, 0, 0, 1, 1, 0.3))])


def _cube() -> None:
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)


def _cube_graded() -> Callable[[float, float, float], float]:
    _cube()
    return lambda x, y, z: 0.3 + z


SHAPES = {
    "plate, one hole": Shape(_plate([(0.7, 0.45, 0.2)]), 2, 0.0037),
    "plate, five holes": Shape(
        _plate(
            [
                (0.3, 0.3, 0.1),
                (0.8, 0.7, 0.15),
                (1.1, 0.25, 0.12),
                (1.6, 0.6, 0.2),
                (0.4, 0.75, 0.08),
            ]
        ),
        2,
        0.0042,
    ),
    "airfoil": Shape(_airfoil, 2, 0.008),
    "graded to a side": Shape(_graded, 2, 0.006),
    "plate, a million": Shape(_plate([(1.3, 0.5, 0.25)]), 2, 0.00155),
    "plate, two holes, P2": Shape(_plate([(0.5, 0.5, 0.2), (1.5, 0.4, 0.15)]), 2, 0.0085, 2),
    "ball cut out": Shape(_ball_cut_out, 3, 0.026),
    "L-shaped solid": Shape(_bracket, 3, 0.018),
    "thin plate": Shape(lambda: gmsh.model.occ.addBox(0, 0, 0, 1, 1, 0.06) and None, 3, 0.0105),
    "cube, graded, P2": Shape(_cube_graded, 3, 0.062, 2),
}
FAR = -1e3  # of the obstacle of a problem in which nothing touches
# Shapes that settings were tried on.
TRIED = {
    "plate": Shape(_plate([(1.0, 0.5, 0.25)]), 2, 0.0037),
    "cube": Shape(_cube, 3, 0.026),
    "plate, P2": Shape(_plate([(1.0, 0.5, 0.25)]), 2, 0.0085, 2),
    "cube, P2": Shape(_cube, 3, 0.058, 2),
}


def mesh_of(comm: MPI.Comm, shape: Shape, factor: float) -> Any:
    """Mesh a shape by gmsh, on rank 0."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Verbosity", 1)
    gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
    size = shape.size * factor
    if comm.rank == 0:
        sizes = shape.draw()
        gmsh.model.occ.synchronize()
        if sizes is not None:
            gmsh.model.mesh.setSizeCallback(lambda d, t, x, y, z, lc: size * sizes(x, y, z))
        gmsh.option.setNumber("Mesh.MeshSizeMax", size if sizes is None else 1.0)
        gmsh.model.addPhysicalGroup(
            shape.dimension, [tag for _, tag in gmsh.model.getEntities(shape.dimension)], 1
        )
        gmsh.model.mesh.generate(shape.dimension)
    domain, _ = gmsh_mesh(gmsh.model, comm, shape.dimension)
    gmsh.finalize()
    return domain


def waves(rng: np.random.Generator, x: Any, dimension: int, count: int = 4) -> Any:
    """A random smooth function of size 1."""
    total: Any = 0.0
    for _ in range(count):
        direction = rng.normal(size=dimension)
        direction *= rng.uniform(2.0, 9.0) / np.linalg.norm(direction)
        phase, share = float(rng.uniform(0.0, 2.0 * np.pi)), float(rng.normal() / count**0.5)
        total += share * ufl.sin(sum(float(d) * x[i] for i, d in enumerate(direction)) + phase)
    return total


def pose(domain: Any, degree: int, seed: int, offset: float = FAR) -> SignoriniProblem:
    """Pose a problem with a random obstacle and load on the whole boundary.

    Args:
        domain: The mesh.
        degree: Of the elements.
        seed: Of the random numbers.
        offset: What is added to the obstacle.
    """
    rng = np.random.default_rng(seed)
    space = fem.functionspace(domain, ("Lagrange", 1))
    if degree > 1:
        space = bernstein_space(domain, degree)
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    dimension = domain.geometry.dim
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + float(rng.uniform(0.1, 2.0)) * u * v) * ufl.dx
    load = float(rng.uniform(-2.0, 2.0)) + 10.0 * waves(rng, x, dimension)
    return SignoriniProblem(
        a,
        load * v * ufl.dx(metadata={"quadrature_degree": degree + 2}),
        contact=boundary_facets(domain),
        obstacle=0.2 * waves(rng, x, dimension) + fem.Constant(domain, offset),
    )


def touching_offset(problem: SignoriniProblem, seed: int) -> float:
    """Return the offset with which a random share of the boundary is below the obstacle.

    Args:
        problem: The solved problem with the obstacle out of reach.
        seed: Of the share.
    """
    gaps = problem.comm.allgather(problem.gap.x.array[problem.contact_dofs])
    share = np.random.default_rng(seed + 1000).uniform(0.1, 0.7)
    return FAR + float(np.quantile(np.concatenate(gaps), share))


def linear_solve(problem: SignoriniProblem, options: dict[str, Any]) -> int:
    """Solve A x = b from zero to a residual of 1e-8, and return the iterations."""
    x = problem.A.createVecRight()
    ksp = PETSc.KSP().create(problem.comm)
    ksp.setOptionsPrefix("any_mesh_")
    with options_set("any_mesh_", {"ksp_type": "cg"} | options):
        ksp.setOperators(problem.A)
        ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        ksp.setTolerances(rtol=1e-8, atol=0.0, max_it=200)
        ksp.setFromOptions()
        ksp.solve(problem.b, x)
    iterations = ksp.getIterationNumber() if ksp.getConvergedReason() > 0 else -1
    ksp.destroy()
    x.destroy()
    return int(iterations)


def measure(
    comm: MPI.Comm, name: str, shape: Shape, factor: float, seed: int, repeats: int
) -> dict[str, Any]:
    """Measure a shape: the solves in turn, some times over."""
    domain = mesh_of(comm, shape, factor)
    seconds: dict[str, list[float]] = {}
    result: Any = None
    for _ in range(repeats):
        free = pose(domain, shape.degree, seed)
        spent = timed(comm, free.solve)[0]
        seconds.setdefault("free", []).append(spent)
        problem = pose(domain, shape.degree, seed, touching_offset(free, seed))
        for amg, options in AMG.items():
            spent, iterations = timed(comm, linear_solve, problem, options)
            seconds.setdefault(amg, []).append(spent if iterations > 0 else math.inf)
        seconds.setdefault("contact", []).append(timed(comm, problem.solve)[0])
        result = problem.result

        touching = result.active_dofs / max(comm.allreduce(len(problem.contact_dofs)), 1)
        unknowns = problem.unknowns
        problem.destroy()
        free.destroy()
    best = min(AMG, key=lambda amg: median(seconds[amg]))
    pairs = zip(seconds["contact"], seconds["free"], seconds[best], strict=True)
    ratios = [(c / x, f / x) for c, f, x in pairs]
    return {
        "shape": name,
        "degree": shape.degree,
        "unknowns": unknowns,
        "touching": touching,
        "seconds": {key: spread(values) for key, values in seconds.items()},
        "best": best,
        "ratio": median(r for r, _ in ratios),
        "free_ratio": median(f for _, f in ratios),
        "solves": result.linear_solves,
        "iterations": result.linear_iterations,
        "setups": result.setups,
        "phases": result.seconds,
    }


def main() -> None:
    """Measure and print."""
    options = parser(__doc__, None, repeats=3)
    known = SHAPES | TRIED
    options.add_argument("--shapes", nargs="+", default=list(SHAPES), choices=list(known))
    options.add_argument("--size", type=float, default=1.0, help="times the sizes of cells")
    options.add_argument("--seed", type=int, default=1)
    args = options.parse_args()
    comm, rows, results = MPI.COMM_WORLD, [], []
    for number, name in enumerate(args.shapes):
        shape = known[name]
        measure(comm, name, shape, 4.0 * args.size, args.seed, 1)
        r = measure(comm, name, shape, args.size, args.seed + number, args.repeats)
        results.append(r)
        contact, linear = (r["seconds"][key]["median"] for key in ("contact", r["best"]))
        figures = (r[key] for key in ("ratio", "free_ratio", "solves", "iterations", "setups"))
        problem = name, r["degree"], r["unknowns"], r["touching"]
        rows.append((*problem, contact, linear, r["best"], *figures))
        if comm.rank == 0:
            print(*rows[-1], r["phases"], sep="  ", flush=True)
    title = f"contact on any mesh over the best linear solve, medians of {args.repeats}"
    report(comm, "any_mesh", title, COLUMNS, rows, {"seed": args.seed, "results": results})


main()
