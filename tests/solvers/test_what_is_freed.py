"""What is left of meshes and of PETSc's objects when problems are destroyed.

On several ranks PETSc keeps an object that Python drops without having destroyed it, and with the
object the communicators of its mesh, of which a process has a limited number.
"""

import ctypes
import gc
import re
import weakref

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini import (
    ContactProblem,
    ObstacleProblem,
    SidedMesh,
    SignoriniProblem,
    coarse_levels,
    elasticity,
    friedrichs_keller,
    solve_adaptively,
    solve_cascade,
)
from dolfinx_signorini.meshes.sided_meshes import boundary_facets


def waves(domain, degree=1, kind=SignoriniProblem, data=None):
    """A problem with several pieces of contact, on the boundary or in the domain."""
    data = {"contact": boundary_facets(domain)} if data is None else data
    space = fem.functionspace(domain, ("Lagrange", degree))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    load = 30.0 * ufl.sin(7.0 * ufl.SpatialCoordinate(domain)[0]) - 4.0
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    return kind(a, load * v * ufl.dx, **data)


def block(domain):
    """A body with its weight, held above."""
    space = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    below, above = (
        mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y))
        for y in (0.0, 1.0)
    )
    held = fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(space, 1, above), space)
    a = elasticity(u, v, young=100.0, poisson=0.3)
    return ContactProblem(a, -v[1] * ufl.dx, contact=below, gap=0.0, bcs=[held])


POSED = {
    "boundary": waves,
    "degree 2": lambda domain: waves(domain, 2),
    "obstacle": lambda domain: waves(domain, 1, ObstacleProblem, {"lower": 0.0}),
    "body": block,
}


@pytest.mark.skipif(MPI.COMM_WORLD.size == 1, reason="one rank keeps nothing")
def test_petsc_keeps_no_object(comm, capfd):
    for name, pose in POSED.items():
        domain = friedrichs_keller(comm, 40)
        problem = pose(domain)
        problem.solve()
        problem.solve()
        problem.destroy()
        del problem
        gc.collect()
        capfd.readouterr()
        PETSc.garbage_view(domain.comm)
        ctypes.CDLL(None).fflush(None)
        entries = re.findall(r"entries: (\d+)", comm.bcast(capfd.readouterr().out))
        assert entries == ["0"] * comm.size, name


@pytest.fixture
def no_collector():
    """Let meshes be freed where nothing refers to them any more, and not some time later."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def test_an_adaptive_loop_frees_meshes_that_are_no_parents(comm, no_collector):
    meshes, counts = [], []

    def alive():
        return {id(each()) for each in meshes if each() is not None}

    def pose(sided):
        meshes.append(weakref.ref(sided.mesh))
        counts.append(len(alive()))
        return waves(sided.mesh, 2)

    first = SidedMesh(friedrichs_keller(comm, 6), {})
    found = solve_adaptively(pose, first, norm="L2", accuracy=1e-3)
    del first
    assert len(found.steps) > 2
    # One mesh of each step is a parent, which multigrid needs.
    assert len(alive()) == len(found.steps) + 1
    assert max(counts) == len(found.steps) + 2  # while the next problem is posed
    found.problem.destroy()
    del found
    assert not alive()


def test_a_cascade_leaves_its_last_mesh_alone(comm, no_collector):
    meshes = []

    def make(level, coarser):
        domain = friedrichs_keller(comm, level)
        meshes.append(weakref.ref(domain))
        return waves(domain)

    problem = solve_cascade(make, [*coarse_levels(120), 120])
    assert [each() is not None for each in meshes] == [False, True]
    problem.destroy()
    del problem
    assert meshes[-1]() is None
