"""Curved sides: vertices that follow them, what facets leave in the error, and what is said."""

import logging
import math
from dataclasses import replace
from types import SimpleNamespace

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy.integrate import dblquad

from dolfinx_signorini import (
    SignoriniProblem,
    box_mesh,
    error_norms,
    gmsh_mesh,
    gmsh_projection,
    solve_adaptively,
)
from dolfinx_signorini.accuracy.adaptive import found_lines
from dolfinx_signorini.accuracy.cells import volumes
from dolfinx_signorini.accuracy.marking import Marks
from dolfinx_signorini.accuracy.moved_sides import MovedSides
from dolfinx_signorini.accuracy.targets import target
from dolfinx_signorini.accuracy.terms import Solution, Solved
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.meshes.curved_sides import CurvedSides, TurnedOverError, arcs
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import (
    SidedMesh,
    boundary_facets,
    facet_cells,
    facet_nodes,
    owned_cells,
)
from dolfinx_signorini.norms.power_sums import total
from dolfinx_signorini.norms.references import Reference
from dolfinx_signorini.scenes import load_scene, solve_scene
from dolfinx_signorini.scenes.domains.mesh_files import MeshFile

RADIUS = 0.3


def plate(comm, around=16, layers=4):
    """A square of side 2 with a round hole of 16 facets, by rays from the hole to the square."""
    angles = 2.0 * math.pi * np.arange(around) / around
    circle = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    square = circle / np.abs(circle).max(axis=1, keepdims=True)
    shares = np.linspace(0.0, 1.0, layers + 1)[:, None, None]
    x = ((1.0 - shares) * RADIUS * circle + shares * square).reshape(-1, 2)
    a, b = (np.arange(layers * around).reshape(layers, around) + k * around for k in range(2))
    c, d = (np.roll(line, -1, axis=1) for line in (a, b))
    cells = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (b, d, c))])
    if comm.rank:
        x, cells = x[:0], cells[:0]
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    domain = mesh.create_mesh(comm, cells.astype(np.int64), x=x, e=element)
    facets = boundary_facets(domain)
    y = domain.geometry.x[facet_nodes(domain, facets)]
    hole = np.hypot(y[..., 0], y[..., 1]).max(axis=1, initial=0.0) < 0.8
    bottom = (y[..., 1] < -1.0 + 1e-9).all(axis=1)
    on = {"hole": hole, "bottom": bottom, "rest": ~hole & ~bottom}
    return SidedMesh(domain, {name: facets[part] for name, part in on.items()})


def onto_hole(x):
    return RADIUS * x / np.hypot(x[0], x[1])


def known(x):
    """The solution -log(r/R), which is harmonic, and 0 on the hole."""
    return -np.log(np.hypot(x[0], x[1]) / RADIUS)


def integral():
    """The integral of the solution over the plate, by quadrature over the square."""
    square = 4.0 * dblquad(lambda y, x: known((x, y)), 0, 1, 0, 1, epsabs=1e-10)[0]
    disc = 0.5 * math.pi * RADIUS**2  # of -log(r/R): 2 pi R^2 times the integral of -t log t
    return square - disc


def poser(kind, degree=2):
    """Pose the problem of the known solution, with contact at the hole or at the bottom.

    At the hole the pressure is 1/R. At the bottom the obstacle is far below, and the flux is 0 but
    for the load on that side; the flux through the hole is given, or the value there.
    """

    def pose(sided):
        domain = sided.mesh
        space = fem.functionspace(domain, ("Lagrange", degree))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        x = ufl.SpatialCoordinate(domain)
        data = fem.Function(space)
        data.interpolate(known)
        pairs = [
            (k, facet_cells(domain, sided.sides[s]).ravel())
            for k, s in ((1, "hole"), (2, "bottom"))
        ]
        on = ufl.ds(domain=domain, subdomain_data=pairs, metadata={"quadrature_degree": 10})
        outer = ("rest",) if kind == "flux" else ("rest", "bottom")
        values = fem.locate_dofs_topological(space, 1, sided.facets(outer))
        L = fem.Constant(domain, 0.0) * v * ufl.dx
        if kind == "flux":  # of -log r: 1/R out of the hole, and y/r^2 at the bottom, where y = -1
            L += v / RADIUS * on(1) + x[1] / (x[0] ** 2 + x[1] ** 2) * v * on(2)
        return SignoriniProblem(
            ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
            L,
            contact=sided.sides["bottom" if kind == "flux" else "hole"],
            obstacle=-9.0 if kind == "flux" else 0.0,
            bcs=[fem.dirichletbc(data, values)],
        )

    return pose


