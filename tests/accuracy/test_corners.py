"""Corners of the domain: their exponents, and what the loop promises of solutions with corners."""

import math
from pathlib import Path

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from known import Known, power, true_error
from mpi4py import MPI
from scipy.optimize import brentq
from ufl import conditional
from ufl.domain import extract_unique_domain

from dolfinx_signorini import (
    ContactProblem,
    ObstacleProblem,
    SidedMesh,
    SignoriniProblem,
    bernstein_space,
    elasticity,
    solve_adaptively,
    solve_scene,
)
from dolfinx_signorini.accuracy.corners import exponents_at_corners
from dolfinx_signorini.meshes.box_meshes import box_mesh
from dolfinx_signorini.meshes.sided_meshes import owned_cells
from dolfinx_signorini.scenes.files.reading import parse_scene

# The corners of a rhomboid of 135 degrees, below and above; those of 45 degrees have whole numbers.
BELOW, ABOVE = (0.0, 0.0), (0.0, 1.0)


def rhomboid(comm, dim):
    """Return a box that is sheared in its first two directions, and the facets with y = 0."""
    domain = box_mesh(comm, [np.linspace(0.0, 1.0, 4)] * dim)
    domain.geometry.x[:, 0] -= domain.geometry.x[:, 1]
    bottom = mesh.locate_entities_boundary(domain, dim - 1, lambda x: np.isclose(x[1], 0.0))
    domain.topology.create_connectivity(dim - 1, dim)
    return domain, bottom, mesh.exterior_facet_indices(domain.topology)


def problem_on(comm, dim, load, held, contact="bottom", diffusion=lambda x: 1.0):
    """Return a solved problem whose load presses it against the bottom, or lifts it.

    Where contact may be everywhere the solution is far from the obstacle away from the bottom.
    """
    domain, bottom, boundary = rhomboid(comm, dim)
    space = bernstein_space(domain, 2)
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    current = ufl.dot(ufl.as_matrix(np.eye(dim).tolist()) * diffusion(x), ufl.grad(u))
    a = (ufl.inner(current, ufl.grad(v)) + u * v) * ufl.dx
    L = load * v * ufl.dx
    bcs = []
    if held:
        rest = np.setdiff1d(boundary, bottom if contact == "bottom" else [])
        dofs = fem.locate_dofs_topological(space, dim - 1, rest.astype(np.int32))
        bcs = [fem.dirichletbc(fem.Function(space), dofs)]
    if contact == "domain":
        problem = ObstacleProblem(a, L, lower=-1.0, bcs=bcs)
    else:
        facets, obstacle = (bottom, 0.0) if contact == "bottom" else (boundary, -100.0 * x[1])
        problem = SignoriniProblem(a, L, contact=facets, obstacle=obstacle, bcs=bcs)
    problem.solve()
    return problem


def without_logarithms(exponents):
    """Return exponents with infinity in place of integers."""
    finite = np.where(np.isinf(exponents), 0.0, exponents)
    return np.where(np.abs(finite - np.round(finite)) > 1e-5, exponents, np.inf)


