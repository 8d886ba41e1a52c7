"""The contact pressure: its total is the resultant force, and its density tends to du/dn."""

import basix
import basix.ufl
import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem, la, mesh
from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.ranks import marked
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.elements import (
    bernstein_space,
    control_points,
    facet_dofs,
    nodal_space,
    values_at_control_points,
)
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, facet_cells
from dolfinx_signorini.pictures.contact_boundary import gather_contact_boundary
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.solvers.densities import Densities
from dolfinx_signorini.studies.paper.solution import AMPLITUDE, christof_haubner, paper_problem

COMM = MPI.COMM_WORLD


def integral(form):
    return float(COMM.allreduce(fem.assemble_scalar(fem.form(form))))


def smallest(values):
    return float(COMM.allreduce(float(np.min(values, initial=np.inf)), op=MPI.MIN))


def uneven(n):
    """The unit square with cells that are narrower on the left."""
    domain = friedrichs_keller(COMM, n)
    domain.geometry.x[:, 0] **= 1.5
    return domain


def cube(n):
    return dolfinx.mesh.create_unit_cube(COMM, n, n, n)


@pytest.mark.parametrize(
    ("domain", "degree"),
    [
        (friedrichs_keller(COMM, 6), 1),
        (friedrichs_keller(COMM, 6), 2),
        (uneven(7), 1),
        (cube(3), 1),
        (cube(2), 2),
        (cube(2), 3),
    ],
    ids=["P1", "P2", "uneven P1", "cube P1", "cube P2", "cube P3"],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_body_pulled_down_evenly_presses_evenly(domain, degree, sign):
    # u = -3 h at the height h is harmonic, lies on the floor 0 and presses with 3 everywhere.
    force, top = 3.0, domain.geometry.dim - 1
    space = fem.functionspace(domain, ("Lagrange", degree))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    lid, floor = (
        dolfinx.mesh.locate_entities_boundary(domain, top, lambda x, h=h: np.isclose(x[top], h))
        for h in (1.0, 0.0)
    )
    dofs = fem.locate_dofs_topological(space, top, lid)
    problem = SignoriniProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        fem.Constant(domain, 0.0) * v * ufl.dx,
        contact=floor,
        bound="lower" if sign > 0.0 else "upper",
        bcs=[fem.dirichletbc(fem.Constant(domain, -sign * force), dofs, space)],
    )
    problem.solve(rtol=1e-12)
    pressure = problem.pressure
    assert pressure.x.array[problem.contact_dofs] == pytest.approx(force, rel=1e-9)
    tags = dolfinx.mesh.meshtags(domain, top, np.sort(floor), np.ones(len(floor), dtype=np.int32))
    ds = ufl.Measure("ds", domain, subdomain_data=tags)(1)
    assert integral(pressure * ds) == pytest.approx(force * integral(1.0 * ds), rel=1e-9)
    problem.destroy()


@pytest.mark.parametrize("n", [16, 33])
def test_the_total_pressure_is_the_resultant_of_load_and_reaction(n):
    exact = christof_haubner(friedrichs_keller(COMM, n))
    problem = paper_problem(exact)
    u = problem.solve(rtol=1e-12)
    load = COMM.allreduce(float(problem.b.array_r.sum()))
    force = integral(problem.pressure * ufl.ds)
    assert force > 1.0
    assert force == pytest.approx(integral(u * ufl.dx) - load, rel=1e-8)
    problem.destroy()


@pytest.mark.parametrize("degree", [1, 2])
def test_the_density_converges_to_the_normal_derivative(degree):
    errors = []
    for n in (40, 80):
        exact = christof_haubner(friedrichs_keller(COMM, n))
        problem = paper_problem(exact, degree)
        problem.solve(rtol=1e-10)
        x, y = control_points(problem.space)[problem.contact_dofs, :2].T
        pressure = problem.pressure.x.array[problem.contact_dofs]
        # du/dn = 10 psi(r) 3/2 r^{1/2} on the bottom to the right of the detachment point.
        r = x - 0.5
        t = r / 0.45
        psi = (1.0 - t) ** 5 * (1.0 + t * (5.0 + t * (15.0 + t * (35.0 + t * 70.0))))
        seen = (y < 1e-12) & (r > 0.1) & (t < 1.0)
        flux = 1.5 * AMPLITUDE * psi[seen] * np.sqrt(r[seen])
        worst = float(np.abs(pressure[seen] - flux).max(initial=0.0))
        largest = float(flux.max(initial=0.0))
        worst, largest = (COMM.allreduce(v, op=MPI.MAX) for v in (worst, largest))
        errors.append(worst / largest)
        problem.destroy()
    assert errors[1] < 0.02
    assert errors[1] < 0.6 * errors[0]