def mean(u):
    return u * ufl.dx


def true_error(found, norm):
    domain = found.sided.mesh
    if norm is mean:
        value = fem.assemble_scalar(fem.form(mean(found.problem.u)))
        return abs(domain.comm.allreduce(value) - integral())
    x = ufl.SpatialCoordinate(domain)
    u = -ufl.ln(ufl.sqrt(x[0] ** 2 + x[1] ** 2) / RADIUS)
    slopes = ufl.grad(u)
    exact = Reference(domain, u, (slopes[0], slopes[1]))
    return error_norms(found.problem.u, exact, [norm])[norm]


MEASURES = [(mean, 1e-4), ("L2", 1e-4), ("Linf", 3e-4), ("H1", 1e-2), ("W1_4", 3e-2)]
# With values given all over the boundary, no mesh improves the data on the outer sides.
CASES = [(kind, *asked) for kind in ("contact", "flux") for asked in MEASURES]
CASES.append(("flux", "L2_boundary", 3e-4))


@pytest.mark.parametrize(("kind", "norm", "accuracy"), CASES)
def test_the_accuracy_is_met_on_a_plate_with_a_round_hole(comm, kind, norm, accuracy):
    geometry = {"hole": onto_hole}
    found = solve_adaptively(
        poser(kind), plate(comm), norm=norm, accuracy=accuracy, geometry=geometry
    )
    error = true_error(found, norm)
    assert found.reached and error <= found.estimate <= accuracy
    assert found.stopped == "the accuracy is reached" and not found.polygonal
    if kind == "contact":
        assert found.estimate < 8.0 * error
    assert distance(found.sided) < 1e-12
    found.problem.destroy()


def distance(sided):
    """How far the vertices of the hole are from the circle."""
    y = sided.mesh.geometry.x[facet_nodes(sided.mesh, sided.sides["hole"])]
    away = np.abs(np.hypot(y[..., 0], y[..., 1]) - RADIUS).max(initial=0.0)
    return sided.mesh.comm.allreduce(away, op=MPI.MAX)


NORMS = [mean, "L1", "L2", "Linf", "H1", "W1_4", "W1_inf"]


def test_what_facets_leave_is_the_error_of_a_polygon(comm):
    """On a fine mesh with degree 4, the facets of the hole leave all of the error."""
    sided = plate(comm)
    curves = CurvedSides({"hole": onto_hole})
    sided = refined(sided).sided
    curves.fit(sided)
    ratios = {}
    for norm in NORMS:
        division = refined(sided)
        problem = poser("contact", degree=4)(division.sided)
        moved = MovedSides(curves, sided, division, problem.solve(rtol=1e-10), target(norm))
        assert moved
        problem.destroy()
        problem = poser("contact", degree=4)(division.sided)
        problem.solve(rtol=1e-10)
        nothing = fem.Function(fem.functionspace(sided.mesh, ("Lagrange", 1)))
        coarse = Solution(nothing, nothing)
        parts = moved.parts(Solved(coarse, problem, division.parents, target(norm)))
        found = SimpleNamespace(problem=problem, sided=division.sided)
        ratios[norm] = total(parts, target(norm).power, comm) / true_error(found, norm)
        problem.destroy()
    assert all(0.95 < ratio < 1.6 for ratio in ratios.values()), ratios


def test_a_polygon_without_a_geometry_is_said_to_be_the_domain(comm, caplog):
    sided = plate(comm)
    with caplog.at_level(logging.WARNING, "dolfinx_signorini"):
        found = solve_adaptively(poser("contact"), sided, norm=mean, accuracy=1e-3)
    assert found.reached and true_error(found, mean) > 5.0 * found.estimate
    assert found.stopped == "the accuracy is reached; the polygon is taken as the domain"
    assert found.polygonal == pytest.approx(
        {"hole": RADIUS * (1.0 - math.cos(math.pi / 16))}, rel=0.02
    )
    if comm.rank == 0:
        assert "'hole': the polygon is taken as the domain" in caplog.text
    several = replace(found, polygonal={**found.polygonal, "rim": 0.25})
    assert all(part in dict(found_lines(several))["domain"] for part in ("hole", "rim 2e-01"))
    found.problem.destroy()
    meant = solve_adaptively(
        poser("contact"), sided, norm=mean, accuracy=1e-2, geometry={"hole": None}
    )
    assert meant.stopped == "the accuracy is reached" and not meant.polygonal
    meant.problem.destroy()


