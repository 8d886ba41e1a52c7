"""Meshes fitted to jumps of formulas: straight ones on facets, curves next to facets."""

import math

import basix
import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from mpi4py import MPI

from dolfinx_signorini.data import parsing
from dolfinx_signorini.data.interfaces.fitting import fitted_mesh
from dolfinx_signorini.data.interfaces.following import follow
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import (
    SidedMesh,
    boundary_facets,
    cell_corners,
    cell_edges,
    facet_cells,
    facet_nodes,
    facet_scale,
    owned_cells,
)
from dolfinx_signorini.scenes.domains.kinds import Cube, Square

SELF = MPI.COMM_SELF

STRAIGHT = [
    (2, "where(3*x < 1, 1, 1000)", lambda x: 3.0 * x[..., 0] < 1.0),
    (2, "where(x + 0.37*y < 0.71, 1, 9)", lambda x: x[..., 0] + 0.37 * x[..., 1] < 0.71),
    (
        2,
        "where(max(abs(x - 0.47), abs(y - 0.52)) < 0.21, 1, 9)",
        lambda x: np.maximum(abs(x[..., 0] - 0.47), abs(x[..., 1] - 0.52)) < 0.21,
    ),
    (2, "where((x - 0.31)*(y - 0.62) > 0, 9, 1)", lambda x: (x - (0.31, 0.62)).prod(axis=-1) > 0.0),
    (
        2,
        "where(-(x - 0.31)^3*exp(y)/(x + y - 0.93) <= 0, 9, 1)",
        lambda x: (x[..., 0] - 0.31) * (x.sum(axis=-1) - 0.93) >= 0.0,
    ),
    (3, "where(x + 0.3*y + 0.5*z < 0.7, 1, 9)", lambda x: x @ (1.0, 0.3, 0.5) < 0.7),
]


def inner_points(domain):
    """Points inside of the owned cells, shape (cells, points, dimension), and the volumes."""
    dim = domain.topology.dim
    kind = basix.CellType[domain.topology.cell_name()]
    lattice = basix.create_lattice(kind, 12, basix.LatticeType.equispaced, False)
    count = domain.topology.index_map(dim).size_local
    edges = cell_edges(domain, np.arange(count, dtype=np.int32))
    first = domain.geometry.x[domain.geometry.dofmap[:count, 0], :dim]
    return first[:, None] + np.einsum("cij,qj->cqi", edges, lattice), abs(np.linalg.det(edges))


