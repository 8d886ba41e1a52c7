"""Scenes with obstacles in the domain: exact solutions, KKT conditions, regions, and refusals."""

import csv
import io
import json

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx.io import XDMFFile
from matplotlib.image import imread
from mpi4py import MPI

from dolfinx_signorini import InputError, ObstacleProblem, box_mesh
from dolfinx_signorini.commands.main import main
from dolfinx_signorini.meshes.balance import balanced
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, owned_cells
from dolfinx_signorini.problem.dirichlet import dirichlet
from dolfinx_signorini.scenes import load_scene, solve_scene
from dolfinx_signorini.scenes.bounds import bound_of_scene
from dolfinx_signorini.scenes.domains.mesh_files import MeshFile
from dolfinx_signorini.scenes.expectations import expect
from dolfinx_signorini.scenes.output.fields import fields_of
from dolfinx_signorini.scenes.output.pictures import draw_scene, scene_boundaries
from dolfinx_signorini.scenes.output.summary import summarise
from dolfinx_signorini.studies.tradeoff.family import Kind, scene_family
from dolfinx_signorini.studies.tradeoff.runs import Configuration, Run

COMM = MPI.COMM_WORLD
# The membrane over the hemisphere: PETSc's snes ex9; Bueler, PETSc for Partial Differential
# Equations, Chapter 12. The square (-2, 2)^2 is blown down to the unit square, where the same
# function of X and Y is harmonic.
RADIUS, HEIGHT = 0.697965148223372, 0.680259411891713
BALL = """
rtol = 1e-10
[domain]
shape = "square"
cells = 8
[define]
r = "4*hypot(x - 0.5, y - 0.5)"
ball = "where(r < 0.9, sqrt(max(1 - r^2, 0)), sqrt(0.19) - 0.9/sqrt(0.19)*(r - 0.9))"
outside = "0.680259411891713*log(2/max(r, 0.5))"
[obstacle]
lower = "ball"
[[dirichlet]]
sides = "all"
value = "outside"
[solution]
u = "where(r < 0.697965148223372, sqrt(max(1 - r^2, 0.1)), outside)"
"""
# The load presses down on the left and up on the right.
BETWEEN = """
rtol = 1e-10
[domain]
shape = "square"
cells = 24
[equation]
load = "300*(x - 0.5)"
[obstacle]
lower = "-0.2 - 0.1*y"
upper = "0.15 + 0.2*(y - 0.5)^2"
[[dirichlet]]
sides = ["left", "right", "bottom"]
value = 0
[[neumann]]
sides = "top"
flux = 2
"""
HALVES = """
[domain]
shape = "file"
file = "halves.msh"
refinements = {refinements}
[equation]
load = -8
[obstacle]
lower = -0.1
cells = {cells}
[[dirichlet]]
sides = "rim"
value = 0
"""


def hemisphere(x):
    r = np.hypot(x[0], x[1])
    h = np.sqrt(1.0 - 0.81)
    return np.where(r < 0.9, np.sqrt(np.maximum(1.0 - r * r, 0.0)), h - 0.9 / h * (r - 0.9))


def over_hemisphere(x):
    r = np.hypot(x[0], x[1])
    near = np.sqrt(np.maximum(1.0 - r * r, 0.0))
    return np.where(r < RADIUS, near, HEIGHT * np.log(2.0 / np.maximum(r, 0.1)))


def membrane(domain, load, data, **obstacles):
    """-Laplace u = load in Python, with Dirichlet data on all of the boundary."""
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    return ObstacleProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        fem.Constant(domain, load) * v * ufl.dx,
        bcs=[dirichlet(space, boundary_facets(domain), data)],
        **obstacles,
    )


def by_place(u):
    """The values at all vertices in the order of their coordinates, on all ranks."""
    count = u.function_space.dofmap.index_map.size_local
    x = u.function_space.tabulate_dof_coordinates()[:count, :2]
    rows = np.concatenate(COMM.allgather(np.column_stack((x, u.x.array[:count]))))
    return rows[np.lexsort(np.round(rows[:, :2], 9).T)]


def write(folder, text):
    if COMM.rank == 0:
        (folder / "scene.toml").write_text(text)
    COMM.barrier()
    return str(folder / "scene.toml")


