"""The stop by the discretisation error, against errors that the solve does not know."""

import math

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.data.formula_values import components
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.references import Reference
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.solvers.linear.algebraic import DEFAULT_OPTIONS
from dolfinx_signorini.solvers.stop import SHARE, Stop
from dolfinx_signorini.studies.paper.solution import christof_haubner, paper_problem

COMM = MPI.COMM_WORLD
NORMS = ("L2", "L4", "Linf", "H1")


def paper(n):
    exact = christof_haubner(friedrichs_keller(COMM, n))
    return paper_problem(exact), exact


def known(domain):
    """A problem whose contact set is the whole boundary, with the solution u = product of sines."""
    V = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    x = ufl.SpatialCoordinate(domain)
    exact = math.prod(ufl.sin(math.pi * x[i]) for i in range(domain.geometry.dim))
    # The flux -du/dn on the boundary is the pressure: u = 0 is pressed onto the obstacle.
    load = (
        -(domain.geometry.dim * math.pi**2 + 1.0)
        * exact
        * v
        * ufl.dx(metadata={"quadrature_degree": 6})
    )
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    return SignoriniProblem(a, load, contact=boundary_facets(domain)), Reference(
        domain, -exact, components(ufl.grad(-exact))
    )


def cube(n):
    return known(mesh.create_unit_cube(COMM, n, n, n))


def square(n):
    return known(friedrichs_keller(COMM, n))


FAMILIES = {"paper": (paper, 19, 76), "square": (square, 16, 64), "cube": (cube, 6, 14)}


def coarse_state(make, n):
    problem, _ = make(n)
    problem.solve()
    return problem.contact_state()


@pytest.mark.parametrize("family", FAMILIES)
def test_a_fiftieth_of_the_discretisation_error_is_left(family):
    make, coarse, fine = FAMILIES[family]
    state, (problem, exact) = coarse_state(make, coarse), make(fine)
    u = problem.solve(coarse=state).copy()
    loose, active = problem.result, problem.active
    tight = problem.solve(coarse=state, rtol=1e-10, warm_start=False)
    assert problem.result.algebraic_share is None
    assert problem.result.linear_iterations > loose.linear_iterations
    assert 0.0 < loose.algebraic_share <= SHARE
    errors = error_norms(tight, exact, NORMS)
    # Both contact sets are the same, but for dofs with a gap that nobody can tell from none.
    changed = np.setxor1d(active, problem.active)
    for found in (u, tight):
        assert np.abs(found.x.array[changed]).max(initial=0.0) <= SHARE * errors["Linf"]
    u.x.array[:] -= tight.x.array
    left = error_norms(u, None, NORMS)
    assert all(left[norm] <= SHARE * errors[norm] for norm in NORMS)
    assert left["L2"] > 1e-8 * errors["L2"]
    problem.destroy()


def test_without_coarse_meshes_or_a_coarse_solution_the_residual_decides():
    state, (problem, _) = coarse_state(paper, 19), paper(76)
    problem.solve()
    assert problem.result.algebraic_share is None
    assert problem.result.natural_residual <= 1e-7
    problem.destroy()
    exact = christof_haubner(friedrichs_keller(COMM, 76))
    other = paper_problem(exact)
    other._options["pc_type"] = DEFAULT_OPTIONS["pc_type"]
    other.solve(coarse=state)
    assert other.result.algebraic_share is None
    assert other.result.natural_residual <= 1e-7
    other.destroy()


def vector(values):
    return PETSc.Vec().createWithArray(np.array(values, dtype=float), comm=PETSc.COMM_SELF)


def ended(stop, iterates, norm=0.0):
    """The number of the iterate with which a linear solve ends; None for none."""
    for number, value in enumerate(iterates):
        if stop.enough(vector([value, 0.0]), number, norm):
            return number
    return None


def geometric(rate, count):
    """Iterates from 0 to 3, the error of which falls by a rate."""
    return [3.0 - 3.0 * rate**number for number in range(count)]


@pytest.mark.parametrize("rate", [0.1, 0.3, 0.8])
def test_the_error_of_a_geometric_sequence_is_estimated(rate):
    stop = Stop()
    stop.begin(ratio=3.0)
    number = ended(stop, geometric(rate, 60))
    # The discretisation error is 1; that of the iterate is 3 rate^number.
    assert stop.error == pytest.approx(1.0, rel=0.05)
    assert stop.left == pytest.approx(3.0 * rate**number, rel=1e-6)
    assert 3.0 * rate**number <= SHARE * stop.error < 3.0 * rate ** (number - 1)
    # The next solve knows the error, and how slowly the last one has converged.
    assert ended(stop, [0.0, 0.1]) is None
    assert ended(stop, [0.0, 0.01]) == (1 if rate < 0.8 else None)
    assert stop.error == pytest.approx(1.0, rel=0.05)
    stop.destroy()


def test_no_solve_ends_without_an_estimate_or_with_a_large_residual():
    stop = Stop()
    assert ended(stop, geometric(0.1, 30)) is None
    stop.begin(ratio=3.0)
    stop.allowed = 1.0
    assert ended(stop, geometric(0.1, 20), norm=2.0) is None
    stop.begin(ratio=3.0)
    assert ended(stop, geometric(0.1, 20), norm=0.5) is not None
    stop.destroy()


def test_a_set_is_settled_when_confirmed_or_when_its_change_is_not_felt():
    stop = Stop()
    stop.begin(ratio=3.0)
    ended(stop, geometric(0.1, 30))
    assert not stop.settle(vector([3.0, 0.0]), same=False)
    assert stop.share is None
    assert not stop.settle(vector([3.0, 0.1]), same=False)
    assert stop.settle(vector([3.0, 0.11]), same=False)
    assert stop.share <= SHARE
    assert stop.settle(vector([9.0, 0.0]), same=True)
    stop.destroy()
