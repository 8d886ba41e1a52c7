"""Contact with known results: a flat punch, slanted and curved sides, and a half-sphere by SNES."""

import dolfinx
import elastic_reference as reference
import gmsh
import hertz
import numpy as np
import punch
import pytest
import ufl
from dolfinx import fem
from elastic_cases import COMM, largest
from elastic_reference import gathered, nodes_of
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini import ContactProblem, elasticity
from dolfinx_signorini.base.compat import gmsh_mesh
from dolfinx_signorini.solvers.linear.options import options_set


def energy_error(u, exact):
    """The relative error in the energy norm, against a function of higher degree."""
    domain, degree = u.function_space.mesh, u.function_space.element.basix_element.degree
    size = domain.geometry.dim
    fine = fem.Function(fem.functionspace(domain, ("Lagrange", degree + 2, (size,))))
    fine.interpolate(exact)

    def norm(w):
        form = elasticity(w, w, young=hertz.E, poisson=hertz.NU)
        return np.sqrt(COMM.allreduce(fem.assemble_scalar(fem.form(form))))

    return norm(u - fine) / norm(fine)


def block(closed_form, n, degree, contact, gap, angle=0.0):
    """A block of 4 x 2, turned about the origin, with the closed form as data on other sides."""
    corners = [(-2.0, 0.0), (2.0, 2.0)]
    domain = dolfinx.mesh.create_rectangle(COMM, corners, (2 * n, n))
    below, others = (
        dolfinx.mesh.locate_entities_boundary(domain, 1, where)
        for where in (contact, lambda x: np.isclose(np.abs(x[0]), 2.0) | np.isclose(x[1], 2.0))
    )
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    domain.geometry.x[:, :2] = domain.geometry.x[:, :2] @ turn.T

    def back(x):
        return turn.T @ x[:2]

    space = fem.functionspace(domain, ("Lagrange", degree, (2,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    data = fem.Function(space)
    data.interpolate(lambda x: turn @ closed_form(back(x)))
    bc = fem.dirichletbc(data, fem.locate_dofs_topological(space, 1, others))
    problem = ContactProblem(
        elasticity(u, v, young=hertz.E, poisson=hertz.NU),
        ufl.inner(fem.Constant(domain, (0.0, 0.0)), v) * ufl.dx,
        contact=below,
        gap=(lambda x: gap(back(x))) if callable(gap) else gap,
        bcs=[bc],
    )
    problem.solve(rtol=1e-11)
    return problem, lambda x: turn @ closed_form(back(x)), turn


def test_the_closed_form_of_the_punch():
    x = np.stack([np.linspace(-0.499, 0.499, 101), np.zeros(101)])
    assert punch.displacement(x)[1] == pytest.approx(-punch.GAP, abs=1e-14)
    rng, step = np.random.default_rng(0), 1e-6
    inside = np.stack([rng.uniform(-1.0, 1.0, 50), rng.uniform(0.1, 1.0, 50)])
    shift = step * np.array([[1.0], [0.0]])
    along = (punch.displacement(inside + shift) - punch.displacement(inside - shift)) / (2.0 * step)
    found = punch.gradient(inside)
    assert found[[0, 2]] == pytest.approx(along, abs=1e-7 * np.abs(found).max())
    xx, xy, yx, yy = punch.gradient(x)
    normal = 2.0 * hertz.MU * yy + hertz.LAMBDA * (xx + yy)
    assert -normal == pytest.approx(punch.pressure(x), rel=1e-9)
    assert np.abs(xy + yx).max() <= 1e-12 * np.abs(yy).max()


def punch_errors(n, degree):
    """The relative errors of energy norm, force, and pressure in the middle of the punch."""
    problem, exact, _ = block(
        punch.displacement,
        n,
        degree,
        lambda x: np.isclose(x[1], 0.0) & (np.abs(x[0]) <= punch.A + 1e-9),
        punch.GAP,
    )
    force, x = problem.force, nodes_of(problem.space)
    middle = np.isclose(x[1], 0.0) & np.isclose(x[0], 0.0)
    peak = gathered(problem.pressure)[middle][0] / punch.pressure(np.zeros((2, 1)))[0] - 1.0
    error = energy_error(problem.u, exact)
    assert problem.result.active_dofs == round(degree * n * punch.A) + 1  # all of the punch
    assert abs(force[0]) <= 1e-9 * force[1]
    problem.destroy()
    return error, force[1] / punch.FORCE - 1.0, peak


@pytest.mark.parametrize("degree", [1, 2])
def test_a_flat_punch(degree):
    """The stress is like r^(-1/2): order 1/2 in energy for each degree, and 1 for the force."""
    found = [punch_errors(n, degree) for n in np.array([16, 32, 64]) // degree]
    energy, force, peak = np.abs(found).T
    assert np.log2(energy[:-1] / energy[1:]) == pytest.approx(0.5, abs=0.12), found
    assert (force <= energy).all() and force[-1] <= 0.6 * force[0]
    assert peak[-1] <= 0.02


@pytest.mark.parametrize("degree, least", [(1, 0.9), (2, 1.25)])
def test_a_slanted_side(degree, least):
    """Hertz's problem turned by 0.6: normals of a slanted side, the same orders."""
    errors = []
    for n in np.array([16, 64]) // degree:
        problem, exact, turn = block(
            hertz.displacement, n, degree, lambda x: np.isclose(x[1], 0.0), hertz.gap, 0.6
        )
        errors.append(energy_error(problem.u, exact))
        force = turn.T @ problem.force
        assert abs(force[0]) <= 1e-9 * force[1]
        assert abs(force[1] / hertz.FORCE - 1.0) <= errors[-1]
        problem.destroy()
    assert np.log2(errors[0] / errors[1]) / 2.0 >= least, errors


def curved(n):
    """A quarter of a ring 1 <= r <= 2 on a round obstacle inside, with an exact solution.

    On r = 1 the radial displacement is A and the pressure p, the shear is 0, and the gap is as
    large as G, where p G = 0: in polar coordinates u = (A + (r - 1) B, -(r - 1) A').
    """
    domain = dolfinx.mesh.create_rectangle(COMM, [(1.0, 0.0), (2.0, np.pi / 2.0)], (n, 2 * n))
    inner, others = (
        dolfinx.mesh.locate_entities_boundary(domain, 1, where)
        for where in (
            lambda x: np.isclose(x[0], 1.0),
            lambda x: np.isclose(x[0], 2.0) | np.isclose(x[1] * (x[1] - np.pi / 2.0), 0.0),
        )
    )
    r, about = domain.geometry.x[:, 0].copy(), domain.geometry.x[:, 1].copy()
    domain.geometry.x[:, 0], domain.geometry.x[:, 1] = r * np.cos(about), r * np.sin(about)
    space = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)

    def exact(x, xp):
        """The displacement, the pressure and G; of coordinates, or of their UFL expressions."""
        length = xp.sqrt(x[0] ** 2 + x[1] ** 2)
        c, s = x[0] / length, x[1] / length
        level, slope = 0.02 * c * s, 0.02 * (c * c - s * s)
        beyond = c - 0.75
        positive = (beyond + abs(beyond)) / 2.0
        pressure = 60.0 * positive**3
        out = -(pressure + hertz.LAMBDA * level) / (2.0 * hertz.MU + hertz.LAMBDA)
        radial, around = level + (length - 1.0) * out, -(length - 1.0) * slope
        moved = radial * c - around * s, radial * s + around * c
        return moved, pressure, (positive - beyond) ** 2, level

    x = ufl.SpatialCoordinate(domain)
    strain = ufl.sym(ufl.grad(ufl.as_vector(exact(x, ufl)[0])))
    stress = 2.0 * hertz.MU * strain + hertz.LAMBDA * ufl.tr(strain) * ufl.Identity(2)
    over = ufl.dx(metadata={"quadrature_degree": 4})
    data = fem.Function(space)
    data.interpolate(lambda x: np.stack(exact(x, np)[0]))
    bc = fem.dirichletbc(data, fem.locate_dofs_topological(space, 1, others))

    def gap(x):
        _, _, beyond, level = exact(x, np)
        return 0.1 * beyond - level

    problem = ContactProblem(
        elasticity(u, v, young=hertz.E, poisson=hertz.NU),
        -ufl.inner(ufl.div(stress), v) * over,
        contact=inner,
        gap=gap,
        bcs=[bc],
    )
    problem.solve(rtol=1e-10)
    return problem, exact


def test_a_curved_side():
    """Averaged normals of the chords: energy order 1, pressure, and the end of the contact."""
    errors = []
    for n in (8, 16, 32):
        problem, exact = curved(n)
        error = energy_error(problem.u, lambda x, of=exact: np.stack(of(x, np)[0]))
        x, gap, pressure = (
            nodes_of(problem.space),
            gathered(problem.gap),
            gathered(problem.pressure),
        )
        nodes = reference.gathered_numbers(problem.space, problem.contact_nodes)
        wanted = exact(x[:, nodes], np)[1]
        apart = np.sqrt(np.mean((pressure[nodes] - wanted) ** 2)) / wanted.max()
        errors.append((error, apart))
        end = x[0, nodes][gap[nodes] == 0.0].min()
        assert abs(np.arccos(end) - np.arccos(0.75)) <= 3.0 * np.pi / (4.0 * n)
        assert gap.min() >= 0.0 and pressure.min() >= 0.0
        assert not (pressure[nodes] * gap[nodes]).any()
        problem.destroy()
    errors = np.array(errors)
    assert (np.log2(errors[:-1] / errors[1:])[:, 0] >= 0.9).all(), errors
    assert errors[-1, 1] <= 0.5 * errors[0, 1] and errors[-1, 1] <= 0.05, errors


# A half-sphere of radius 1 on a plane, E = 2e4, nu = 0.3: against SNES on the same mesh.


STIFF = 2e4


def half_sphere(h):
    gmsh.initialize()
    gmsh.option.setNumber("General.Verbosity", 1)
    if COMM.rank == 0:
        occ = gmsh.model.occ
        ball, box = [(3, occ.addSphere(0, 0, 0, 1))], [(3, occ.addBox(-2, -2, 0, 4, 4, 4))]
        occ.cut(ball, box)
        occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", h)
        gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)], 1)
        gmsh.model.mesh.generate(3)
    domain = gmsh_mesh(gmsh.model, COMM, 3)[0]
    gmsh.finalize()
    return domain


