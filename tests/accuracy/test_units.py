"""Nothing depends on units, places and axes: the same steps, and estimates in the same units."""

import math

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

import dolfinx_signorini as ds
from dolfinx_signorini import SidedMesh, SignoriniProblem, detachment_points, solve_adaptively
from dolfinx_signorini.meshes.sided_meshes import boundary_facets


def membrane(comm, form=1.0, length=1.0, moved=(0.0, 0.0), n=8):
    """A mesh of a square, and what poses a membrane over a roof, with forms in another unit."""
    domain = mesh.create_unit_square(comm, n, n)
    x = domain.geometry.x
    bubble = np.sin(np.pi * x[:, 0]) * np.sin(np.pi * x[:, 1])
    x[:, :2] += 0.07 * bubble[:, None] * np.sin(5.0 * x[:, :2] + 3.0 * x[:, 1::-1])
    x[:, :2] = length * (x[:, :2] + moved)

    def facets(level, y):
        at = length * (y + moved[1])
        return mesh.locate_entities_boundary(
            level.mesh, 1, lambda x: np.abs(x[1] - at) < 1e-6 * length
        )

    def pose(level):
        space = fem.functionspace(level.mesh, ("Lagrange", 2))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        at = [
            c / length - shift
            for c, shift in zip(ufl.SpatialCoordinate(level.mesh), moved, strict=True)
        ]
        top = fem.locate_dofs_topological(space, 1, facets(level, 1.0))
        return SignoriniProblem(
            form * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
            form / length**2 * (6.0 * ufl.sin(2.0 * np.pi * at[0]) - 3.0) * v * ufl.dx,
            contact=facets(level, 0.0),
            obstacle=-0.05 - 0.1 * abs(at[0] - 0.6),
            bcs=[fem.dirichletbc(0.0, top, space)],
        )

    return SidedMesh(domain, {}), pose


def steps(found):
    return [(step.unknowns, step.estimate) for step in found.steps]


@pytest.mark.parametrize("norm, accuracy", [("L2", 5e-4), ("L4", 5e-4), ("Linf", 2e-3)])
def test_the_loop_has_no_unit(comm, norm, accuracy):
    power = {"L2": 1.0, "L4": 0.5, "Linf": 0.0}[norm]  # of the length in the norm
    found = []
    for form, length in ((1.0, 1.0), (2.0**40, 1.0), (2.0**-40, 1.0), (1.0, 2.0**30)):
        sided, pose = membrane(comm, form, length)
        asked = accuracy * length**power
        result = solve_adaptively(pose, sided, norm=norm, accuracy=asked)
        found.append([(n, e / length**power) for n, e in steps(result)])
        result.problem.destroy()
    for other in found[1:]:
        assert [n for n, _ in other] == [n for n, _ in found[0]]
        assert [e for _, e in other] == pytest.approx([e for _, e in found[0]], rel=1e-4)


def test_detachment_points_have_no_place(comm):
    """Far away coordinates carry rounding across a side, too."""
    found = []
    for moved in ((0.0, 0.0), (1000.0, -2000.0)):
        domain = mesh.create_unit_square(comm, 32, 32)
        turn = np.array([[0.8, -0.6], [0.6, 0.8]])
        domain.geometry.x[:, :2] = domain.geometry.x[:, :2] @ turn.T + moved
        space = fem.functionspace(domain, ("Lagrange", 2))
        u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
        s = turn[0, 0] * (x[0] - moved[0]) + turn[1, 0] * (x[1] - moved[1])

        middles = mesh.compute_midpoints(domain, 1, boundary_facets(domain))[:, :2] - moved
        height = middles @ turn[:, 1]
        below, above = (boundary_facets(domain)[np.abs(height - y) < 1e-6] for y in (0.0, 1.0))
        top = fem.locate_dofs_topological(space, 1, above)
        problem = SignoriniProblem(
            ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
            -2.0 * s * v * ufl.dx,
            contact=below,
            obstacle=-0.3,
            bcs=[fem.dirichletbc(0.0, top, space)],
        )
        problem.solve(rtol=1e-10)
        (point,) = detachment_points(problem)
        found.append([*(turn.T @ (np.array(point.position) - moved)), point.uncertainty])
        problem.destroy()
    assert found[0][2] < 0.25 / 32
    assert found[1] == pytest.approx(found[0], rel=1e-3, abs=1e-9)


def block(comm, angle, length=1.0):
    """A mesh of a turned block, and what poses its contact with a round support."""
    domain = mesh.create_unit_square(comm, 8, 8)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    domain.geometry.x[:, :2] = length * domain.geometry.x[:, :2] @ turn.T

    def pose(level):
        def facets(y):
            return mesh.locate_entities_boundary(
                level.mesh, 1, lambda x: np.abs(turn[:, 1] @ x[:2] - length * y) < 1e-6 * length
            )

        space = fem.functionspace(level.mesh, ("Lagrange", 2, (2,)))
        u, v, x = (
            ufl.TrialFunction(space),
            ufl.TestFunction(space),
            ufl.SpatialCoordinate(level.mesh),
        )
        along = ufl.dot(ufl.as_vector(turn[:, 0].tolist()), x) / length
        top = fem.locate_dofs_topological(space, 1, facets(1.0))
        return ds.ContactProblem(
            ds.elasticity(u, v, young=10.0, poisson=0.3),
            ufl.inner(ufl.as_vector((-0.5 / length * turn[:, 1]).tolist()), v) * ufl.dx,
            contact=facets(0.0),
            gap=length * 0.3 * (along - 0.4) ** 2,
            direction=-turn[:, 1],
            bcs=[fem.dirichletbc(-0.02 * length * turn[:, 1], top, space)],
        )

    return SidedMesh(domain, {}), pose


def test_the_loop_of_a_body_has_no_axes(comm):
    """What the meshes gain in the first division hardly depends on how the body is turned."""
    found = []
    for angle in (0.0, 0.1, 0.25 * np.pi, 0.5 * np.pi):
        sided, pose = block(comm, angle)
        result = solve_adaptively(pose, sided, norm="L2", accuracy=1e-4)
        found.append(steps(result))
        result.problem.destroy()
    for other in found[1:]:
        assert np.array(other[:2]) == pytest.approx(np.array(found[0][:2]), rel=0.1)


@pytest.mark.parametrize("length", [2.0**-10, 2.0**10])
def test_the_loop_of_a_stress_has_no_unit_of_length(comm, length):
    def stress(u):
        return ds.stress(u, 10.0, 0.3)

    found = []
    for size in (1.0, length):
        sided, pose = block(comm, 0.0, size)
        result = solve_adaptively(pose, sided, norm="L2", of=stress, accuracy=0.1 * size)
        found.append([(n, e / size) for n, e in steps(result)])
        result.problem.destroy()
    assert np.array(found[1]) == pytest.approx(np.array(found[0]), rel=1e-4)


@pytest.mark.parametrize("form", [1e-16, 1e-100, 1e100])
def test_small_problems_are_factored_in_any_unit(form, comm):
    sided, pose = membrane(comm, form)
    problem = pose(sided)
    problem.solve(rtol=1e-9)
    if comm.size == 1:
        assert problem.result.preconditioner == "cholesky"
    assert problem.result.natural_residual <= 1e-9
    problem.destroy()
