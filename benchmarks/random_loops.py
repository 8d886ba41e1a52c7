"""Loops of random changes, where every step is held against reactions that DOLFINx assembles anew.

    ./with-dolfinx python3 benchmarks/random_loops.py [--loops 1000] [--seed 0]
    ./with-dolfinx mpirun -n 3 python3 benchmarks/random_loops.py --loops 50

A loop poses a problem of a random mesh, element, form, contact boundary and obstacle, and changes
the obstacle, the load, the Dirichlet data, the coefficients of the form, or several of them, from
step to step: steadily, slowly, to and fro, at random or with a jump. Some steps start from nothing,
and some follow a value that was refused. The check knows the forms and the data, and takes of the
package the functions that it hands out and the residual that it asked for. The exit code is 1 if a
step failed.
"""

import argparse
import sys
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc
from random_problems import COMM, RTOLS, STEPS, Loop, random_loop

from dolfinx_signorini import InputError, NotConvergedError
from dolfinx_signorini.base.tables import text_table

Array = npt.NDArray[np.float64]

PRECISION = float(np.finfo(np.float64).eps)
ROUNDING = 64.0 * PRECISION  # the documented one of A u
LOOSEST = 1e-4  # a residual that rounding does not spoil where a problem makes sense
SUMS = 16.0 * PRECISION  # of the products of a row: matrices that are assembled twice differ


def summed(value: float) -> float:
    return float(COMM.allreduce(float(value)))


def norm(values: Array) -> float:
    return float(np.sqrt(summed(float(values @ values))))


def on_contact(loop: Loop, u: fem.Function) -> float:
    """The integral of a function over the contact facets."""
    domain, marks = loop.problem.space.mesh, np.ones(len(loop.facets), dtype=np.int32)
    tags = mesh.meshtags(domain, domain.topology.dim - 1, loop.facets, marks)
    over = ufl.Measure("ds", domain, subdomain_data=tags)
    return summed(fem.assemble_scalar(fem.form(u * over(1))))


class Reactions:
    """What DOLFINx says of the u that a problem hands out: reactions, gaps and their sizes."""

    def __init__(self, loop: Loop, rtol: float):
        space, dofs = loop.problem.space, loop.dofs
        owned = space.dofmap.index_map.size_local
        A = fem_petsc.assemble_matrix(fem.form(loop.a))
        b = fem_petsc.assemble_vector(fem.form(loop.L))
        A.assemble()
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        self.u, load = loop.problem.u.x.array[:owned].copy(), b.array_r.copy()

        def times(values: Array) -> Array:
            x, y = A.createVecs()
            x.array_w[:] = values
            A.mult(x, y)
            found = y.array_r.copy()
            for item in (x, y):
                item.destroy()
            return np.asarray(found)

        diagonal = A.getDiagonal()
        self.diagonal = diagonal.array_r[dofs].copy()
        held = np.zeros(owned)
        held[loop.fixed] = self.u[loop.fixed]
        lifted = load - times(held)
        lifted[loop.fixed] = 0.0
        self.all = times(self.u) - load  # reactions at Dirichlet dofs, too
        size = norm(self.u * diagonal.array_r)
        self.multiplier = loop.sign * self.all[dofs]
        self.obstacle = loop.sign * loop.obstacle.x.array[dofs]
        self.gap = loop.sign * self.u[dofs] - self.obstacle
        pushing = norm(self.diagonal * np.maximum(self.obstacle, 0.0))
        forced = norm(self.multiplier[self.multiplier > self.diagonal * self.gap])
        scale = max(norm(lifted) + min(pushing, forced), ROUNDING / rtol * pushing)
        self.asked, self.rounding = (
            rtol * (scale if scale > 0.0 else 1.0),
            SUMS * (size + norm(load)),
        )
        self.tolerance = self.asked + self.rounding
        for item in (A, b, diagonal):
            item.destroy()


def faults(loop: Loop, found: Reactions) -> tuple[list[str], float]:
    """What is wrong with the solution that the problem hands out, and the force missed.

    Returns:
        The faults, the same on all ranks, and by how much the total force misses the balance with
        load and Dirichlet reactions, relative to what the tolerance explains.
    """
    problem = loop.problem
    dofs, tolerance, count = loop.dofs, found.tolerance, problem.unknowns
    owned = len(found.u)
    forces, gap, pressure = (
        item.x.array[:owned] for item in (problem.forces, problem.gap, problem.pressure)
    )
    left = found.all.copy()
    left[dofs] -= loop.sign * forces[dofs]
    left[loop.fixed] = 0.0
    residual = found.all.copy()
    residual[dofs] = np.minimum(found.diagonal * found.gap, found.multiplier)
    residual[loop.fixed] = 0.0
    total, integral = summed(forces.sum()), on_contact(loop, problem.pressure)
    balance = summed(fem.assemble_scalar(fem.form(loop.balance)))
    explained = np.sqrt(count) * tolerance
    missed = abs(problem.force + summed(found.all[loop.fixed].sum()) - balance) / explained
    highest = np.max(abs(np.concatenate((found.obstacle, found.u[dofs]))), initial=0.0)
    near = ROUNDING * COMM.allreduce(float(highest), op=MPI.MAX)
    active, others = problem.active, np.setdiff1d(dofs, problem.active)
    undecided = abs(found.multiplier - found.diagonal * found.gap) <= tolerance
    held = np.isin(dofs, active)
    shared = loop.names["cells"] == "tetrahedra" and loop.names["basis"] == "nodal"
    tests = {
        "residual": norm(residual) > 1.01 * tolerance,
        "forces are no reactions": norm(left) > 1.01 * tolerance,
        "balance": missed > 1.01,
        "total force": abs(loop.sign * total - problem.force) > ROUNDING * abs(total) * count,
        "gap below 0": (found.gap < -near).any() or (gap < 0.0).any(),
        "gap": (abs(gap[dofs] - np.maximum(found.gap, 0.0)) > near).any(),
        "pull": (forces < 0.0).any() or (pressure < 0.0).any(),
        "complementarity": np.any(gap[forces > 0.0]),
        "forces elsewhere": np.any(np.delete(forces, dofs)),
        "pressure integral": abs(integral - total) > ROUNDING * count * abs(total),
        "force without pressure": np.any(forces[dofs][pressure[dofs] == 0.0]),
        "pressure without force": not shared and np.any(pressure[dofs][forces[dofs] == 0.0]),
        "active without contact": np.any(gap[active]),
        "contact not active": (gap[others] == 0.0).any() or np.any(forces[others]),
        "active set": (held != (found.multiplier > found.diagonal * found.gap))[~undecided].any(),
        "count": COMM.allreduce(len(active)) != problem.result.active_dofs,
    }
    wrong = COMM.allreduce(np.array([int(value) for value in tests.values()]))
    return [name for name, bad in zip(tests, wrong, strict=True) if bad], missed