def check(problem, below, above):
    """Compare the exponents with those of the two edges of 135 degrees; None is for smooth ones."""
    domain = problem.space.mesh
    found, places = exponents_at_corners(problem)
    found = without_logarithms(found)
    x = domain.geometry.x[domain.geometry.dofmap[owned_cells(domain)]]
    expected = np.full(len(x), np.inf)
    for point, exponent in ((BELOW, below), (ABOVE, above)):
        at = np.count_nonzero(np.linalg.norm(x[:, :, :2] - point, axis=2) < 1e-9, axis=1)
        expected[at == domain.topology.dim - 1] = np.inf if exponent is None else exponent
        here = places[(at > 0) & (expected < np.inf)]  # of one corner: cells have no two
        where = np.array([*point, 0.0]) if domain.topology.dim == 2 else np.full(3, np.inf)
        assert (here == where).all()
    assert problem.comm.allreduce(int((expected < np.inf).sum())) > 0 or below is above is None
    assert found == pytest.approx(expected, rel=1e-9)
    problem.destroy()


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(
    ("load", "held", "contact", "below", "above"),
    [
        (-5.0, True, "bottom", 4 / 3, 4 / 3),  # in contact as with Dirichlet data
        (5.0, True, "bottom", 2 / 3, 4 / 3),  # away from the obstacle as with no flux
        (-5.0, False, "bottom", 2 / 3, 4 / 3),
        (5.0, False, "bottom", 4 / 3, 4 / 3),
        (-5.0, False, "everywhere", 4 / 3, 4 / 3),  # no change of condition
        (1.0, True, "domain", 4 / 3, 4 / 3),
    ],
)
def test_the_exponent_follows_from_angle_and_conditions(
    comm, dim, load, held, contact, below, above
):
    check(problem_on(comm, dim, load, held, contact), below, above)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_diffusion_turns_and_stretches_the_corner(comm, dim):
    """With K = S S^T the domain S^{-1} x is a box, whose solutions are smooth."""
    shear = np.eye(dim)
    shear[0, 1] = -1.0
    tensor = shear @ shear.T
    check(problem_on(comm, dim, -5.0, True, diffusion=lambda x: ufl.as_matrix(tensor)), None, None)
    smooth = problem_on(comm, dim, -5.0, True, diffusion=lambda x: 1.0 + 0.3 * x[1] ** 2)
    check(smooth, 4 / 3, 4 / 3)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_jump_that_ends_at_corners_changes_their_exponents(comm, dim):
    """The jump is along the line between the corners, at right angles to the sides."""

    def flux(ratio):  # below the jump the angle is a right one at the corner that is below

        def equation(a):
            low, high = 0.5 * math.pi * a, 0.25 * math.pi * a
            return ratio * np.tan(high) + np.tan(low)

        return equation

    jump = problem_on(comm, dim, -5.0, True, diffusion=lambda x: conditional(x[0] > 0.0, 5.0, 1.0))
    roots = [brentq(flux(ratio), 1.0 + 1e-9, 2.0 - 1e-9) for ratio in (5.0, 0.2)]
    check(jump, *roots)


@pytest.mark.parametrize(("load", "expected"), [(-5.0, 1.0), (5.0, None)])
def test_a_right_angle_between_a_side_in_contact_and_a_free_one(comm, load, expected):
    """Data with a slope make solutions like r log r; without any given value they are smooth."""
    domain = box_mesh(comm, [np.linspace(0.0, 1.0, 4)] * 2)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    problem = SignoriniProblem(a, load * v * ufl.dx, contact=bottom)
    problem.solve()
    found = exponents_at_corners(problem)[0]
    x = domain.geometry.x[domain.geometry.dofmap[owned_cells(domain)]]
    corner = (np.isclose(x[:, :, 1], 0.0) & np.isin(x[:, :, 0], (0.0, 1.0))).any(axis=1)
    assert found[corner] == pytest.approx(np.inf if expected is None else expected, abs=1e-5)
    assert (found[corner] != 1.0).all() and (found[~corner] == np.inf).all()
    problem.destroy()


def test_nothing_is_said_of_coefficients_that_are_not_readable(comm):
    def diffusion(x):
        return 1.0 + ufl.CellVolume(extract_unique_domain(x))

    check(problem_on(comm, 2, -5.0, True, diffusion=diffusion), None, None)


RATIO = 25.27414236908818  # Kellogg's example: u = r^(1/4) U(t) around the middle of the square


def chequered(comm, kind):
    """Return a solved problem on (-1, 1)^2 with a diffusion of two values in four squares."""
    domain = mesh.create_rectangle(comm, [(-1.0, -1.0), (1.0, 1.0)], (4, 4))
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    cells = np.arange(len(owned_cells(domain)) + domain.topology.index_map(2).num_ghosts)
    middles = mesh.compute_midpoints(domain, 2, cells.astype(np.int32))
    high = middles[:, 0] * middles[:, 1] > 0.0
    energy = ufl.inner(ufl.grad(u), ufl.grad(v))
    if kind == "a formula":
        a = conditional(x[0] * x[1] > 0.0, RATIO, 1.0) * energy * ufl.dx
    elif kind == "a function":
        values = fem.Function(fem.functionspace(domain, ("DG", 0)))
        values.x.array[:] = np.where(high, RATIO, 1.0)[: len(values.x.array)]
        # Another function, whose values in corners are not known, has no part in the diffusion.
        at_points = basix.ufl.quadrature_element(domain.basix_cell(), degree=2)
        reaction = fem.Function(fem.functionspace(domain, at_points))
        a = values * energy * ufl.dx + reaction * u * v * ufl.dx(metadata={"quadrature_degree": 2})
    else:
        tags = mesh.meshtags(domain, 2, cells.astype(np.int32), high.astype(np.int32))
        dx = ufl.Measure("dx", domain=domain, subdomain_data=tags)
        a = RATIO * energy * dx(1) + energy * dx(0)
    domain.topology.create_connectivity(1, 2)
    boundary = mesh.exterior_facet_indices(domain.topology)
    dofs = fem.locate_dofs_topological(space, 1, boundary)
    bcs = [fem.dirichletbc(fem.Function(space), dofs)]
    problem = ObstacleProblem(a, v * ufl.dx, lower=-1.0, bcs=bcs)
    problem.solve()
    return problem


