"""A step of a loop with contact, beside a step of the same loop without contact.

    ./with-dolfinx python3 benchmarks/time_steps.py [--cells 300] [--steps 200]
    ./with-dolfinx python3 benchmarks/time_steps.py --shape cube    # on a mesh of gmsh
    ./with-dolfinx python3 benchmarks/time_steps.py --contact domain
    ./with-dolfinx python3 benchmarks/time_steps.py --contact damage
    ./with-dolfinx python3 benchmarks/time_steps.py --contact body --steps 50
    ./with-dolfinx python3 benchmarks/time_steps.py --contact put --cells 1600

The problem is that of `demos/parabolic.py`, with the obstacle on a side or in the domain, that of
`demos/irreversible.py`, that of `demos/growing_load.py`, or that of `demos/american_put.py`. Both
loops make the same steps in turn in one process. The loop without contact has the best of what a
user would write: the matrix and the set-up of BoomerAMG with the contact solve's settings are made
once (for damage and for the put, whose matrices change, in each step), and CG starts from the last
solution and ends at the residual that the contact solve has to reach, 1e-7 of the load. On the
interval of the put a factorization takes the place of CG.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from common import parser, spread, timed, write_json
from dolfinx import fem, mesh
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc
from shapes import TRIED, mesh_of

from dolfinx_signorini import (
    ContactProblem,
    ObstacleProblem,
    SignoriniProblem,
    elasticity,
    friedrichs_keller,
)
from dolfinx_signorini.base.tables import text_table
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.problem.signorini import DEFAULT_RTOL
from dolfinx_signorini.solvers.linear.algebraic import amg_options
from dolfinx_signorini.solvers.linear.options import options_set

DT = 0.01


class Parabolic:
    """Forms of one implicit Euler step; `u` is the solution of the step before.

    Args:
        domain: The mesh.
        steps: The number of steps.
    """

    changes = False  # the matrix

    def __init__(self, domain: mesh.Mesh, steps: int):
        self.mesh, self.bcs = domain, []
        space = fem.functionspace(domain, ("Lagrange", 1))
        self.u, trial, v = fem.Function(space), ufl.TrialFunction(space), ufl.TestFunction(space)
        self.pump = fem.Constant(domain, (0.0, 0.2))
        dx = ufl.dx(metadata={"quadrature_degree": 4})
        x = ufl.SpatialCoordinate(domain)
        distance = ufl.as_vector((x[0], x[1])) - self.pump
        source = 5.0 - 100.0 * ufl.exp(-50.0 * ufl.inner(distance, distance))
        self.a = (trial * v + DT * ufl.inner(ufl.grad(trial), ufl.grad(v))) * dx
        self.L = (self.u + DT * source) * v * dx

    def move(self, step: int) -> None:
        """Move the pump to its place in a step."""
        self.pump.value[0] = 0.5 - 0.35 * np.cos(2.0 * np.pi * DT * (step + 1))

    def problem(self) -> BoundConstrainedProblem:
        """The problem with contact on the lower side."""
        wall = side(self.mesh, 1, 0.0)
        return SignoriniProblem(self.a, self.L, contact=wall, u=self.u)


class InDomain(Parabolic):
    """The same with the obstacle in the domain."""

    def problem(self) -> BoundConstrainedProblem:
        """The problem with contact in all cells."""
        return ObstacleProblem(self.a, self.L, lower=0.0, u=self.u)


class Damage:
    """Forms of damage that cannot heal: the last solution is the obstacle; see `Parabolic`."""

    changes = True

    def __init__(self, domain: mesh.Mesh, steps: int):
        self.mesh, self.steps, self.bcs = domain, steps, []
        space = fem.functionspace(domain, ("Lagrange", 1))
        self.u, self.last = fem.Function(space), fem.Function(space)
        trial, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        self.load, self.place = fem.Constant(domain, 0.0), fem.Constant(domain, (0.0, 0.5))
        distance = ufl.SpatialCoordinate(domain) - self.place
        stored = self.load * ufl.exp(-40.0 * ufl.inner(distance, distance))
        dx = ufl.dx(metadata={"quadrature_degree": 4})
        self.a = (2.0 * stored * trial * v + 0.2 * ufl.inner(ufl.grad(trial), ufl.grad(v))) * dx
        self.L = (2.0 * stored - 10.0) * v * dx

    def move(self, step: int) -> None:
        """Let the load grow and fall while its peak wanders."""
        time = (step + 1) / (self.steps + 1)
        self.load.value, self.place.value[0] = 60.0 * np.sin(np.pi * time), 0.2 + 0.6 * time
        self.last.x.array[:] = self.u.x.array

    def problem(self) -> BoundConstrainedProblem:
        """The problem with the last solution below."""
        return ObstacleProblem(self.a, self.L, lower=self.last, u=self.u)


class Body:
    """Forms of a block whose weight grows; see `Parabolic`."""

    changes = False

    def __init__(self, domain: mesh.Mesh, steps: int):
        self.mesh, self.steps, dim = domain, steps, domain.geometry.dim
        space = fem.functionspace(domain, ("Lagrange", 1, (dim,)))
        self.u, trial, v = fem.Function(space), ufl.TrialFunction(space), ufl.TestFunction(space)
        self.weight = fem.Constant(domain, 0.0)
        self.a = elasticity(trial, v, young=200.0, poisson=0.3)
        self.L = -self.weight * v[dim - 1] * ufl.dx
        above = fem.locate_dofs_topological(space, dim - 1, side(domain, dim - 1, 1.0))
        self.bcs = [fem.dirichletbc(np.zeros(dim), above, space)]

    def move(self, step: int) -> None:
        """Let the weight grow."""
        self.weight.value = 40.0 * (step + 1) / self.steps

    def problem(self) -> BoundConstrainedProblem:
        """The problem with contact with a bump below."""
        below = side(self.mesh, self.mesh.geometry.dim - 1, 0.0)
        gap = 0.2 * (ufl.SpatialCoordinate(self.mesh)[0] - 0.45) ** 2
        return ContactProblem(self.a, self.L, contact=below, gap=gap, bcs=self.bcs, u=self.u)


class Put:
    """Forms of an American put in steps of the method of Crank and Nicolson; see `Parabolic`."""

    changes = True

    def __init__(self, domain: mesh.Mesh, steps: int):
        self.mesh, self.steps = domain, steps
        space = fem.functionspace(domain, ("Lagrange", 1))
        self.u, trial, v = fem.Function(space), ufl.TrialFunction(space), ufl.TestFunction(space)
        self.u.interpolate(self.payoff)
        kept = self.u.copy()
        ends = fem.locate_dofs_geometrical(space, lambda x: np.isclose(np.abs(x[0]), 2.0))
        self.bcs = [fem.dirichletbc(kept, ends)]
        self.half = fem.Constant(domain, 1.0)  # of the time step
        rate, variance = 0.06, 0.04
        weight = ufl.exp((2.0 * rate / variance - 1.0) * ufl.SpatialCoordinate(domain)[0])
        dx = ufl.dx(domain, metadata={"quadrature_degree": 4})

        def energy(u: Any) -> Any:
            bending = 0.5 * variance * ufl.inner(ufl.grad(u), ufl.grad(v))
            return self.half * weight * (bending + rate * u * v)

        self.a = (weight * trial * v + energy(trial)) * dx
        self.L = (weight * self.u * v - energy(self.u)) * dx

    @staticmethod
    def payoff(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """What the put is worth at once, for a strike price of 40."""
        return np.maximum(40.0 - 40.0 * np.exp(x[0]), 0.0)

    def move(self, step: int) -> None:
        """Let the time steps grow, as the exercise boundary moves like a root of the time."""
        self.half.value = (step + 0.5) / self.steps**2

    def problem(self) -> BoundConstrainedProblem:
        """The problem with the pay-off below."""
        return ObstacleProblem(self.a, self.L, lower=self.payoff, bcs=self.bcs, u=self.u)


LOOPS = {"put": Put, "side": Parabolic, "domain": InDomain, "damage": Damage, "body": Body}


def side(domain: mesh.Mesh, axis: int, place: float) -> npt.NDArray[np.int32]:
    """The facets of a side at right angles to an axis."""
    facets = domain.topology.dim - 1
    return mesh.locate_entities_boundary(domain, facets, lambda x: np.isclose(x[axis], place))


class Contact:
    """The loop with contact."""

    def __init__(self, forms: Any):
        self.forms, self.problem = forms, forms.problem()

    def step(self, number: int) -> int:
        """Make a step, and return the CG iterations that the step took."""
        self.forms.move(number)
        self.problem.solve()
        return self.problem.result.linear_iterations


class Linear:
    """The loop without contact; the multigrid set-up is made once for each matrix."""

    def __init__(self, forms: Any):
        self.forms, self.a = forms, fem.form(forms.a)
        A = fem_petsc.assemble_matrix(self.a, bcs=forms.bcs)
        A.assemble()
        self.form, self.x = fem.form(forms.L), A.createVecRight()
        self.b = fem_petsc.create_vector(self.form)
        self.ksp = PETSc.KSP().create(forms.mesh.comm)
        self.ksp.setOptionsPrefix("linear_")
        space = forms.u.function_space
        block = space.dofmap.bs
        if block > 1:
            places = A.createVecLeft()
            places.setBlockSize(block)
            owned = space.dofmap.index_map.size_local
            places.array_w[:] = space.tabulate_dof_coordinates()[:owned, :block].ravel()
            A.setNearNullSpace(PETSc.NullSpace().createRigidBody(places))
        exact = {"ksp_type": "preonly", "pc_type": "lu"}
        amg = amg_options(block, alone=forms.mesh.comm.size == 1)
        with options_set("linear_", exact if forms.mesh.topology.dim == 1 else amg):
            self.ksp.setFromOptions()
        self.ksp.setOperators(A)
        if self.ksp.getType() != PETSc.KSP.Type.PREONLY:
            self.ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
            self.ksp.setTolerances(rtol=DEFAULT_RTOL, atol=0.0)
            self.ksp.setInitialGuessNonzero(True)

    def step(self, number: int) -> int:
        """Make a step, and return the CG iterations that the step took."""
        self.forms.move(number)
        if self.forms.changes:
            A, _ = self.ksp.getOperators()
            A.zeroEntries()
            fem_petsc.assemble_matrix(A, self.a, bcs=self.forms.bcs)
            A.assemble()
            self.ksp.setOperators(A)
        with self.b.localForm() as local:
            local.set(0.0)
        fem_petsc.assemble_vector(self.b, self.form)
        fem_petsc.apply_lifting(self.b, [self.a], [self.forms.bcs])
        self.b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        fem_petsc.set_bc(self.b, self.forms.bcs)
        self.ksp.solve(self.b, self.x)
        values = self.forms.u.x
        values.array[: self.x.getLocalSize()] = self.x.array_r
        values.scatter_forward()
        return int(self.ksp.getIterationNumber())


def main() -> None:
    options = parser(__doc__ or "", 300)
    options.add_argument("--steps", type=int, default=200)
    options.add_argument("--contact", choices=list(LOOPS), default="side")
    options.add_argument("--shape", choices=[name for name in TRIED if "P2" not in name])
    options.add_argument("--size", type=float, default=1.0, help="times the sizes of cells")
    args = options.parse_args()
    comm = MPI.COMM_WORLD
    if args.contact == "put":
        domain, where = mesh.create_interval(comm, args.cells, (-2.0, 2.0)), f"N = {args.cells}"
    elif args.shape is None:
        domain, where = friedrichs_keller(comm, args.cells), f"N = {args.cells}"
    else:
        domain, where = mesh_of(comm, TRIED[args.shape], args.size), args.shape
    forms = LOOPS[args.contact]
    loops = {
        "contact": Contact(forms(domain, args.steps)),
        "linear": Linear(forms(domain, args.steps)),
    }
    seconds: dict[str, list[float]] = {name: [] for name in loops}
    iterations: dict[str, list[int]] = {name: [] for name in loops}
    solves, moved, setups = [], [], []
    for step in range(args.steps):
        for name, loop in loops.items():
            took, count = timed(comm, loop.step, step)
            if step:  # the first step makes the set-up
                seconds[name].append(took)
                iterations[name].append(count)
        result = loops["contact"].problem.result
        solves.append(result.linear_solves)
        moved.append(result.active_dofs)
        setups.append(result.setups)
    ratio = float(np.sum(seconds["contact"]) / np.sum(seconds["linear"]))
    if comm.rank == 0:
        rows = [
            [name, *spread(seconds[name]).values(), float(np.mean(iterations[name]))]
            for name in loops
        ]
        columns = ["loop", "min s", "median s", "max s", "CG iterations"]
        print(text_table(columns, rows, f"a step, {args.contact}, {where}, {comm.size} ranks"))
        print(f"all steps after the first, contact / linear: {ratio:.2f}")
        print(
            f"linear solves per step {np.mean(solves):.2f}, set-ups {np.mean(setups[1:]):.2f}, "
            f"dofs in contact from {min(moved)} to {max(moved)}"
        )
    content = {
        "where": where,
        "steps": args.steps,
        "seconds": {name: spread(values) for name, values in seconds.items()},
        "iterations": {name: float(np.mean(values)) for name, values in iterations.items()},
        "ratio": ratio,
    }
    kinds = [kind for kind in (args.contact, args.shape) if kind not in ("side", None)]
    write_json(comm, "_".join(["time_steps", *kinds]), content)


if __name__ == "__main__":
    main()
