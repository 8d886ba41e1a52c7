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
from statistics import median
from typing import Any

import numpy as np
import ufl
from amg import AMG
from common import cg_solve, parser, report, spread, timed
from dolfinx import fem
from mpi4py import MPI
from peers import snes, tao
from shapes import SHAPES, TRIED, Shape, mesh_of

from dolfinx_signorini import SignoriniProblem, bernstein_space, boundary_facets
from dolfinx_signorini.problem.signorini import DEFAULT_RTOL
from dolfinx_signorini.solvers.linear.algebraic import HYPRE

COLUMNS = (
    *("shape", "degree", "unknowns", "touching", "contact s", "linear s", "best AMG"),
    *("ratio", "free ratio", "solves", "iterations", "set-ups"),
)
FAR = -1e3  # of the obstacle of a problem in which nothing touches


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


def active_sets(problem: SignoriniProblem, rtol: float) -> None:
    """The plain primal-dual active set method, with a new matrix and set-up for each set."""
    A, b, dofs, g = problem.A, problem.b, problem.contact_dofs, problem.obstacle
    x, r, held = b.duplicate(), b.duplicate(), np.full(len(dofs), True)
    diagonal = A.getDiagonal().array_r[dofs]
    first, atol = A.getOwnershipRange()[0], rtol * b.norm()
    for _ in range(60):
        x.set(0.0)
        x.array_w[dofs[held]] = g[held]
        matrix, load = A.copy(), b.copy()
        matrix.zeroRowsColumns(dofs[held] + first, diag=float(diagonal.mean()), x=x, b=load)
        cg_solve(matrix, load, HYPRE, 0.5 * atol / load.norm(), x)
        matrix.destroy()
        load.destroy()
        A.mult(x, r)
        r.axpy(-1.0, b)
        force, gap = r.array_r[dofs].copy(), diagonal * (x.array_r[dofs] - g)
        r.array_w[dofs] = np.minimum(force, gap)
        if r.norm() <= atol:
            break
        held = force > gap


# What else one would use from a cold start, with the same algebraic multigrid.
PEERS = {
    "SNES vinewtonrsls": snes("vinewtonrsls", "cg", HYPRE),
    "SNES vinewtonssls": snes("vinewtonssls", "gmres", HYPRE),
    "TAO bntr": tao("bntr"),
    "active sets": active_sets,
}


def measure_peers(comm: MPI.Comm, name: str, shape: Shape, factor: float, seed: int) -> list[Any]:
    """Measure the peers and the contact solve on a shape, once each, for a residual of 1e-7."""
    domain = mesh_of(comm, shape, factor)
    free = pose(domain, shape.degree, seed)
    free.solve()
    offset = touching_offset(free, seed)
    free.destroy()
    problem = pose(domain, shape.degree, seed, offset)
    contact = timed(comm, problem.solve)[0]
    figures: list[Any] = [name, problem.unknowns, contact]
    for peer in PEERS.values():
        spent = timed(comm, peer, problem, DEFAULT_RTOL)[0]
        figures += [spent, spent / contact]
    problem.destroy()
    return figures


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
            spent, (*_, iterations) = timed(comm, cg_solve, problem.A, problem.b, options)
            seconds.setdefault(amg, []).append(spent if iterations < math.inf else math.inf)
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
    options.add_argument("--peers", action="store_true", help="beside SNES, TAO and active sets")
    args = options.parse_args()
    comm, rows, results = MPI.COMM_WORLD, [], []
    for number, name in enumerate(args.shapes):
        shape = known[name]
        if args.peers:
            measure_peers(comm, name, shape, 4.0 * args.size, args.seed)
            rows.append(measure_peers(comm, name, shape, args.size, args.seed + number))
            if comm.rank == 0:
                print(*rows[-1], sep="  ", flush=True)
            continue
        measure(comm, name, shape, 4.0 * args.size, args.seed, 1)
        r = measure(comm, name, shape, args.size, args.seed + number, args.repeats)
        results.append(r)
        contact, linear = (r["seconds"][key]["median"] for key in ("contact", r["best"]))
        figures = (r[key] for key in ("ratio", "free_ratio", "solves", "iterations", "setups"))
        problem = name, r["degree"], r["unknowns"], r["touching"]
        rows.append((*problem, contact, linear, r["best"], *figures))
        if comm.rank == 0:
            print(*rows[-1], r["phases"], sep="  ", flush=True)
    if args.peers:
        columns = ["shape", "unknowns", "contact s"]
        columns += [head for peer in PEERS for head in (f"{peer} s", "/ contact")]
        title = "cold starts on any mesh"
        report(comm, "any_mesh_peers", title, columns, rows, {"seed": args.seed, "rows": rows})
        return
    title = f"contact on any mesh over the best linear solve, medians of {args.repeats}"
    report(comm, "any_mesh", title, COLUMNS, rows, {"seed": args.seed, "results": results})


if __name__ == "__main__":
    main()
