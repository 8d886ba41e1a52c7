"""The adaptive loop for elastic contact: the identity of the error, and requests."""

from dataclasses import replace

import dolfinx
import elastic_known as known
import hertz
import numpy as np
import pytest
import ufl
from dolfinx import fem, la
from mpi4py import MPI

import dolfinx_signorini as ds
from dolfinx_signorini import InputError
from dolfinx_signorini.accuracy.boundary_defects import data_between_nodes, data_defects
from dolfinx_signorini.accuracy.estimates import Estimator
from dolfinx_signorini.accuracy.negative_pressure import pressure_density
from dolfinx_signorini.accuracy.targets import target
from dolfinx_signorini.accuracy.terms import (
    TERMS,
    Solution,
    Solved,
    assembled,
    difference,
    dual_solution,
    met,
)
from dolfinx_signorini.meshes.between_meshes import interpolate_between
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, owned_cells

NORMS = {
    "L2": (1e-3, 1e-4), "L4": (1e-3, 1e-4), "Linf": (1e-3, 2e-4), "H1": (1e-2, 3e-3),
    "W1_4": (2e-2, 6e-3), "energy": (0.2, 0.05), "stress": (3.0, 0.8),
    "largest stress": (6.0, 3.0),
}  # fmt: skip
SLANTED = known.Slanted()


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("what", NORMS)
def test_requests_for_hertz(what, degree):
    """Two ends of contact, where the stress is like the root of the distance."""
    for accuracy in NORMS[what]:
        accuracy *= 3.0 if degree == 1 else 0.3
        found = known.solve(known.hertz_on(degree), known.first_mesh(), what, accuracy)
        true = known.true_error(found.problem.u, hertz, what)
        found.problem.destroy()
        assert found.reached and true <= found.estimate <= accuracy, (true, found)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("what", ["L2", "Linf", "H1", "stress"])
def test_requests_for_full_contact_on_a_slanted_side(what, degree):
    accuracy = NORMS[what][0] * (2.0 if degree == 1 else 0.1)
    sided = known.first_mesh(3, SLANTED.Q)
    found = known.solve(SLANTED.on(degree), sided, what, accuracy)
    problem = found.problem
    true = known.true_error(problem.u, SLANTED, what)
    assert found.reached and true <= found.estimate <= accuracy, (true, found)
    nodes = problem.comm.allreduce(len(problem.contact_nodes))
    assert problem.comm.allreduce(len(problem.active)) == nodes
    problem.destroy()


def test_a_body_that_is_held_weakly_has_a_limit(comm):
    """What no mesh may decide: how far the body has slid."""
    domain = dolfinx.mesh.create_rectangle(comm, [(0.0, 0.0), (2.0, 1.0)], (8, 4))
    floor = dolfinx.mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))

    def pose(sided):
        space = fem.functionspace(sided.mesh, ("Lagrange", 2, (2,)))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        x = ufl.SpatialCoordinate(sided.mesh)
        near = ufl.exp(-30.0 * ((x[0] - 0.3) ** 2 + (x[1] - 0.8) ** 2))
        a, L = ds.elasticity(u, v, young=10.0, poisson=0.3), -(0.2 + 20.0 * near) * v[1] * ufl.dx
        floor = {"contact": sided.sides["floor"], "direction": (0.0, -1.0)}
        return ds.ContactProblem(a, L, **floor, held_weakly=True)

    sided = ds.SidedMesh(domain, {"floor": floor})
    first, second = (
        ds.solve_adaptively(pose, sided, norm="L2", accuracy=accuracy) for accuracy in (1e-3, 1e-5)
    )
    fine = second.problem.u
    coarse = fem.Function(fine.function_space)
    interpolate_between([(first.problem.u, coarse)], owned_cells(second.sided.mesh))
    apart = ds.error_norms(difference(fine, coarse), None, ["L2"])["L2"]
    assert first.reached and second.reached and apart <= first.estimate
    for found in (first, second):
        found.problem.destroy()