@pytest.mark.parametrize("kind", ["a formula", "a function", "two measures"])
def test_jumps_that_cross_inside_of_the_domain(comm, kind):
    problem = chequered(comm, kind)
    x = problem.space.mesh.geometry.x[problem.space.mesh.geometry.dofmap]
    x = x[owned_cells(problem.space.mesh)]
    at = (np.linalg.norm(x, axis=2) < 1e-9).any(axis=1)
    found = without_logarithms(exponents_at_corners(problem)[0])
    assert found[at] == pytest.approx(0.25, abs=1e-6)
    # Where a jump ends at the boundary at a right angle, solutions are polynomials.
    assert (found[~at] == math.inf).all()
    problem.destroy()


@pytest.mark.parametrize("dim", [2, 3])
def test_the_exponents_of_a_body_depend_on_poissons_ratio(comm, dim):
    """A block that is clamped on one side has, at its ends, the exponents of Williams (1952)."""
    domain = box_mesh(comm, [np.linspace(0.0, 1.0, 4)] * dim)
    space = fem.functionspace(domain, ("Lagrange", 1, (dim,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    left, bottom = (
        mesh.locate_entities_boundary(domain, dim - 1, lambda x, k=k: np.isclose(x[k], 0.0))
        for k in (0, 1)
    )
    clamped = fem.dirichletbc(
        fem.Function(space), fem.locate_dofs_topological(space, dim - 1, left)
    )
    a = elasticity(u, v, young=3.0, poisson=0.3)
    load = fem.Constant(domain, np.eye(dim)[1])
    direction = -np.eye(dim)[1]
    problem = ContactProblem(
        a, ufl.inner(load, v) * ufl.dx, contact=bottom, gap=1.0, direction=direction, bcs=[clamped]
    )
    problem.solve()
    found = exponents_at_corners(problem)[0]
    x = domain.geometry.x[domain.geometry.dofmap[owned_cells(domain)]]
    ends = np.zeros(len(x), dtype=bool)
    for k in range(1, dim):
        for side in (0.0, 1.0):
            on_edge = np.isclose(x[:, :, 0], 0.0) & np.isclose(x[:, :, k], side)
            ends |= on_edge.sum(axis=1) == dim - 1
    assert found[ends] == pytest.approx(0.711173, abs=1e-6)
    assert (found[~ends] > 1.0).all()
    problem.destroy()


def wave_with_corner(factor, first, second, phase):
    """An L-shaped domain with a wave, and c r^{2/3} sin(2t/3) at the re-entrant corner.

    The wave has the larger errors on coarse meshes, and the corner the larger ones on finer meshes.
    """
    s = math.sqrt(0.5)
    text = f"""
[domain]
shape = "polygon"
vertices = [[0, 0], [1, 0], [1, 1], [-1, 1], [-1, -1], [0, -1]]
width = 0.5
[define]
t = "atan2({s!r}*(0 - x - y), {s!r}*(y - x)) + 0.75*pi"
wave = "sin({first!r}*x + {second!r}*y + {phase!r})"
w = "{factor!r}*hypot(x, y)^(2/3)*sin(2*t/3) + wave - 10*x"
[equation]
load = "{first**2 + second**2!r}*wave"
[contact]
sides = 4
obstacle = "w"
[[dirichlet]]
sides = [1, 2, 3, 5, 6]
value = "w"
"""

    def u(x, y):
        wave = np.sin(first * x + second * y + phase)
        return factor * power(x, y, 2.0 / 3.0, 0.0)[0] + wave - 10.0 * x

    def gradient(x, y):
        _, dx, dy = power(x, y, 2.0 / 3.0, 0.0)
        slope = np.cos(first * x + second * y + phase)
        return factor * dx + first * slope - 10.0, factor * dy + second * slope

    return Known(text, u, gradient, {})


@pytest.mark.parametrize(
    ("norm", "accuracy", "parameters"),
    [
        ("L2", 1.2e-5, (0.01587, -1.036784, 0.640535, 2.177837)),
        ("L2", 7.2e-5, (0.00534, 1.090582, -2.248063, 1.950155)),
        ("Linf", 6.8e-4, (0.02208, -2.066013, 1.469176, 3.435646)),
        ("W1_4", 7.7e-3, (0.02206, -3.257741, 3.518497, 3.898547)),
    ],
)
def test_the_claim_knows_a_corner_that_coarse_meshes_do_not_show(comm, norm, accuracy, parameters):
    known = wave_with_corner(*parameters)
    scene = parse_scene(known.text, Path("corner.toml"), comm)
    result = solve_scene(scene, comm, accuracy=accuracy, norm=norm)
    assert result.found.reached
    assert true_error(result.u, known, norm) <= result.found.estimate
    result.destroy()


def test_a_note_tells_that_the_strain_of_a_clamped_body_is_infinite(comm):
    """At the ends of the clamped side of a block, with Poisson's ratio 0.3."""
    domain = box_mesh(comm, [np.linspace(0.0, 1.0, 4)] * 2)
    left, bottom = (
        mesh.locate_entities_boundary(domain, 1, lambda x, k=k: np.isclose(x[k], 0.0))
        for k in (0, 1)
    )

    def pose(sided):
        space = fem.functionspace(sided.mesh, ("Lagrange", 2, (2,)))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        dofs = fem.locate_dofs_topological(space, 1, sided.sides["left"])
        clamped = fem.dirichletbc(fem.Function(space), dofs)
        a, load = elasticity(u, v, young=3.0, poisson=0.3), -0.1 * v[1] * ufl.dx
        keywords = {"contact": sided.sides["bottom"], "gap": 0.01, "direction": (0.0, -1.0)}
        return ContactProblem(a, load, bcs=[clamped], **keywords)

    sides = {"left": left, "bottom": bottom}
    wanted = {"norm": "W1_inf", "accuracy": 1e-6, "max_unknowns": 2000}
    found = solve_adaptively(pose, SidedMesh(domain, sides), **wanted)
    assert not found.reached
    assert any("infinite if u ~ r^0.711 at a corner" in note for note in found.notes)
    found.problem.destroy()


LOGARITHM = """
degree = 2
[domain]
shape = "square"
cells = 4
[define]
w = "{factor}*(x*atan2(y, x) + y*log(max(hypot(x, y), 1e-30))) - y"
[equation]
load = 0
[obstacle]
lower = -100
[[dirichlet]]
sides = ["bottom", "right", "top"]
value = "w"
[[neumann]]
sides = "left"
flux = "{factor}*0 - {factor}*pi/2"
"""


@pytest.mark.parametrize(("factor", "infinite"), [(1.0, True), (0.0, False)])
def test_data_that_meet_at_a_right_angle_make_a_logarithm(comm, factor, infinite):
    """Im(z log z) is 0 on the x-axis, and its flux is constant on the y-axis."""
    scene = parse_scene(LOGARITHM.format(factor=factor), Path("log.toml"), comm)
    found = solve_scene(scene, comm, accuracy=1e-2, norm="W1_inf").found
    assert found.reached != infinite
    assert ("infinite if u ~ r^1 log r at a corner" in found.stopped) == infinite
    found.problem.destroy()


def test_contact_in_the_domain_ends_at_a_free_side_without_a_singularity(comm):
    """u is a parabola below the obstacle, and depends on y alone."""
    domain = mesh.create_unit_square(comm, 16, 16)
    V = fem.functionspace(domain, ("Lagrange", 2))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    ends = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1] * (1 - x[1]), 0.0))
    problem = ObstacleProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        10.0 * v * ufl.dx,
        upper=0.5,
        bcs=[fem.dirichletbc(0.0, fem.locate_dofs_topological(V, 1, ends), V)],
    )
    problem.solve()
    assert comm.allreduce(len(problem.active)) > 0
    # At the corners of the square, between given and free sides, the exponent is 1.
    least = comm.allreduce(float(exponents_at_corners(problem)[0].min(initial=9.0)), op=MPI.MIN)
    assert least == pytest.approx(1.0, abs=1e-4)
    problem.destroy()


