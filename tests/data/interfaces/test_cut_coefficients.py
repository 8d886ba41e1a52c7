"""The warning for a diffusion that jumps inside of cells: exactly where its jump cuts a cell."""

import logging

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_signorini as ds
from dolfinx_signorini.base import logs
from dolfinx_signorini.data.interfaces import piecewise_forms
from dolfinx_signorini.problem.arguments import has_choices

COMM = MPI.COMM_WORLD
# Facets lie on x = k/6, y = k/6, and on the diagonals x - y = k/6; see `create_unit_square`.
SQUARE = dolfinx.mesh.create_unit_square(COMM, 6, 6)
CUBE = dolfinx.mesh.create_unit_cube(COMM, 3, 3, 3)


def between(inside):
    return ufl.conditional(inside, 1.0, 10.0)


def circle(x, y, radius):
    return lambda z: between((z[0] - x) ** 2 + (z[1] - y) ** 2 < radius**2)


@pytest.fixture(autouse=True)
def forget():
    """Each coefficient is told once in a process."""
    logs.warn_once.cache_clear()


def warnings(caplog, domain, form, solves=1):
    """What the solve says about a form, as a function of u, v and x."""
    V = fem.functionspace(domain, ("Lagrange", 1))
    u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(domain)
    axis = domain.geometry.dim - 1
    bottom, top = (
        dolfinx.mesh.locate_entities_boundary(domain, axis, lambda x, y=y: np.isclose(x[axis], y))
        for y in (0.0, 1.0)
    )
    bc = fem.dirichletbc(0.0, fem.locate_dofs_topological(V, axis, top), V)
    problem = ds.SignoriniProblem(
        form(u, v, x), -v * ufl.dx, contact=bottom, obstacle=-0.05, bcs=[bc]
    )
    with caplog.at_level(logging.WARNING, logger="dolfinx_signorini"):
        for _ in range(solves):
            problem.solve()
    problem.destroy()
    return [record.getMessage() for record in caplog.records]


def diffusion(k):
    return lambda u, v, x: k(x) * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx


@pytest.mark.parametrize(
    ("k", "cuts"),
    [
        (lambda x: between(x[1] < 0.5), False),
        (lambda x: between(x[1] < 0.51), True),
        (lambda x: between(x[1] <= 1 / 6), False),
        (lambda x: between(ufl.lt(x[0], x[1])), False),
        (lambda x: between(x[0] + x[1] < 1.0), True),
        (lambda x: between(x[0] < 2.0), False),
        (lambda x: between((x[0] + 1.0) ** 2 < 2.25), False),  # not linear, on the facets x = 1/2
        (lambda x: between((x[0] + 1.0) ** 2 < 2.26), True),
        (lambda x: 2.0 + ufl.sign(x[1] - 0.4), True),
        (lambda x: 2.0 + ufl.sign(x[1] - 1 / 3), False),
        (circle(0.5, 0.5, 0.2), True),
        (circle(0.11, 0.04, 0.02), True),  # inside of one cell, and around no vertex
        (circle(0.5, 0.5, 0.9), False),
        (lambda x: 1.0 + abs(x[1] - 0.4), False),  # a kink is no jump
        (lambda x: 1.0 + x[1], False),
    ],
)
def test_a_warning_comes_exactly_where_a_cell_is_cut(caplog, k, cuts):
    told = warnings(caplog, SQUARE, diffusion(k))
    assert len(told) == (cuts and COMM.rank == 0)
    if told:
        assert told[0].startswith("a: the coefficient ") and "docs/howto/jumps.md" in told[0]


@pytest.mark.parametrize(("height", "cuts"), [(1 / 3, False), (0.4, True)])
def test_in_space(caplog, height, cuts):
    told = warnings(caplog, CUBE, diffusion(lambda x: between(x[2] < height)))
    assert len(told) == (cuts and COMM.rank == 0)


def test_the_entries_of_a_matrix_are_read(caplog):
    def form(u, v, x):
        K = ufl.as_matrix([[1.0, 0.0], [0.0, between(x[0] < 0.3)]])
        return ufl.inner(K * ufl.grad(u), ufl.grad(v)) * ufl.dx

    assert len(warnings(caplog, SQUARE, form)) == (COMM.rank == 0)


def test_each_coefficient_is_told_once(caplog):
    form = diffusion(lambda x: between(x[1] < 0.4))
    assert len(warnings(caplog, SQUARE, form, solves=2)) == (COMM.rank == 0)
    assert len(warnings(caplog, SQUARE, form)) == (COMM.rank == 0)


@pytest.mark.parametrize(("number", "cuts"), [(1, False), (2, True)])
def test_only_the_cells_of_an_integral_count(caplog, number, cuts):
    count = SQUARE.topology.index_map(2).size_local
    middles = dolfinx.mesh.compute_midpoints(SQUARE, 2, np.arange(count, dtype=np.int32))
    numbers = np.where(middles[:, 1] < 1 / 3, 1, 2).astype(np.int32)
    tags = dolfinx.mesh.meshtags(SQUARE, 2, np.arange(count, dtype=np.int32), numbers)
    dx = ufl.Measure("dx", SQUARE, subdomain_data=tags)

    def form(u, v, x):
        slopes = ufl.inner(ufl.grad(u), ufl.grad(v))
        return between(x[1] < 0.4) * slopes * dx(number) + slopes * dx(3 - number)

    assert len(warnings(caplog, SQUARE, form)) == (cuts and COMM.rank == 0)


def test_what_does_no_harm_is_not_told(caplog):
    def reaction(u, v, x):
        return (ufl.inner(ufl.grad(u), ufl.grad(v)) + between(x[1] < 0.4) * u * v) * ufl.dx

    def on_cells(u, v, x):
        k = fem.Function(fem.functionspace(SQUARE, ("DG", 0)))
        k.interpolate(lambda x: np.where(x[1] < 0.4, 1.0, 10.0))
        return k * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx

    assert warnings(caplog, SQUARE, reaction) == []
    assert warnings(caplog, SQUARE, on_cells) == []


def test_the_adaptive_loop_which_follows_the_jump_is_silent(caplog):
    def pose(sided):
        V = fem.functionspace(sided.mesh, ("Lagrange", 2))
        u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(sided.mesh)
        a = diffusion(lambda x: between(x[1] < 0.4))(u, v, x)
        bc = fem.dirichletbc(0.0, fem.locate_dofs_topological(V, 1, sided.sides["top"]), V)
        floor = sided.sides["floor"]
        return ds.SignoriniProblem(a, -v * ufl.dx, contact=floor, obstacle=-0.05, bcs=[bc])

    domain = dolfinx.mesh.create_unit_square(COMM, 6, 6)
    sides = {
        name: dolfinx.mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y))
        for name, y in (("floor", 0.0), ("top", 1.0))
    }
    with caplog.at_level(logging.WARNING, logger="dolfinx_signorini"):
        ds.solve_adaptively(pose, ds.SidedMesh(domain, sides), norm="H1", accuracy=0.05)
    assert not [r for r in caplog.records if "docs/howto/jumps.md" in r.getMessage()]


def test_forms_without_choices_are_not_read(monkeypatch, caplog):
    monkeypatch.setattr(piecewise_forms, "choices_in_diffusion", None)
    assert warnings(caplog, SQUARE, diffusion(lambda x: 1.0 + x[1])) == []
    x = ufl.SpatialCoordinate(SQUARE)
    assert has_choices(between(x[1] < 0.4) * ufl.dx)
    assert not has_choices(abs(x[1]) * ufl.dx + between(x[1] < 0.4) * ufl.ds)
