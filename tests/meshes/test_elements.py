"""The Bernstein basis: the constraint holds between the nodes, and the bases fit together."""

import gc
import weakref

import basix
import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI

from dolfinx_signorini import SignoriniProblem, bernstein_space, boundary_facets
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.data.formula_values import FormulaAtPoints
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.elements import (
    coefficients_of,
    control_points,
    discontinuous_space,
    is_bernstein,
    nodal_space,
    subtriangles,
    values_at_control_points,
)
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.refinement import Transfer, refined
from dolfinx_signorini.meshes.sided_meshes import cells_with_dofs, facet_cells, owned_cells
from dolfinx_signorini.studies.paper.solution import christof_haubner, paper_problem

COMM = MPI.COMM_WORLD
POINTS = 50  # per edge of a facet


def domains(dimension):
    if dimension == 2:
        return mesh.create_unit_square(COMM, 5, 4, diagonal=mesh.DiagonalType.crossed)
    return mesh.create_unit_cube(COMM, 3, 2, 2)


def lowest_on_contact(problem, obstacle=lambda x: 0.0 * x[0]):
    """The smallest u - g at a lattice of points of each contact facet, on any rank."""
    domain = problem.space.mesh
    kind = basix.CellType.interval if domain.topology.dim == 2 else basix.CellType.triangle
    count = POINTS if domain.topology.dim == 2 else 12
    lattice = np.array(basix.create_lattice(kind, count, basix.LatticeType.equispaced, True))
    owned = domain.topology.index_map(domain.topology.dim - 1).size_local
    pairs = facet_cells(domain, problem.contact[problem.contact < owned])
    points = Points(domain, pairs, lattice)
    gap = points.values(problem.u)[0] - obstacle(points.x)
    return COMM.allreduce(float(gap.min(initial=np.inf)), op=MPI.MIN)


@pytest.mark.parametrize("degree", (0, 2))
@pytest.mark.parametrize("dimension", (2, 3))
def test_polynomials_that_may_jump_are_numbered_once_and_let_their_mesh_go(dimension, degree):
    domain = domains(dimension)
    space, other = (discontinuous_space(domain, degree) for _ in range(2))
    own = fem.functionspace(domain, ("DG", degree))
    assert space == other and space != own
    u, v = fem.Function(other), fem.Function(own)
    for each in (u, v):
        each.interpolate(lambda x: np.floor(3.0 * x[0]) + (x[0] * x[1] if degree else 0.0))
    x = ufl.SpatialCoordinate(domain)
    for form in (u - v) ** 2 * ufl.dx, (u - v) * x[0] * ufl.ds:
        assert abs(COMM.allreduce(fem.assemble_scalar(fem.form(form)))) < 1e-15
    seen = weakref.ref(domain)
    del domain, space, other, own, u, v, x, each, form
    gc.collect()
    assert seen() is None


@pytest.mark.parametrize("dimension", [2, 3])
def test_formulas_have_the_outward_normals_of_facets(dimension):
    domain = domains(dimension)
    domain.geometry.x[:, 0] *= 3.0
    pairs = facet_cells(domain, boundary_facets(domain))
    points = Points(domain, pairs, np.full((2, dimension - 1), [[0.2], [0.3]]))
    normal = ufl.FacetNormal(domain)
    found = np.array(FormulaAtPoints(domain, [2.0 * normal[i] for i in range(dimension)])(points))
    sides = np.array(points.x) / np.array([3.0, *[1.0] * (dimension - 1)])[:, None, None]
    assert found == pytest.approx(2.0 * (np.isclose(sides, 1.0) * 1.0 - np.isclose(sides, 0.0)))
    cells = Points(domain, pairs[:, 0], np.full((1, dimension), 0.2))
    with pytest.raises(InputError, match="normal"):
        FormulaAtPoints(domain, [normal[0]])(cells)