def write_halves(folder, n=8, ends=False):
    """The unit square in n x n squares, each cut in two; cells left of x = 1/2 have the tag 5.

    The rim is all of the boundary, or the ends at the left and at the right.
    """
    x = np.array([(i, j) for j in range(n + 1) for i in range(n + 1)], dtype=float) / n
    low = np.array([i + (n + 1) * j for j in range(n) for i in range(n)])[:, None]
    cells = np.concatenate((low + np.array([0, 1, n + 2]), low + np.array([0, n + 2, n + 1])))
    tags = np.where(x[cells].mean(axis=1)[:, 0] < 0.5, 5, 7)
    side, across = np.arange(n), n * (n + 1)
    starts = np.concatenate((side, side + across, side * (n + 1), side * (n + 1) + n))
    edges = np.column_stack((starts, starts + np.repeat((1, n + 1), 2 * n)))[2 * n * ends :]
    elements = [(1, 1, ends) for ends in edges] + [(2, *c) for c in zip(tags, cells, strict=True)]
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", "3"]
    lines += ['1 1 "rim"', '2 5 "left"', '2 7 "right"', "$EndPhysicalNames", "$Nodes", str(len(x))]
    lines += [f"{k} {a!r} {b!r} 0" for k, (a, b) in enumerate(x.tolist(), 1)]
    lines += ["$EndNodes", "$Elements", str(len(elements))]
    for k, (kind, tag, nodes) in enumerate(elements, 1):
        lines.append(f"{k} {kind} 2 {tag} {tag} " + " ".join(str(m + 1) for m in nodes))
    if COMM.rank == 0:
        (folder / "halves.msh").write_text("\n".join([*lines, "$EndElements", ""]))
    COMM.barrier()


def area(domain, cells):
    """The area of owned cells on all ranks."""
    x = domain.geometry.x[domain.geometry.dofmap[cells]][:, :, :2]
    (a, b), (c, d) = (x[:, 1] - x[:, 0]).T, (x[:, 2] - x[:, 0]).T
    return COMM.allreduce(0.5 * float(np.abs(a * d - b * c).sum()))


@pytest.mark.parametrize(
    ("n", "mean", "largest", "active"), [(8, 3.076e-3, 1.334e-2, 9), (16, 2.707e-3, 1.428e-2, 29)]
)
def test_the_ball_has_the_figures_of_the_five_point_scheme(parse, n, mean, largest, active):
    result = solve_scene(parse(BALL.replace("cells = 8", f"cells = {n}")), COMM)
    assert result.solve.active_dofs == active
    x, y, u = by_place(result.u).T
    errors = np.abs(u - over_hemisphere((4.0 * x - 2.0, 4.0 * y - 2.0)))
    assert (errors.mean(), errors.max()) == pytest.approx((mean, largest), rel=5e-4)
    result.destroy()


def test_the_ball_is_that_of_the_python_class(parse):
    result = solve_scene(parse(BALL.replace("cells = 8", "cells = 24")), COMM)
    domain = box_mesh(COMM, [np.linspace(-2.0, 2.0, 25)] * 2)
    problem = membrane(domain, 0.0, over_hemisphere, lower=hemisphere)
    problem.solve(rtol=1e-10)
    assert by_place(result.u)[:, 2] == pytest.approx(by_place(problem.u)[:, 2], abs=1e-8)
    # Forces of harmonic functions do not change when the plane is blown down; pressures do.
    summary = summarise(result, scene_boundaries(result))
    assert summary.forces["contact"] == pytest.approx(problem.force, rel=1e-7)
    pressures = by_place(result.pressure)[:, 2], 16.0 * by_place(problem.pressure)[:, 2]
    assert pressures[0] == pytest.approx(pressures[1], abs=1e-5 * pressures[0].max())
    result.destroy()
    problem.destroy()


def test_contact_of_the_ball_ends_at_its_radius(demos):
    pytest.importorskip("gmsh")
    scene = load_scene(demos / "membrane.toml", COMM, ["domain.width=0.05"])
    result = solve_scene(scene, COMM)
    summary = summarise(result, scene_boundaries(result))
    assert np.sqrt(summary.contact_size / np.pi) == pytest.approx(RADIUS, abs=0.5 * 0.05)
    assert summary.boundary_size == pytest.approx(16.0)
    # The flux through any circle around the contact set.
    assert summary.forces["contact"] == pytest.approx(2.0 * np.pi * HEIGHT, rel=2e-3)
    assert summary.errors["Linf"] <= 2e-3 and summary.imbalance <= 1e-5
    assert summary.detachment_points == ()
    result.destroy()


def test_an_upper_obstacle_is_the_mirror_of_a_lower_one(parse):
    turned = BALL.replace('lower = "ball"', 'upper = "-(ball)"').replace(
        'value = "outside"', 'value = "-(outside)"'
    )
    results = [solve_scene(parse(text.split("[solution]")[0]), COMM) for text in (BALL, turned)]
    low, high = (by_place(result.u)[:, 2] for result in results)
    assert high == pytest.approx(-low, abs=1e-10)
    forces = [summarise(r, scene_boundaries(r)).forces["contact"] for r in results]
    assert forces[1] == pytest.approx(-forces[0]) and forces[0] > 0.0
    for result in results:
        result.destroy()


