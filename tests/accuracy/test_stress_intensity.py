"""The factors of r^{1/2} and r^{3/2} at detachment points, against exact ones."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini.accuracy.stress_intensity import stress_intensity
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.elements import bernstein_space
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.detachment import detachment_points
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.studies.paper.solution import AMPLITUDE, christof_haubner, paper_problem

COMM = MPI.COMM_WORLD
POINT = (0.5, 0.0)


def solved_paper(n):
    """The paper's problem, whose factors are 0 and 10, with its terms."""
    exact = christof_haubner(friedrichs_keller(COMM, n))
    problem = paper_problem(exact)
    problem.solve()
    return problem, EnergyTerms(reaction=1.0, load=exact.load)


def variation(n, upper=False, element=("Lagrange", 1)):
    """A problem with the diffusion 2, the reaction 3 and an affine obstacle; factors 0 and 10."""
    domain = friedrichs_keller(COMM, n)
    exact, x = christof_haubner(domain), ufl.SpatialCoordinate(domain)
    space = bernstein_space(domain, 2) if element is None else fem.functionspace(domain, element)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    sign = -1.0 if upper else 1.0
    g = 0.3 - 0.7 * x[0]
    a = (2.0 * ufl.inner(ufl.grad(u), ufl.grad(v)) + 3.0 * u * v) * ufl.dx
    # -2 div grad u + 3 u of u = g + sign * w, with -div grad w = load - w.
    load = sign * (2.0 * (exact.load - exact.u) + 3.0 * exact.u) + 3.0 * g
    # The bottom is the contact boundary; on the others u = g.
    bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    sides = np.setdiff1d(boundary_facets(domain), bottom)
    value = fem.Function(space)
    value.interpolate(lambda x: 0.3 - 0.7 * x[0])
    held = fem.dirichletbc(value, fem.locate_dofs_topological(space, 1, sides))
    problem = SignoriniProblem(
        a,
        load * v * ufl.dx(metadata={"quadrature_degree": 8}),
        contact=bottom,
        obstacle=lambda x: 0.3 - 0.7 * x[0],
        bound="upper" if upper else "lower",
        bcs=[held],
    )
    problem.solve()
    return problem, EnergyTerms(diffusion=2.0, reaction=3.0, load=load)


def test_the_factors_of_the_paper_converge():
    coarse, fine = (stress_intensity(p, POINT, t) for p, t in map(solved_paper, (31, 61)))
    assert abs(fine.three_halves - AMPLITUDE) < 0.03
    assert abs(fine.three_halves - AMPLITUDE) < 0.4 * abs(coarse.three_halves - AMPLITUDE)
    assert abs(fine.half) < 0.4 * abs(coarse.half) < 0.01
    assert fine.tangent == pytest.approx((1.0, 0.0))


def test_a_misplaced_point_is_corrected():
    problem, terms = solved_paper(61)
    for shift in (-0.01, 0.01):
        found = stress_intensity(problem, (0.5 + shift, 0.0), terms)
        # Towards the contact set a becomes -3/2 b d.
        assert found.half == pytest.approx(-1.5 * AMPLITUDE * shift, rel=0.05)
        assert found.corrected == pytest.approx(POINT, abs=6e-4)


@pytest.mark.parametrize("upper", [False, True])
def test_coefficients_obstacle_and_side(upper):
    problem, terms = variation(48, upper)
    found = stress_intensity(problem, detachment_points(problem)[0], terms)
    assert found.three_halves == pytest.approx(AMPLITUDE, abs=0.1)
    assert found.corrected == pytest.approx(POINT, abs=2e-3)


@pytest.mark.parametrize("element", [("Lagrange", 2), None])
def test_quadratic_elements(element):
    problem, terms = variation(24, element=element)
    found = stress_intensity(problem, POINT, terms)
    assert found.three_halves == pytest.approx(AMPLITUDE, abs=0.1)


def test_the_load_near_the_point_counts():
    # A load that does not vanish at the point, and no known solution: the factors settle.
    found = []
    for n in (24, 48, 96):
        domain = friedrichs_keller(COMM, n)
        space = fem.functionspace(domain, ("Lagrange", 1))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        load = 40.0 * (0.45 - ufl.SpatialCoordinate(domain)[0])
        a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
        problem = SignoriniProblem(a, load * v * ufl.dx, contact=boundary_facets(domain))
        problem.solve()
        point = min(detachment_points(problem), key=lambda p: p.position[1])
        first = stress_intensity(problem, point, EnergyTerms(reaction=1.0, load=load))
        found.append(
            stress_intensity(problem, first.corrected, EnergyTerms(reaction=1.0, load=load))
        )
    b = [f.three_halves for f in found]
    assert min(b) > 0.5
    assert abs(b[2] - b[1]) < 0.6 * abs(b[1] - b[0]) + 1e-3 * b[2]
    assert abs(found[2].half) < 0.02 * b[2]
    # Another radius sees the same singularity.
    last = found[2]
    again = stress_intensity(
        problem, last.point, EnergyTerms(reaction=1.0, load=load), radius=0.6 * last.radius
    )
    assert again.three_halves == pytest.approx(last.three_halves, rel=0.02)
    wrong = stress_intensity(problem, last.point, EnergyTerms(reaction=1.0))
    assert abs(wrong.three_halves - last.three_halves) > 0.1 * last.three_halves


@pytest.mark.parametrize(
    ("point", "radius", "message"),
    [
        ((0.5, 0.2), None, "not on the contact boundary"),
        ((0.8, 0.0), None, "no contact ends here"),
        ((0.3, 0.0), None, "no contact ends here"),
        (POINT, 0.6, "at most 0.5"),
        (POINT, -1.0, "must be a positive number"),
    ],
)
def test_points_that_make_no_sense(point, radius, message):
    problem, terms = solved_paper(31)
    with pytest.raises(InputError, match=message):
        stress_intensity(problem, point, terms, radius)


def test_obstacles_that_bend_are_refused():
    problem, terms = solved_paper(31)
    x = ufl.SpatialCoordinate(problem.space.mesh)
    v = ufl.TestFunction(problem.space)
    bent = SignoriniProblem(
        problem.a, terms.load * v * ufl.dx, contact=problem.contact, obstacle=-x[0] * x[0]
    )
    bent.solve()
    points = detachment_points(bent)
    with pytest.raises(InputError, match="affine"):
        stress_intensity(bent, points[0] if points else POINT, terms)
