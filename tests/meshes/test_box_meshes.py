"""Meshes of lattices against those of DOLFINx, and how the ranks share them."""

import math

import numpy as np
import pytest
import ufl
from dolfinx import default_scalar_type, fem, mesh
from dolfinx.fem import petsc as fem_petsc
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.meshes import box_meshes
from dolfinx_signorini.meshes.box_meshes import box_mesh, friedrichs_keller

COMM = MPI.COMM_WORLD


@pytest.mark.parametrize("n", [1, 2, 7, 20])
def test_every_cell_has_one_owner_and_every_interior_facet_both_its_cells(n):
    domain = friedrichs_keller(COMM, n)
    topology = domain.topology
    assert topology.index_map(2).size_global == 2 * n * n
    assert topology.index_map(0).size_global == (n + 1) ** 2
    one = fem.Constant(domain, default_scalar_type(1.0))

    def total(integral):
        return COMM.allreduce(fem.assemble_scalar(fem.form(integral)))

    assert total(one * ufl.dx) == pytest.approx(1.0, rel=1e-13)
    assert total(one * ufl.ds) == pytest.approx(4.0, rel=1e-13)
    # The inner grid lines and the diagonals; without its ghost cell a facet would be missing.
    assert total(one("+") * ufl.dS) == pytest.approx(2.0 * (n - 1) + n * math.sqrt(2.0), rel=1e-13)


def test_the_ranks_share_the_cells_evenly_and_alike_in_every_run():
    first, second = (friedrichs_keller(COMM, 24) for _ in range(2))
    cells = first.topology.index_map(2).size_local
    assert abs(cells - 2 * 24**2 / COMM.size) <= 2 * 24
    assert np.array_equal(first.geometry.x, second.geometry.x)
    assert np.array_equal(first.geometry.dofmap, second.geometry.dofmap)


def facts(domain):
    """What does not depend on numbers of cells and nodes, nor on ranks."""
    dim, x = domain.topology.dim, ufl.SpatialCoordinate(domain)
    for k in range(dim):
        domain.topology.create_entities(k)
    domain.topology.create_connectivity(dim - 1, dim)
    counts = [domain.topology.index_map(k).size_global for k in range(dim + 1)]
    counts.append(COMM.allreduce(len(mesh.exterior_facet_indices(domain.topology))))
    space = fem.functionspace(domain, ("Lagrange", 2))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    jumps = ufl.inner(ufl.jump(ufl.grad(u)), ufl.jump(ufl.grad(v))) * ufl.dS
    norms = []
    for form in (ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, (1 + x[0]) * u * v * ufl.ds, jumps):
        matrix = fem_petsc.assemble_matrix(fem.form(form))
        matrix.assemble()
        norms.append(matrix.norm())
        matrix.destroy()
    return counts, norms


@pytest.mark.parametrize("cells", [(7, 5), (1, 1), (2, 9), (4, 3, 5), (1, 1, 1), (2, 1, 6)])
def test_the_meshes_are_those_of_dolfinx(cells):
    high = [1.0, 2.0, 0.5][: len(cells)]
    lines = [np.linspace(0.0, end, n + 1) for end, n in zip(high, cells, strict=True)]
    made = mesh.create_rectangle if len(cells) == 2 else mesh.create_box
    shared = mesh.GhostMode.shared_facet
    other = made(COMM, [[0.0] * len(cells), high], cells, ghost_mode=shared)
    (counts, norms), (right, expected) = facts(box_mesh(COMM, lines)), facts(other)
    assert counts == right
    assert norms == pytest.approx(expected, rel=1e-12)


WIDTHS = st.lists(st.floats(1e-3, 10.0), min_size=1, max_size=6)


@settings(max_examples=25)
@given(st.lists(WIDTHS, min_size=2, max_size=3), st.floats(-5.0, 5.0))
def test_nodes_lie_at_all_combinations_of_coordinates(widths, start):
    lines = [start + np.cumsum([0.0, *w]) for w in widths]
    domain = box_mesh(COMM, [line.tolist() for line in lines])
    owned = domain.geometry.index_map().size_local
    x = np.concatenate(COMM.allgather(domain.geometry.x[:owned, : len(lines)]))
    expected = np.stack([c.ravel() for c in np.meshgrid(*lines, indexing="ij")], axis=1)
    assert np.array_equal(x[np.lexsort(x.T[::-1])], expected)
    volume = fem.assemble_scalar(fem.form(default_scalar_type(1.0) * ufl.dx(domain)))
    size = np.prod([line[-1] - line[0] for line in lines])
    assert COMM.allreduce(volume) == pytest.approx(size, rel=1e-12)


def test_the_last_node_of_a_side_is_at_one():
    for n in (7, 49, 93):  # (1 / 49) * 49 is less than 1
        x = friedrichs_keller(COMM, n).geometry.x
        assert COMM.allreduce(x[:, :2].max(initial=0.0), op=MPI.MAX) == 1.0


@pytest.mark.parametrize(
    ("cubes", "ranks", "blocks"),
    [
        ((1001, 1001), 4, (2, 2)),
        ((100, 2), 4, (4, 1)),
        ((2, 100), 6, (1, 6)),
        ((8, 8, 8), 8, (2, 2, 2)),
        ((64, 64, 4), 16, (4, 4, 1)),
        ((9, 9), 2, (2, 1)),
        ((5, 5, 5), 3, (3, 1, 1)),
        ((5, 7), 1, (1, 1)),
    ],
)
def test_blocks_are_small_and_have_small_surfaces(cubes, ranks, blocks):
    assert box_meshes._blocks(ranks, cubes) == blocks


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (None, "two or three lists of coordinates"),
        ([[0, 1]], "two or three lists of coordinates, not 1"),
        ([[0, 1]] * 4, "not 4"),
        ([[0, 1], [0]], "at least two finite numbers"),
        ([[0, 1], [0, 1, 1]], "increasing"),
        ([[0, 1], [0, math.nan]], "increasing"),
        ([[0, 1], [0, math.inf]], "finite"),
        ([[0, 1], "01"], "lists of at least two"),
        ([[0, 1], [[0, 1]]], "lists of at least two"),
        ([3, 4], "lists of at least two"),
    ],
)
def test_lines_that_are_no_coordinates_are_refused(lines, words):
    with pytest.raises(InputError, match=words) as caught:
        box_mesh(COMM, lines)
    assert caught.value.subject == "lines"
