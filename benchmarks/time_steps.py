"""A step of a parabolic problem with contact, beside a step of the same loop without contact.

    ./with-dolfinx python3 benchmarks/time_steps.py [--cells 300] [--steps 200]
    ./with-dolfinx python3 benchmarks/time_steps.py --shape cube    # on a mesh of gmsh

The problem is that of `demos/parabolic.py`. Both loops make the same time steps in turn in one
process. The loop without contact has the best of what a user would write: the matrix and the set-up
of BoomerAMG with the contact solve's settings are made once, and CG starts from the last solution
and ends at the residual that the contact solve has to reach, 1e-7 of the load.
"""

import numpy as np
import ufl
from common import parser, spread, timed, write_json
from dolfinx import fem, mesh
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc
from shapes import TRIED, mesh_of

from dolfinx_signorini import SignoriniProblem, friedrichs_keller
from dolfinx_signorini.base.tables import text_table
from dolfinx_signorini.problem.signorini import DEFAULT_RTOL
from dolfinx_signorini.solvers.linear.algebraic import DEFAULT_OPTIONS
from dolfinx_signorini.solvers.linear.options import options_set

DT = 0.01


class Loop:
    """Forms of one implicit Euler step; `u` is the solution of the step before."""

    def __init__(self, domain: mesh.Mesh):
        self.mesh = domain
        space = fem.functionspace(self.mesh, ("Lagrange", 1))
        self.u, trial, v = fem.Function(space), ufl.TrialFunction(space), ufl.TestFunction(space)
        self.pump = fem.Constant(self.mesh, (0.0, 0.2))
        dx = ufl.dx(metadata={"quadrature_degree": 4})
        x = ufl.SpatialCoordinate(self.mesh)
        distance = ufl.as_vector((x[0], x[1])) - self.pump
        source = 5.0 - 100.0 * ufl.exp(-50.0 * ufl.inner(distance, distance))
        self.a = (trial * v + DT * ufl.inner(ufl.grad(trial), ufl.grad(v))) * dx
        self.L = (self.u + DT * source) * v * dx

    def move(self, step: int) -> None:
        """Move the pump to its place in a step."""
        self.pump.value[0] = 0.5 - 0.35 * np.cos(2.0 * np.pi * DT * (step + 1))


class Contact(Loop):
    """The loop with contact on the lower side."""

    def __init__(self, domain: mesh.Mesh):
        super().__init__(domain)
        facets = domain.topology.dim - 1
        wall = mesh.locate_entities_boundary(domain, facets, lambda x: np.isclose(x[1], 0.0))
        self.problem = SignoriniProblem(self.a, self.L, contact=wall, u=self.u)

    def step(self, number: int) -> int:
        """Make a step, and return the CG iterations that the step took."""
        self.move(number)
        self.problem.solve()
        return self.problem.result.linear_iterations


class Linear(Loop):
    """The loop without contact, with the matrix and the multigrid set-up of the first step."""

    def __init__(self, domain: mesh.Mesh):
        super().__init__(domain)
        A = fem_petsc.assemble_matrix(fem.form(self.a))
        A.assemble()
        self.form, self.b, self.x = fem.form(self.L), A.createVecLeft(), A.createVecRight()
        self.ksp = PETSc.KSP().create(domain.comm)
        self.ksp.setOptionsPrefix("linear_")
        with options_set("linear_", DEFAULT_OPTIONS):
            self.ksp.setFromOptions()
        self.ksp.setOperators(A)
        self.ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        self.ksp.setTolerances(rtol=DEFAULT_RTOL, atol=0.0)
        self.ksp.setInitialGuessNonzero(True)

    def step(self, number: int) -> int:
        """Make a step, and return the CG iterations that the step took."""
        self.move(number)
        with self.b.localForm() as local:
            local.set(0.0)
        fem_petsc.assemble_vector(self.b, self.form)
        self.b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        self.ksp.solve(self.b, self.x)
        self.u.x.array[: self.x.getLocalSize()] = self.x.array_r
        self.u.x.scatter_forward()
        return int(self.ksp.getIterationNumber())


def main() -> None:
    options = parser(__doc__ or "", 300)
    options.add_argument("--steps", type=int, default=200)
    options.add_argument("--shape", choices=[name for name in TRIED if "P2" not in name])
    options.add_argument("--size", type=float, default=1.0, help="times the sizes of cells")
    args = options.parse_args()
    comm = MPI.COMM_WORLD
    if args.shape is None:
        domain, where = friedrichs_keller(comm, args.cells), f"N = {args.cells}"
    else:
        domain, where = mesh_of(comm, TRIED[args.shape], args.size), args.shape
    loops = {"contact": Contact(domain), "linear": Linear(domain)}
    seconds: dict[str, list[float]] = {name: [] for name in loops}
    iterations: dict[str, list[int]] = {name: [] for name in loops}
    solves, moved = [], []
    for step in range(args.steps):
        for name, loop in loops.items():
            took, count = timed(comm, loop.step, step)
            if step:  # the first step makes the set-up
                seconds[name].append(took)
                iterations[name].append(count)
        result = loops["contact"].problem.result
        solves.append(result.linear_solves)
        moved.append(result.active_dofs)
    ratio = float(np.sum(seconds["contact"]) / np.sum(seconds["linear"]))
    if comm.rank == 0:
        rows = [
            [name, *spread(seconds[name]).values(), float(np.mean(iterations[name]))]
            for name in loops
        ]
        columns = ["loop", "min s", "median s", "max s", "CG iterations"]
        print(text_table(columns, rows, f"a step, {where}, {comm.size} ranks"))
        print(f"all steps after the first, contact / linear: {ratio:.2f}")
        print(
            f"linear solves per step {np.mean(solves):.2f}, "
            f"dofs in contact from {min(moved)} to {max(moved)}"
        )
    content = {
        "where": where,
        "steps": args.steps,
        "seconds": {name: spread(values) for name, values in seconds.items()},
        "iterations": {name: float(np.mean(values)) for name, values in iterations.items()},
        "ratio": ratio,
    }
    write_json(comm, "time_steps" if args.shape is None else f"time_steps_{args.shape}", content)


if __name__ == "__main__":
    main()