@pytest.mark.parametrize(("dim", "text", "inside"), STRAIGHT)
def test_no_cell_is_on_both_sides_of_a_straight_jump(dim, text, inside, comm):
    plain = (Square(4) if dim == 2 else Cube(2)).make(comm)
    fitted = fitted_mesh(plain, [parsing.parse(text, dim)], 3000)
    points, volumes = inner_points(fitted.mesh)
    sides = inside(points)
    assert (sides.all(axis=1) | ~sides.any(axis=1)).all()
    assert not comm.allreduce(bool((volumes < 1e-6).any()))
    total = comm.allreduce(volumes.sum()) / (2.0 if dim == 2 else 6.0)
    assert total == pytest.approx(1.0, abs=1e-12)
    boundary = boundary_facets(fitted.mesh)
    for k, (name, facets) in enumerate(fitted.sides.items()):
        mine = np.intersect1d(facets, boundary).astype(np.int32)
        area = comm.allreduce(facet_scale(fitted.mesh, facet_cells(fitted.mesh, mine)).sum())
        assert area == pytest.approx(1.0 if dim == 2 else 2.0, abs=1e-12), name
        nodes = facet_nodes(fitted.mesh, mine)
        nodes = fitted.mesh.geometry.x[np.unique(nodes)]
        assert (abs(nodes[:, k // 2] - k % 2) < 1e-14).all()


def test_a_fitted_mesh_has_any_number_of_sides(comm):
    # Each facet of the boundary has a side of its own, and one more side has the four corners.
    count = 20
    plain = Square(count).make(comm)
    facets = boundary_facets(plain.mesh)

    def places(domain, facets):
        middles = domain.geometry.x[facet_nodes(domain, facets)].mean(axis=1) - 0.5
        return np.degrees(np.arctan2(middles[:, 1], middles[:, 0])).round(6)

    angles = np.unique(np.concatenate(comm.allgather(places(plain.mesh, facets))))
    sides = {str(k): facets[places(plain.mesh, facets) == angle] for k, angle in enumerate(angles)}
    assert len(sides) == 4 * count
    sided = SidedMesh(plain.mesh, sides | {"all": facets})
    fitted = fitted_mesh(sided, [parsing.parse("where(x + 0.37*y < 0.713, 1, 9)")], 3000)
    cells = fitted.mesh.topology.index_map(2).size_global
    assert cells > plain.mesh.topology.index_map(2).size_global
    for name, facets in fitted.sides.items():
        area = comm.allreduce(facet_scale(fitted.mesh, facet_cells(fitted.mesh, facets)).sum())
        if name == "all":
            assert area == pytest.approx(4.0, abs=1e-12)
            continue
        # Vertices are moved along straight parts of the boundary between facets of one side.
        assert area == pytest.approx(1.0 / count, abs=1e-12), name
        near = np.abs(places(fitted.mesh, facets) - angles[int(name)])
        assert (near < 180.0 / count).all()


def test_a_mesh_without_a_jump_inside_cells_stays_as_it_is(comm):
    plain = Square(4).make(comm)
    assert fitted_mesh(plain, [parsing.parse("where(2*x < 1, 1, 2)")], 3000) is plain
    assert fitted_mesh(plain, [parsing.parse("1 + x^2")], 3000) is plain


def test_a_strip_narrower_than_a_cell_has_facets_on_both_sides(comm):
    plain = Square(4).make(comm)
    strip = parsing.parse("where(5*(x - 0.26)*(0.37 - x) > 0, 20*y, 0)")
    points, _ = inner_points(fitted_mesh(plain, [], 3000, straight=[strip]).mesh)
    inside = abs(points[..., 0] - 0.315) < 0.055
    assert (inside.all(axis=1) | ~inside.any(axis=1)).all()
    assert comm.allreduce(bool(inside.any()))


def test_of_loads_only_straight_jumps_get_facets(comm):
    plain = Square(4).make(comm)
    circle = parsing.parse("where(hypot(x - 0.5, y - 0.45) < 0.3, 1, 9)")
    line = parsing.parse("max(x + 0.37*y - 0.71, 0)")
    assert fitted_mesh(plain, [], 3000, straight=[circle]) is plain
    assert fitted_mesh(plain, [], 32, straight=[line]) is plain  # 32 cells are there already
    both = fitted_mesh(plain, [], 3000, straight=[circle, line])
    points, _ = inner_points(both.mesh)
    inside = points @ (1.0, 0.37) < 0.71
    assert (inside.all(axis=1) | ~inside.any(axis=1)).all()


def test_lines_that_are_nearly_straight_get_facets_next_to_them(comm):
    wave = parsing.parse("where(y < 0.4091 + 0.0004*sin(6*x), 0, 40)")
    points, _ = inner_points(fitted_mesh(Square(4).make(comm), [], 3000, straight=[wave]).mesh)
    above = points[..., 1] - 0.4091
    assert ((above > -1e-3).all(axis=1) | (above < 1e-3).all(axis=1)).all()


def test_refined_meshes_follow_a_circle(comm):
    formula = parsing.parse("where(hypot(x - 0.5, y - 0.45) < 0.3, 1, 9)")
    sided = fitted_mesh(Square(4).make(comm), [formula], 3000)
    wrong = []
    for _ in range(3):
        points, volumes = inner_points(sided.mesh)
        within = np.linalg.norm(points.mean(axis=1) - (0.5, 0.45), axis=1) < 0.3
        area = comm.allreduce(float(0.5 * volumes[within].sum()))
        wrong.append(abs(area - np.pi * 0.09))
        sided = refined(sided).sided
        follow(sided, [formula])
    assert wrong[0] < 0.02
    assert wrong[1] < 0.35 * wrong[0] and wrong[2] < 0.35 * wrong[1]  # 1/4; chords stay as wrong


def test_vertices_that_are_not_moved_keep_every_digit(comm):
    """A formula such as atan2(y, x) jumps where rounding moves the boundary y = 0."""
    formula = parsing.parse("where(y < 0.37, 1, 50)")
    sided = refined(fitted_mesh(Square(4).make(comm), [formula], 3000)).sided
    before = sided.mesh.geometry.x.copy()
    follow(sided, [formula])
    assert (sided.mesh.geometry.x == before).all()


def with_regions(comm, dim):
    """A square or cube whose left part and lower part are regions that overlap."""
    plain = (Square(4) if dim == 2 else Cube(2)).make(comm)
    middles = cell_corners(plain.mesh).mean(axis=1)
    left, low = (np.flatnonzero(middles[:, k] < 0.5).astype(np.int32) for k in range(2))
    return SidedMesh(plain.mesh, plain.sides, {"left": left, "low": low})


def sizes(sided):
    """The sizes of the sides and of the regions of a mesh, and the worst shape of a cell."""
    domain, comm = sided.mesh, sided.mesh.comm
    edges = cell_edges(domain, owned_cells(domain))
    dim = edges.shape[1]
    volumes = np.abs(np.linalg.det(edges)) / math.factorial(dim)
    corners = cell_corners(domain)
    lengths = np.linalg.norm(corners[:, :, None] - corners[:, None], axis=3).max(axis=(1, 2))
    boundary = boundary_facets(domain)
    mine = [np.intersect1d(f, boundary).astype(np.int32) for f in sided.sides.values()]
    areas = [facet_scale(domain, facet_cells(domain, facets)).sum() for facets in mine]
    own = [float(total) for total in (*areas, volumes.sum())]
    own += [float(volumes[cells].sum()) for cells in sided.regions.values()]
    worst = float((volumes / lengths**dim).min(initial=1.0))
    return np.sum(comm.allgather(own), axis=0), comm.allreduce(worst, op=MPI.MIN)


def made_at(comm, place, regions):
    """How far a vertex is from a point that is to be one, and the sizes before and after."""
    dim = len(place)
    plain = with_regions(comm, dim) if regions else (Square(3) if dim == 2 else Cube(1)).make(comm)
    made = fitted_mesh(plain, [], 3000, points=[tuple(place)])
    away = np.linalg.norm(made.mesh.geometry.x[:, :dim] - place, axis=1).min(initial=9.0)
    return comm.allreduce(away, op=MPI.MIN), sizes(plain), sizes(made)


@pytest.mark.parametrize("dim", [2, 3])
@given(data=st.data())
@settings(max_examples=10, phases=(Phase.generate,))  # meshes take long to shrink
def test_any_point_becomes_a_vertex(dim, data, comm):
    """Inside, on sides and edges of regions, next to corners: all that has a name stays."""
    some, near = st.sampled_from([0.0, 0.3, 0.5, 1.0]), st.sampled_from([1e-3, 0.4999])
    anywhere = st.one_of(st.floats(0.0, 1.0), some, near) if dim == 2 else some
    place = [data.draw(anywhere) for _ in range(dim)]
    place = comm.bcast(place)
    for regions in (True, False):
        away, (before, shape), (after, thin) = made_at(comm, place, regions)
        assert away < 2e-8
        assert after == pytest.approx(before, abs=1e-12)
        assert thin > 0.2 * shape


def test_points_outside_and_at_vertices_leave_a_mesh_as_it_is(comm):
    plain = Square(4).make(comm)
    assert fitted_mesh(plain, [], 3000, points=[(1.1, 0.5), (0.5, 0.25), (0.0, 1.0)]) is plain


def test_points_that_take_too_many_cells_stay_inside_of_cells(comm):
    """A corner that is very near cannot be moved; others can, and take no cell more."""
    plain = Square(4).make(comm)
    near, other = (1e-4, 2e-4), (0.3, 0.4)
    made = fitted_mesh(plain, [], 40, points=[near, other])
    x = made.mesh.geometry.x[:, :2]
    for place, there in ((near, False), (other, True)):
        away = np.linalg.norm(x - place, axis=1).min(initial=9.0)
        assert (comm.allreduce(away, op=MPI.MIN) < 1e-12) == there
    assert comm.allreduce(len(owned_cells(made.mesh))) == comm.allreduce(
        len(owned_cells(plain.mesh))
    )


def test_a_vertex_at_a_point_stays_where_a_jump_is_followed(comm):
    line, place = parsing.parse("where(x + 0.37*y < 0.713, 1, 9)"), (0.52, 0.5)
    made = fitted_mesh(Square(4).make(comm), [line], 3000, points=[place])
    away = np.abs(made.mesh.geometry.x[:, :2] - place).max(axis=1).min(initial=9.0)
    assert comm.allreduce(away, op=MPI.MIN) == 0.0
    points, _ = inner_points(made.mesh)
    inside = points @ (1.0, 0.37) < 0.713
    assert (inside.all(axis=1) | ~inside.any(axis=1)).all()


@pytest.mark.parametrize(
    ("text", "points"),
    [
        ("where(x - y < 0.1, 1, 3)", ()),
        ("where(hypot(x - 0.5, y - 0.45) < 0.31, 1, 9)", ()),
        ("1", ((0.25, 0.25), (1.0, 0.001))),
    ],
)
def test_the_fitted_mesh_is_the_same_on_any_number_of_ranks(comm, text, points):
    """Where two choices are as good as each other, numbers of nodes must not decide."""
    formulas = [parsing.parse(text)]
    meshes = [fitted_mesh(Square(6).make(c), formulas, 3000, points=points) for c in (comm, SELF)]
    middles = []
    for sided in meshes:
        domain = sided.mesh
        count = domain.topology.index_map(2).size_local
        x = domain.geometry.x[domain.geometry.dofmap[:count], :2].mean(axis=1)
        found = np.concatenate(domain.comm.allgather(x))
        middles.append(found[np.lexsort(np.round(found, 9).T)])
    assert middles[0] == pytest.approx(middles[1], abs=1e-14)