def weighted_pressure(profile, size, depth):
    """The integral of the pressure times a profile on the side y = 0, as a functional of u."""

    def functional(u):
        x = ufl.SpatialCoordinate(ufl.domain.extract_unique_domain(u))
        inside = ufl.And(ufl.lt(abs(x[0]), size), ufl.lt(x[1], depth))
        height = profile(x[0] / size) * (1.0 - x[1] / depth) ** 2
        moved = ufl.as_vector([0.0, ufl.conditional(inside, height, 0.0)])
        stress = ds.stress(u, hertz.E, hertz.NU)
        return ufl.inner(stress, ufl.grad(moved)) * ufl.dx(metadata={"quadrature_degree": 12})

    return functional


def value(functional, u):
    return u.function_space.mesh.comm.allreduce(fem.assemble_scalar(fem.form(functional(u))))


@pytest.mark.parametrize("degree", [1, 2])
def test_largest_pressure_and_width_of_hertz(degree):
    """A mean with a kernel of order 4 is the largest pressure, but for p'''' times size^4."""
    size = 0.3

    def kernel(t):
        return 105.0 / (64.0 * size) * (1.0 - t**2) ** 2 * (1.0 - 3.0 * t**2)

    t, w = np.polynomial.legendre.leggauss(40)
    exact = size * (w * kernel(t) * hertz.pressure(np.stack([size * t, 0.0 * t]))).sum()
    assert exact == pytest.approx(hertz.P0, rel=2e-4)
    peak = weighted_pressure(kernel, size, 0.4)
    for accuracy in (5e-3 * hertz.P0, 5e-4 * hertz.P0):
        pose = known.hertz_on(degree)
        found = ds.solve_adaptively(pose, known.first_mesh(), norm=peak, accuracy=accuracy)
        true = abs(value(peak, found.problem.u) - exact)
        assert found.reached and true <= found.estimate <= accuracy, (true, found)
        problem = found.problem
    assert value(peak, problem.u) == pytest.approx(hertz.P0, rel=1e-3)
    first, last = sorted(point.position[0] for point in ds.detachment_points(problem))
    assert 0.5 * (last - first) == pytest.approx(hertz.A, rel=1e-3)
    problem.destroy()


@pytest.mark.parametrize("degree", [1, 2])
def test_contact_force_of_hertz(degree):
    """With the weight 1 where contact is, the weighted pressure is the contact force."""

    def flat(t):
        edge = 0.5  # beyond 1 a smooth step to 0 at 2
        s = ufl.max_value(abs(t) - edge, 0.0) / (1.0 - edge)
        return (1.0 - s**2) ** 2

    force = weighted_pressure(flat, 2.0, 2.0)
    for accuracy in (1e-2, 1e-3):
        accuracy *= hertz.FORCE
        pose = known.hertz_on(degree)
        found = ds.solve_adaptively(pose, known.first_mesh(), norm=force, accuracy=accuracy)
        true = abs(value(force, found.problem.u) - hertz.FORCE)
        assert found.reached and true <= found.estimate <= accuracy, (true, found)
        assert found.problem.force[1] == pytest.approx(hertz.FORCE, abs=accuracy)
        found.problem.destroy()


def compared(degree, direction, height, unit=1.0, place=None):
    """Two solutions on a block with a round support, which is held on components of two sides.

    At a node of the finer mesh alone, or at another place, the support has a pin of a height.
    """
    place = 1.0 / (3.0 * degree) if place is None else place

    def pose(sided):
        domain = sided.mesh
        V, x = fem.functionspace(domain, ("Lagrange", degree, (2,))), ufl.SpatialCoordinate(domain)
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)

        def side(axis, at):
            return dolfinx.mesh.locate_entities_boundary(
                domain, 1, lambda x: np.isclose(x[axis], at)
            )

        push = fem.Function(V.sub(1).collapse()[0])
        push.interpolate(lambda x: -0.1 + 0.02 * np.sin(3.0 * x[0]))
        pairs = fem.locate_dofs_topological((V.sub(1), push.function_space), 1, side(1, 2.0))
        bcs = [fem.dirichletbc(push, pairs, V.sub(1))]
        left = fem.locate_dofs_topological(V.sub(0), 1, side(0, -2.0))
        bcs.append(fem.dirichletbc(0.0, left, V.sub(0)))
        pin = ufl.exp(-(((x[0] - place) / 0.02) ** 2))
        load = ufl.as_vector([x[1], -x[0]])  # which both meshes integrate exactly
        a = ds.elasticity(u, v, 10.0, 0.3) + 0.1 * ufl.inner(u, v) * ufl.dx
        return ds.ContactProblem(
            a,
            ufl.inner(load, v) * ufl.dx,
            contact=sided.sides["below"],
            gap=unit * (0.02 + 0.05 * x[0] ** 2 - height * pin),
            direction=direction,
            bcs=bcs,
        )

    sided = known.first_mesh(3)
    division = refined(sided)
    problems = [pose(sided), pose(division.sided)]
    for problem in problems:
        problem.solve(rtol=1e-12)
    coarse = Solution(problems[0].u, problems[0].forces)
    return Solved(coarse, problems[1], division.parents, target("L2")), problems