def test_what_is_written_satisfies_the_conditions_of_two_obstacles(folder):
    out = folder / "out"
    assert main(["solve", write(folder, BETWEEN), "--out", str(out)]) == 0
    COMM.barrier()
    with (out / "boundary.csv").open() as file:
        table = [{k: float(v or "nan") for k, v in row.items()} for row in csv.DictReader(file)]
    record = json.loads((out / "record.json").read_text())
    n = 24
    grid = {name: np.full((n + 1, n + 1), np.nan) for name in ("u", "gap", "pressure")}
    for row in table:
        i, j = round(n * row["x"]), round(n * row["y"])
        for name, values in grid.items():
            values[i, j] = row[name]
    u, h, (x, y) = (
        grid["u"],
        1.0 / n,
        np.meshgrid(*[np.linspace(0.0, 1.0, n + 1)] * 2, indexing="ij"),
    )
    # The five-point scheme for a load that is linear; at the top half of it, with the flux.
    f = 300.0 * (x - 0.5)
    force = np.zeros_like(u)
    middle = slice(1, -1)
    force[middle, middle] = (
        4.0 * u[middle, middle]
        - u[:-2, middle] - u[2:, middle] - u[middle, :-2] - u[middle, 2:]
        - h * h * f[middle, middle]
    )  # fmt: skip
    # Cells are cut from their lower left to their upper right corner.
    third = h * h / 24.0
    below_left, right = f[:-2, -2], f[2:, -1]
    load = third * (6.0 * f[middle, -1] + 2.0 * f[:-2, -1] + 1.0 * right)
    load += third * (2.0 * f[middle, -2] + 1.0 * below_left)
    force[middle, -1] = (
        2.0 * u[middle, -1] - 0.5 * u[:-2, -1] - 0.5 * u[2:, -1] - u[middle, -2] - load - 2.0 * h
    )
    low, high = -0.2 - 0.1 * y, 0.15 + 0.2 * (y - 0.5) ** 2
    free = (slice(1, -1), slice(1, None))
    force, u, low, high = force[free], u[free], low[free], high[free]
    assert (u >= low).all() and (u <= high).all()
    below, above = u - low <= 1e-12, high - u <= 1e-12
    size = np.abs(force).max()
    assert 20 < below.sum() < 250 and 20 < above.sum() < 250
    assert force[below].min() >= -1e-8 * size and force[above].max() <= 1e-8 * size
    assert np.abs(force[~below & ~above]).max() <= 1e-8 * size
    assert grid["gap"][free] == pytest.approx(np.minimum(u - low, high - u), abs=1e-12)
    inside = (slice(None), slice(None, -1))
    assert grid["pressure"][free][inside] * h * h == pytest.approx(force[inside], abs=1e-8 * size)
    summary = record["summary"]
    assert summary["forces"]["contact"] == pytest.approx(force.sum(), abs=1e-7 * size)
    assert summary["forces"]["flux"] == pytest.approx(2.0)
    assert summary["imbalance"] <= 1e-8 and summary["boundary_size"] == pytest.approx(1.0)


RIM = """
rtol = 1e-10
title = "a membrane over a floor, with a rim"
outputs = ["fields", "boundary", "pictures", "report"]
[domain]
shape = "square"
cells = 24
[equation]
load = -6
[obstacle]
lower = "-0.3 + 0.02*x"
[contact]
sides = "bottom"
obstacle = "-0.25 + 0.1*cos(6*x)"
[[dirichlet]]
sides = "top"
value = 0
"""


