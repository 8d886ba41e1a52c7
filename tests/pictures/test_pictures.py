"""Pictures: the names of sides, the facets in contact, peaks that are cut off, and solids."""

import io
from itertools import product

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from matplotlib import colormaps
from matplotlib.collections import TriMesh
from matplotlib.image import imread
from mpi4py import MPI

from dolfinx_signorini import InputError, ObstacleProblem, SignoriniProblem
from dolfinx_signorini.pictures import problem_pictures
from dolfinx_signorini.pictures.contact_boundary import ContactBoundary, gather_contact_boundary
from dolfinx_signorini.pictures.contact_pictures import draw_contact
from dolfinx_signorini.pictures.picture import Picture, add_triangles, typeset_norm
from dolfinx_signorini.pictures.triangles import Slice, Triangles, gather_triangles

COMM = MPI.COMM_WORLD


def solved(domain, degree=1, pressed=0.5):
    """A body with a reaction on the floor 0, which is pressed down where x < pressed.

    u = f on the whole boundary but for diffusion, which is small: contact is where f < 0.
    """
    space = fem.functionspace(domain, ("Lagrange", degree))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    facets = mesh.exterior_facet_indices(domain.topology)
    a = (1e-6 * ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    problem = SignoriniProblem(a, (x[0] - pressed) * v * ufl.dx, contact=facets)
    problem.solve()
    return problem


def square(n=12):
    domain = mesh.create_unit_square(COMM, n, n)
    domain.topology.create_connectivity(1, 2)
    return domain


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_cells_that_are_no_simplices_are_drawn_whole(cell, degree):
    kind = mesh.CellType[cell]
    if cell == "quadrilateral":
        domain = mesh.create_unit_square(COMM, 3, 4, kind)
    else:
        domain = mesh.create_unit_cube(COMM, 2, 3, 2, kind)
    domain.topology.create_connectivity(domain.topology.dim - 1, domain.topology.dim)
    problem = solved(domain, degree)
    boundary = gather_contact_boundary(problem)
    u = problem.u
    drawn, whole = gather_triangles(u), 1.0 if cell == "quadrilateral" else 6.0
    if COMM.rank == 0:
        assert boundary.sizes.sum() == pytest.approx(4.0 if cell == "quadrilateral" else 6.0)
        corners = drawn.points[drawn.triangles]
        edges = corners[:, 1:] - corners[:, :1]
        areas = 0.5 * np.sqrt(np.linalg.det(edges @ edges.transpose(0, 2, 1)))
        assert areas.sum() == pytest.approx(whole)
    assert (problem.plot(what="solution") is None) == (COMM.rank > 0)
    assert (problem.plot() is None) == (COMM.rank > 0)
    problem.destroy()


def side(domain, axis, value):
    dim = domain.topology.dim - 1
    return mesh.locate_entities_boundary(domain, dim, lambda x: np.isclose(x[axis], value))


@pytest.mark.parametrize("degree", [1, 2])
def test_sides_are_named_where_they_are(degree):
    domain = square()
    sides = {"left": side(domain, 0, 0.0), "top": side(domain, 1, 1.0)}
    problem = solved(domain, degree)
    boundary = gather_contact_boundary(problem, sides)
    problem.destroy()
    if boundary is None:
        return
    middles = boundary.points[boundary.pieces].mean(axis=1)
    expected = np.where(middles[:, 0] == 0.0, 0, np.where(middles[:, 1] > 1.0 - 1e-9, 1, -1))
    assert np.array_equal(boundary.sides, expected)
    above = draw_contact(boundary).axes[0]
    (chain,) = boundary.chains()
    x = boundary.points[chain]
    s = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(x, axis=0).T))))
    for text in above.texts:  # a name is written where its side is
        x_there = [np.interp(text.get_position()[0], s, x[:, axis]) for axis in (0, 1)]
        assert x_there[0 if text.get_text() == "left" else 1] == pytest.approx(
            {"left": 0.0, "top": 1.0}[text.get_text()]
        )
    assert {text.get_text() for text in above.texts} == {"left", "top"}


