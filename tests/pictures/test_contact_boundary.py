"""Pieces of the contact boundary: their sizes, and which of them are in contact or undecided."""

import numpy as np
import pytest
import ufl
from dolfinx import mesh
from mpi4py import MPI

import dolfinx_signorini as ds
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.pictures.contact_boundary import (
    CLEAR,
    ContactBoundary,
    gather_contact_boundary,
)
from dolfinx_signorini.studies.paper.solution import christof_haubner, paper_problem

COMM = MPI.COMM_WORLD


def boundary(points, pieces, touching, clear):
    return ContactBoundary(
        points=np.array(points, dtype=np.float64),
        values=np.zeros((len(points), 3)),
        pieces=np.array(pieces),
        touching=np.array(touching, dtype=bool),
        clear=np.array(clear, dtype=bool),
        upper=False,
    )


def test_lengths_and_what_touches_with_both_ends():
    line = boundary(
        [(0, 0), (3, 4), (3, 5), (5, 5), (5, 6)],
        [(0, 1), (1, 2), (2, 3), (3, 4)],
        [1, 1, 0, 0, 0],
        [0, 0, 0, 0, 1],
    )
    assert line.sizes == pytest.approx([5.0, 1.0, 2.0, 1.0])
    assert line.in_contact.tolist() == [True, False, False, False]
    assert line.undecided.tolist() == [False, True, True, False]


def test_areas_of_triangles():
    surface = boundary(
        [(0, 0, 0), (2, 0, 0), (0, 1, 0), (0, 0, 3)],
        [(0, 1, 2), (0, 2, 3)],
        [1, 1, 1, 0],
        [0, 0, 0, 1],
    )
    assert surface.sizes == pytest.approx([1.0, 1.5])
    assert surface.in_contact.tolist() == [True, False]
    assert surface.undecided.tolist() == [False, False]


def posed(degree, size, length, comm):
    """A body, or a membrane for size 1, on a bump; the vector to the obstacle has a length."""
    domain = friedrichs_keller(comm, 8)
    sides = [
        mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y)) for y in (0, 1)
    ]
    space = ds.bernstein_space(domain, degree, (size,) if size > 1 else ())
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    bump = 0.02 + 0.5 * (x[0] - 0.4) ** 2
    if size == 1:
        top = ds.dirichlet(space, sides[1], 0.0)
        a, L = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, -v * ufl.dx
        return ds.SignoriniProblem(a, L, contact=sides[0], obstacle=-bump, bcs=[top])
    a, L = ds.elasticity(u, v, young=2.0, poisson=0.3), -v[1] * ufl.dx
    known = {"contact": sides[0], "gap": length * bump, "direction": (0.0, -length)}
    bcs = [ds.dirichlet(space, sides[1], 0.0, k) for k in range(size)]
    return ds.ContactProblem(a, L, **known, bcs=bcs)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("size, length", [(1, 1.0), (2, 1.0), (2, 0.01), (2, 30.0)])
def test_points_in_contact_have_no_gap_and_the_gap_is_what_u_leaves(degree, size, length):
    problem = posed(degree, size, length, COMM)
    problem.solve(rtol=1e-10)
    found = gather_contact_boundary(problem.along_direction)
    some = COMM.allreduce(len(problem.active))
    problem.destroy()
    if found is None:
        return
    u, gap, _ = found.values.T
    assert 0 < found.touching.sum() < len(gap) and some
    assert gap[found.touching].max() <= 1e-6 * gap.max() < gap[~found.touching].max()
    bump = length * (0.02 + 0.5 * (found.points[:, 0] - 0.4) ** 2)
    assert gap + (u if size > 1 else -u) == pytest.approx(bump, abs=1e-9)


@pytest.mark.parametrize("n", [20, 41])
def test_contact_of_the_papers_solution(n):
    # Positive on 0.05 < x < 0.5 of the bottom, but hardly near the left end; zero elsewhere.
    problem = paper_problem(christof_haubner(friedrichs_keller(COMM, n)))
    problem.solve(rtol=1e-10)
    pieces = gather_contact_boundary(problem)
    problem.destroy()
    if pieces is None:
        return
    contact, undecided = (
        float(pieces.sizes[part].sum()) for part in (pieces.in_contact, pieces.undecided)
    )
    assert pieces.sizes.sum() == pytest.approx(4.0)
    assert 0.2 < 4.0 - contact - undecided < 1.0
    gap, size = pieces.values[:, 1], np.abs(pieces.values[:, 0]).max()
    assert np.array_equal(pieces.clear, gap > CLEAR * size * (1.0 / n) ** 1.5)


def test_contact_reaches_to_the_points_where_it_ends():
    # Contact from 1 to 3 and at 6 alone; it ends at 0.7, 3.4, 5.8 and, unknown, right of 6.
    x = np.arange(8.0)
    line = boundary(
        np.column_stack((x, 0.0 * x)),
        np.column_stack((np.arange(7), np.arange(1, 8))),
        [0, 1, 1, 1, 0, 0, 1, 0],
        [1, 0, 0, 0, 0, 0, 0, 0],
    )
    assert line.measured() == pytest.approx((2.0, 4.0))
    points = [(0.7, 0.0), (3.4, 0.0), (5.8, 0.0)]
    contact, undecided = line.measured(points)
    assert contact == pytest.approx(0.3 + 2.0 + 0.4 + 0.2)
    assert undecided == pytest.approx(2.0)  # from 4 to 5, and from 6 to 7