def refused(loop: Loop) -> bool:
    """Whether a load that is no number is refused, with the number put back afterwards."""
    value = float(loop.numbers["load"].value)
    loop.numbers["load"].value = np.nan
    try:
        loop.problem.solve()
    except InputError:
        return True
    finally:
        loop.numbers["load"].value = value
    return False


def step_faults(loop: Loop, warm: bool) -> tuple[list[str], float]:
    """Solve, and return what is wrong, see `faults`.

    A residual that rounding does not allow may be refused by a NotConvergedError; ten times as much
    is asked for then.
    """
    rtol, default = RTOLS[loop.names["rtol"]], loop.names["rtol"] == "default"
    try:
        loop.problem.solve(rtol=None if default else rtol, warm_start=warm)
        return faults(loop, Reactions(loop, rtol))
    except NotConvergedError as error:
        refused_at = rtol
        while True:
            try:
                rtol *= 10.0
                loop.problem.solve(rtol=rtol)
                break
            except NotConvergedError:
                refused_at = rtol
                if rtol > LOOSEST:
                    raise error from None
    allowed = Reactions(loop, refused_at)
    wrong, share = faults(loop, Reactions(loop, rtol))
    return [*wrong, *["not reached"] * (allowed.asked > allowed.rounding)], share


def run(seed: int, number: int) -> tuple[dict[str, str], list[tuple[int, str]], list[float]]:
    """Run a loop; return what it is, the failures with their steps, and the forces missed."""
    rng = np.random.default_rng([seed, number])
    loop = random_loop(rng)
    failures: list[tuple[int, str]] = []
    missed = []
    for step in range(STEPS):
        loop.move(step)
        event = rng.random()
        if event < 0.03 and not refused(loop):
            failures.append((step, "NaN not refused"))
        try:
            wrong, share = step_faults(loop, event < 0.97)
        except Exception as error:
            wrong, share = [f"{type(error).__name__}: {str(error)[:200]}"], 0.0
        failures += [(step, name) for name in wrong]
        missed.append(share)
    loop.problem.destroy()
    return loop.names, failures, missed


def rows(results: Sequence[Any]) -> list[list[Any]]:
    """A row for all loops, and for those of each element, change, law and so on."""
    groups: dict[tuple[str, str], list[Any]] = defaultdict(list)
    for names, failures, missed in results:
        element = f"{names['cells']}, {names['basis']}, degree {names['degree']}"
        kinds = ("change", "law", "obstacle", "bound", "rtol", "Dirichlet", "singular")
        for key in [("", "all"), *((k, names[k]) for k in kinds), ("~element", element)]:
            groups[key].append((failures, missed))
    made = []
    for (kind, name), loops in sorted(groups.items()):
        shares = [share for _, missed in loops for share in missed]
        bad = sum(len({step for step, _ in failures}) for failures, _ in loops)
        title = f"{kind.strip('~')}: {name}" if kind else name
        made.append([title, len(loops), len(shares), max(shares), bad])
    return made


def main() -> None:
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("--loops", type=int, default=1000)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--only", type=int, help="the number of one loop to run")
    args = options.parse_args()
    results = []
    for number in range(args.loops) if args.only is None else [args.only]:
        results.append(run(args.seed, number))
        names, failures, _ = results[-1]
        if COMM.rank == 0 and failures:
            print(f"loop {number}: {names}\n  {failures}", file=sys.stderr, flush=True)
        elif COMM.rank == 0 and number % 10 == 9:
            print(f"{number + 1} loops", file=sys.stderr, flush=True)
    counts = Counter(name.split(":")[0] for _, failures, _ in results for _, name in failures)
    if COMM.rank == 0:
        head = ["loops", "number", "steps", "force missed / tolerance", "steps that failed"]
        print(text_table(head, rows(results), f"seed {args.seed}, {COMM.size} ranks"), end="")
        print("failures:", ", ".join(f"{n} {name}" for name, n in counts.items()) or "none")
    sys.exit(bool(counts))


if __name__ == "__main__":
    main()