@pytest.mark.parametrize("degree", [1, 3])
def test_the_active_set_is_drawn_on_the_mesh(degree, tmp_path):
    problem = solved(square(), degree)
    figure = problem.plot(what="solution")
    with pytest.raises(InputError, match="what"):
        problem.plot(what="everything")
    for sides in ([1], {"a": 5}, {1: np.array([0])}):
        with pytest.raises(InputError, match="sides"):
            problem.plot(sides=sides)
    for name in ("picture.unknown", "none/picture.png"):
        with pytest.raises(InputError, match=r"path|output folder"):
            problem.plot(tmp_path / name)
    problem.destroy()
    if figure is None:
        return
    drawn = {c.get_label(): np.array(c.get_segments()) for c in figure.axes[0].collections[1:]}
    parts = drawn["in contact"]
    assert len(drawn["contact boundary"]) == 48
    assert parts[:, :, 0].max() == pytest.approx(0.5, abs=1.1 / 12)
    assert parts[:, :, 0].min() == 0.0
    lengths = np.hypot(*(parts[:, 1] - parts[:, 0]).T).sum()
    assert lengths == pytest.approx(2.0, abs=0.3)  # the left side, and half of bottom and top
    assert figure._repr_png_().startswith(b"\x89PNG")


def boundary_with(pressure):
    count = len(pressure)
    x = np.linspace(0.0, 1.0, count)
    points = np.column_stack((x, np.zeros(count)))
    values = np.column_stack((x, x, pressure))
    pieces = np.column_stack((np.arange(count - 1), np.arange(1, count)))
    touching = np.zeros(count, dtype=bool)
    return ContactBoundary(points, values, pieces, touching, touching, False)


def test_a_peak_of_the_pressure_does_not_hide_the_rest():
    pressure = np.linspace(1.0, 2.0, 200)
    below = draw_contact(boundary_with(pressure)).axes[1]
    assert below.get_ylim()[1] >= 2.0 and below.get_title() == ""
    pressure[100] = 1e5
    below = draw_contact(boundary_with(pressure)).axes[1]
    assert 2.0 < below.get_ylim()[1] < 10.0
    assert "1e+05" in below.get_title()