@pytest.mark.parametrize("whole", [2, 3, 4])
def test_a_loop_whose_curves_turn_cells_over_keeps_what_it_has(comm, monkeypatch, whole):
    fit, calls = CurvedSides.fit, []

    def failing(self, sided):
        calls.append(sided)
        if len(calls) > whole:
            raise TurnedOverError
        return fit(self, sided)

    monkeypatch.setattr(CurvedSides, "fit", failing)
    found = solve_adaptively(
        poser("contact"), plate(comm), norm=mean, accuracy=1e-6, geometry={"hole": onto_hole}
    )
    assert not found.reached and found.stopped.startswith("geometry moves vertices so far")
    assert len(found.steps) > 1 and found.estimate == min(step.estimate for step in found.steps)
    assert found.problem.space.mesh is found.sided.mesh
    assert true_error(found, mean) <= found.estimate
    found.problem.destroy()


def test_a_mesh_whose_cells_would_turn_over_stays_as_it_was(comm):
    sided = plate(comm)
    before = sided.mesh.geometry.x.copy()
    with pytest.raises(TurnedOverError):
        CurvedSides({"hole": lambda x: 20.0 * x}).fit(sided)
    assert (sided.mesh.geometry.x == before).all()


@pytest.mark.parametrize("deep", [1, 6])
def test_divisions_follow_the_circle_and_keep_cells_upright(comm, deep):
    sided = plate(comm)
    curves, count = CurvedSides({"hole": onto_hole}), len(owned_cells(sided.mesh))
    at_hole = np.zeros(count)
    at_hole[facet_cells(sided.mesh, sided.sides["hole"])[:, 0]] = deep
    marks = Marks(at_hole, np.full((count, 3), np.inf))
    divided = marks.apply(sided, curves.fit)
    assert distance(divided.sided) < 1e-12
    assert comm.allreduce(divided.levels.max(initial=0.0), op=MPI.MAX) >= deep
    domain = divided.sided.mesh
    area = comm.allreduce(0.5 * float(volumes(domain).sum()))
    facets = 16 * 2**deep
    inside = 0.5 * facets * RADIUS**2 * math.sin(2.0 * math.pi / facets)
    assert area == pytest.approx(4.0 - inside, abs=1e-12)


@pytest.mark.parametrize("count", [5, 8, 40])
@pytest.mark.parametrize("rounds", [0, 1, 3])
def test_arcs_are_told_from_polygons(comm, count, rounds):
    """Where edges have several facets from the first mesh on, a polygon is meant."""
    away = pytest.approx({"all": 1.0 - math.cos(math.pi / count)}, rel=0.1)
    curve, meant = polygon(comm, count), polygon(comm, count, facets=2)
    for k in range(rounds):
        cells = None if k == 0 else np.arange(k, dtype=np.int32)  # everywhere, and then in places
        curve, meant = (refined(sided, cells).sided for sided in (curve, meant))
    assert arcs(curve) == away and not arcs(meant)
    assert not arcs(curve, frozenset({"all"}))


@pytest.mark.parametrize("count", [4, 8, 24])
@pytest.mark.parametrize("rounds", [0, 1])
def test_arcs_inside_of_the_domain_are_told(comm, count, rounds):
    """A polygon of cells with a name in a square: an arc from five edges on."""
    angles = 2.0 * math.pi * np.arange(count) / count
    inner = 0.4 * np.stack((np.cos(angles), np.sin(angles)), axis=1)
    outer = inner / np.abs(inner).max(axis=1)[:, None]
    k, x = np.arange(count), np.vstack((np.zeros(2), inner, outer))
    a, b = k + 1, (k + 1) % count + 1
    rings = ((0 * k, a, b), (a, b, a + count), (b, a + count, b + count))
    cells = np.concatenate([np.stack(each, axis=1) for each in rings])
    if comm.rank:
        x, cells = x[:0], cells[:0]
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    domain = mesh.create_mesh(comm, cells.astype(np.int64), x=x, e=element)
    middles = mesh.compute_midpoints(domain, 2, owned_cells(domain))
    apart = np.linalg.norm(middles, axis=1) < 0.4 * math.cos(math.pi / count)
    sided = SidedMesh(domain, {}, {"core": np.flatnonzero(apart).astype(np.int32)})
    assert comm.allreduce(int(apart.sum())) == count
    for _ in range(rounds):
        sided = refined(sided).sided
    away = 0.4 * (1.0 - math.cos(math.pi / count))
    found = arcs(sided, frozenset({"all"}))
    assert found == ({} if count == 4 else {"edge of core": pytest.approx(away, rel=0.1)})