def test_a_rim_is_written_beside_what_is_in_the_domain(folder):
    """Pressures in the files are the forces of the five-point scheme, and each zone has its own."""
    out, n = folder / "out", 24
    assert main(["solve", write(folder, RIM), "--out", str(out)]) == 0
    COMM.barrier()
    tables = []
    for name in ("boundary.csv", "contact_boundary.csv"):
        with (out / name).open() as file:
            tables.append(
                [{k: float(v or "nan") for k, v in row.items()} for row in csv.DictReader(file)]
            )
    grid = {name: np.full((n + 1, n + 1), np.nan) for name in ("u", "pressure")}
    for row in tables[0]:
        for name, values in grid.items():
            values[round(n * row["x"]), round(n * row["y"])] = row[name]
    u, h, middle = grid["u"], 1.0 / n, slice(1, -1)
    x = np.linspace(0.0, 1.0, n + 1)
    # The five-point scheme inside, and with half of it on the lower side.
    force = 4.0 * u[middle, middle] - u[:-2, middle] - u[2:, middle] - u[middle, :-2]
    force += 6.0 * h * h - u[middle, 2:]
    touching = u[middle, middle] <= -0.3 + 0.02 * x[middle, None] + 1e-12
    assert 50 < touching.sum() < 400
    assert np.abs(force[~touching]).max() <= 1e-9 and force[touching].min() >= -1e-9
    assert grid["pressure"][middle, middle] * h * h == pytest.approx(force, abs=1e-9)
    at_rim = 2.0 * u[middle, 0] - 0.5 * u[:-2, 0] - 0.5 * u[2:, 0] - u[middle, 1] + 3.0 * h * h
    rows = {round(n * row["x"]): row for row in tables[1]}
    assert len(rows) == n + 1 and all(row["y"] == 0.0 for row in tables[1])
    gap = np.array([rows[i]["gap"] for i in range(n + 1)])
    assert gap == pytest.approx(u[:, 0] - (-0.25 + 0.1 * np.cos(6.0 * x)), abs=1e-12)
    # In the middle the floor is higher than the rim, and holds the end of the membrane.
    pressure, held = np.array([rows[i]["pressure"] for i in range(1, n)]), gap[middle] == 0.0
    assert pressure * h == pytest.approx(np.where(held, at_rim, 0.0), abs=1e-9)
    assert 5 < held.sum() < n - 5 and (pressure[held] > 0.0).all()
    at_floor = u[middle, 0] == -0.3 + 0.02 * x[middle]
    assert at_floor.sum() > 2 and (at_rim[~held & ~at_floor] <= 1e-9).all()
    summary = json.loads((out / "record.json").read_text())["summary"]
    forces = summary["forces"]
    assert set(forces) == {"load", "contact", "obstacle", "Dirichlet sides"}
    assert forces["load"] == pytest.approx(-6.0) and summary["imbalance"] <= 1e-9
    assert forces["contact"] > at_rim[held].sum() > 0.0 and forces["obstacle"] > force.sum() > 0.0
    touching, undecided, whole = summary["beside"]
    assert 0.4 < touching < 0.8 and undecided == 0.0 and whole == pytest.approx(1.0)
    assert summary["boundary_size"] == pytest.approx(1.0)
    assert len(summary["detachment_points"]) == 2
    pictures = {"contact.png", "contact_boundary.png", "solution.png"}
    assert pictures <= {path.name for path in out.iterdir()}
    page = (out / "report.html").read_text()
    assert page.count("<img") == 3 and "contact boundary" in page


def test_the_fields_of_both_zones(folder):
    result = solve_scene(load_scene(write(folder, RIM), COMM), COMM)
    fields = {field.name: by_place(field) for field in fields_of(result)}
    _, y, everywhere = fields["has_obstacle"].T
    below = y < 1e-9
    assert (everywhere == 1.0).all() and (fields["contact_boundary"][:, 2] == below).all()
    problem = result.posed.problem
    assert by_place(problem.boundary.pressure)[:, 2] == pytest.approx(
        fields["boundary_pressure"][:, 2]
    )
    assert (fields["pressure"][below, 2] * fields["boundary_pressure"][below, 2] == 0.0).all()
    assert fields["boundary_gap"][~below, 2].max() == 0.0
    for name, zone in zip(("", "boundary_"), problem.zones, strict=True):
        assert fields[f"{name}gap"][:, 2] == pytest.approx(by_place(zone.gap)[:, 2])
        at = fields[f"{name}in_contact"][:, 2] == 1.0
        assert at.any() and fields[f"{name}gap"][at, 2].max() == 0.0
    result.destroy()


def test_an_accuracy_with_a_rim_is_reached(folder):
    """Against the forces of the scene on a mesh that is much finer."""
    text = (
        RIM.replace("cells = 24\n", "")
        .replace("rtol = 1e-10\n", "")
        .replace("outputs", 'norm = "L2"\naccuracy = 1e-3\n#')
    )
    result = solve_scene(load_scene(write(folder, text), COMM), COMM)
    fine = solve_scene(load_scene(write(folder, RIM), COMM, ["domain.cells=200"]), COMM)
    assert result.found.reached
    forces = [summarise(r, scene_boundaries(r)).forces for r in (result, fine)]
    for name in ("contact", "obstacle"):
        assert forces[0][name] == pytest.approx(forces[1][name], abs=0.03)
    for each in (result, fine):
        each.destroy()


def test_no_bound_is_printed_with_a_rim(folder, capfd):
    assert main(["solve", write(folder, RIM), "--bound"]) == 2
    COMM.barrier()
    if COMM.rank == 0:
        assert "[contact] and [obstacle]" in capfd.readouterr().err


