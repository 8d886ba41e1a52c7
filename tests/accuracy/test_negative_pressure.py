"""Gaps in the contact set that no dof sees: the pressure between the dofs shows them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from known import Known, true_error

from dolfinx_signorini import SignoriniProblem, solve_adaptively
from dolfinx_signorini.accuracy.estimates import Estimator
from dolfinx_signorini.accuracy.negative_pressure import negative_pressure, pressure_density
from dolfinx_signorini.accuracy.targets import target
from dolfinx_signorini.accuracy.terms import Solution, Solved
from dolfinx_signorini.meshes.elements import bernstein_space, control_points
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, boundary_facets
from dolfinx_signorini.norms.references import interpolant
from dolfinx_signorini.scenes import solve_scene
from dolfinx_signorini.scenes.files.reading import parse_scene
from dolfinx_signorini.scenes.posing import pose

CENTRE, HALF = 0.5531, 0.02
PULLS = {2: 6e-4, 3: 2.4e-3}  # by dimension, so small that all forces on dofs are positive


def gap(centre=CENTRE, cells=8):
    """Contact on the bottom but for an interval: u = -Im (z^2 - k^2)^(3/2), which is k^3 there."""
    text = f"""
[domain]
shape = "square"
cells = {cells}
[define]
X = "x - {centre!r}"
k = "{HALF!r}"
t = "0.5*(atan2(y, X - k) + atan2(y, X + k))"
w = "0 - (hypot(X - k, y)*hypot(X + k, y))^1.5*sin(3*t)"
[equation]
[contact]
sides = "bottom"
obstacle = 0
[[dirichlet]]
sides = ["left", "right", "top"]
value = "w"
"""

    def parts(x, y):
        z = x - centre + 1j * np.abs(y)
        angle = 0.5 * (np.angle(z - HALF) + np.angle(z + HALF))
        return z, np.sqrt(np.abs(z**2 - HALF**2)) * np.exp(1j * angle)

    def gradient(x, y):
        z, root = parts(x, y)
        return -(3.0 * z * root).imag, -(3.0 * z * root).real

    return Known(text, lambda x, y: -(parts(x, y)[1] ** 3).imag, gradient, {})


@pytest.mark.parametrize(("norm", "accuracy"), [("Linf", 1e-6), ("L2", 1e-7), ("W1_4", 2e-5)])
def test_a_gap_between_the_dofs_of_coarse_meshes_is_found(comm, norm, accuracy):
    known = gap()
    scene = parse_scene(known.text, Path("gap.toml"), comm)
    result = solve_scene(scene, comm, accuracy=accuracy, norm=norm, max_unknowns=100_000)
    result.destroy()
    assert result.found.reached
    assert true_error(result.u, known, norm) <= accuracy


@pytest.mark.parametrize(("centre", "degree"), [(0.59, 3), (0.55, 3), (0.583, 4)])
def test_a_gap_between_all_dofs_is_in_a_functional(comm, centre, degree):
    """The integral of the gap is 3 pi k^4 / 8, and 0 for two solutions that hold all dofs."""
    known = gap(centre, 4)
    scene = replace(parse_scene(known.text, Path("gap.toml"), comm), degree=degree)
    sided = scene.domain.make(comm)
    division = refined(sided)
    coarse, fine = (pose(scene, comm, part).problem for part in (sided, division.sided))
    for problem in (coarse, fine):
        problem.solve(rtol=1e-12)
        assert len(problem.active) == len(problem.contact_dofs)
    bottom = mesh.meshtags(fine.space.mesh, 1, *tagged(division.sided.sides["bottom"]))
    over = ufl.Measure("ds", domain=fine.space.mesh, subdomain_data=bottom)(1)
    wanted = target(lambda v: v * over)
    estimator = Estimator(coarse.space, target(lambda v: v * ufl.dx))
    solved = Solved(Solution(coarse.u, coarse.forces), fine, division.parents, wanted)
    estimator.compare(solved)
    error = 3.0 * np.pi * HALF**4 / 8.0
    assert estimator.found.difference <= 1e-3 * error <= error <= estimator.estimate <= 20.0 * error
    for problem in (coarse, fine):
        problem.destroy()


def tagged(facets):
    facets = np.sort(facets)
    return facets, np.ones(len(facets), dtype=np.int32)


def held(comm, dim, pull, norm="L2", centre=CENTRE, degree=3, ends=False):
    """A solution with contact on the whole bottom: a polynomial with the pressure 3 X^2 - pull.

    The other sides have fluxes, or with ends Dirichlet data, up to the bottom.
    """
    if dim == 2:
        domain = mesh.create_unit_square(comm, 4, 4)
    else:
        domain = mesh.create_unit_cube(comm, 2, 2, 2)
    facets = boundary_facets(domain)
    rest = mesh.locate_entities_boundary(domain, dim - 1, lambda x: np.isclose(x[dim - 1], 0.0))
    division = refined(SidedMesh(domain, {"bottom": np.intersect1d(facets, rest)}))
    space = bernstein_space(division.sided.mesh, degree)
    x = ufl.SpatialCoordinate(space.mesh)
    X, z = x[0] - centre, x[dim - 1]
    exact = z**3 - 3 * X**2 * z + pull * z
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    flux = ufl.dot(ufl.grad(exact), ufl.FacetNormal(space.mesh))
    bcs = []
    if ends:
        data = interpolant(space, exact)
        sides = np.setdiff1d(boundary_facets(space.mesh), division.sided.sides["bottom"])
        bcs = [fem.dirichletbc(data, fem.locate_dofs_topological(space, dim - 1, sides))]
    # The force on the bottom is left to the contact: there the flux of the data is 0.
    outside = ufl.conditional(ufl.gt(z, 1e-12), flux, 0.0)
    problem = SignoriniProblem(
        (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx,
        exact * v * ufl.dx + outside * v * ufl.ds(metadata={"quadrature_degree": 6}),
        contact=division.sided.sides["bottom"],
        obstacle=0.0,
        bcs=bcs,
    )
    problem.solve(rtol=1e-12)
    coarse = fem.Function(bernstein_space(domain, degree))
    return Solved(Solution(coarse, coarse), problem, division.parents, target(norm))


@pytest.mark.parametrize("ends", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_the_density_of_the_pressure_is_that_of_the_flux(comm, dim, ends):
    """Also on facets that end where Dirichlet data begin, whose forces are not known there."""
    pull = PULLS[dim]
    problem = held(comm, dim, pull, ends=ends).fine
    # At the vertices, where the coefficients of the Bernstein basis are values.
    space = problem.space
    vertices = mesh.locate_entities_boundary(space.mesh, 0, lambda x: np.isclose(x[dim - 1], 0.0))
    dofs = fem.locate_dofs_topological(space, 0, vertices)
    x = control_points(space)[dofs, 0]
    found = pressure_density(problem).x.array[dofs]
    # At fixed dofs the smallest part of the highest degree is sought with a share of 9e-10.
    within = 1e-6 if ends else 1e-7
    assert found == pytest.approx(3.0 * (x - CENTRE) ** 2 - pull, abs=within)
    problem.destroy()


@pytest.mark.parametrize(("dim", "centre"), [(2, CENTRE), (3, CENTRE), (2, 0.5)])
def test_a_pull_is_measured(comm, dim, centre):
    """In the middle of a facet, and on both sides of a vertex."""
    pull = PULLS[dim]
    largest = {}
    for norm in ("W1_inf", "Linf"):
        solved = held(comm, dim, pull, norm, centre)
        assert len(solved.fine.active) == len(solved.fine.contact_dofs)
        parts = negative_pressure(solved, None)[1]
        largest[norm] = max(comm.allgather(parts.max(initial=0.0)))
        solved.fine.destroy()
    assert 0.8 * pull <= largest["W1_inf"] <= pull * (1.0 + 1e-5)
    # The pressure is negative on a strip of this half-width; a crack of the width is opened by the
    # pull times the half-width.
    half = np.sqrt(pull / 3.0)
    assert 0.5 * pull * half <= largest["Linf"] <= 5.0 * pull * half


@pytest.mark.parametrize("pull", [6e-4, 3e-3])
def test_a_pull_counts_that_is_smaller_than_the_error_of_the_density(comm, pull):
    """With degree 2, the density of 3 X^2 - pull is wrong by more than the pull."""
    solved = held(comm, 2, pull, "W1_inf", degree=2)
    found = max(comm.allgather(negative_pressure(solved, None)[1].max(initial=0.0)))
    solved.fine.destroy()
    assert found >= pull


@pytest.mark.parametrize("dim", [2, 3])
def test_where_the_obstacle_pushes_nothing_is_added(comm, dim):
    solved = held(comm, dim, -1e-3)
    assert not negative_pressure(solved, None).any()
    solved.fine.destroy()


@pytest.mark.parametrize("norm", ["L2", "H1"])
def test_the_pressure_of_an_upper_obstacle_pulls_nothing(norm, comm):
    """The problem turned over, with a lower obstacle that nothing reaches, takes the same steps."""
    found = []
    for sign in (1.0, -1.0):

        def posed(sided, sign=sign):
            x = ufl.SpatialCoordinate(sided.mesh)
            V = fem.functionspace(sided.mesh, ("Lagrange", 2))
            u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
            walls = fem.locate_dofs_topological(V, 1, sided.sides["top"])
            a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
            L = -sign * 3.0 * (1.0 + x[0]) * v * ufl.dx
            bounds = {"lower": -0.1} if sign > 0.0 else {"lower": -300.0, "upper": 0.1}
            bottom = sided.sides["bottom"]
            bcs = [fem.dirichletbc(0.0, walls, V)]
            return SignoriniProblem(a, L, contact=bottom, bcs=bcs, **bounds)

        domain = mesh.create_unit_square(comm, 6, 6)
        sides = {
            name: mesh.locate_entities_boundary(domain, 1, lambda x, z=z: np.isclose(x[1], z))
            for name, z in (("bottom", 0.0), ("top", 1.0))
        }
        accuracy = 1e-5 if norm == "L2" else 3e-3
        run = solve_adaptively(posed, SidedMesh(domain, sides), norm=norm, accuracy=accuracy)
        assert run.reached
        found.append((run.problem.unknowns, run.estimate))
    assert found[0] == pytest.approx(found[1], rel=1e-4)
