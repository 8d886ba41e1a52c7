"""Geometric multigrid: prolongations between meshes, coarse matrices, and linear solves."""

import re
from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc as fem_petsc
from dolfinx.graph import adjacencylist
from mpi4py import MPI

from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.elements import bernstein_space, control_points, nodal_space
from dolfinx_signorini.meshes.parents import parent_mesh
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, boundary_facets
from dolfinx_signorini.problem.contact import ContactProblem
from dolfinx_signorini.problem.obstacle import ObstacleProblem
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.solvers.linear import hierarchy, lattice, projected
from dolfinx_signorini.solvers.linear.algebraic import AMG, HYPRE
from dolfinx_signorini.solvers.linear.hierarchy import degree_prolongations, prolongations
from dolfinx_signorini.solvers.linear.iterative import PERIOD, IterativeSolver
from dolfinx_signorini.solvers.linear.lattice import coarsened, find_lattice
from dolfinx_signorini.solvers.linear.multigrid import Multigrid

COMM = MPI.COMM_WORLD


def cube(n):
    return mesh.create_unit_cube(COMM, n, n, n)


def uniform(domain, times):
    for _ in range(times):
        domain = refined(SidedMesh(domain, {})).sided.mesh
    return domain


def towards_corner(domain, times):
    for step in range(times):
        count = domain.topology.index_map(domain.topology.dim).size_local
        cells = np.arange(count, dtype=np.int32)
        middles = mesh.compute_midpoints(domain, domain.topology.dim, cells)
        near = cells[np.linalg.norm(middles, axis=1) < 0.5 * 0.5**step]
        domain = refined(SidedMesh(domain, {}), near).sided.mesh
    return domain


MESHES = {
    "square": lambda: friedrichs_keller(COMM, 48),
    "an odd square": lambda: friedrichs_keller(COMM, 77),
    "rectangle": lambda: mesh.create_rectangle(COMM, [(-1.0, 2.0), (3.0, 2.5)], (90, 17)),
    "cube": lambda: cube(14),
    "refined square": lambda: uniform(
        mesh.create_unit_square(COMM, 5, 4, diagonal=mesh.DiagonalType.crossed), 4
    ),
    "divided square": lambda: uniform(towards_corner(friedrichs_keller(COMM, 20), 3), 1),
    "refined cube": lambda: uniform(cube(3), 2),
    "adapted cube": lambda: towards_corner(cube(9), 3),
}


def space_on(domain):
    return fem.functionspace(domain, ("Lagrange", 1))


def owned_nodes(domain):
    return np.arange(domain.geometry.index_map().size_local, dtype=np.int32)


def matrix_on(domain):
    """The matrix of the energy, in the order of the geometry's nodes."""
    space = space_on(domain)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    A = fem_petsc.assemble_matrix(
        fem.form((ufl.inner(ufl.grad(u), ufl.grad(v)) + 30.0 * u * v) * ufl.dx)
    )
    A.assemble()
    return A, space


def energies(A, points):
    """The energies of some functions, given by their values at the nodes of this rank."""
    x, y, found = A.createVecRight(), A.createVecLeft(), []
    p = np.zeros((points.shape[1], 3))
    p[:, : len(points)] = points.T
    for k in range(1, 5):
        x.array_w[:] = np.sin(k * p[:, 0] + 2.0 * p[:, 1] - 3.0 * k * p[:, 2]) + p[:, 0] ** k
        A.mult(x, y)
        found.append(x.dot(y))
    x.destroy()
    y.destroy()
    return found


def graded(comm, n):
    """An interval whose cells grow."""
    domain = mesh.create_interval(comm, n, (0.0, 1.0))
    domain.geometry.x[:, 0] = np.expm1(3.0 * domain.geometry.x[:, 0]) / np.expm1(3.0)
    return domain