LAYER = """
degree = 2
[domain]
shape = "square"
cells = 8
[define]
layer = "exp({k}*(y - 1))"
u = "layer*(1 + {a}*sin({b}*x))"
[equation]
reaction = "{k}^2"
load = "{a}*{b}^2*layer*sin({b}*x)"
[contact]
sides = "bottom"
obstacle = "u"
bound = "upper"
[[dirichlet]]
sides = ["left", "top"]
value = "u"
[[neumann]]
sides = "right"
flux = "{a}*{b}*layer*cos({b}*x)"
"""


@pytest.mark.parametrize(("k", "a", "b"), [(20, 0.2, 3), (30, 0.2, 3), (30, 0.3, 2)])
def test_a_layer_that_is_not_resolved_is_no_logarithm(comm, k, a, b):
    text = LAYER.format(k=k, a=a, b=b)

    def u(x, y):
        return np.exp(k * (y - 1.0)) * (1.0 + a * np.sin(b * x))

    def gradient(x, y):
        return a * b * np.exp(k * (y - 1.0)) * np.cos(b * x), k * u(x, y)

    result = solve_scene(
        parse_scene(text, Path("layer.toml"), comm), comm, accuracy=0.01 * k, norm="W1_inf"
    )
    assert result.found.reached
    assert true_error(result.u, Known(text, u, gradient, ()), "W1_inf") <= 0.01 * k
    result.destroy()


