"""The strong form that is read from the forms of a problem, beside the one that a user states."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from energy_cases import Case, cube, detaching, in_space, left, polynomial, square, top

from dolfinx_signorini import (
    EnergyTerms,
    InputError,
    ObstacleProblem,
    SignoriniProblem,
    bernstein_space,
    dirichlet,
    energy_bound,
)
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, facet_cells

TENSOR = ufl.as_matrix([[2.0, 0.5], [0.5, 1.0]])
CASES = {
    "Dirichlet and Neumann": (polynomial, {"fixed": top}),
    "reaction and Robin": (polynomial, {"c": 3.0, "robin": top}),
    "upper": (detaching, {"upper": True, "fixed": left, "c": 1.0}),
    "a tensor": (polynomial, {"A": TENSOR, "c": 1.0}),
}


@pytest.mark.parametrize("name", CASES)
def test_the_forms_tell_what_a_user_states(name, comm):
    """Loads, fluxes with normals, coefficients and data: every part of the bound is the same."""
    solution, given = CASES[name]
    domain = square(comm, 6)
    case = Case(domain, solution(ufl.SpatialCoordinate(domain)), 2, told=True, **given)
    read, stated = energy_bound(case.problem), energy_bound(case.problem, case.terms)
    for part in ("flux", "data", "contact", "mean", "lifting", "total"):
        size = 1e-9 * stated.total
        assert getattr(read, part) == pytest.approx(getattr(stated, part), rel=1e-6, abs=size)
    assert (read.sampled, read.notes) == (stated.sampled, stated.notes)
    assert case.error() <= read.total


def test_in_space(comm):
    domain = cube(comm, 2)
    case = Case(domain, in_space(ufl.SpatialCoordinate(domain)), 1, c=2.0)
    stated = energy_bound(case.problem, case.terms).total
    assert energy_bound(case.problem).total == pytest.approx(stated, rel=1e-6)


@pytest.fixture
def pieces(comm):
    """A problem with coefficients on parts of the mesh: tags, pairs of numbers and facets."""
    domain = mesh.create_unit_square(comm, 6, 6)
    V = bernstein_space(domain, 2)
    u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(domain)
    cells = np.arange(domain.topology.index_map(2).size_local, dtype=np.int32)
    right = mesh.compute_midpoints(domain, 2, cells)[:, 0] > 0.5
    dx = ufl.dx(subdomain_data=mesh.meshtags(domain, 2, cells, right.astype(np.int32) + 1))
    top_ = mesh.locate_entities_boundary(domain, 1, top)
    own = np.intersect1d(top_, boundary_facets(domain)).astype(np.int32)
    ds = ufl.ds(subdomain_data=[(4, facet_cells(domain, own).flatten())])
    wall = mesh.locate_entities_boundary(domain, 1, left)
    bottom = mesh.locate_entities_boundary(domain, 1, lambda p: np.isclose(p[1], 0.0))
    reaction = fem.Function(fem.functionspace(domain, ("DG", 0)))
    reaction.x.array[:] = 2.0
    c = fem.Constant(domain, 3.0)
    a = ufl.inner(ufl.grad(u), ufl.grad(v)) * dx + c * ufl.dot(ufl.grad(u), ufl.grad(v)) * dx(2)
    a += reaction * u * v * dx((1, 2)) + x[0] * u * v * ds(4)
    L = 4.0 * (x[0] - 0.7) * v * dx(1) - v * dx + 0.5 * v * ds(4)
    problem = SignoriniProblem(a, L, contact=bottom, bcs=[dirichlet(V, wall, 0.1 * x[1])])
    problem.solve()
    inside = fem.Function(fem.functionspace(domain, ("DG", 0)))
    inside.x.array[cells] = right
    inside.x.scatter_forward()
    terms = EnergyTerms(
        diffusion=1.0 + 3.0 * inside,
        reaction=2.0,
        load=4.0 * (x[0] - 0.7) * (1.0 - inside) - 1.0,
        neumann=[(0.5, top_)],
        robin=[(x[0], top_)],
        dirichlet=[(0.1 * x[1], wall)],
    )
    return problem, terms


def test_coefficients_on_parts_of_the_mesh(pieces):
    problem, terms = pieces
    stated = energy_bound(problem, terms)
    assert energy_bound(problem).total == pytest.approx(stated.total, rel=1e-9)
    assert not energy_bound(problem).sampled


def test_an_obstacle_in_the_domain(comm):
    domain = square(comm, 8)
    V = bernstein_space(domain, 1)
    u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(domain)
    rim = boundary_facets(domain)
    problem = ObstacleProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        -8.0 * v * ufl.dx + 0.3 * v * ufl.ds,  # where u is given the flux says nothing
        lower=-0.2 - x[0] * x[1],
        bcs=[dirichlet(V, rim, 0.0)],
    )
    problem.solve()
    stated = energy_bound(problem, EnergyTerms(load=-8.0, dirichlet=[(0.0, rim)]))
    assert energy_bound(problem).total == pytest.approx(stated.total, rel=1e-9)


REFUSED = {
    "mixed slopes": (lambda u, v, n: (u.dx(0) * v + u * v.dx(0)) * ufl.dx, None, "a"),
    "a flux in the load": (None, lambda u, v, n: v.dx(1) * ufl.dx, "L"),
    "slopes on facets": (lambda u, v, n: u.dx(1) * v.dx(1) * ufl.ds, None, "a"),
    "interior facets": (lambda u, v, n: ufl.jump(u) * ufl.jump(v) * ufl.dS, None, "a"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_other_terms_are_refused(name, comm):
    more_a, more_L, argument = REFUSED[name]
    domain = square(comm, 3)
    V = bernstein_space(domain, 1)
    u, v, n = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.FacetNormal(domain)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    a = a + 1e-3 * more_a(u, v, n) if more_a else a
    L = v * ufl.dx + more_L(u, v, n) if more_L else v * ufl.dx
    bottom = mesh.locate_entities_boundary(domain, 1, lambda p: np.isclose(p[1], 0.0))
    problem = SignoriniProblem(a, L, contact=bottom)
    problem.solve()
    with pytest.raises(InputError, match=rf"^{argument}: has a term .* `EnergyTerms`"):
        energy_bound(problem)


def test_data_at_nodes_alone_are_refused(comm):
    domain = square(comm, 3)
    V = bernstein_space(domain, 1)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    wall = mesh.locate_entities_boundary(domain, 1, left)
    bcs = [fem.dirichletbc(0.0, fem.locate_dofs_topological(V, 1, wall), V)]
    bottom = mesh.locate_entities_boundary(domain, 1, lambda p: np.isclose(p[1], 0.0))
    a = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    problem = SignoriniProblem(a, v * ufl.dx, contact=bottom, bcs=bcs)
    problem.solve()
    with pytest.raises(InputError, match=r"^bcs: .* `dirichlet`"):
        energy_bound(problem)