def test_everything_is_written(folder):
    out = folder / "out"
    assert main(["solve", write(folder, BALL), "--out", str(out)]) == 0
    COMM.barrier()
    fields = "fields.bp" if dolfinx.has_adios2 else "fields.xdmf"
    names = {"boundary.csv", "contact.png", fields, "record.json", "report.html", "solution.png"}
    assert names <= {path.name for path in out.iterdir()}
    page = (out / "report.html").read_text()
    assert page.count("<img") == 2 and "force of contact" in page


def test_the_fields_tell_where_the_obstacle_is(folder):
    write_halves(folder)
    scene = load_scene(write(folder, HALVES.format(refinements=0, cells=5)), COMM)
    result = solve_scene(scene, COMM)
    fields = {field.name: field for field in fields_of(result)}
    obstacle, touching = fields["has_obstacle"], fields["in_contact"]
    x, _, here = by_place(obstacle).T
    inner = (x > 1e-9) & (x < 1.0 - 1e-9) & (by_place(result.u)[:, 2] != 0.0)
    assert (here[inner] == (x[inner] <= 0.5 + 1e-9)).all()
    assert (by_place(touching)[:, 2] <= here).all()
    result.destroy()


@pytest.mark.parametrize("cells", ["5", '"left"', '["5", "left"]', "[5, 7]", '"all"'])
@pytest.mark.parametrize("refinements", [0, 2])
def test_obstacles_in_cells_with_tags_are_those_of_the_python_class(folder, cells, refinements):
    write_halves(folder)
    scene = load_scene(write(folder, HALVES.format(refinements=refinements, cells=cells)), COMM)
    result = solve_scene(scene, COMM)
    n = 8 * 2**refinements
    domain = box_mesh(COMM, [np.linspace(0.0, 1.0, n + 1)] * 2)
    every = cells in ("[5, 7]", '"all"')
    left = mesh.locate_entities(domain, 2, lambda x: every | (x[0] < 0.5 + 1e-9))
    problem = membrane(domain, -8.0, 0.0, lower=-0.1, cells=left)
    problem.solve(rtol=1e-10)
    ours, theirs = by_place(result.u), by_place(problem.u)
    # Divided cells have other diagonals than those of a finer lattice.
    tolerance = 1e-8 if refinements == 0 else 2e-3
    assert ours[:, 2] == pytest.approx(theirs[:, 2], abs=tolerance)
    size = summarise(result, scene_boundaries(result)).boundary_size
    assert size == pytest.approx(1.0 if every else 0.5)
    assert every or ours[:, 2].min() < -0.2
    result.destroy()
    problem.destroy()


def test_regions_keep_their_place_in_refined_and_balanced_meshes(folder):
    write_halves(folder)
    found = MeshFile.open(COMM, folder / "halves.msh").with_regions(COMM)
    assert set(found.region_names) == {"5", "left", "7", "right"}
    sided = found.make(COMM)
    for _ in range(3):  # towards a corner of the left half, until a rank has too many cells
        middles = mesh.compute_midpoints(sided.mesh, 2, owned_cells(sided.mesh))
        marked = np.flatnonzero(np.hypot(*middles.T[:2]) < 0.3).astype(np.int32)
        sided = balanced(refined(sided, marked)).sided
        assert area(sided.mesh, sided.cells(("left",))) == pytest.approx(0.5)
        assert area(sided.mesh, sided.cells(("left", "7"))) == pytest.approx(1.0)
        left = mesh.compute_midpoints(sided.mesh, 2, sided.cells(("5",)))
        assert (left[:, 0] < 0.5).all()


def test_accuracy_with_an_obstacle_in_cells(folder):
    write_halves(folder)
    text = HALVES.format(refinements=0, cells='"left"')
    scene = load_scene(write(folder, text), COMM, adapted=True)
    result = solve_scene(scene, COMM, accuracy=5e-3, norm="Linf", degree=1)
    domain = box_mesh(COMM, [np.linspace(0.0, 1.0, 129)] * 2)
    left = mesh.locate_entities(domain, 2, lambda x: x[0] < 0.5 + 1e-9)
    fine = membrane(domain, -8.0, 0.0, lower=-0.1, cells=left)
    fine.solve()
    known = {(round(128 * x), round(128 * y)): u for x, y, u in by_place(fine.u)}
    shared = [
        (u, known[round(128 * x), round(128 * y)])
        for x, y, u in by_place(result.u)
        if np.allclose(np.array([128 * x, 128 * y]) % 1.0, 0.0)
    ]
    ours, theirs = np.array(shared).T
    assert len(ours) > 100 and result.found.reached
    assert np.abs(ours - theirs).max() <= 5e-3
    result.destroy()
    fine.destroy()