def kellogg(exponent, ratio, angle):
    """u = r^a U(t) with a diffusion of two values in four quadrants, by Kellogg (1974)."""
    phases = [math.pi / 2 - angle, math.pi / 4, angle, math.pi / 4]
    amplitudes = [math.cos(phase * exponent) for phase in phases]
    middles = [math.pi / 4, math.pi - angle, 1.25 * math.pi, 1.5 * math.pi + angle]
    # The angle in each quadrant, by functions that do not jump there.
    angles = ["atan2(y, x)", "atan2(y, x)", "atan2(0-y, 0-x) + pi", "atan2(x, 0-y) + 1.5*pi"]
    parts = [
        f"{factor!r}*cos({exponent!r}*({name} - {middle!r}))"
        for factor, name, middle in zip(amplitudes, angles, middles, strict=True)
    ]
    text = f"""
[domain]
shape = "polygon"
vertices = [[-1, -1], [1, -1], [1, 1], [-1, 1]]
width = 0.5
[define]
above = "where(x > 0, {parts[0]}, {parts[1]})"
below = "where(x < 0, {parts[2]}, {parts[3]})"
w = "hypot(x, y)^{exponent!r}*where(y > 0, above, below)"
[equation]
diffusion = "where(x*y > 0, {ratio!r}, 1)"
load = 0
[obstacle]
lower = -100
[[dirichlet]]
sides = [1, 2, 3, 4]
value = "w"
"""

    def u(x, y):
        t = np.arctan2(y, x) % (2.0 * math.pi)
        k = np.minimum((2.0 * t / math.pi).astype(int), 3)
        waves = np.cos(exponent * (t - np.array(middles)[k]))
        return np.hypot(x, y) ** exponent * np.array(amplitudes)[k] * waves

    return Known(text, u, lambda x, y: (), {})


@pytest.mark.parametrize(
    ("exponent", "ratio", "angle", "norm", "accuracy"),
    [
        (0.5, 5.82842712474619, -2.356194490192345, "L2", 1e-4),
        (0.5, 5.82842712474619, -2.356194490192345, "Linf", 1e-3),
        (0.25, 25.27414236908818, -5.49778714378214, "L2", 1e-3),
        (0.25, 25.27414236908818, -5.49778714378214, "L4", 1e-2),
        (0.25, 25.27414236908818, -5.49778714378214, "Linf", 1e-2),
    ],
)
def test_materials_that_meet_at_a_point(comm, exponent, ratio, angle, norm, accuracy):
    known = kellogg(exponent, ratio, angle)
    scene = parse_scene(known.text, Path("materials.toml"), comm)
    result = solve_scene(scene, comm, accuracy=accuracy, norm=norm)
    assert result.found.reached
    assert true_error(result.u, known, norm) <= 1.05 * result.found.estimate
    result.destroy()