def test_the_pressure_is_not_negative_where_a_loose_solve_leaves_a_pull():
    # Pushed down but for a strip at the bottom: what is held there is not released any more.
    domain = friedrichs_keller(COMM, 10)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    strip = ufl.And(ufl.lt(x[1], 0.15), ufl.lt(abs(x[0] - 0.5), 0.2))
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    load = ufl.conditional(strip, 4.0, -1.0) * v * ufl.dx(metadata={"quadrature_degree": 4})
    problem = SignoriniProblem(a, load, contact=boundary_facets(domain))
    problem.solve(rtol=0.9)
    vector = problem.system.vector_of(problem.u)
    forces = problem.system.multiplier(vector)[problem.system.touching(vector)]
    vector.destroy()
    assert smallest(forces) < 0.0  # else there is nothing to see
    assert smallest(problem.pressure.x.array) == 0.0
    problem.destroy()


def graded(n, cell):
    """The unit square or cube with cells that are much smaller near the corner 0."""
    square = cell in ("triangle", "quadrilateral")
    create = mesh.create_unit_square if square else mesh.create_unit_cube
    domain = create(COMM, *[n] * (2 if square else 3), mesh.CellType[cell])
    domain.geometry.x[:] **= 1.7
    return domain


CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")
ELEMENTS = [(cell, degree, "gll_warped") for cell in CELLS for degree in (1, 2, 3)]
ELEMENTS += [("triangle", 4, "gll_warped"), ("tetrahedron", 4, "gll_warped")]
ELEMENTS += [(cell, degree, "bernstein") for cell in CELLS[::2] for degree in (2, 3)]


def density_of(space, facets, forces):
    """The density of some forces on the dofs of facets, and the integral over these facets."""
    domain, dim = space.mesh, space.mesh.topology.dim - 1
    owned = facets[facets < domain.topology.index_map(dim).size_local]
    density = fem.Function(space)
    density.x.array[:] = Densities(space, facet_cells(domain, owned)).of(forces)
    tags = mesh.meshtags(domain, dim, np.sort(facets), np.ones(len(facets), dtype=np.int32))
    return density, ufl.Measure("ds", domain, subdomain_data=tags)(1)


@pytest.mark.parametrize(("cell", "degree", "variant"), ELEMENTS)
def test_a_density_has_the_forces_as_integral_on_every_element(cell, degree, variant):
    # Forces of any size on two parts of the floor: each part of the density integrates to its own.
    element = basix.ufl.element("P", cell, degree, lagrange_variant=basix.LagrangeVariant[variant])
    domain = graded(6, cell)
    space = fem.functionspace(domain, element)
    top = domain.geometry.dim - 1
    floor = mesh.locate_entities_boundary(domain, top, lambda x: x[top] < 1e-12)
    dofs = fem.locate_dofs_topological(space, top, floor)
    place = control_points(space)
    left, right = place[:, 0] < 0.15, place[:, 0] > 0.75
    forces = fem.Function(space)
    forces.x.array[dofs] = (1.2 + np.sin(40.0 * place[:, 0] + 23.0 * place[:, 1]))[dofs]
    forces.x.array[~(left | right)] = 0.0
    density, ds = density_of(space, floor, forces.x.array)
    x = ufl.SpatialCoordinate(domain)
    owned = np.arange(len(place)) < space.dofmap.index_map.size_local
    for part, where in ((left, x[0] < 0.45), (right, x[0] > 0.45)):
        total = COMM.allreduce(float(forces.x.array[part & owned].sum()))
        rule = {"quadrature_degree": degree}
        found = integral(ufl.conditional(where, density, 0.0) * ds(metadata=rule))
        assert total > 0.0 and found == pytest.approx(total, rel=1e-12)
    assert smallest(density.x.array) >= 0.0
    # Of the forces of the density 1 the density is 1.
    v = ufl.TestFunction(space)
    ones = fem.assemble_vector(fem.form(v * ds))
    ones.scatter_reverse(la.InsertMode.add)
    ones.scatter_forward()
    flat, _ = density_of(space, floor, ones.array)
    assert flat.x.array[dofs] == pytest.approx(1.0, abs=1e-10)