def polygon(comm, count, facets=1):
    """A regular polygon in the unit circle, whose edges have so many facets."""
    angles = 2.0 * math.pi * np.arange(count + 1) / count
    corners = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    shares = np.arange(facets)[:, None, None] / facets
    points = (1.0 - shares) * corners[:-1] + shares * corners[1:]
    return fan(comm, np.swapaxes(points, 0, 1).reshape(-1, 2))


def fan(comm, corners):
    """A polygon around the origin, in triangles with a vertex there."""
    count, x = len(corners), np.vstack((np.zeros(2), corners))
    k = np.arange(count)
    cells = np.stack((0 * k, k + 1, (k + 1) % count + 1), axis=1)
    if comm.rank:
        x, cells = x[:0], cells[:0]
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    return SidedMesh(mesh.create_mesh(comm, cells.astype(np.int64), x=x, e=element), {})


def test_squares_and_cubes_bend_at_their_corners_alone(comm):
    square = polygon(comm, 4)
    side = np.array([[1.0, -0.9], [1.0, 0.0], [1.0, 0.9]])
    turns = [np.linalg.matrix_power(np.array([[0, 1], [-1, 0]]), k) for k in range(4)]
    assert not arcs(fan(comm, np.concatenate([side @ turn for turn in turns])))  # corners cut off
    cube = SidedMesh(box_mesh(comm, [np.linspace(0.0, 1.0, n + 1) for n in (1, 2, 3)]), {})
    assert not arcs(square) and not arcs(cube)


def fails(x):
    raise KeyError("nothing there")


@pytest.mark.parametrize(
    ("geometry", "message"),
    [
        ({"hole": fails}, "nothing there"),
        ({"hole": lambda x: x[:2]}, "shape"),
        ({"hole": lambda x: x / 0.0}, "not finite"),
        ({"hole": "circle"}, "function"),
        ({"roof": onto_hole}, "the mesh has the sides hole, bottom, rest, all"),
        # A curve that all vertices are on, but no middle of a facet.
        (
            {"hole": lambda x: onto_hole(x) * (1.0 + 0.05 * np.sin(16.0 * np.arctan2(x[1], x[0])))},
            "too roughly",
        ),
    ],
)
def test_a_geometry_that_makes_no_sense_is_refused_before_any_solve(comm, geometry, message):
    def pose(sided):
        raise AssertionError("the problem was posed")

    with np.errstate(all="ignore"), pytest.raises(InputError, match=f"geometry: .*{message}"):
        solve_adaptively(pose, plate(comm), accuracy=1.0, geometry=geometry)


def test_vertices_that_would_turn_cells_over_are_refused(comm):
    curves = CurvedSides({"hole": lambda x: 3.0 * onto_hole(x)})
    with pytest.raises(InputError, match=r"geometry: .*turn over"):
        curves.fit(plate(comm))


