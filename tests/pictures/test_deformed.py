"""Pictures of deformed bodies: where body and obstacle are drawn, the scale, what is refused."""

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.collections import LineCollection, TriMesh
from mpi4py import MPI

from dolfinx_signorini import ContactProblem, InputError, elasticity, von_mises
from dolfinx_signorini.data.node_values import node_averages, values_in_cells
from dolfinx_signorini.pictures.deformed import DRAWN, SEEN, scale_for

COMM = MPI.COMM_WORLD
CellType = dolfinx.mesh.CellType
GAP, DOWN = 0.002, 0.006


def pressed(domain, degree=1, gap=GAP, solve=True):
    """A body whose highest side goes down by more than the gap to a floor."""
    size = domain.geometry.dim
    space = fem.functionspace(domain, ("Lagrange", degree, (size,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    low, high = (
        dolfinx.mesh.locate_entities_boundary(
            domain, size - 1, lambda x, at=at: np.isclose(x[size - 1], at)
        )
        for at in (0.0, 1.0)
    )
    moved = np.zeros(size)
    moved[-1] = -DOWN
    problem = ContactProblem(
        elasticity(u, v, 100.0, 0.3),
        ufl.inner(fem.Constant(domain, np.zeros(size)), v) * ufl.dx,
        contact=low,
        gap=gap,
        bcs=[fem.dirichletbc(moved, fem.locate_dofs_topological(space, size - 1, high), space)],
    )
    if solve:
        problem.solve()
    return problem


def square(kind=CellType.triangle, n=6):
    return dolfinx.mesh.create_unit_square(COMM, n, n, kind)


def cube(kind=CellType.tetrahedron):
    return dolfinx.mesh.create_unit_cube(COMM, 2, 2, 3, kind)


def lines(figure, label):
    """The pieces of a part of a picture, shape (pieces, 2, 2)."""
    parts = [c for c in figure.axes[0].collections if isinstance(c, LineCollection)]
    (found,) = [part for part in parts if part.get_label() == label]
    return np.array(found.get_segments())


@pytest.mark.parametrize("scale", [1.0, 20.0])
@pytest.mark.parametrize("degree", [1, 2])
def test_body_and_obstacle_are_drawn_in_the_scale_that_is_told(scale, degree):
    problem = pressed(square(), degree)
    figure = problem.plot(what="deformed", scale=scale)
    assert (figure is None) == (COMM.rank > 0)
    if figure is not None:
        title = figure.axes[0].get_title()
        told = "to scale" if scale == 1.0 else "20 times as large"
        assert title == f"displacement {told}"
        (drawn,) = [c for c in figure.axes[0].collections if isinstance(c, TriMesh)]
        y = drawn._triangulation.y
        # Body and floor touch in any scale.
        assert y.min() == pytest.approx(-scale * GAP, abs=1e-9)
        assert y.max() == pytest.approx(1.0 - scale * DOWN, abs=1e-9)
        for part in ("obstacle", "in contact"):
            found = lines(figure, part)
            assert found[..., 1] == pytest.approx(-scale * GAP, abs=1e-9)
            length = np.linalg.norm(found[:, 1] - found[:, 0], axis=1).sum()
            # Friction is none: the lower side becomes longer by Poisson's ratio.
            longer = 1.0 if part == "obstacle" else 1.0 + scale * 0.3 / 0.7 * (DOWN - GAP)
            assert length == pytest.approx(longer, rel=2e-3 * scale)
        rest = lines(figure, "at rest")
        assert (rest.min(), rest.max()) == (0.0, 1.0)
    problem.destroy()


def test_what_is_not_in_contact_is_not_drawn_so():
    problem = pressed(square(), gap=lambda x: GAP + 10.0 * np.maximum(x[0] - 0.5, 0.0) ** 2)
    figure = problem.plot(what="deformed", scale=1.0)
    if figure is not None:
        found = lines(figure, "in contact")
        assert found[..., 0].min() < 0.0 and 0.45 < found[..., 0].max() < 0.75
        obstacle = lines(figure, "obstacle")
        assert obstacle[..., 1].min() == pytest.approx(-GAP - 10.0 * 0.25)
    problem.destroy()


@pytest.mark.parametrize(
    "domain",
    [
        lambda: square(CellType.quadrilateral), cube, lambda: cube(CellType.hexahedron),
    ],
)  # fmt: skip
@pytest.mark.parametrize("degree", [1, 2])
def test_bodies_of_other_cells_are_drawn(domain, degree, folder):
    problem = pressed(domain(), degree)
    path = folder / "body.png"
    stress = von_mises(problem.u, 100.0, 0.3)
    figure = problem.plot(path, what="deformed", stress=stress)
    assert (figure is None) == (COMM.rank > 0)
    if figure is not None:
        assert path.stat().st_size > 10_000
        assert "times as large" in figure.axes[0].get_title()
    problem.destroy()


def test_colours_are_those_of_the_stress():
    """Between planes without friction on the sides the strain is constant, and so is the stress."""
    domain = square()
    problem = pressed(domain)
    problem.u.interpolate(lambda x: np.stack([0.0 * x[0], -0.01 * x[1]]))
    stress = von_mises(problem.u, 100.0, 0.0)
    figure = problem.plot(what="deformed", stress=stress, scale=1.0)
    if figure is not None:
        (drawn,) = [c for c in figure.axes[0].collections if isinstance(c, TriMesh)]
        assert np.array(drawn.get_array()) == pytest.approx(np.full(49, 1.0))
    problem.destroy()


def test_means_at_nodes_are_those_of_the_cells_around():
    """Of a function that is the number of its cell's side of x = 1/2, and of a linear one."""
    domain = square(n=4)
    space = fem.functionspace(domain, ("Lagrange", 1))
    x = ufl.SpatialCoordinate(domain)
    item = ufl.as_vector([ufl.conditional(ufl.lt(x[0], 0.5), 1.0, 3.0), x[0] + 2.0 * x[1]])
    values = values_in_cells(space, item)
    assert values.shape[1:] == (3, 2)
    assert (
        np.isin(values[..., 0], (1.0, 3.0)).all() and (np.ptp(values[..., 0], axis=1) == 0.0).all()
    )
    means = node_averages(space, values)
    places = space.tabulate_dof_coordinates()
    assert means[:, 1] == pytest.approx(places[:, 0] + 2.0 * places[:, 1], abs=1e-5)
    sides = np.sign(np.round(places[:, 0] - 0.5, 9))
    assert means[sides != 0.0, 0] == pytest.approx(2.0 + sides[sides != 0.0])
    inner = (sides == 0.0) & (places[:, 1] > 0.1) & (places[:, 1] < 0.9)
    assert means[inner, 0] == pytest.approx(2.0)  # three cells on each side


@given(st.floats(1e-12, 10.0))
def test_a_scale_is_one_or_makes_the_displacement_seen(share):
    scale = scale_for(share)
    if share >= SEEN:
        assert scale == 1.0
    else:
        assert scale > 1.0 and 0.4 * DRAWN * (1.0 - 1e-9) <= scale * share <= DRAWN * (1.0 + 1e-9)
        digit = scale / 10.0 ** np.floor(np.log10(scale) + 1e-9)
        assert min(abs(digit - d) for d in (1.0, 2.0, 5.0)) < 1e-9


def test_a_body_at_rest_is_drawn_to_scale():
    assert scale_for(0.0) == 1.0


@pytest.mark.parametrize(
    ("arguments", "subject"),
    [
        ({"what": "solution"}, "what"),
        ({"what": 1}, "what"),
        ({"what": "deformed", "scale": 0.0}, "scale"),
        ({"what": "deformed", "scale": "2"}, "scale"),
        ({"what": "deformed", "stress": 1.0}, "stress"),
        ({"what": "deformed", "stress": "vector"}, "stress"),
    ],
)
def test_pictures_that_do_not_exist_are_refused(arguments, subject):
    problem = pressed(square())
    if arguments.get("stress") == "vector":
        arguments = arguments | {"stress": problem.u}
    with pytest.raises(InputError) as error:
        problem.plot(**arguments)
    assert error.value.subject == subject
    problem.destroy()


@pytest.mark.parametrize("what", ["contact", "deformed"])
def test_a_problem_without_a_solution_has_no_picture(what):
    problem = pressed(square(), solve=False)
    with pytest.raises(InputError, match="has not been solved"):
        problem.plot(what=what)
    problem.destroy()