def test_cells_of_an_xdmf_file(folder):
    domain = box_mesh(COMM, [np.linspace(0.0, 1.0, 9)] * 2)
    facets, cells = boundary_facets(domain), owned_cells(domain)
    left = mesh.compute_midpoints(domain, 2, cells)[:, 0] < 0.5
    numbers = np.where(left, 5, 7).astype(np.int32)
    tags = [
        mesh.meshtags(domain, 1, facets, np.full(len(facets), 1, dtype=np.int32)),
        mesh.meshtags(domain, 2, cells, numbers),
    ]
    for each, name in zip(tags, ("facet_tags", "materials"), strict=True):
        each.name = name
    with XDMFFile(COMM, str(folder / "halves.xdmf"), "w") as file:
        file.write_mesh(domain)
        for each in tags:
            file.write_meshtags(each, domain.geometry)
    text = HALVES.format(refinements=1, cells=5).replace('"rim"', "1").replace(".msh", ".xdmf")
    path = write(folder, text.replace("refinements", 'cell_tags = "materials"\nrefinements'))
    result = solve_scene(load_scene(path, COMM), COMM)
    assert summarise(result, scene_boundaries(result)).boundary_size == pytest.approx(0.5)
    result.destroy()
    with pytest.raises(InputError, match=r"obstacle\.cells.*no mesh .* cell tags 'cell_tags'"):
        load_scene(write(folder, text), COMM)


def test_scenes_without_the_table_have_no_regions(demos):
    pytest.importorskip("gmsh")
    scene = load_scene(demos / "plate.toml", COMM)
    assert scene.obstacle is None and scene.domain.region_names == ()
    assert scene.domain.make(COMM).regions == {}


@pytest.mark.parametrize(("norm", "accuracy"), [("Linf", 3e-3), ("H1", 0.1)])
def test_an_accuracy_is_reached(parse, norm, accuracy):
    text = BALL.replace("rtol = 1e-10", f'accuracy = {accuracy}\nnorm = "{norm}"')
    result = solve_scene(parse(text.replace("cells = 8\n", "")), COMM)
    summary = summarise(result, scene_boundaries(result))
    assert result.found.reached and result.found.estimate <= accuracy
    if norm == "Linf":
        domain = result.u.function_space.mesh
        middles = mesh.compute_midpoints(domain, 2, owned_cells(domain))
        values = result.u.eval(middles, owned_cells(domain)).ravel()
        errors = np.abs(values - over_hemisphere(4.0 * middles[:, :2].T - 2.0))
        assert COMM.allreduce(errors.max(initial=0.0), op=MPI.MAX) <= accuracy
    assert summary.errors[norm] <= result.found.estimate
    assert summary.errors[norm] >= 0.02 * accuracy
    # Contact ends at a quarter of the radius, because the plane is blown down, or in the next cell.
    assert np.sqrt(summary.contact_size / np.pi) == pytest.approx(RADIUS / 4.0, rel=0.08)
    result.destroy()


def test_a_narrow_obstacle_is_not_overlooked(parse):
    """A needle of width 0.0003 that no vertex of the first meshes is near."""
    needle = "exp(-((x - 0.53)^2 + (y - 0.47)^2)/1e-7) - 0.5"
    text = f"""
    accuracy = 0.02
    norm = "L2"
    [domain]
    shape = "square"
    [obstacle]
    lower = "{needle}"
    [[dirichlet]]
    sides = "all"
    value = 0
    """
    result = solve_scene(parse(text), COMM)
    highest = COMM.allreduce(float(result.u.x.array.max(initial=0.0)), op=MPI.MAX)
    assert highest >= 0.45
    assert summarise(result, scene_boundaries(result)).forces["contact"] > 0.0
    result.destroy()


def test_an_obstacle_in_space(folder):
    text = """
    [domain]
    shape = "cube"
    cells = 8
    [equation]
    load = -10
    [obstacle]
    lower = -0.1
    [[dirichlet]]
    sides = "all"
    value = 0
    """
    out = folder / "out"
    assert main(["solve", write(folder, text), "--out", str(out)]) == 0
    COMM.barrier()
    assert (out / "solution.png").exists() and not (out / "contact.png").exists()
    summary = json.loads((out / "record.json").read_text())["summary"]
    assert summary["boundary_size"] == pytest.approx(1.0)
    # Where u touches a constant the pressure is minus the load, less what higher neighbours hold.
    force, size = summary["forces"]["contact"], summary["contact_size"]
    assert 2.0 < force <= 10.0 * size < 10.0
    assert sum(summary["forces"].values()) == pytest.approx(0.0, abs=1e-6)