def test_a_solid_is_drawn():
    domain = mesh.create_unit_cube(COMM, 2, 3, 4)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 2)))
    u.interpolate(lambda x: x[0] + 2.0 * x[1] - x[2])
    surface = gather_triangles(u)
    if surface is None:
        return
    corners = surface.points[surface.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.linalg.norm(normals, axis=1).sum() / 2.0 == pytest.approx(6.0)
    assert np.allclose(surface.values, surface.points @ [1.0, 2.0, -1.0])
    faces = problem_pictures.draw_solid(surface, corners[:0]).axes[0].collections[0]
    assert np.allclose(faces.get_array(), corners.mean(axis=1) @ [1.0, 2.0, -1.0])


def test_a_solid_is_seen_from_where_contact_is():
    corners = np.array(list(product([1.0, 3.0], [-2.0, 0.0], [0.0, 1e-3])))
    surface = Triangles(corners, np.zeros(8), np.array([[0, 1, 2]]))
    for axis, end in product(range(3), (0, 1)):
        side = corners[corners[:, axis] == np.unique(corners[:, axis])[end]]
        pieces = np.array([[0, 1, 2], [1, 2, 3]])
        view = problem_pictures.view_of(surface, side[pieces])
        assert view[axis] == 2 * end - 1 and np.delete(view, axis).tolist() == [1.0, 1.0]


def test_triangles_have_the_colours_of_their_values_and_are_no_objects(monkeypatch):
    def objects(*_):
        raise AssertionError("an object of each triangle")

    monkeypatch.setattr(TriMesh, "convert_mesh_to_paths", objects)
    picture = Picture(figsize=(2.0, 2.0), dpi=50, layout="none")
    axes = picture.add_axes((0.0, 0.0, 1.0, 1.0))
    points = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [0.0, 2.0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    add_triangles(axes, points, triangles, points @ [0.25, 0.0], cmap="viridis")
    axes.margins(0.0)
    assert axes.get_xlim() == (0.0, 4.0) and axes.get_ylim() == (0.0, 2.0)
    row = imread(io.BytesIO(picture.png()))[50, 10:90, :3]
    # Gouraud's colours are linear in red, green and blue between the vertices.
    ends = colormaps["viridis"]([0.0, 1.0])[:, :3]
    wanted = ends[0] + (ends[1] - ends[0]) * ((np.arange(10, 90) + 0.5) / 100.0)[:, None]
    np.testing.assert_allclose(row, wanted, atol=0.02)


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("L4", "$L^{4}$"),
        ("Linf", r"$L^{\infty}$"),
        ("W1_16", "$W^{1,16}$"),
        ("W1_inf", r"$W^{1,\infty}$"),
        ("Linf_sampled", r"$L^{\infty}$ sampled"),
        ("H1", "$H^{1}$"),
        ("H1_2_boundary", r"$H^{1/2}(\partial\Omega)$"),
        ("H1_2_boundary_spectral", r"$H^{1/2}(\partial\Omega)$ spectral"),
        ("L2_boundary", r"$L^{2}(\partial\Omega)$"),
        ("a functional", "a functional"),
    ],
)
def test_norms_are_typeset(name, label):
    assert typeset_norm(name) == label
    figure = Picture()
    figure.text(0.5, 0.5, typeset_norm(name))
    assert figure.png().startswith(b"\x89PNG")  # matplotlib reads it


@pytest.mark.parametrize(("kind", "degree"), [("tetrahedron", 2), ("hexahedron", 1)])
def test_a_slice_through_a_solid(kind, degree):
    """A linear function is exact on the slice, whose triangles cover the section of the solid."""
    cells = mesh.CellType[kind]
    corners = [(0.0, 0.0, 0.0), (2.0, 1.0, 3.0)]
    domain = mesh.create_box(COMM, corners, (4, 3, 5), cells)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", degree)))
    u.interpolate(lambda x: 3.0 * x[0] - 2.0 * x[1] + 5.0 * x[2])
    for axis, others, height in ((0, [1, 2], 0.7), (1, [0, 2], 0.5), (2, [0, 1], 0.0)):
        found = Slice(domain, axis, height).gather(u)
        assert (found is None) == (COMM.rank > 0)
        if found is None:
            continue
        x = np.full((len(found.points), 3), height)
        x[:, others] = found.points
        assert found.values == pytest.approx(x @ [3.0, -2.0, 5.0], abs=1e-12)
        p, q = (
            found.points[found.triangles[:, i]] - found.points[found.triangles[:, 0]]
            for i in (1, 2)
        )
        area = 0.5 * np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum()
        assert area == pytest.approx(np.prod(np.array(corners[1])[others]))


def test_a_slice_of_an_obstacle_problem_in_space(tmp_path):
    domain = mesh.create_unit_cube(COMM, 4, 4, 4)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    load = (ufl.SpatialCoordinate(domain)[0] - 0.5) * v * ufl.dx
    problem = ObstacleProblem(a, load, lower=0.0)
    problem.solve()
    problem.plot(tmp_path / f"slice-{COMM.rank}.png", what="contact", plane=("y", 0.3))
    assert (tmp_path / f"slice-{COMM.rank}.png").exists() == (COMM.rank == 0)
    for plane in (("w", 0.5), ("z", 2.0), ("z", np.inf), 0.5):
        with pytest.raises(InputError) as refusal:
            problem.plot(plane=plane)
        assert refusal.value.subject == "plane"
    problem.destroy()