def far_above(sided, data, component):
    """A body above its obstacle, held at its sides; on top a component of u has the data."""
    domain = sided.mesh
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(domain)
    below, sides = (
        dolfinx.mesh.locate_entities_boundary(domain, 1, marker)
        for marker in (lambda x: np.isclose(x[1], 0.0), lambda x: x[1] > -1.0)
    )
    sides = np.setdiff1d(sides, below).astype(np.int32)
    bcs = [ds.dirichlet(V, sides, 0.0 * x[0], 1 - component)]
    bcs.append(ds.dirichlet(V, sides, data(x), component))
    a, L = ds.elasticity(u, v, 10.0, 0.3), ufl.inner(fem.Constant(domain, (0.0, 0.0)), v) * ufl.dx
    problem = ds.ContactProblem(a, L, contact=below, gap=10.0, direction=(0.0, -1.0), bcs=bcs)
    problem.solve(rtol=1e-12)
    return problem


@pytest.mark.parametrize("component", [0, 1])
def test_the_mean_of_dirichlet_data_between_nodes_moves_a_functional(component, comm):
    """The solutions vanish; from far away sin(pi x) (1 - cos(k x)) on the top is like sin(pi x)."""
    k = 32.0 * np.pi  # twice the number of the finer nodes
    sided = SidedMesh(dolfinx.mesh.create_unit_square(comm, 8, 8), {})
    division, problems = refined(sided), []

    def moved(v):
        return v[component] * ufl.dx

    for part, wave in ((sided, 1.0), (division.sided, 1.0), (division.sided, 0.0)):

        def data(x, wave=wave):
            top = ufl.sin(np.pi * x[0]) * (1.0 - wave * ufl.cos(k * x[0]))
            return ufl.conditional(x[1] > 1.0 - 1e-9, top, 0.0)

        problems.append(far_above(part, data, component))
    coarse, fine, even = problems
    assert np.abs(fine.u.x.array).max() <= 1e-12
    solved = Solved(Solution(coarse.u, coarse.forces), fine, division.parents, target(moved))
    dual = dual_solution(solved, assembled(moved(ufl.TestFunction(fine.space)), fine.space))
    found = comm.allreduce(float(data_between_nodes(solved, dual)[0].sum()))
    wanted = comm.allreduce(fem.assemble_scalar(fem.form(moved(even.u))))
    assert found == pytest.approx(wanted, rel=0.05)
    for problem in problems:
        problem.destroy()


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("length", [1.0, 3.0])
def test_a_pin_between_all_nodes(degree, length):
    """A direction of another length, with a gap in its unit, has the same defect."""
    height = 0.05
    solved, problems = compared(degree, (0.0, -length), height, unit=length, place=1.235)
    solved = replace(solved, target=target("Linf"))
    parts = problems[0].comm.allreduce(data_defects(solved, None)[1].max(initial=0.0), op=MPI.MAX)
    assert 0.9 * height <= parts <= 1.1 * height
    for problem in problems:
        problem.destroy()


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("direction", [None, (0.6, -0.8), (1.2, -1.6)])
@pytest.mark.parametrize("pin", [0.0, 0.3])
def test_the_terms_add_up_to_the_difference(degree, direction, pin):
    """J(w - u_h) is the sum of residuals, of released nodes and of held ones, for any J."""
    solved, problems = compared(degree, direction, pin)
    comm, V = problems[0].comm, solved.fine.space
    active = [comm.allreduce(len(problem.active)) for problem in problems]
    nodes = [comm.allreduce(len(problem.contact_nodes)) for problem in problems]
    assert 0 < active[0] < nodes[0] and 0 < active[1] < nodes[1]
    v, x = ufl.TestFunction(V), ufl.SpatialCoordinate(V.mesh)
    load = (v[0] + ufl.exp(x[0]) * v[1]) * ufl.dx
    dual = dual_solution(solved, assembled(load, V))
    error = ufl.replace(load, {v: solved.error})
    have = comm.allreduce(fem.assemble_scalar(fem.form(error)))
    found = [term(solved, dual) for term in (*TERMS, met)]
    assert all((np.abs(signed) <= sizes * (1.0 + 1e-12) + 1e-300).all() for signed, sizes in found)
    parts = np.array([comm.allreduce(float(signed.sum())) for signed, _ in found])
    assert dual.value == pytest.approx(have, rel=1e-8)
    assert abs(parts.sum() - have) <= 1e-7 * np.abs(parts).sum(), parts
    counts = pin > 0.0, True  # the pin releases nodes around
    changed = abs(parts[1]), abs(parts[2] + parts[4])  # released, and held at data met or not
    assert ((np.array(changed) > 1e-4 * np.abs(parts).sum()) == counts).all(), parts
    for problem in problems:
        problem.destroy()