def test_orders_are_those_of_a_gap_like_the_square_of_the_distance(parse):
    text = BALL.replace("rtol", "degree = 2\nrtol")
    found = solve_scene(parse(text), COMM)
    orders = found.expectation.orders
    assert orders["H1"] == 1.5 and orders["W1_inf"] == 1.0 and orders["L2"] == 2.0
    found.destroy()


def test_a_solution_beyond_the_obstacle_is_told(parse):
    scene = parse(BALL)
    assert expect(scene, scene.domain.make(COMM)).notes == ()
    scene = parse(BALL.replace('u = "where', 'u = "-0.5*exp(-99*((x-0.5)^2+(y-0.25)^2)) + where'))
    (note,) = expect(scene, scene.domain.make(COMM)).notes
    # At the distance 1 from the middle u is 0.47 and the obstacle 0.23.
    off = 0.5 - HEIGHT * np.log(2.0) + hemisphere(np.array([[1.0], [0.0]]))[0]
    assert note == f"exact solution: u >= lower fails at (0.5, 0.25) by {off:.3g}"


@pytest.mark.parametrize(
    "u,failing",
    [
        ("1 + y", ["flux >= 0"]),  # the flux outwards is -1 below
        ("y - 0.5", ["u >= lower", "flux >= 0", "u >= g"]),
        ("2 - y + y^2/2", ["flux = 0"]),
        ("1 + y^2", []),
    ],
)
def test_a_known_solution_is_held_against_both_obstacles(parse, u, failing):
    text = RIM.replace("load = -6", "").replace(
        "[[dirichlet]]", f'[solution]\nu = "{u}"\n[[dirichlet]]'
    )
    scene = parse(text.replace("cells = 24", "cells = 4").replace("value = 0", f'value = "{u}"'))
    notes = expect(scene, scene.domain.make(COMM)).notes
    found = [note for note in notes if note.startswith("exact solution: ")]
    assert len(found) == len(failing)
    assert all(f"exact solution: {name}" in note for name, note in zip(failing, found, strict=True))


TWO = """
[domain]
shape = "square"
cells = 16
[equation]
load = "40*sin(2*pi*y)"
[obstacle]
lower = -0.3
upper = 0.3
[[dirichlet]]
sides = ["bottom", "top"]
value = 0
"""


def test_forces_that_cancel_are_in_balance(parse):
    """The load, and the forces of a lower and an upper obstacle, have the sum 0 each."""
    result = solve_scene(parse(TWO), COMM)
    summary = summarise(result, scene_boundaries(result))
    assert np.abs(result.posed.problem.forces.x.array).max() > 0.01
    assert summary.imbalance <= 1e-7
    result.destroy()


def test_the_family_of_the_trade_off_has_no_graded_meshes(parse):
    family = scene_family(parse(BALL))
    assert family.has_kind(Kind("uniform", 2)) and not family.has_kind(Kind("graded", 2))
    run = Run(COMM, family, Configuration(Kind("uniform", 1), 16))
    assert run.result.active_dofs == 29
    run.destroy()
    with pytest.raises(InputError, match="graded: only in the plane"):
        Run(COMM, family, Configuration(Kind("graded", 1), 16))


PLAIN = BETWEEN.replace("cells = 24", "cells = 4")


@pytest.mark.parametrize(
    ("text", "key", "message"),
    [
        (PLAIN.replace("lower", "#").replace("upper", "#"), "obstacle", "is missing"),
        (PLAIN.split("[obstacle]")[0], "contact", "no [contact] and no [obstacle]"),
        (PLAIN.replace("lower", "lowr"), "obstacle.lowr", "did you mean 'lower'"),
        (
            PLAIN.replace('lower = "', 'lower = "where(hypot(x - 0.5, y - 0.5) < 0.2, 1, 0) + '),
            "obstacle.upper",
            "below the lower",
        ),
        (PLAIN.replace('lower = "', 'lower = "1/0 + '), "obstacle.lower", ""),
        (PLAIN.replace('lower = "', 'lower = "log(x - 2) + '), "obstacle.lower", "not a finite"),
        (PLAIN.replace('lower = "', 'lower = "0.5 + '), "obstacle.lower", "above the Dirichlet"),
        (PLAIN.replace("upper", "cells = 1\nupper"), "obstacle.cells", "a mesh from a file"),
        (PLAIN + '[contact]\nsides = "tp"\n', "contact.sides", "top"),
        (PLAIN.replace("[obstacle]", "[[obstacle]]"), "obstacle", "one table"),
        (
            PLAIN.replace("value = 0\n", "").replace("flux = 2\n", "").replace("load", "# load")
            + '[solution]\nu = "0"\nmanufactured = true\n',
            "solution.manufactured",
            "not with [obstacle]",
        ),
    ],
)
def test_tables_that_make_no_sense_are_refused_by_their_key(folder, capfd, text, key, message):
    path = write(folder, text)
    for job in ("check", "solve"):
        with pytest.raises(SystemExit) as caught:
            raise SystemExit(main([job, path]))
        assert caught.value.code == 2
        told = "".join(COMM.allgather(capfd.readouterr().err))
        assert f": {key}: " in told and message in told


