"""Cells and patches of one shape: what they share is what each of them has alone."""

import numpy as np
import pytest
import ufl
from dolfinx import mesh
from energy_cases import Case, cube, detaching, sampled_bound, square, top

from dolfinx_signorini.bounds import condensation, congruence, patch_groups
from dolfinx_signorini.bounds.frames import cell_frames
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller


def refined(comm):
    """Return a mesh that is refined around the end of the contact set."""
    domain = square(comm, 8)
    for radius in (0.4, 0.2, 0.1):
        domain.topology.create_entities(1)
        edges = mesh.locate_entities(
            domain, 1, lambda x, r=radius: (x[0] - 0.5) ** 2 + x[1] ** 2 < r**2
        )
        domain, *_ = mesh.refine(domain, edges)
    return domain


@pytest.mark.parametrize(
    ("make", "degree", "c"),
    [(refined, 1, 0.0), (refined, 2, 1.0), (refined, 1, 1e6), (cube, 1, 1.0), (cube, 2, 0.0)],
)
def test_a_bound_without_classes_is_the_same(make, degree, c, monkeypatch, comm):
    domain = make(comm)
    case = Case(domain, detaching(ufl.SpatialCoordinate(domain)), degree, c=c, fixed=top)
    bound = sampled_bound(case.problem, case.terms)

    def apart(rows):
        return np.arange(len(rows), dtype=np.uint64)

    monkeypatch.setattr(patch_groups, "codes", apart)
    monkeypatch.setattr(condensation, "alike", lambda rows: (np.arange(len(rows)),) * 2)
    other = sampled_bound(case.problem, case.terms)
    assert other.total == pytest.approx(bound.total, rel=1e-9)
    assert other.cells == pytest.approx(bound.cells, rel=1e-6, abs=1e-9 * bound.total)
    assert other.notes == bound.notes


@pytest.mark.parametrize(
    ("make", "orders"), [(friedrichs_keller, 2), (lambda comm, n: cube(comm, n), 6)]
)
def test_translated_cells_have_one_order(make, orders, comm):
    """The squares of a plane lattice have two triangles each, the cubes six tetrahedra."""
    frames = cell_frames(make(comm, 6))
    edges = np.round(600 * (frames.corners - frames.corners[:, :1]))
    shapes = {tuple(row) for rows in comm.allgather(edges.reshape(len(edges), -1)) for row in rows}
    assert len(shapes) == orders


def test_ranks_agree_about_the_order_of_vertices(comm):
    """Two cells have the vertices of their facet in one order."""
    frames = cell_frames(cube(comm, 3))
    found = {}
    for vertices, facets in comm.allreduce(list(zip(frames.vertices, frames.facets, strict=True))):
        for k, facet in enumerate(facets):
            ends = tuple(np.delete(vertices, k))
            assert found.setdefault(facet, ends) == ends


def test_rows_that_differ_by_rounding_are_alike():
    rng = np.random.default_rng(0)
    rows = rng.random((50, 4))
    some = rng.integers(50, size=1000)
    noise = 1e-15 * rng.standard_normal((1000, 4))
    first, number = congruence.alike(rows[some] * (1.0 + noise))
    assert len(first) == len(set(some))
    assert (some[first][number] == some).all()
    members = congruence.codes(np.array([[1, 2], [3, 4], [3, 4], [1, 2], [1, 2], [3, 4]]))
    one, turned, again = congruence.codes_of_groups(
        members, np.array([0, 2, 4]), np.array([0, 1] * 3)
    )
    assert one == again != turned