@pytest.mark.parametrize("degree", [2, 3, 4])
@pytest.mark.parametrize("dimension", [2, 3])
def test_values_and_coefficients_are_those_of_one_function(dimension, degree):
    domain = domains(dimension)
    space = bernstein_space(domain, degree)
    assert is_bernstein(space) and not is_bernstein(nodal_space(space))
    x = control_points(space).T
    values = np.cos(x[0] + 2.0 * x[1])
    function = fem.Function(space)
    function.x.array[:] = coefficients_of(space, values)
    nodal = fem.Function(nodal_space(space))
    nodal.interpolate(lambda x: np.cos(x[0] + 2.0 * x[1]))
    difference = fem.form((function - nodal) ** 2 * ufl.dx)
    assert COMM.allreduce(fem.assemble_scalar(difference)) <= 1e-28
    assert values_at_control_points(space, function.x.array) == pytest.approx(values, abs=1e-12)


@pytest.mark.parametrize("variant", ["bernstein", "gll_warped"])
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("kind", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_places_of_dofs_lie_on_the_sides(kind, degree, variant):
    cell = mesh.CellType[kind]
    flat = kind in ("triangle", "quadrilateral")
    if flat:
        domain = mesh.create_unit_square(COMM, 3, 4, cell)
    else:
        domain = mesh.create_unit_cube(COMM, 2, 3, 2, cell)
    if variant == "gll_warped":
        space = fem.functionspace(domain, ("Lagrange", degree))
    elif kind in ("triangle", "tetrahedron"):
        space = bernstein_space(domain, degree)
    else:
        pytest.skip("the Bernstein basis is one of simplices")
    places, last = control_points(space), 1 if flat else 2
    assert places == pytest.approx(nodal_space(space).tabulate_dof_coordinates(), abs=1e-15)
    domain.topology.create_connectivity(last, last + 1)
    for side in (0.0, 1.0):
        facets = mesh.locate_entities_boundary(domain, last, lambda x, s=side: x[last] == s)
        dofs = fem.locate_dofs_topological(space, last, facets)
        assert COMM.allreduce(len(dofs)) > 0
        rounding = 1e-15 if side and degree > 1 else 0.0
        assert np.abs(places[dofs, last] - side).max(initial=0.0) <= rounding
        some = cells_with_dofs(space, np.isin(np.arange(len(places)), dofs))
        assert (control_points(space, some)[dofs] == places[dofs]).all()


@pytest.mark.parametrize(
    ("cell", "count"), [(basix.CellType.triangle, 1), (basix.CellType.quadrilateral, 2)]
)
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_small_triangles_fill_a_cell(cell, count, degree):
    variant = basix.LagrangeVariant.equispaced
    element = basix.create_element(basix.ElementFamily.P, cell, degree, variant)
    corners = element.points[subtriangles(cell, degree)]
    areas = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    assert areas == pytest.approx(np.full(count * degree**2, 1.0 / degree**2))
    assert len(np.unique(corners.mean(axis=1).round(9), axis=0)) == len(corners)


@pytest.mark.parametrize("degree", [2, 3, 4])
@pytest.mark.parametrize("n", [9, 32])
def test_the_papers_solution_is_nowhere_below_the_obstacle(degree, n):
    problem = paper_problem(christof_haubner(friedrichs_keller(COMM, n)), degree)
    problem.solve()
    assert lowest_on_contact(problem) >= -1e-14


def test_nodal_elements_dip_below_the_obstacle():
    # The test of the test: with constraints at the nodes of degree 2 the same points show it.
    domain = friedrichs_keller(COMM, 9)
    exact = christof_haubner(domain)
    space = fem.functionspace(domain, ("Lagrange", 2))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    dx = ufl.dx(metadata={"quadrature_degree": 7})
    problem = SignoriniProblem(a, exact.load * v * dx, contact=boundary_facets(domain))
    problem.solve()
    assert lowest_on_contact(problem) < -1e-4


@pytest.mark.parametrize(("dimension", "degree"), [(2, 2), (2, 3), (2, 4), (3, 2), (3, 3)])
@settings(max_examples=6)
@given(wave=st.floats(1.0, 9.0), push=st.floats(1.0, 30.0), slope=st.floats(-0.2, 0.2))
def test_the_constraint_holds_at_every_point(dimension, degree, wave, push, slope):
    """For loads that press in some places, and obstacles that the elements hold exactly."""
    domain = domains(dimension)
    space = bernstein_space(domain, degree)
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    load = fem.Constant(domain, push) * ufl.sin(fem.Constant(domain, wave) * (x[0] + x[1]))
    problem = SignoriniProblem(
        a,
        load * v * ufl.dx(metadata={"quadrature_degree": 6}),
        contact=boundary_facets(domain),
        obstacle=lambda x: slope * x[0] - 0.1 * x[1] ** 2,
    )
    problem.solve()
    low = lowest_on_contact(problem, lambda x: slope * x[0] - 0.1 * x[1] ** 2)
    assert low >= -1e-13 * max(1.0, push)
    assert problem.gap.x.array.min(initial=0.0) >= 0.0
    assert problem.pressure.x.array.min(initial=0.0) >= 0.0
    held, forces = problem.active, problem.pressure.x.array
    free = np.setdiff1d(problem.contact_dofs, held)
    assert (forces[free] == 0.0).all()


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_the_forces_are_the_integral_of_the_density(degree):
    problem = paper_problem(christof_haubner(friedrichs_keller(COMM, 16)), degree)
    problem.solve(rtol=1e-11)
    ds = ufl.Measure("ds", problem.space.mesh, metadata={"quadrature_degree": degree})
    total = COMM.allreduce(fem.assemble_scalar(fem.form(problem.pressure * ds)))
    system = problem.system
    x = system.start(problem.u.x.array)
    forces = COMM.allreduce(float(system.multiplier(x).sum()))
    x.destroy()
    assert total == pytest.approx(forces, rel=1e-6)


@pytest.mark.parametrize("kind", ["number", "callable", "expression", "function"])
def test_an_obstacle_can_be_given_in_any_form(kind):
    domain = friedrichs_keller(COMM, 6)
    space = bernstein_space(domain, 3)
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    own = fem.Function(space)
    own.x.array[:] = coefficients_of(space, control_points(space)[:, 0] ** 2)
    obstacle = {
        "number": 0.25,
        "callable": lambda x: x[0] ** 2,
        "expression": x[0] ** 2,
        "function": own,
    }[kind]
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    problem = SignoriniProblem(
        a, -5.0 * v * ufl.dx, contact=boundary_facets(domain), obstacle=obstacle
    )
    problem.solve()
    # Pressed down everywhere, the solution is the obstacle on the whole boundary.
    exact = (lambda x: 0.25 + 0.0 * x[0]) if kind == "number" else (lambda x: x[0] ** 2)
    points = Points(domain, facet_cells(domain, boundary_facets(domain)), np.array([[0.3], [0.77]]))
    assert points.values(problem.u)[0] == pytest.approx(exact(points.x), abs=1e-13)


@pytest.mark.parametrize("degree", [2, 3, 4])
@pytest.mark.parametrize("dimension", [2, 3])
def test_polynomials_are_carried_between_a_mesh_and_its_refinement(dimension, degree):
    from dolfinx_signorini.meshes.sided_meshes import SidedMesh

    domain = domains(dimension)
    step = refined(SidedMesh(domain, {}), owned_cells(domain)[::2])
    coarse, fine = (bernstein_space(m, degree) for m in (domain, step.sided.mesh))
    transfer, both = Transfer(coarse, fine, step.parents), []
    for space in (coarse, fine):
        u = fem.Function(space)
        x = control_points(space).T
        u.x.array[:] = coefficients_of(space, x[0] ** degree - x[1])
        both.append(u)
    low, high = both
    owned = fine.dofmap.index_map.size_local
    assert transfer.prolong(low).x.array[:owned] == pytest.approx(high.x.array[:owned], abs=1e-12)
    owned = coarse.dofmap.index_map.size_local
    assert transfer.restrict(high).x.array[:owned] == pytest.approx(low.x.array[:owned], abs=1e-12)