def test_cells_that_are_unknown_are_refused(folder, capfd):
    write_halves(folder)
    assert main(["solve", write(folder, HALVES.format(refinements=0, cells='"lft"'))]) == 2
    told = "".join(COMM.allgather(capfd.readouterr().err))
    assert "obstacle.cells: unknown cell tag 'lft'; did you mean 'left'?" in told


@pytest.mark.parametrize("more", [(), ("--accuracy", "0.5", "--norm", "H1")])
def test_a_proven_bound_is_printed_and_written(folder, capfd, more):
    out = folder / "out"
    path = write(folder, BALL.replace("cells = 8", "cells = 16"))
    assert main(["solve", path, "--bound", "--out", str(out), "--report", *more]) == 0
    COMM.barrier()
    told = "".join(COMM.allgather(capfd.readouterr().out))
    summary = json.loads((out / "record.json").read_text())["summary"]
    (line,) = (line for line in told.splitlines() if "  energy error" in line)
    said, kind = summary["bound"]["energy error"].split(", ")
    assert kind == "proven" and f"{said}, proven" in line
    assert said in (out / "report.html").read_text()
    bound = float(said.removeprefix("at most "))
    assert summary["errors"]["H1"] <= 1.01 * bound <= 3.0 * summary["errors"]["H1"]


def test_a_bound_with_an_obstacle_in_some_cells(folder):
    """Contact up to x = 0.3; where there is no obstacle the solution is below it at last."""
    write_halves(folder, 10, ends=True)
    text = HALVES.format(refinements=0, cells=5).replace("lower = -0.1", "lower = 0")
    text = text.replace("load = -8", 'load = "where(x < 0.3, -2, 6*x - 2.6)"')
    scene = load_scene(write(folder, text.replace("value = 0", 'value = "-0.147*x"')), COMM)
    result = solve_scene(scene, COMM)
    x = ufl.SpatialCoordinate(result.u.function_space.mesh)
    t = ufl.max_value(x[0] - 0.3, 0.0)
    slope = ufl.as_vector([0.8 * t - 3.0 * t**2, 0.0])
    e = ufl.grad(result.u) - slope
    square = fem.assemble_scalar(fem.form(ufl.inner(e, e) * ufl.dx))
    error, bound = np.sqrt(COMM.allreduce(square)), bound_of_scene(result.posed)
    assert not bound.sampled and error <= bound.total <= 1.3 * error
    result.destroy()


def test_what_is_foretold(folder, capfd):
    assert main(["check", write(folder, BETWEEN)]) == 0
    told = "".join(COMM.allgather(capfd.readouterr().out))
    assert "lower obstacle -0.2 - 0.1*y in the domain" in told
    assert "upper obstacle 0.15 + 0.2*(y - 0.5)^2 in the domain" in told


def test_regions_stay_where_the_diffusion_jumps(folder):
    """Meshes are not fitted to a jump that crosses the edge of a region."""
    write_halves(folder)
    text = HALVES.format(refinements=0, cells='"left"')
    text = text.replace("load", 'diffusion = "where(y < 0.41 + 0.1*x, 1, 3)"\nload')
    scene = load_scene(write(folder, text), COMM, adapted=True)
    result = solve_scene(scene, COMM, accuracy=0.01, norm="Linf")
    sided = result.posed.sided
    assert result.found.steps[-1].unknowns > result.found.steps[0].unknowns
    assert area(sided.mesh, sided.cells(("left",))) == pytest.approx(0.5)
    result.destroy()


SIDES = '[contact]\nsides = "left"\nobstacle = -0.4\n'


@pytest.mark.parametrize("text", [TWO, TWO.replace("upper = 0.3\n", "") + SIDES])
def test_no_label_of_a_picture_is_cut_off(text, parse):
    result = solve_scene(parse(text), COMM)
    for name, picture in draw_scene(result, scene_boundaries(result)).items():
        drawn = imread(io.BytesIO(picture.png()))[:, :, :3].min(axis=2)
        border = np.concatenate((drawn[[0, -1]].ravel(), drawn[:, [0, -1]].ravel()))
        assert border.min() == 1.0, name
    result.destroy()
