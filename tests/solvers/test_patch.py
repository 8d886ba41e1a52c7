"""Patch problems: one dof at a wrong end of the active set is enough to find the right end."""

import numpy as np
import pytest
from mpi4py import MPI

from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.solvers.linear.iterative import IterativeSolver
from dolfinx_signorini.solvers.patch import active_in_patch
from dolfinx_signorini.solvers.residual import NaturalResidual
from dolfinx_signorini.studies.paper.solution import christof_haubner, paper_problem

COMM = MPI.COMM_WORLD


@pytest.mark.parametrize("off", [-4, -2, 3])
def test_an_end_that_is_off_by_some_dofs_is_put_right(off):
    n = 60
    problem = paper_problem(christof_haubner(friedrichs_keller(COMM, n)))
    problem.solve(rtol=1e-11)
    system = problem.system
    right = problem.u.x.array[system.contact_dofs] == 0.0
    x, y = problem.space.tabulate_dof_coordinates()[system.contact_dofs, :2].T
    bottom = (y < 1e-12) & (x > 0.3) & (x < 0.7)
    local = float(x[bottom & right].min(initial=np.inf))
    end = COMM.allreduce(local, op=MPI.MIN)  # the first dof in contact
    wrong = np.where(bottom, x > end + (off - 0.5) / n, right)
    solver, measure, v = IterativeSolver(system), NaturalResidual(system), system.start()
    solver.solve(system, v, wrong, 1e-12)
    system.project(v)
    measure(v)
    seeds = system.contact_dofs[bottom & (abs(x - end - off / n) < 0.5 / n)]
    found = active_in_patch(system, v, measure.multiplier, wrong, seeds)
    changes = COMM.allreduce(np.array([(wrong != right).sum(), (found != right)[bottom].sum()]))
    for item in (solver, measure, v):
        item.destroy()
    problem.destroy()
    assert changes[0] == abs(off)
    assert changes[1] == 0