@pytest.mark.parametrize("what", ["L2", "L4", "Linf", "H1"])
def test_the_axes_do_not_matter(what):
    """The estimate is that of the turned problem, on the same mesh."""
    estimates = []
    for turn in (np.eye(2), SLANTED.Q):
        case = known.Slanted()
        case.Q = turn
        sided = known.first_mesh(3)
        division = refined(sided)
        for domain in (sided.mesh, division.sided.mesh):
            domain.geometry.x[:, :2] = domain.geometry.x[:, :2] @ turn.T
        problems = [case.on(2)(part) for part in (sided, division.sided)]
        for problem in problems:
            problem.solve(rtol=1e-12)
        coarse = Solution(problems[0].u, problems[0].forces)
        estimator = Estimator(problems[0].space, target(what))
        estimator.compare(Solved(coarse, problems[1], division.parents, target(what)))
        estimates.append(estimator.estimate)
        for problem in problems:
            problem.destroy()
    # The derivatives along axes are others, the sum of the squares of which is the same.
    assert estimates[0] == pytest.approx(estimates[1], rel=1e-4)


def test_what_is_not_estimated_is_refused():
    sided = known.first_mesh()
    pose = known.hertz_on(1)

    def jumping(sided):
        V = fem.functionspace(sided.mesh, ("Lagrange", 1, (2,)))
        u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(sided.mesh)
        young = ufl.conditional(ufl.lt(x[0] ** 2 + x[1] ** 2, 0.2345), 1.0, 50.0)
        a = ds.elasticity(u, v, young, 0.3) + ufl.inner(u, v) * ufl.dx
        return ds.ContactProblem(a, v[1] * ufl.dx, contact=sided.sides["below"])

    with pytest.raises(InputError, match="jumps inside of cells"):
        ds.solve_adaptively(jumping, sided, accuracy=1.0)
    with pytest.raises(InputError, match="derivatives alone"):
        ds.solve_adaptively(pose, sided, norm="L2", of=lambda u: u, accuracy=1.0)
    with pytest.raises(InputError, match="linear"):
        ds.solve_adaptively(pose, sided, norm="L2", of=lambda u: ufl.grad(u) * u[0], accuracy=1.0)
    problem = pose(sided)
    problem.solve()
    with pytest.raises(InputError, match="symmetric equilibrated stress"):
        ds.energy_bound(problem, ds.EnergyTerms())
    problem.destroy()