def by_snes(a, data, held, bounded, least):
    """The displacement by vinewtonrsls with a factorization, assembled by DOLFINx."""
    A = dolfinx.fem.petsc.assemble_matrix(fem.form(a))
    A.assemble()
    held = np.unique(held[held < A.getLocalSize()[0]]).astype(np.int32)
    first = A.getOwnershipRange()[0]
    A.zeroRows(held + first, diag=STIFF)
    low, high, x, b = (A.createVecRight() for _ in range(4))
    low.set(PETSc.NINFINITY)
    high.set(PETSc.INFINITY)
    low.array_w[bounded] = least
    b.set(0.0)
    b.array_w[held] = STIFF * data[held]

    def residual(snes, x, f):
        A.mult(x, f)
        f.axpy(-1.0, b)

    snes = PETSc.SNES().create(COMM)
    snes.setType("vinewtonrsls")
    snes.setFunction(residual, b.duplicate())
    snes.setJacobian(lambda *_: None, A)
    snes.setVariableBounds(low, high)
    snes.setTolerances(rtol=0.0, stol=0.0, atol=1e-8, max_it=100)
    snes.getKSP().setType("preonly")
    snes.getKSP().getPC().setType("lu")
    snes.getKSP().getPC().setFactorSolverType("mumps")
    snes.setOptionsPrefix("half_sphere_")
    with options_set("half_sphere_", {"snes_linesearch_type": "basic"}):
        snes.setFromOptions()
    x.set(0.0)
    snes.solve(None, x)
    assert snes.getConvergedReason() > 0
    A.mult(x, b)
    found = x.array_r.copy(), b.array_r.copy()
    snes.destroy()
    return found