def gmsh_ball(comm, gmsh, size):
    """A ball, with its model: the sphere is the physical group 1."""
    if comm.rank == 0:
        gmsh.initialize(readConfigFiles=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.addSphere(0, 0, 0, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(2, [tag for _, tag in gmsh.model.getEntities(2)], 1, "skin")
        gmsh.model.addPhysicalGroup(3, [1], 1)
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        gmsh.option.setNumber("Mesh.MeshSizeMin", size)
        gmsh.model.mesh.generate(3)
    domain, tags = gmsh_mesh(gmsh.model, comm, 3)
    return SidedMesh(domain, {"skin": tags.find(1)})


def test_a_ball_follows_the_model_of_gmsh(comm):
    """-div grad u = -6 with u = 0 in contact all over the sphere: u = r^2 - 1."""
    gmsh = pytest.importorskip("gmsh")
    sided = gmsh_ball(comm, gmsh, 0.7)

    def pose(sided):
        space = fem.functionspace(sided.mesh, ("Lagrange", 2))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        a, L = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, -6.0 * v * ufl.dx
        return SignoriniProblem(a, L, contact=sided.sides["skin"])

    try:
        assert list(arcs(sided)) == ["skin"]
        geometry = {"skin": gmsh_projection(gmsh.model, 2, 1)}
        found = solve_adaptively(pose, sided, norm=mean, accuracy=0.1, geometry=geometry)
    finally:
        if comm.rank == 0:
            gmsh.finalize()
    value = comm.allreduce(fem.assemble_scalar(fem.form(mean(found.problem.u))))
    error = abs(value + 4.0 * math.pi * (1.0 / 3.0 - 1.0 / 5.0))
    assert found.reached and error <= found.estimate <= 0.1
    found.problem.destroy()


SCENE = """
accuracy = 1e-3
[domain]
shape = "file"
file = "plate.msh"
{curves}
[contact]
sides = "hole"
obstacle = 0
[[dirichlet]]
sides = "rest"
value = "-log(hypot(x, y)/0.3)"
[solution]
u = "-log(hypot(x, y)/0.3)"
norms = ["L2"]
"""


def plate_file(comm, gmsh, path):
    if comm.rank == 0:
        gmsh.initialize(readConfigFiles=False)
        gmsh.option.setNumber("General.Terminal", 0)
        occ = gmsh.model.occ
        square, disc = occ.addRectangle(-1, -1, 0, 2, 2), occ.addDisk(0, 0, 0, RADIUS, RADIUS)
        occ.cut([(2, square)], [(2, disc)])
        occ.synchronize()
        lines = {tag: gmsh.model.getType(1, tag) for _, tag in gmsh.model.getEntities(1)}
        for k, name in enumerate(("hole", "rest"), 1):
            tags = [tag for tag, kind in lines.items() if (kind == "Line") == (name == "rest")]
            gmsh.model.addPhysicalGroup(1, tags, k, name)
        gmsh.model.addPhysicalGroup(2, [s for _, s in gmsh.model.getEntities(2)], 1)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.2)
        gmsh.model.mesh.generate(2)
        gmsh.write(str(path))
        gmsh.finalize()
    comm.barrier()


def test_a_scene_tells_the_curve_of_a_side(comm, folder):
    plate_file(comm, pytest.importorskip("gmsh"), folder / "plate.msh")
    curve = '[domain.curves]\nhole = "x^2 + y^2 - 0.09"'
    for name, text in (("curved", curve), ("plain", ""), ("wrong", curve.replace("hole", "whole"))):
        if comm.rank == 0:
            (folder / f"{name}.toml").write_text(SCENE.format(curves=text))
    comm.barrier()
    results = {}
    for name in ("curved", "plain"):
        result = solve_scene(load_scene(folder / f"{name}.toml", comm))
        results[name] = true_error(result.found, "L2"), result.found
        result.destroy()
    error, found = results["curved"]
    assert found.reached and error <= found.estimate <= 1e-3 and not found.polygonal
    error, found = results["plain"]
    assert error > 5.0 * found.estimate and list(found.polygonal) == ["hole"]
    with pytest.raises(InputError, match=r"domain\.curves\.whole: unknown side.*hole"):
        load_scene(folder / "wrong.toml", comm)


def test_refinements_of_a_mesh_file_follow_its_curves(comm, folder):
    plate_file(comm, pytest.importorskip("gmsh"), folder / "plate.msh")
    text = SCENE.replace("accuracy = 1e-3", "").format(
        curves='refinements = 3\n[domain.curves]\nhole = "hypot(x, y) - 0.3"'
    )
    if comm.rank == 0:
        (folder / "fine.toml").write_text(text)
    comm.barrier()
    domain = load_scene(folder / "fine.toml", comm).domain
    assert isinstance(domain, MeshFile)
    for level in domain.levels():
        sided = level.make(comm)
        if level.refinements:
            assert distance(sided) < 1e-12
    area = comm.allreduce(0.5 * float(volumes(sided.mesh).sum()))
    assert area == pytest.approx(4.0 - math.pi * RADIUS**2, abs=1e-3)