def test_in_space():
    """Full contact of a cube: u = (-z g_x, -z g_y, g - 0.2 z) has no shear at z = 0."""

    def exact(x, sin, cos):
        g, gx, gy = (
            0.03 * cos(2.0 * x[0]) * cos(x[1]),
            -0.06 * sin(2.0 * x[0]) * cos(x[1]),
            -0.03 * cos(2.0 * x[0]) * sin(x[1]),
        )
        return [-x[2] * gx, -x[2] * gy, g - 0.2 * x[2]]

    def pose(sided):
        V = fem.functionspace(sided.mesh, ("Lagrange", 1, (3,)))
        u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(sided.mesh)
        data = fem.Function(V)
        data.interpolate(lambda x: np.stack(exact(x, np.sin, np.cos)))
        bc = fem.dirichletbc(data, fem.locate_dofs_topological(V, 2, sided.sides["held"]))
        load = -ufl.div(ds.stress(ufl.as_vector(exact(x, ufl.sin, ufl.cos)), 10.0, 0.3))
        a, L = ds.elasticity(u, v, 10.0, 0.3), ufl.inner(load, v) * ufl.dx
        gap = -0.03 * ufl.cos(2.0 * x[0]) * ufl.cos(x[1])
        return ds.ContactProblem(a, L, contact=sided.sides["below"], gap=gap, bcs=[bc])

    cube = dolfinx.mesh.create_unit_cube(known.COMM, 2, 2, 2)
    below = dolfinx.mesh.locate_entities_boundary(cube, 2, lambda x: np.isclose(x[2], 0.0))
    others = np.setdiff1d(ds.boundary_facets(cube), below).astype(np.int32)
    for what, accuracy in (("L2", 1e-3), ("energy", 0.05)):
        of = None if what == "L2" else (lambda u: ds.weighted_strain(u, 10.0, 0.3))
        found = ds.solve_adaptively(
            pose,
            ds.SidedMesh(cube, {"below": below, "held": others}),
            norm="L2",
            of=of,
            accuracy=accuracy,
        )
        u = found.problem.u
        x = ufl.SpatialCoordinate(u.function_space.mesh)
        error = u - ufl.as_vector(exact(x, ufl.sin, ufl.cos))
        square = ufl.inner(error, error) if of is None else ufl.inner(of(error), of(error))
        form = fem.form(square * ufl.dx(metadata={"quadrature_degree": 8}))
        true = np.sqrt(known.COMM.allreduce(fem.assemble_scalar(form)))
        found.problem.destroy()
        assert found.reached and true <= found.estimate <= accuracy, (true, found)


def test_where_contact_ends_below_a_body_that_bends_away():
    """The gap beside the contact is a small part of the largest gap."""
    sided = known.first_mesh(24)
    V = fem.functionspace(sided.mesh, ("Lagrange", 1, (2,)))
    u, v, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(sided.mesh)
    top = dolfinx.mesh.locate_entities_boundary(sided.mesh, 1, lambda x: np.isclose(x[1], 2.0))
    push, gap = np.array([0.0, -0.2]), x[0] ** 2 + 5.0 * x[0] ** 4
    bc = fem.dirichletbc(push, fem.locate_dofs_topological(V, 1, top), V)
    L = ufl.inner(fem.Constant(sided.mesh, (0.0, 0.0)), v) * ufl.dx
    a, contact = ds.elasticity(u, v, 1.0, 0.3), sided.sides["below"]
    problem = ds.ContactProblem(a, L, contact=contact, gap=gap, bcs=[bc])
    problem.solve(rtol=1e-10)
    first, last = (point.position[0] for point in ds.detachment_points(problem))
    nodes = problem.along_direction.space.tabulate_dof_coordinates()[problem.active, 0]
    half = problem.comm.allreduce(np.abs(nodes).max(initial=0.0), op=MPI.MAX)
    width = 2.0 / 24.0
    assert first == pytest.approx(-last, abs=1e-3) and abs(last - half) <= width
    problem.destroy()


@pytest.mark.parametrize("degree", [1, 2])
def test_the_density_of_the_pressure_has_the_forces(degree):
    """Its products with the basis functions are the forces along the direction."""
    _, problems = compared(degree, (0.6, -0.8), 0.0)
    problem = problems[1]
    density, forces = pressure_density(problem), problem.normal_forces
    space = density.function_space
    tags = np.full(len(problem.contact), 1, dtype=np.int32)
    tags = dolfinx.mesh.meshtags(space.mesh, 1, np.sort(problem.contact), tags)
    ds_contact = ufl.Measure("ds", space.mesh, subdomain_data=tags)
    products = fem.assemble_vector(fem.form(density * ufl.TestFunction(space) * ds_contact(1)))
    products.scatter_reverse(la.InsertMode.add)
    nodes = problem.contact_nodes
    assert np.abs(products.array[nodes] - forces.x.array[nodes]).max(initial=0.0) <= 1e-10
    total = problem.comm.allreduce(forces.x.array[nodes].sum())
    # The direction is the unit vector, and no friction acts.
    assert problem.force == pytest.approx(-total * np.array([0.6, -0.8]), rel=1e-9)
    assert total > 0.01
    for each in problems:
        each.destroy()
