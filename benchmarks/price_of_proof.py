"""The price of a proven bound: over mesh, matrix and solve of the same problem.

    ./with-dolfinx python3 benchmarks/price_of_proof.py [--plane 501] [--space 29] [--repeats 3]

The numerator is `energy_bound` alone, the denominator all that gives the solution: mesh, assembly
and the cascade, or on meshes refined towards a corner one solve from nothing. Both are timed in
one process after a run of the same size, in which forms are compiled and memory is new. The load is
a polynomial that presses a part of the boundary down and lifts the rest.
"""

import argparse
from collections.abc import Callable
from functools import partial

import numpy as np
import ufl
from common import contact_solve, report, spread, timed
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini import (
    EnergyTerms,
    SignoriniProblem,
    boundary_facets,
    energy_bound,
    friedrichs_keller,
)

LOAD = 40.0  # a load of the size of those of `common.SCENES`
CORNER = 8  # cells across, where meshes begin that are refined towards a corner


def posed(degree: int, make: Callable[[int], mesh.Mesh], n: int) -> SignoriniProblem:
    """Pose the problem on the mesh of a size."""
    domain = make(n)
    space = fem.functionspace(domain, ("Lagrange", degree))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    return SignoriniProblem(
        a, load(domain) * v * ufl.dx, contact=boundary_facets(domain), obstacle=0.0
    )


def load(domain: mesh.Mesh) -> ufl.core.expr.Expr:
    """Return the load, a linear function."""
    x = ufl.SpatialCoordinate(domain)
    return LOAD * (0.35 - x[0] + 0.2 * x[1])


def square(comm: MPI.Comm, n: int) -> mesh.Mesh:
    """Return a uniform mesh of the unit square."""
    return friedrichs_keller(comm, n - 1)


def cube(comm: MPI.Comm, n: int) -> mesh.Mesh:
    """Return a uniform mesh of the unit cube."""
    return mesh.create_unit_cube(comm, n - 1, n - 1, n - 1)


def refined(comm: MPI.Comm, n: int) -> mesh.Mesh:
    """Return a mesh of the unit square with about n^2 vertices, refined towards a corner."""
    domain, radius = mesh.create_unit_square(comm, CORNER, CORNER), 1.0
    while domain.topology.index_map(0).size_global < n**2:
        domain.topology.create_entities(1)
        edges = mesh.locate_entities(domain, 1, lambda x, r=radius: np.hypot(*x[:2]) < r)
        domain, radius = mesh.refine(domain, edges)[0], 0.8 * radius
        radius = max(radius, 0.3)  # so that the cells become more there, too
    return domain


def solved(pose: Callable[[int], SignoriniProblem], n: int, uniform: bool) -> SignoriniProblem:
    """Return the solved problem, from nothing."""
    problem = pose(n)
    if uniform:
        contact_solve(problem, pose, n, None)
    else:
        problem.solve()
    return problem


def main() -> None:
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--plane", type=int, default=501, help="unknowns across")
    options.add_argument("--space", type=int, default=29, help="unknowns across")
    options.add_argument("--degrees", type=int, nargs="+", default=[1, 2, 3])
    options.add_argument("--repeats", type=int, default=3)
    args = options.parse_args()
    comm, rows, results = MPI.COMM_WORLD, [], []
    shapes = {"square": (square, args.plane), "refined": (refined, args.plane)}
    for name, (shape, across) in (shapes | {"cube": (cube, args.space)}).items():
        for degree in args.degrees:
            pose, n = partial(posed, degree, partial(shape, comm)), 1 + (across - 1) // degree
            seconds: dict[str, list[float]] = {"solution": [], "bound": []}
            for k in range(args.repeats + 1):  # the first one compiles forms and touches memory
                elapsed, problem = timed(comm, solved, pose, n, name != "refined")
                terms = EnergyTerms(reaction=1.0, load=load(problem.space.mesh))
                more, bound = timed(comm, energy_bound, problem, terms)
                if k:
                    seconds["solution"].append(elapsed)
                    seconds["bound"].append(more)
                unknowns = problem.unknowns
                problem.destroy()
            pairs = zip(seconds["bound"], seconds["solution"], strict=True)
            ratio = spread([b / s for b, s in pairs])
            middle = {what: spread(values) for what, values in seconds.items()}
            results.append(
                {"mesh": name, "degree": degree, "unknowns": unknowns, "total": bound.total}
                | {"ratio": ratio}
                | middle
            )
            rows.append(
                (name, degree, unknowns, *(m["median"] for m in middle.values()), ratio["median"])
            )
    columns = ("mesh", "degree", "unknowns", "solution s", "bound s", "bound / solution")
    title = f"the price of a bound, medians of {args.repeats}"
    report(comm, "price_of_proof", title, columns, rows, {"results": results})


if __name__ == "__main__":
    main()
