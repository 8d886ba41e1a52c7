"""Loops of random changes: in every step contact is exact, and its forces balance the equation."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc as fem_petsc
from hypothesis import given
from hypothesis import strategies as st
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.meshes.elements import bernstein_space
from dolfinx_signorini.problem.contact import ContactProblem
from dolfinx_signorini.problem.elasticity import elasticity
from dolfinx_signorini.problem.signorini import SignoriniProblem

Array = npt.NDArray[np.float64]

CHANGES = ("obstacle", "load", "Dirichlet", "matrix", "obstacle and load")
ROUNDING = 1e-11  # of all forces


@dataclass
class Loop:
    """A problem with numbers to change: what a random loop is made of."""

    problem: SignoriniProblem
    a: ufl.Form
    L: ufl.Form
    numbers: dict[str, fem.Constant]
    held: fem.Function
    size: float

    def change(self, name: str, factor: float) -> None:
        """Give a number a multiple of its first value; Dirichlet data stay above the obstacle."""
        if name == "Dirichlet":
            self.held.x.array[:] = self.problem.sign * self.size * max(factor, 0.5)
        else:
            self.numbers[name].value = max(factor, 0.05) if name == "matrix" else factor


def random_loop(rng: np.random.Generator) -> Loop:
    """A problem of a random element, bound, contact boundary and form on a random small mesh."""
    comm, solid = MPI.COMM_WORLD, rng.random() < 0.2
    degree, bernstein = int(rng.integers(1, 4 if solid else 5)), bool(rng.random() < 0.5)
    n = int(rng.integers(2, 5) if solid else rng.integers(3, max(4, 40 // degree)))
    domain = mesh.create_unit_cube(comm, n, n, n) if solid else mesh.create_unit_square(comm, n, n)
    V = bernstein_space(domain, degree) if bernstein else fem.functionspace(domain, ("P", degree))
    u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(domain)
    bound = str(rng.choice(["lower", "upper"]))
    sign, size = (1.0 if bound == "lower" else -1.0), 10.0 ** rng.uniform(-2.0, 2.0)
    names = "obstacle", "load", "matrix"
    numbers = {name: fem.Constant(domain, 1.0) for name in names}
    # Constants, so that all loops of an element share their compiled forms.
    slope, level = (20.0, -12.0) if rng.random() < 0.5 else (-1.0, -1.0)
    sizes = sign * size * slope, sign * size * level, 0.1 * sign * size, 10.0 ** rng.uniform(-2, 2)
    slope, level, height, reaction = (fem.Constant(domain, float(size)) for size in sizes)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + numbers["matrix"] * reaction * u * v) * ufl.dx
    L = numbers["load"] * (slope * x[0] + level) * v * ufl.dx
    g = height * numbers["obstacle"] * (1.0 + x[1])
    facets, bcs = mesh.exterior_facet_indices(boundary_topology(domain)), []
    held = fem.Function(V)
    held.x.array[:] = sign * size
    if rng.random() < 0.4:
        top = mesh.locate_entities_boundary(domain, domain.topology.dim - 1, on_top)
        dofs = fem.locate_dofs_topological(V, domain.topology.dim - 1, top)
        facets, bcs = np.setdiff1d(facets, top), [fem.dirichletbc(held, dofs)]
    problem = SignoriniProblem(a, L, contact=facets, obstacle=g, bound=bound, bcs=bcs)
    return Loop(problem, a, L, numbers, held, size)


def boundary_topology(domain: mesh.Mesh) -> mesh.Topology:
    domain.topology.create_connectivity(domain.topology.dim - 1, domain.topology.dim)
    return domain.topology


def on_top(x: Array) -> npt.NDArray[np.bool_]:
    return np.isclose(x[1], 1.0)


def run(seed: int, steps: int = 6) -> None:
    """Change a random problem step by step, and check every step."""
    rng = np.random.default_rng(seed)
    loop, change = random_loop(rng), str(rng.choice(CHANGES))
    rtol = [None, 1e-6, 1e-10][rng.integers(3)]
    speed, jump = rng.uniform(-0.3, 0.3), rng.random() < 0.2
    for step in range(steps):
        factor = 1.0 + (rng.uniform(-0.9, 0.9) if jump else speed * step / 2.0)
        for name in change.split(" and "):
            loop.change(name, factor)
        loop.problem.solve(rtol=rtol)
        check(loop, f"seed {seed}, {change}, step {step}, {loop.problem!r}")
    loop.problem.destroy()


def check(loop: Loop, case: str) -> None:
    """Hold gap, pressure, forces and active set against reactions that are assembled anew."""
    problem = loop.problem
    space, comm, sign = problem.space, problem.comm, problem.sign
    dofs, count = problem.contact_dofs, problem.space.dofmap.index_map.size_local
    residual = ufl.action(loop.a, problem.u) - loop.L
    reaction = assembled(residual)[:count] * sign
    diagonal = fem_petsc.assemble_matrix(fem.form(loop.a))
    diagonal.assemble()
    entries = diagonal.getDiagonal().array_r.copy()
    diagonal.destroy()
    forces, gap = problem.forces.x.array[:count], problem.gap.x.array[:count]
    pressure = problem.pressure.x.array[:count]
    g = sign * problem.obstacle
    lifted = assembled(loop.L)[:count]
    push = entries[dofs] * np.maximum(g, 0.0)
    sizes = lifted @ lifted, push @ push, np.sum(np.square(entries * problem.u.x.array[:count]))
    load, pushing, whole = np.sqrt(comm.allreduce(np.array(sizes)))
    fixed = problem.fixed_dofs
    if comm.allreduce(len(fixed)):
        load = np.sqrt(comm.allreduce(float(problem.b.array_r @ problem.b.array_r)))
    tolerance = problem.result.natural_residual * (load + pushing) + ROUNDING * whole
    left = reaction.copy()
    left[dofs] -= forces[dofs]
    left[fixed] = 0.0
    norm = np.sqrt(comm.allreduce(float(left @ left)))
    assert norm <= 1.01 * tolerance, f"{case}: forces miss the reactions by {norm / tolerance:.2g}"
    sums = comm.allreduce(np.array([reaction[dofs].sum(), forces.sum(), left[dofs].sum()]))
    assert abs(sums[0] - sums[1]) <= np.sqrt(problem.unknowns) * tolerance, case
    pressed = forces != 0.0
    assert (gap[pressed] == 0.0).all(), f"{case}: a gap under pressure"
    assert (forces >= 0.0).all() and (pressure >= 0.0).all() and (gap >= 0.0).all(), case
    assert np.isin(np.flatnonzero(pressed), problem.active).all(), case
    assert (gap[problem.active] == 0.0).all(), case
    assert comm.allreduce(len(problem.active)) == problem.result.active_dofs, case
    above = sign * problem.u.x.array[dofs] - g
    assert (above >= 0.0).all() and np.array_equal(above, gap[dofs]), case
    space.mesh.comm.barrier()


def assembled(form: ufl.Form) -> Array:
    """A linear form assembled by DOLFINx alone, with the shares of all ranks added up."""
    vector = fem_petsc.assemble_vector(fem.form(form))
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    values = vector.array_r.copy()
    vector.destroy()
    return values


@given(seed=st.integers(1_000, 1_000_000))
def test_every_step_of_a_random_loop_has_its_contact(seed):
    run(seed)


@pytest.mark.parametrize("cells", [1, 2])
def test_a_body_of_few_cells_comes_and_goes(cells, comm):
    """On several ranks some have no dof of the body."""
    domain = mesh.create_unit_cube(comm, cells, 1, 1, mesh.CellType.hexahedron)
    space = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    below, above = (
        mesh.locate_entities_boundary(domain, 2, lambda x, z=z: np.isclose(x[2], z))
        for z in (0.0, 1.0)
    )
    bc = fem.dirichletbc(fem.Function(space), fem.locate_dofs_topological(space, 2, above))
    load = fem.Constant(domain, 20.0)
    gap = 0.05 + 0.1 * ufl.SpatialCoordinate(domain)[0]
    form = elasticity(u, v, 5.0, 0.3)
    problem = ContactProblem(form, -load * v[2] * ufl.dx, contact=below, gap=gap, bcs=[bc])
    forces = []
    for k in range(4):
        load.value = 20.0 * (-1) ** k
        problem.solve(rtol=1e-10)
        forces.append(problem.force[2])
    assert forces[0] == pytest.approx(forces[2]) and forces[0] > 1.0
    assert forces[1] == forces[3] == 0.0
    problem.destroy()


@pytest.mark.slow
@pytest.mark.parametrize("block", range(10))
def test_a_thousand_random_loops(block):
    for seed in range(100 * block, 100 * (block + 1)):
        run(seed)


@pytest.mark.parametrize("bound", ["lower", "upper"])
@pytest.mark.parametrize("method", ["cascade", "bncg", "bntr"])
@pytest.mark.parametrize("height", [1e-14, 1e-11])
def test_a_start_that_hovers_above_the_obstacle_gets_its_contact(height, method, bound, comm):
    """The residual accepts the start as it is: what is pressed is set down all the same."""
    domain, sign = mesh.create_unit_square(comm, 8, 8), 1.0 if bound == "lower" else -1.0
    V = fem.functionspace(domain, ("P", 2))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    load = fem.Constant(domain, -sign)
    facets = mesh.exterior_facet_indices(boundary_topology(domain))
    problem = SignoriniProblem(
        a, load * v * ufl.dx, contact=facets, obstacle=0.1 * sign, bound=bound
    )
    problem.solve(rtol=1e-13)
    force, touching = problem.force, problem.result.active_dofs
    start = problem.u.copy()
    start.x.array[:] += sign * height
    problem.solve(method, start=start, rtol=1e-8)
    assert problem.force == pytest.approx(force, rel=1e-6)
    assert problem.result.active_dofs == touching > 0
    problem.destroy()