def test_a_basis_without_positive_integrals_on_quadrilaterals_is_refused():
    # The rule of Newton and Cotes with 9 points has negative weights.
    element = basix.ufl.element("P", "hexahedron", 8, basix.LagrangeVariant.equispaced)
    domain = mesh.create_unit_cube(COMM, 1, 1, COMM.size, mesh.CellType.hexahedron)
    space = fem.functionspace(domain, element)
    floor = mesh.locate_entities_boundary(domain, 2, lambda x: x[0] < 1e-12)
    with pytest.raises(InputError, match="gll_warped"):
        density_of(space, floor, np.zeros(len(control_points(space))))


def pushed(domain, degree, sign, bernstein=False):
    """A body pushed unevenly onto a floor, or against a ceiling for the sign -1."""
    make = bernstein_space if bernstein else lambda m, k: fem.functionspace(m, ("Lagrange", k))
    space, top = make(domain, degree), domain.geometry.dim - 1
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    floor = mesh.locate_entities_boundary(domain, top, lambda x: np.isclose(x[top], 0.0))
    return SignoriniProblem(
        (ufl.inner(ufl.grad(u), ufl.grad(v)) + 4.0 * u * v) * ufl.dx,
        -sign * (60.0 * x[0] - 35.0) * v * ufl.dx,
        contact=floor,
        obstacle=-sign * 0.1,
        bound="lower" if sign > 0.0 else "upper",
    )


@pytest.mark.parametrize(
    ("domain", "degree", "bernstein"),
    [(friedrichs_keller(COMM, 9), 2, False), (cube(4), 2, False), (cube(4), 2, True)],
    ids=["P2", "cube P2", "cube Bernstein 2"],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_pressure_force_and_balance_say_the_same(domain, degree, bernstein, sign):
    problem = pushed(domain, degree, sign, bernstein)
    u = problem.solve(rtol=1e-11)
    x = ufl.SpatialCoordinate(domain)
    carried = integral((4.0 * u + sign * (60.0 * x[0] - 35.0)) * ufl.dx)
    assert sign * problem.force > 0.2
    assert problem.force == pytest.approx(carried, rel=1e-8)
    pressure = problem.pressure
    tags = mesh.meshtags(domain, domain.topology.dim - 1, np.sort(problem.contact), 1)
    ds = ufl.Measure("ds", domain, subdomain_data=tags)(1)
    assert integral(pressure * ds) == pytest.approx(sign * problem.force, rel=1e-12)
    # No pressure away from contact: at free dofs, but on tetrahedra on facets that lie apart.
    space = problem.space
    dofs = facet_dofs(space, problem.system.layout.owned_entities)
    near = marked(space, problem.active)
    if domain.topology.dim == 3:
        near = marked(space, dofs[near[dofs].any(axis=1)].ravel())
        near = marked(space, dofs[near[dofs].any(axis=1)].ravel())
    assert COMM.allreduce(int((~near[dofs]).sum())) > 3
    values = values_at_control_points(space, pressure.x.array)
    assert (values[dofs][~near[dofs]] == 0.0).all()
    if domain.topology.dim == 3:
        fine = fem.Function(fem.functionspace(domain, ("Lagrange", 4)))
        fine.interpolate(pressure)
        floor = fem.locate_dofs_topological(fine.function_space, 2, problem.contact)
        assert smallest(fine.x.array[floor]) >= -1e-12
    # Pictures and tables have the values of the function, which in the Bernstein basis are others.
    table = gather_contact_boundary(problem)
    values = fem.Function(nodal_space(space))
    values.interpolate(pressure)
    highest = COMM.allreduce(float(values.x.array[dofs].max(initial=0.0)), op=MPI.MAX)
    if table is not None:
        assert table.values[:, 2].max() == pytest.approx(highest, rel=1e-12)
    problem.destroy()
