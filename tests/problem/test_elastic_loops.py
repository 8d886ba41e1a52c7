"""Loops of elastic contact: steps begin with the last contact set, and solves are counted."""

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from elastic_cases import COMM, largest

from dolfinx_signorini import ContactProblem, elasticity
from dolfinx_signorini.solvers.linear.iterative import IterativeSolver

STEPS = 50


class Indented:
    """A block that is held above, over a paraboloid that may rise, under a load that may grow."""

    def __init__(self, n, size, degree=1):
        create = dolfinx.mesh.create_unit_cube if size == 3 else dolfinx.mesh.create_unit_square
        domain = create(COMM, *[n] * size)
        space = fem.functionspace(domain, ("Lagrange", degree, (size,)))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        below, above = (
            dolfinx.mesh.locate_entities_boundary(
                domain, size - 1, lambda x, z=z: np.isclose(x[size - 1], z)
            )
            for z in (0.0, 1.0)
        )
        self.weight, self.height = fem.Constant(domain, 0.0), fem.Constant(domain, 0.0)
        self.moved = fem.Constant(domain, np.zeros(size))
        x = ufl.SpatialCoordinate(domain)
        dofs = fem.locate_dofs_topological(space, size - 1, above)
        self.problem = ContactProblem(
            elasticity(u, v, young=200.0, poisson=0.3),
            -self.weight * v[size - 1] * ufl.dx,
            contact=below,
            gap=0.2 * sum((x[i] - 0.45) ** 2 for i in range(size - 1)) - self.height,
            bcs=[fem.dirichletbc(self.moved, dofs, space)],
        )

    def step(self, kind, part):
        """Set the data of a part of the way, and solve; the linear solves and their iterations."""
        if kind == "load":
            self.weight.value = 40.0 * part
        elif kind == "sinking":
            self.moved.value[-1] = -0.05 * part
        else:
            self.height.value = 0.05 * part
        self.problem.solve(rtol=1e-8)
        return self.problem.result.linear_solves, self.problem.result.linear_iterations

    def one_linear_solve(self):
        """The iterations of one solve from zero, with the contact known."""
        system = self.problem.system
        solver, x = IterativeSolver(system, f"one_{id(self)}_"), system.start()
        held = np.isin(system.contact_dofs // self.problem.space.dofmap.bs, self.problem.active)
        x.set(0.0)
        system.place(x, held)
        forces = system.A.createVecLeft()
        system.A.mult(x, forces)
        forces.axpy(-1.0, system.b)
        forces.array_w[np.concatenate((system.contact_dofs[held], system.fixed_dofs))] = 0.0
        solver.solve(system, x, held, 0.5e-8 * forces.norm())
        found = solver.iterations
        solver.destroy()
        for item in (x, forces):
            item.destroy()
        return found


@pytest.mark.parametrize("kind", ["load", "sinking", "indenter"])
@pytest.mark.parametrize("n, size, degree", [(48, 2, 1), (20, 2, 2), (8, 3, 1)])
def test_a_step_costs_a_linear_solve(kind, n, size, degree):
    """The first steps apart, in which contact begins: one to two solves a step, with few digits.

    All iterations of a step are fewer than 1.3 times those of one solve from zero.
    """
    body, counts, active = Indented(n, size, degree), [], []
    for k in range(1, STEPS + 1):
        counts.append(body.step(kind, k / STEPS))
        active.append(body.problem.result.active_dofs)
    solves, iterations = np.array(counts)[5:].T
    assert active[-1] >= 2 * active[4] > 0 and active == sorted(active)
    assert solves.mean() <= (2.0 if COMM.size == 1 else 2.5), solves  # patches end at ranks
    assert solves.max() <= 5, solves
    if "multigrid" in body.problem.result.preconditioner:
        assert iterations.mean() <= 1.3 * body.one_linear_solve(), iterations
    problem = body.problem
    found, force = problem.u.x.array.copy(), problem.force
    problem.solve(rtol=1e-8, warm_start=False)
    assert largest(found - problem.u.x.array) <= 1e-6 * largest(found)
    assert force == pytest.approx(problem.force, rel=1e-6, abs=1e-6)
    problem.destroy()