def test_a_half_sphere_on_a_plane_by_snes():
    domain = half_sphere(0.25)
    space = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    a, L = (
        elasticity(u, v, young=STIFF, poisson=0.3),
        ufl.inner(fem.Constant(domain, (0.0,) * 3), v) * ufl.dx,
    )
    flat, ball = (
        dolfinx.mesh.locate_entities_boundary(domain, 2, where)
        for where in (
            lambda x: np.isclose(x[2], 0.0),
            lambda x: np.isclose((x**2).sum(axis=0), 1.0, atol=1e-6),
        )
    )
    moved = fem.Constant(domain, (0.0, 0.0, 0.0))
    dofs = fem.locate_dofs_topological(space, 2, flat)
    options = {"gap": lambda x: x[2] + 1.0, "direction": (0.0, 0.0, -1.0)}
    options["bcs"] = [fem.dirichletbc(moved, dofs, space)]
    problem = ContactProblem(a, L, contact=ball, **options)
    owned = space.dofmap.index_map.size_local
    places = space.tabulate_dof_coordinates()[:owned]
    nodes = problem.contact_nodes
    radii = []
    for depth in (-0.1, -0.15, -0.2):
        moved.value = (0.0, 0.0, depth)
        problem.solve(rtol=1e-12)
        data = np.tile(moved.value, owned)
        held = (3 * dofs[:, None] + np.arange(3)).ravel()
        values, forces = by_snes(a, data, held, 3 * nodes + 2, -1.0 - places[nodes, 2])
        scale = COMM.allreduce(largest(values), op=MPI.MAX)
        assert largest(values - problem.u.x.array[: 3 * owned]) <= 1e-8 * scale
        force = COMM.allreduce(forces[3 * nodes + 2].sum())
        assert problem.force[2] == pytest.approx(force, rel=1e-8)
        touching = nodes[values[3 * nodes + 2] <= -1.0 - places[nodes, 2]]
        radius, own = (
            COMM.allreduce(largest(np.hypot(*places[at, :2].T)), op=MPI.MAX)
            for at in (touching, problem.active)
        )
        assert own == pytest.approx(radius, abs=1e-8) and own > 0.1
        radii.append(own)
    assert radii == sorted(radii)
    problem.destroy()