@pytest.mark.parametrize(
    "make, n", [(graded, 20), (friedrichs_keller, 12), (lambda _, n: cube(n), 6)]
)
def test_coarse_matrices_of_a_lattice_are_those_of_the_coarse_mesh(make, n):
    A, space = matrix_on(make(COMM, n))
    fine = find_lattice(space.mesh, hierarchy.nodes_of(space))
    coarse, parents, weights = coarsened(fine)
    P = hierarchy.edge_prolongation(COMM, parents, coarse.places.shape[1], weights)
    product = A.ptap(P)
    B, coarse_space = matrix_on(make(COMM, n // 2))
    x = coarse_space.tabulate_dof_coordinates()[: B.getLocalSize()[0], : len(fine.cells)].T
    lines = zip(coarse.lines, coarse.places, strict=True)
    points = [line[p] * step for (line, p), step in zip(lines, coarse.unit, strict=True)]
    found = energies(product, np.array(points) + coarse.corner[:, None])
    assert found == pytest.approx(energies(B, x), rel=1e-12)
    for item in (A, P, product, B):
        item.destroy()


@pytest.mark.parametrize("local", [False, True], ids=["everywhere", "locally"])
@pytest.mark.parametrize("make", [lambda: friedrichs_keller(COMM, 10), lambda: cube(4)])
def test_coarse_matrices_of_a_refined_mesh_are_those_of_its_parent(make, local):
    parent = make()
    A, space = matrix_on(towards_corner(parent, 1) if local else uniform(parent, 1))
    nodes = hierarchy.nodes_of(space)
    P = hierarchy.refinement_prolongation(space.mesh, nodes, parent_mesh(space.mesh))
    product, (B, coarse_space) = A.ptap(P), matrix_on(parent)
    x = parent.geometry.x[owned_nodes(parent), : parent.topology.dim].T
    y = coarse_space.tabulate_dof_coordinates()[: B.getLocalSize()[0], : len(x)].T
    assert energies(product, x) == pytest.approx(energies(B, y), rel=1e-12)
    for item in (A, P, product, B):
        item.destroy()


def loaded(domain, across=1.0, space=None):
    """A load on a body, whose diffusion in all directions but the first may be small."""
    space = space_on(domain) if space is None else space
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    diffusion = ufl.diag(ufl.as_vector([1.0, across, across][: domain.geometry.dim]))
    a = (ufl.inner(diffusion * ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    L = 40.0 * (0.35 - x[0] + 0.2 * x[1]) * v * ufl.dx
    return SignoriniProblem(a, L, contact=boundary_facets(domain))


def held_below(problem):
    """Hold the boundary where y is small, and a stretch of the rest."""
    x = nodal_space(problem.space).tabulate_dof_coordinates()[problem.contact_dofs]
    return (x[:, 1] < 0.01) | ((x[:, 0] < 0.01) & (x[:, 1] < 0.4))


def solved(problem, held, **settings):
    """Solve from zero; return the solver, and the relative residual at the free dofs."""
    system = problem.system
    solver, x = IterativeSolver(system, **settings), system.start()
    start = system.b.copy()
    start.array_w[system.contact_dofs[held]] = 0.0
    solver.solve(system, x, held, 1e-8 * start.norm())
    rest = x.duplicate()
    system.A.mult(x, rest)
    rest.axpy(-1.0, system.b)
    rest.array_w[system.contact_dofs[held]] = 0.0
    residual = rest.norm() / start.norm()
    for item in (start, x, rest):
        item.destroy()
    return solver, residual


@pytest.mark.parametrize("name", MESHES)
def test_few_iterations_whatever_the_mesh(name):
    problem = loaded(MESHES[name]())
    solver, residual = solved(problem, held_below(problem))
    assert problem.unknowns > 1000 and solver.preconditioner.startswith("multigrid over")
    assert residual <= 1.001e-8
    assert solver.iterations <= (16 if "adapted" in name else 13)
    assert solver.setups == 1
    solver.destroy()
    problem.destroy()


SPACES = {
    "Bernstein": bernstein_space,
    "nodal": lambda domain, degree: fem.functionspace(domain, ("Lagrange", degree)),
}


@pytest.mark.parametrize("degree", [2, 3, 4])
@pytest.mark.parametrize("kind", SPACES)
def test_iterations_hardly_feel_the_degree(kind, degree):
    domain = towards_corner(friedrichs_keller(COMM, 14), 2)
    problem = loaded(domain, space=SPACES[kind](domain, degree))
    solver, residual = solved(problem, held_below(problem))
    degrees = int(re.match(r"multigrid over (\d) lower degrees", solver.preconditioner)[1])
    assert degrees > (degree > 2)
    assert residual <= 1.001e-8
    assert solver.iterations <= 13
    solver.destroy()
    problem.destroy()


def test_on_a_graded_mesh_changed_dofs_cost_few_iterations_and_small_local_solves(monkeypatch):
    factored, splu = [], projected.splu
    monkeypatch.setattr(
        projected, "splu", lambda A, **kwargs: factored.append(A.shape[0]) or splu(A, **kwargs)
    )
    domain = towards_corner(friedrichs_keller(COMM, 12), 7)
    problem = loaded(domain, space=bernstein_space(domain, 3))
    system, held = problem.system, held_below(problem)
    x = nodal_space(problem.space).tabulate_dof_coordinates()[problem.contact_dofs]
    # At the corner a few are released.
    changed = held & ~(np.isclose(x[:, 1], 0.0) & (x[:, 0] < 0.002))
    assert 4 <= COMM.allreduce(int((changed != held).sum())) <= 16
    counts = []
    for first in (changed, held):
        solver, y = IterativeSolver(system, options={"pc_type": "gamg"}), system.start()
        solver.solve(system, y, first, 1e-9)
        before, _ = solver.iterations, y.set(0.0)
        solver.solve(system, y, changed, 1e-9)
        counts.append(solver.iterations - before)
        assert solver.setups == 1
        for item in (solver, y):
            item.destroy()
    assert counts[1] <= counts[0] + 3
    assert 0 < COMM.allreduce(sum(factored)) < 0.15 * problem.unknowns
    problem.destroy()


@pytest.mark.parametrize("kind", SPACES)
def test_lower_degrees_are_carried_exactly(kind):
    domain = friedrichs_keller(COMM, 10)
    space = SPACES[kind](domain, 4)
    made, lowest = degree_prolongations(space)
    coarse, fine = fem.Function(lowest), fem.Function(space)
    coarse.interpolate(lambda x: np.cos(5.0 * x[0]) * x[1])
    fine.interpolate(coarse)
    vectors = [coarse.x.petsc_vec.copy(), *(P.createVecLeft() for P in reversed(made))]
    for P, x, y in zip(reversed(made), vectors, vectors[1:], strict=False):
        P.mult(x, y)
    owned = space.dofmap.index_map.size_local
    assert len(made) == 2
    assert vectors[-1].array_r == pytest.approx(fine.x.array[:owned], abs=1e-12)
    for item in (*made, *vectors):
        item.destroy()


def test_a_set_up_serves_a_new_matrix_and_a_new_set():
    problem = loaded(friedrichs_keller(COMM, 50))
    solver, _ = solved(problem, held_below(problem))
    system, x = problem.system, problem.system.start()
    system.A.scale(4.0)
    changed = replace(system, assembled=system.assembled + 1)
    everywhere = np.full(len(system.contact_dofs), True)
    before = solver.iterations
    solver.solve(changed, x, everywhere, 1e-8 * system.b.norm())
    assert solver.setups == 2 and solver.iterations - before <= 12
    for item in (solver, x, problem):
        item.destroy()


@pytest.mark.parametrize("degree", [1, 2])
def test_slow_convergence_leads_to_boomeramg(degree):
    # Strands along the first direction, hardly coupled: point smoothers do not smooth across.
    domain = friedrichs_keller(COMM, 64 // degree)
    problem = loaded(domain, across=1e-4, space=bernstein_space(domain, degree))
    solver, residual = solved(problem, held_below(problem))
    assert solver.setups == 1 + degree  # without coarser meshes, without lower degrees
    assert residual <= 1.001e-8
    solver.destroy()
    problem.destroy()


def test_few_coarse_nodes_are_solved_for_exactly():
    # So nothing that a coarse function can mend is left: the residual is orthogonal to all of them.
    problem = loaded(stretched(1.0, 1000.0))
    first, *others = hierarchy.mesh_prolongations(problem.space)
    while first.getSize()[1] > hierarchy.SMALL:
        first, fine = first.matMult(others[0]), first
        for item in (fine, others.pop(0)):
            item.destroy()
    matrix, b = problem.system.A.copy(), problem.system.b
    multigrid = Multigrid([first], 0, "exact_", AMG)
    multigrid.set_up(matrix, np.empty(0, dtype=np.int32), 1.0, 1)
    x, rest, coarse, load = b.duplicate(), b.duplicate(), *(first.createVecRight() for _ in "ab")
    multigrid.nested(b, x)
    matrix.mult(x, rest)
    rest.aypx(-1.0, b)
    first.multTranspose(rest, coarse)
    first.multTranspose(b, load)
    assert coarse.norm() <= 1e-9 * load.norm()
    for item in (matrix, x, rest, coarse, load, *others, multigrid, problem):
        item.destroy()


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("cells", ["in pieces", "anywhere"])
def test_a_cycle_reduces_the_energy_of_every_error_however_ranks_share_the_cells(size, cells):
    """The energy norm of I - B A is the largest size of its eigenvalues, as B is symmetric."""
    create, n = (mesh.create_unit_square, 48) if size == 2 else (mesh.create_unit_cube, 16)
    rng = np.random.default_rng(3 + COMM.rank)

    def partitioner(_, __, ___, cells):
        count = len(np.atleast_1d(cells[0])) // (size + 1)
        ranks = adjacencylist(rng.integers(COMM.size, size=(count, 1), dtype=np.int32))
        return getattr(ranks, "_cpp_object", ranks)

    options = {"partitioner": partitioner} if cells == "anywhere" else {}
    domain = create(COMM, *[n] * size, **options)
    space = fem.functionspace(domain, ("Lagrange", 1, (size,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    strain = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
    energy = ufl.inner(*strain) + ufl.inner(ufl.div(u), ufl.div(v)) + 1e-3 * ufl.inner(u, v)
    side = mesh.locate_entities_boundary(domain, size - 1, lambda x: np.isclose(x[0], 0.0))
    problem = ContactProblem(energy * ufl.dx, v[0] * ufl.dx, contact=side)
    matrix, solver = problem.A.copy(), IterativeSolver(problem.system, "energy_")
    multigrid = solver.multigrid
    assert multigrid is not None
    before, none = matrix.copy(), np.empty(0, dtype=np.int32)
    before.scale(0.1)
    multigrid.set_up(before, none, 1.0, 1)
    multigrid.set_up(matrix, none, 1.0, 2)  # nothing of the first matrix is left
    error, image, correction = (matrix.createVecRight() for _ in range(3))
    error.array_w[:] = rng.standard_normal(error.getLocalSize())
    energies = []
    for _ in range(25):
        matrix.mult(error, image)
        energies.append(error.dot(image))
        multigrid.pc.apply(image, correction)
        error.axpy(-1.0, correction)
    assert np.all(np.diff(energies) < 0.0)
    for item in (matrix, before, error, image, correction, solver, problem):
        item.destroy()


def test_coarse_functions_that_differ_at_held_dofs_alone():
    """The node between two coarse ones is free alone: their functions are equal there."""
    domain = uniform(mesh.create_unit_square(COMM, 20, 20), 1)
    space = space_on(domain)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    energy = ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v
    problem = ObstacleProblem(energy * ufl.dx, v * ufl.dx, lower=0.0)
    x = control_points(space)[problem.system.contact_dofs]
    held = np.linalg.norm(x[:, :2] - [0.525, 0.5], axis=1) > 1e-9
    assert COMM.allreduce(int((~held).sum())) == 1
    solver, residual = solved(problem, held)
    assert solver.setups == 1 and solver.preconditioner == "multigrid over 1 coarser meshes"
    assert residual <= 1.001e-8
    solver.destroy()
    problem.destroy()


def stretched(*sizes):
    if len(sizes) == 2:
        return mesh.create_rectangle(COMM, [(0.0, 0.0), sizes], (64, 64))
    return mesh.create_box(COMM, [(0.0, 0.0, 0.0), sizes], (24, 24, 24))


@pytest.mark.parametrize(
    "sizes", [(3.0, 1.0), (1.0, 30.0), (1.0, 1000.0), (1.0, 1.0, 30.0), (1.0, 100.0, 3.0)]
)
def test_flat_cells_are_no_obstacle(sizes):
    problem = loaded(stretched(*sizes))
    solver, residual = solved(problem, held_below(problem))
    few = 12 if COMM.size == 1 else 16  # smoothers work rank by rank
    assert solver.setups == 1 and solver.iterations <= few
    assert residual <= 1.001e-8
    solver.destroy()
    problem.destroy()


@pytest.mark.skipif(AMG is not HYPRE, reason="GAMG is slow on flat cells itself")
@pytest.mark.parametrize("height", [100.0, 1000.0])
def test_convergence_that_becomes_slow_leads_to_boomeramg(height, monkeypatch):
    # With every second node in both directions, the first iterations on flat cells take two
    # digits, and hundreds the next ones.
    monkeypatch.setattr(lattice, "FLAT", np.inf)
    problem = loaded(stretched(1.0, height))
    solver, residual = solved(problem, held_below(problem))
    few = 2 * PERIOD + 12  # two looks at the pace, then BoomerAMG
    assert solver.setups == 2 and solver.iterations <= few
    assert residual <= 1.001e-8
    solver.destroy()
    problem.destroy()


def not_a_lattice(kind):
    if kind == "crossed":
        return mesh.create_unit_square(COMM, 20, 20, diagonal=mesh.DiagonalType.crossed)
    domain = friedrichs_keller(COMM, 40)
    x = domain.geometry.x
    if kind == "moved":
        x[:, 0] += 0.1 * x[:, 0] * x[:, 1]
    elif kind == "folded":  # two columns of nodes at one place, and a place without any
        x[np.isclose(x[:, 0], 0.5), 0] = 0.525
    return domain


@pytest.mark.parametrize("kind", ["crossed", "moved", "folded"])
def test_what_is_no_lattice_is_not_taken_for_one(kind):
    space = space_on(not_a_lattice(kind))
    assert prolongations(space) == ([], [])


@pytest.mark.parametrize("options", [{"pc_type": "jacobi"}, {"pc_hypre_boomeramg_max_iter": 2}])
def test_who_chooses_a_preconditioner_gets_it(options):
    problem = loaded(friedrichs_keller(COMM, 40))
    solver, _ = solved(problem, held_below(problem), options=options)
    assert "multigrid" not in solver.preconditioner
    solver.destroy()
    problem.destroy()