def on_a_re_entrant_corner(comm, exact, power=0, degree=2):
    """Pose a problem on a square of which a quarter is cut out.

    Contact on one side of the corner, no flux on the other, and Dirichlet data elsewhere.
    """
    left = mesh.DiagonalType.left
    domain = mesh.create_rectangle(comm, [[-1.0, -1.0], [1.0, 1.0]], [6, 6], diagonal=left)
    cells = mesh.locate_entities(domain, 2, lambda x: (x[0] <= 1e-9) | (x[1] >= -1e-9))
    domain = mesh.create_submesh(domain, 2, cells)[0]
    contact = mesh.locate_entities_boundary(
        domain, 1, lambda x: np.isclose(x[1], 0.0) & (x[0] > -1e-9)
    )
    free = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], 0.0) & (x[1] < 1e-9))
    domain.topology.create_connectivity(1, 2)
    every = mesh.exterior_facet_indices(domain.topology)
    rest = np.setdiff1d(every, np.concatenate([contact, free])).astype(np.int32)

    def pose(sided):
        space = fem.functionspace(sided.mesh, ("Lagrange", degree))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        data = fem.Function(space)
        data.interpolate(exact)
        dofs = fem.locate_dofs_topological(space, 1, sided.sides["rest"])
        y = ufl.SpatialCoordinate(sided.mesh)[1]
        return SignoriniProblem(
            ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
            fem.Constant(sided.mesh, 1.0 * power * (power - 1))
            * y ** max(power - 2, 0)
            * v
            * ufl.dx,
            contact=sided.sides["contact"],
            bcs=[fem.dirichletbc(data, dofs)],
        )

    return pose, SidedMesh(domain, {"contact": contact, "rest": rest})


def singular(x):
    """-r^(1/3) sin(t/3): 0 on the x-axis, where the obstacle pushes, and no flux on the y-axis."""
    angle = 0.75 * np.pi + np.angle(np.exp(-0.75j * np.pi) * (x[0] + 1j * x[1]))
    return -(np.hypot(x[0], x[1]) ** (1 / 3)) * np.sin(angle / 3)


@pytest.mark.parametrize("norm", ["W1_4", "H1_2_boundary"])
def test_a_norm_that_is_infinite_is_not_reached(comm, norm):
    pose, sided = on_a_re_entrant_corner(comm, singular)
    found = solve_adaptively(pose, sided, norm=norm, accuracy=1e-2)
    assert not found.reached and norm in found.stopped and "infinite" in found.stopped
    assert any("r^0.333" in note for note in found.notes)
    found.problem.destroy()


@pytest.mark.parametrize(("power", "accuracy"), [(2, 1e-2), (3, 1e-2)])
def test_a_smooth_solution_has_no_singular_corner(comm, power, accuracy):
    """At the same corner -y - y^2, which elements of degree 2 have, or y^3: the doubt is a note."""
    pose, sided = on_a_re_entrant_corner(comm, lambda x: -x[1] - x[1] ** power, power)
    found = solve_adaptively(pose, sided, norm="W1_4", accuracy=accuracy)
    assert found.reached and any("r^0.333" in note for note in found.notes)
    found.problem.destroy()


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("norm", ["L1", "L2", "L16", "H1", "Linf"])
def test_the_first_estimate_at_a_corner_is_no_less_than_the_error(comm, norm, degree):
    """No cell has been divided yet: the derivatives tell how much order is lost."""

    def gradient(x, y):
        """Of the imaginary part of -z^(1/3), with the angles of `singular`."""
        turn = 0.75 * np.pi
        z = np.exp(-1j * turn) * (x + 1j * y)
        power = np.hypot(x, y) ** (-2 / 3) * np.exp(-2j / 3 * (turn + np.angle(z)))
        return -power.imag / 3.0, -power.real / 3.0

    known = Known("", lambda x, y: singular((x, y)), gradient, {})
    pose, sided = on_a_re_entrant_corner(comm, singular, degree=degree)
    found = solve_adaptively(pose, sided, norm=norm, accuracy=10.0)
    assert found.reached and len(found.steps) == 1
    assert 0.0 < true_error(found.problem.u, known, norm) <= found.estimate
    found.problem.destroy()
