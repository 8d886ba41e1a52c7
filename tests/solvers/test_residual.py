"""The natural residual, number by number: what counts, and relative to which forces."""

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.base.ranks import parallel_norm
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.solvers.residual import NaturalResidual

COMM = MPI.COMM_WORLD


def make(load=-1.0, obstacle=0.0, clamped=None):
    """Pressed on the bottom; the top is free or has constant Dirichlet data."""
    domain = friedrichs_keller(COMM, 6)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    bottom, top = (
        dolfinx.mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y))
        for y in (0.0, 1.0)
    )
    dofs = fem.locate_dofs_topological(space, 1, top)
    return SignoriniProblem(
        7.0 * (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx,
        fem.Constant(domain, load) * v * ufl.dx,
        contact=bottom,
        obstacle=obstacle,
        bcs=[] if clamped is None else [fem.dirichletbc(clamped, dofs, space)],
    )


def norm(values):
    return float(np.sqrt(COMM.allreduce(float(np.sum(np.square(values))))))


def by_hand(system, values):
    """The natural residual vector of owned values, and A v - b, by their definitions."""
    x = system.A.createVecRight()
    x.array_w[:] = values
    product = x.duplicate()
    system.A.mult(x, product)
    multiplier = product.array_r - system.b.array_r
    x.destroy()
    product.destroy()
    residual, dofs = multiplier.copy(), system.contact_dofs
    gap = values[dofs] - system.obstacle
    residual[dofs] = np.minimum(system.contact_diagonal * gap, multiplier[dofs])
    residual[system.fixed_dofs] = 0.0
    return residual, multiplier, gap


@pytest.mark.parametrize("shift", [0.3, 0.0, -0.2])
@pytest.mark.parametrize("clamped", [None, 5.0, 0.002])
def test_the_residual_is_min_of_gap_and_multiplier_over_the_load(shift, clamped):
    problem = make(clamped=clamped)
    system = problem.system
    x = system.start()
    values = 0.1 * np.cos(np.arange(len(x.array_r))) + shift  # above, at and below the obstacle
    values[system.fixed_dofs] = system.fixed_values
    x.array_w[:] = values
    residual, multiplier, gap = by_hand(system, values)
    # The forces on Dirichlet dofs are reactions and no load; the body rests at the data or at 0.
    rest, forces = system.A.createVecs()
    rest.set(clamped or 0.0)
    system.A.mult(rest, forces)
    loads = [system.b.array_r.copy(), system.b.array_r - forces.array_r]
    for each in loads:
        each[system.fixed_dofs] = 0.0
    load = min(loads, key=lambda load: COMM.allreduce(np.abs(load).sum()))
    rest.destroy()
    forces.destroy()
    measure = NaturalResidual(system)
    assert measure(x) == pytest.approx(norm(residual) / norm(load), rel=1e-12)
    defect = multiplier[system.contact_dofs] - system.contact_diagonal * gap
    assert measure.defect(x) == pytest.approx(defect, rel=1e-12, abs=1e-12)
    for item in (measure, x):
        item.destroy()
    problem.destroy()


def test_the_residual_that_a_solve_tells_is_that_of_its_solution():
    problem = make()
    for rtol in (1e-2, 1e-5, 1e-9):
        u = problem.solve(rtol=rtol, warm_start=False)
        owned = u.x.array[: problem.b.getLocalSize()]
        residual, _, _ = by_hand(problem.system, owned)
        told = problem.result.natural_residual
        assert told <= rtol
        assert told == pytest.approx(norm(residual) / problem.b.norm(), rel=1e-6, abs=1e-15)
    problem.destroy()


@pytest.mark.parametrize("height", [1.0, 1e3])
def test_on_a_high_obstacle_the_pressure_counts_and_not_the_lifting_force(height):
    # A load that lets the body press with little more than its load.
    problem = make(load=7.0 * height - 1.0, obstacle=height)
    u = problem.solve(rtol=1e-11)
    x = problem.system.vector_of(u)
    measure = NaturalResidual(problem.system, 1e-11)
    measure(x)
    forces = problem.system.multiplier(x)
    assert measure.scale == pytest.approx(problem.b.norm() + norm(forces), rel=1e-6)
    lifting = norm(problem.system.contact_diagonal * height)
    assert measure.scale < problem.b.norm() + 0.5 * lifting
    for item in (measure, x):
        item.destroy()
    problem.destroy()


@pytest.mark.parametrize("size", [1.0, 1e-200, 1e200])
def test_norms_do_not_overflow_and_do_not_underflow(size):
    assert parallel_norm(COMM, size * np.array([3.0, -4.0])) == pytest.approx(
        5.0 * size * np.sqrt(COMM.size), rel=1e-14
    )
