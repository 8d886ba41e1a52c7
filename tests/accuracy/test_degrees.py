"""The degree of elements: chosen by the loop, and accurate whichever is chosen."""

from functools import partial
from pathlib import Path

import pytest
from known import SCENES, true_error

import dolfinx_signorini as ds
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import SidedMesh
from dolfinx_signorini.scenes import solve_scene
from dolfinx_signorini.scenes.files.reading import parse_scene
from dolfinx_signorini.studies.paper.solution import paper_problem


def degree_of(u):
    return u.function_space.element.basix_element.degree


@pytest.mark.parametrize(
    ("accuracy", "expected"), [(3e-3, {2}), (1.5e-4, {3}), (1e-6, {4})], ids=["2", "3", "4"]
)
def test_the_smaller_the_accuracy_the_higher_the_degree(comm, accuracy, expected):
    known = SCENES["Dirichlet to Neumann"]
    scene = parse_scene(known.text, Path("x.toml"), comm)
    result = solve_scene(scene, comm, accuracy=accuracy, norm="L2")
    assert result.found.reached
    assert true_error(result.u, known, "L2") <= accuracy
    assert degree_of(result.u) in expected
    result.destroy()


@pytest.mark.parametrize(
    ("name", "asked", "expected"),
    [("jump across a circle", 3e-4, 2), ("Dirichlet to Neumann", 1e-6, 4)],
)
def test_a_higher_degree_is_not_taken_for_what_facets_leave_along_a_curve(
    comm, name, asked, expected
):
    """The flux is smooth across a circle where the diffusion jumps, and the derivatives jump."""
    known = SCENES[name]
    scene = parse_scene(known.text, Path("x.toml"), comm)
    result = solve_scene(scene, comm, accuracy=asked, norm="H1", max_unknowns=30_000)
    assert degree_of(result.u) == expected
    assert 0.2 * result.found.estimate < true_error(result.u, known, "H1") <= result.found.estimate
    result.destroy()


@pytest.mark.parametrize("degree", [1, 3])
def test_a_degree_that_is_asked_for_is_taken(comm, degree):
    scene = parse_scene(SCENES["Dirichlet to Neumann"].text, Path("x.toml"), comm)
    result = solve_scene(scene, comm, accuracy=5e-2, norm="L2", degree=degree)
    assert degree_of(result.u) == degree
    result.destroy()


def test_functions_that_pose_the_problem_are_taken_by_degree(comm):
    exact = {}

    def pose(degree, sided):
        exact["u"] = ds.christof_haubner(sided.mesh)
        return paper_problem(exact["u"], degree)

    first = SidedMesh(friedrichs_keller(comm, 4), {})
    poses = {degree: partial(pose, degree) for degree in (4, 2)}
    found = ds.solve_adaptively(poses, first, norm="L4", accuracy=1e-4)
    assert degree_of(found.problem.u) == 4
    assert ds.error_norms(found.problem.u, exact["u"], ["L4"])["L4"] <= 1e-4
    found.problem.destroy()
    limited = ds.solve_adaptively(poses, first, norm="L4", accuracy=1e-4, max_unknowns=1000)
    assert degree_of(limited.problem.u) == 2
    assert limited.steps[-1].unknowns <= 1000
    assert not limited.reached
    limited.problem.destroy()
    with pytest.raises(ds.InputError, match="pose"):
        ds.solve_adaptively({}, first, accuracy=1.0)


@pytest.mark.parametrize(("norm", "accuracy"), [("H1", 1e-3), ("W1_4", 1e-2), ("L4", 1e-5)])
def test_a_kink_of_the_obstacle_is_seen_inside_of_large_cells(comm, norm, accuracy):
    known = SCENES["kink of the obstacle"]
    scene = parse_scene(known.text, Path("x.toml"), comm)
    result = solve_scene(scene, comm, accuracy=accuracy, norm=norm, degree=4)
    assert result.found.reached
    assert true_error(result.u, known, norm) <= accuracy
    result.destroy()


@pytest.mark.slow
def test_the_largest_derivative_is_accurate_at_cells_of_a_millionth(comm):
    """The derivative is like r^{1/2}: cells of 1e-8 of the square, on which residuals weigh."""
    exact = {}

    def pose(sided):
        exact["u"] = ds.christof_haubner(sided.mesh)
        return paper_problem(exact["u"], 4)

    first = SidedMesh(friedrichs_keller(comm, 4), {})
    found = ds.solve_adaptively(pose, first, norm="W1_inf", accuracy=1e-3)
    assert found.reached
    assert ds.error_norms(found.problem.u, exact["u"], ["W1_inf"])["W1_inf"] <= 1e-3
    found.problem.destroy()
