"""Rigid motions: no strain, and what algebraic multigrid makes of them on meshes without levels."""

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini import ContactProblem, elasticity
from dolfinx_signorini.meshes.box_meshes import box_mesh
from dolfinx_signorini.meshes.elements import bernstein_space
from dolfinx_signorini.solvers.linear import iterative, multigrid
from dolfinx_signorini.solvers.linear.hierarchy import coarse_places, prolongations
from dolfinx_signorini.solvers.linear.iterative import IterativeSolver
from dolfinx_signorini.solvers.motions import motions_of, owned_places

COMM = MPI.COMM_WORLD


def shaken(n, size):
    """A mesh of the unit square or cube whose inner vertices are moved: no lattice is found."""
    create = dolfinx.mesh.create_unit_cube if size == 3 else dolfinx.mesh.create_unit_square
    domain = create(COMM, *[n] * size)
    x = domain.geometry.x
    inside = np.all((x[:, :size] > 1e-9) & (x[:, :size] < 1.0 - 1e-9), axis=1)
    waves = 0.2 / n * np.sin(173.0 * x[:, [1, 0, 0]] + 311.0 * x[:, [2, 2, 1]] + [0.0, 1.0, 2.0])
    x[inside, :size] += waves[inside, :size]
    return domain


def pressed(domain, degree=1):
    """A block whose upper side is fixed and whose lower side has contact in many directions."""
    size = domain.geometry.dim
    space = fem.functionspace(domain, ("Lagrange", degree, (size,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    above, below = (
        dolfinx.mesh.locate_entities_boundary(
            domain, size - 1, lambda x, z=z: np.isclose(x[size - 1], z)
        )
        for z in (1.0, 0.0)
    )
    dofs = fem.locate_dofs_topological(space, size - 1, above)
    bc = fem.dirichletbc(np.zeros(size), dofs, space)
    load = fem.Constant(domain, (0.0,) * (size - 1) + (-1.0,))

    def direction(x):
        return np.stack([np.sin(5.0 * x[i]) for i in range(size - 1)] + [-1.0 + 0.0 * x[0]])

    return ContactProblem(
        elasticity(u, v, young=100.0, poisson=0.3),
        ufl.inner(load, v) * ufl.dx,
        contact=below,
        direction=direction,
        gap=1e-3,
        bcs=[bc],
    )


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("size", [2, 3])
def test_rigid_motions_have_no_force(size, degree):
    """Away from the Dirichlet data A r = 0, in the directions of the contact nodes."""
    problem = pressed(shaken(4, size), degree)
    motions = motions_of(problem.system.layout)
    assert motions.shape[1] == {2: 3, 3: 6}[size]
    near = owned_places(problem.system.layout.nodal)[:, size - 1] > 0.7
    x, y = problem.A.createVecs()
    diagonal = problem.A.getDiagonal()
    for motion in motions.T:
        x.array_w[:] = motion
        problem.A.mult(x, y)
        forces = np.abs(y.array_r).reshape(-1, size)
        assert forces[~near].max(initial=0.0) <= 1e-12 * diagonal.norm() * x.norm()
    independent = COMM.allreduce(motions.T @ motions)
    assert np.linalg.matrix_rank(independent) == motions.shape[1]
    for item in (x, y, diagonal):
        item.destroy()
    problem.destroy()


@pytest.mark.parametrize("degree, n", [(1, 32), (2, 20)])
def test_places_of_coarser_levels(degree, n):
    """The coordinates are linear: their prolongation is exact."""
    space = bernstein_space(box_mesh(COMM, [np.linspace(0.0, 1.0, n + 1)] * 2), degree)
    degrees, meshes = prolongations(space)
    steps = [*degrees, *meshes]
    fine = owned_places(space)
    assert steps
    for step, coarse in zip(steps, coarse_places(steps, fine), strict=True):
        y, x = step.createVecs()[::-1]
        for k in range(2):
            x.array_w[:] = coarse[:, k]
            step.mult(x, y)
            assert np.abs(y.array_r - fine[:, k]).max(initial=0.0) <= 1e-13
        for item in (x, y):
            item.destroy()
        fine = coarse
    for step in steps:
        step.destroy()


def iterations(problem):
    """The iterations of CG to a residual of 1e-8, with half of the contact held."""
    system, problem.count = problem.system, getattr(problem, "count", 0) + 1
    solver, x = IterativeSolver(system, f"motions_{id(problem)}_{problem.count}_"), system.start()
    held = np.zeros(len(system.contact_dofs), dtype=bool)
    held[::2] = True
    solver.solve(system, x, held, 1e-8 * system.b.norm())
    found, name = solver.iterations, solver.preconditioner
    solver.destroy()
    x.destroy()
    return found, name


@pytest.mark.parametrize(
    "size, degree, n, name",
    [
        (2, 1, 60, "gamg"),
        (3, 1, 12, "gamg"),
        (2, 2, 30, "multigrid over 1 lower degrees"),
        (3, 2, 8, "multigrid over 1 lower degrees"),
    ],
)
def test_algebraic_multigrid_knows_rigid_motions(monkeypatch, size, degree, n, name):
    problem = pressed(shaken(n, size), degree)
    with_motions, found = iterations(problem)
    assert found == name or COMM.size > 1  # sweeps on three ranks may be dropped as slow
    assert with_motions <= (20 if COMM.size == 1 else 40)  # sweeps leave out what couples ranks
    for module in (iterative, multigrid):
        monkeypatch.setattr(module, "attach_motions", lambda *_: None)
    without, _ = iterations(problem)
    assert with_motions < without
    problem.destroy()
