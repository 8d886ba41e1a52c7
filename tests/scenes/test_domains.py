"""Domains and their sides: lengths, areas, cascades, mesh files, and what is refused."""

import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from dolfinx import mesh
from dolfinx.io import XDMFFile
from hypothesis import example, given
from hypothesis import strategies as st
from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.data import parsing
from dolfinx_signorini.meshes.mesh_defects import cell_defect
from dolfinx_signorini.meshes.parents import parent_mesh
from dolfinx_signorini.meshes.sided_meshes import (
    SidedMesh,
    boundary_facets,
    facet_cells,
    facet_scale,
    gathered_cells,
    owned_cells,
)
from dolfinx_signorini.scenes import load_scene, solve_scene
from dolfinx_signorini.scenes.domains.kinds import Cube, Square
from dolfinx_signorini.scenes.domains.mesh_files import MeshFile
from dolfinx_signorini.scenes.domains.polygons import Polygon

PENTAGON = ((0.0, 0.0), (2.0, 0.0), (2.5, 1.0), (1.0, 2.0), (0.0, 1.0))


def sizes(sided, comm):
    """Length or area of each side, on all ranks."""
    domain = sided.mesh
    factor = 1.0 if domain.topology.dim == 2 else 0.5
    owned = domain.topology.index_map(domain.topology.dim - 1).size_local
    result = {}
    for name, facets in sided.sides.items():
        scale = facet_scale(domain, facet_cells(domain, facets[facets < owned]))
        result[name] = comm.allreduce(factor * float(scale.sum()))
    return result


def area(domain, comm):
    cells = domain.geometry.x[domain.geometry.dofmap[owned_cells(domain)]][:, :, :2]
    a, b = (cells[:, 1] - cells[:, 0]).T, (cells[:, 2] - cells[:, 0]).T
    return comm.allreduce(0.5 * float(np.abs(a[0] * b[1] - a[1] * b[0]).sum()))


@pytest.mark.parametrize("domain", [Square(5), Cube(3)])
def test_each_side_of_square_and_cube_has_size_one(domain, comm):
    sided = domain.make(comm)
    found = sizes(sided, comm)
    assert set(found) == set(domain.side_names)
    assert list(found.values()) == pytest.approx([1.0] * len(found))
    assert sided.mesh.topology.index_map(0).size_global == domain.vertices
    total = facet_scale(sided.mesh, facet_cells(sided.mesh, sided.facets(("all",)))).sum()
    factor = 1.0 if domain.dimension == 2 else 0.5
    assert factor * comm.allreduce(float(total)) == pytest.approx(len(found))


def test_a_polygon_has_its_area_and_the_lengths_of_its_edges(comm):
    pytest.importorskip("gmsh")
    polygon = Polygon(PENTAGON, 0.15)
    sided = polygon.make(comm)
    lengths = [math.dist(a, b) for a, b in zip(PENTAGON, (*PENTAGON[1:], PENTAGON[0]), strict=True)]
    assert list(sizes(sided, comm)[str(k)] for k in range(1, 6)) == pytest.approx(lengths)
    assert area(sided.mesh, comm) == pytest.approx(polygon.area) == 3.5
    count = sided.mesh.topology.index_map(0).size_global
    assert polygon.vertices == pytest.approx(count, rel=0.3)
    h = sided.mesh.h(2, owned_cells(sided.mesh))
    assert comm.allreduce(float(h.max(initial=0.0)), op=max) <= 2.0 * 0.15


@pytest.mark.parametrize("power", [-150, -40, -3])
def test_a_small_polygon_has_the_mesh_of_a_large_one(comm, power):
    unit = 2.0**power
    small = Polygon(tuple((unit * x, unit * y) for x, y in PENTAGON), 0.25 * unit).make(comm).mesh
    large = Polygon(PENTAGON, 0.25).make(comm).mesh
    assert small.topology.index_map(2).size_global == large.topology.index_map(2).size_global
    assert area(small, comm) == pytest.approx(unit**2 * area(large, comm), rel=1e-12)
    found, expected = (m.geometry.x[np.lexsort(m.geometry.x.T)] for m in (small, large))
    if comm.size == 1:
        assert (found == unit * expected).all()


def test_a_fine_polygon_is_refined_from_coarse_levels_with_its_width_and_sides(comm):
    pytest.importorskip("gmsh")
    polygon = Polygon(PENTAGON, 0.025)
    coarse, fine = polygon.levels()
    assert fine == polygon and coarse.width == 0.05
    sided = coarse.make(comm)
    finer = fine.make_after(coarse, sided)
    assert parent_mesh(finer.mesh).sided is sided
    counts = [m.topology.index_map(2).size_global for m in (sided.mesh, finer.mesh)]
    assert counts[1] == 4 * counts[0]
    lengths = [math.dist(a, b) for a, b in zip(PENTAGON, (*PENTAGON[1:], PENTAGON[0]), strict=True)]
    for made in (finer, polygon.make(comm)):
        assert made.mesh.topology.index_map(2).size_global == counts[1]
        assert list(sizes(made, comm)[str(k)] for k in range(1, 6)) == pytest.approx(lengths)
        assert area(made.mesh, comm) == pytest.approx(3.5)
    edges = finer.mesh.h(2, owned_cells(finer.mesh))  # the longest of each cell
    longest = comm.allreduce(float(edges.max(initial=0.0)), op=max)
    mean = comm.allreduce(float(edges.sum())) / counts[1]
    assert 0.9 * 0.025 < mean < 1.2 * 0.025 and longest < 1.7 * 0.025
    assert Polygon((*PENTAGON, (0.0, 0.999)), 0.025).refinements == 0  # gmsh resolves the edge


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(1e-3, 1e3))
@example(0.7182, 0.7182, 1.0)
def test_a_square_anywhere_has_its_area_and_meshes_of_all_widths(x, y, side):
    corners = ((x, y), (x + side, y), (x + side, y + side), (x, y + side))
    polygon = Polygon(corners, 0.5 * side)
    assert polygon.size == pytest.approx(side, abs=1e-12)  # rounding of the coordinates alone
    for n in (1, 3, 20):
        assert polygon.at(n).cells_across == n


@given(st.lists(st.floats(0.3, 1.0), min_size=4, max_size=9), st.booleans())
def test_star_shaped_polygons_are_simple_and_figures_of_eight_are_not(radii, turned):
    count = len(radii)
    angles = [2.0 * math.pi * k / count for k in range(count)]
    points = [(r * math.cos(a), r * math.sin(a)) for r, a in zip(radii, angles, strict=True)]
    if turned:
        points.reverse()
    polygon = Polygon(tuple(points), 0.1)
    wedges = [radii[k] * radii[k - 1] * math.sin(2.0 * math.pi / count) / 2.0 for k in range(count)]
    assert polygon.area == pytest.approx(sum(wedges))
    crossed = (points[1], points[0], *points[2:])
    if count == 4:
        with pytest.raises(InputError, match="meet"):
            Polygon(crossed, 0.1)


def write_xdmf(folder, comm, sided):
    """The mesh with a tag for each side, the first one's 1."""
    domain = sided.mesh
    owned = domain.topology.index_map(1).size_local
    parts = [(f[f < owned], int(name)) for name, f in sided.sides.items()]
    facets = np.concatenate([f for f, _ in parts])
    tags = np.concatenate([np.full(len(f), tag) for f, tag in parts]).astype(np.int32)
    order = np.argsort(facets)
    marked = mesh.meshtags(domain, 1, facets[order].astype(np.int32), tags[order])
    marked.name = "sides"
    with XDMFFile(comm, str(folder / "mesh.xdmf"), "w") as file:
        file.write_mesh(domain)
        domain.topology.create_connectivity(1, 2)
        file.write_meshtags(marked, domain.geometry)


def test_an_xdmf_mesh_has_the_sides_it_was_written_with(comm, folder):
    pytest.importorskip("gmsh")
    sided = Polygon(PENTAGON, 0.4).make(comm)
    write_xdmf(folder, comm, sided)
    read = MeshFile.open(comm, folder / "mesh.xdmf", tags="sides")
    assert read.vertices == sided.mesh.topology.index_map(0).size_global
    assert sorted(read.side_names) == ["1", "2", "3", "4", "5"]
    assert sizes(read.make(comm), comm) == pytest.approx(sizes(sided, comm))
    with pytest.raises(InputError, match="facet tags 'facet_tags'"):
        MeshFile.open(comm, folder / "mesh.xdmf")


def test_a_scene_on_a_mesh_file_is_solved_as_on_the_domain_it_is_of(comm, folder):
    pytest.importorskip("gmsh")
    sided = Polygon(PENTAGON, 0.2).make(comm)
    write_xdmf(folder, comm, sided)
    text = """
    [domain]
    {}
    [equation]
    load = "-1 - x"
    [contact]
    sides = 1
    obstacle = "-0.2"
    [[dirichlet]]
    sides = 4
    value = "0.1*y"
    """
    shapes = {
        "file": 'shape = "file"\nfile = "mesh.xdmf"\ntags = "sides"',
        "polygon": f'shape = "polygon"\nvertices = {[list(p) for p in PENTAGON]}\nwidth = 0.2',
    }
    norms = []
    for name, shape in shapes.items():
        if comm.rank == 0:
            (folder / f"{name}.toml").write_text(text.format(shape))
        comm.barrier()
        result = solve_scene(load_scene(folder / f"{name}.toml", comm), comm)
        norms.append((result.solve.active_dofs, result.u.x.petsc_vec.norm()))
        result.destroy()
    assert norms[0][0] == norms[1][0] > 0
    assert norms[0][1] == pytest.approx(norms[1][1], rel=1e-6)


def test_named_tags_of_a_msh_file_are_known_by_name_and_number(comm, demos):
    pytest.importorskip("gmsh")
    domain = MeshFile.open(comm, demos / "plate.msh")
    assert {"ground", "top", "hole", "ends", "1", "2", "3", "4"} == set(domain.side_names)
    found = sizes(domain.make(comm), comm)
    assert found["ground"] == found["1"] == pytest.approx(2.0)
    assert found["hole"] == pytest.approx(0.4 * math.pi, rel=0.01)
    finer = replace(domain, refinements=2)
    assert sizes(finer.make(comm), comm) == pytest.approx(found)
    assert finer.levels() == [finer]
    cells = [d.make(comm).mesh.topology.index_map(2).size_global for d in (domain, finer)]
    assert cells[1] == 16 * cells[0]


def test_a_refined_mesh_of_a_file_has_coarser_levels_from_many_cells_on(comm, demos):
    pytest.importorskip("gmsh")
    scene = load_scene(demos / "plate.toml", comm, ["domain.refinements=3"])
    counts = [level.domain.refinements for level in scene.levels()]
    assert counts == [0, 3]
    result = solve_scene(scene, comm)
    vertices = [level.unknowns for level in result.levels]
    assert scene.domain.vertices == pytest.approx(vertices[1], rel=0.2)
    assert 32 * vertices[0] < vertices[1] < 64 * vertices[0]
    assert result.solve.linear_solves <= 3
    result.destroy()


def test_a_wrong_number_of_refinements_is_named_and_not_the_file(comm, demos):
    with pytest.raises(InputError) as error:
        load_scene(demos / "plate.toml", comm, ["domain.refinements=-1"])
    assert error.value.subject == "--set domain.refinements"


def test_a_side_under_two_names_belongs_to_one_part(comm, demos, folder):
    pytest.importorskip("gmsh")
    if comm.rank == 0:
        shutil.copy(demos / "plate.msh", folder)
        (folder / "twice.toml").write_text(
            '[domain]\nshape = "file"\nfile = "plate.msh"\n[contact]\nsides = "ground"\n'
            "[[dirichlet]]\nsides = 1\nvalue = 0\n"
        )
    comm.barrier()
    with pytest.raises(InputError, match="dirichlet: some facet belongs to"):
        solve_scene(load_scene(folder / "twice.toml", comm), comm)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("none.msh", None, "No such file"),
        ("a.stl", b"solid", "ends in .msh or .xdmf"),
        ("script.msh", b'SystemCall "touch run";\n', "not a .msh file"),
        ("cut.msh", "half", "cut.msh|gmsh"),
        ("headless.msh", b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n", "headless.msh|gmsh"),
        ("a.xdmf", b"<Xdmf>", "not an XDMF file"),
        ("a.xdmf", b"<Xdmf></Xdmf>", "no mesh 'mesh'"),
        ("a.xdmf", b'<!DOCTYPE x [<!ENTITY a "b">]><Xdmf>&a;</Xdmf>', "not an XDMF file"),
        (
            "a.xdmf",
            b'<Xdmf><DataItem Format="HDF">../../etc/passwd:/a</DataItem></Xdmf>',
            "is not next to it",
        ),
    ],
)
def test_what_is_no_mesh_is_refused(name, content, reason, comm, demos, folder):
    pytest.importorskip("gmsh")
    if comm.rank == 0 and content is not None:
        if content == "half":
            content = (demos / "plate.msh").read_bytes()[:20_000]
        (folder / name).write_bytes(content)
    comm.barrier()
    with pytest.raises(InputError, match=reason):
        MeshFile.open(comm, folder / name)
    assert not (folder / "run").exists()


@pytest.mark.parametrize("kind", ["cut", "bytes", "line lost", "numbers", "gap"])
def test_a_damaged_msh_file_is_refused_or_still_a_mesh(kind, comm, demos, folder):
    """dolfinx itself would end the program for many of these."""
    pytest.importorskip("gmsh")
    content = (demos / "plate.msh").read_bytes()
    rng = np.random.default_rng(len(kind))
    whole = MeshFile.open(comm, demos / "plate.msh")
    total, refused = area(whole.make(comm).mesh, comm), 0
    for _ in range(8):
        data, place = bytearray(content), int(rng.integers(60, len(content) - 60))
        lines = content.split(b"\n")
        number = int(rng.integers(4, len(lines)))
        if kind == "cut":
            data = data[:place]
        elif kind == "bytes":
            data[place : place + 3] = rng.integers(0, 256, 3, dtype=np.uint8).tobytes()
        elif kind == "gap":
            del data[place : place + int(rng.integers(1, 2000))]
        else:
            lines[number] = b" ".join(b"1000000" for _ in lines[number].split())
            del lines[number : number + (kind == "line lost")]
            data = b"\n".join(lines)
        if comm.rank == 0:
            (folder / "damaged.msh").write_bytes(data)
        comm.barrier()
        try:
            domain = MeshFile.open(comm, folder / "damaged.msh")
        except InputError as error:
            assert "damaged.msh" in str(error) or "gmsh" in str(error)
            refused += 1
        else:
            assert 0.0 < area(domain.make(comm).mesh, comm) < 2.0 * total
        comm.barrier()
    assert refused >= (8 if kind == "cut" else 1)


def write_msh(path, comm, points, cells, sides):
    """A plane mesh in gmsh's format 2.2, with one group of cells and one of sides."""
    elements = [(1, ends) for ends in sides] + [(2, corners) for corners in cells]
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$Nodes", str(len(points))]
    lines += [f"{k} {x!r} {y!r} 0" for k, (x, y) in enumerate(np.asarray(points).tolist(), 1)]
    lines += ["$EndNodes", "$Elements", str(len(elements))]
    for k, (kind, nodes) in enumerate(elements, 1):
        lines.append(f"{k} {kind} 2 1 1 " + " ".join(str(n + 1) for n in nodes))
    if comm.rank == 0:
        path.write_text("\n".join([*lines, "$EndElements", ""]))
    comm.barrier()


def grid_of(n):
    """The vertices, cells and bottom edges of n x n squares, each cut in two."""
    x = np.array([(i, j) for j in range(n + 1) for i in range(n + 1)], dtype=float) / n
    low = np.array([i + (n + 1) * j for j in range(n) for i in range(n)])[:, None]
    cells = np.concatenate((low + np.array([0, 1, n + 2]), low + np.array([0, n + 2, n + 1])))
    return x, cells, np.array([(i, i + 1) for i in range(n)])


def twice(x, cells, sides, moved):
    """Two bodies, the second one of the moved points."""
    n = len(x)
    both = (np.concatenate((part, part + n)) for part in (cells, sides))
    return np.concatenate((x, moved)), *both


def overlapping(kind):
    x, cells, sides = grid_of(6)
    if kind == "a vertex in a far cell":
        x[24] = x[24] + [0.3, 0.22]
    elif kind == "a corner inside":
        x[0] = [0.52, 0.45]
    elif kind == "folded":  # the right half lies on the left one
        x[:, 0] = 0.5 - abs(x[:, 0] - 0.5)
    elif kind == "one body twice":
        return twice(x, cells, sides, x.copy())
    elif kind == "a body in a body":
        return twice(x, cells, sides, 0.4 + 0.05 * x)
    elif kind == "two bodies, a little":
        return twice(x, cells, sides, x + np.array([0.99, 0.31]))
    elif kind == "a spiral":  # no fold, but the annulus closes on itself
        angle, radius = 7.0 * x[:, 0], 1.0 + x[:, 1]
        x = np.stack((radius * np.cos(angle), radius * np.sin(angle)), axis=1)
    return x, cells, sides


OVERLAPPING = (
    "a vertex in a far cell",
    "a corner inside",
    "folded",
    "one body twice",
    "a body in a body",
    "two bodies, a little",
    "a spiral",
)


@pytest.mark.parametrize("kind", OVERLAPPING)
def test_cells_that_overlap_are_refused(kind, comm, folder):
    pytest.importorskip("gmsh")
    write_msh(folder / "a.msh", comm, *overlapping(kind))
    with pytest.raises(InputError, match=r"a\.msh: cells overlap near"):
        MeshFile.open(comm, folder / "a.msh")


def test_cells_that_overlap_are_refused_in_an_xdmf_file(comm, folder):
    sided = Square(6).make(comm)
    sided.mesh.geometry.x[:, 0] = 0.5 - abs(sided.mesh.geometry.x[:, 0] - 0.3)
    write_xdmf(folder, comm, SidedMesh(sided.mesh, {"1": sided.sides["bottom"]}))
    with pytest.raises(InputError, match=r"mesh\.xdmf: cells overlap near"):
        MeshFile.open(comm, folder / "mesh.xdmf", tags="sides")


@pytest.mark.parametrize("kind", ["clockwise", "side by side", "a slit", "corner on corner", "far"])
def test_cells_that_only_touch_are_a_mesh(kind, comm, folder):
    pytest.importorskip("gmsh")
    x, cells, sides = grid_of(6)
    if kind == "clockwise":  # the orientation of a cell does not matter
        cells[::2] = cells[::2, ::-1]
    elif kind == "side by side":
        angle = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
        x, cells, sides = twice(x, cells, sides, x + np.array([1.0, 0.0]))
        x = 1e3 * x @ angle + 1e5
    elif kind == "a slit":  # the left and right half have vertices of their own
        x = np.concatenate((x, x))
        right = x[cells].mean(axis=1)[:, 0] > 0.5
        cells[right] += len(x) // 2
        sides = sides[:3]
        keep, cells = np.unique(cells, return_inverse=True)
        x, cells = x[keep], cells.reshape(-1, 3)
    elif kind == "corner on corner":
        x, cells, sides = twice(x, cells, sides, x + 1.0)
    else:
        x, cells, sides = twice(x, cells, sides, 1e-4 * x + 3.0)
    write_msh(folder / "a.msh", comm, x, cells, sides)
    made = MeshFile.open(comm, folder / "a.msh").make(comm)
    assert made.mesh.topology.index_map(2).size_global == len(cells)


def test_tetrahedra_that_overlap():
    cube = mesh.create_unit_cube(MPI.COMM_SELF, 4, 4, 4)
    ids, x = gathered_cells(cube)
    corners = x[ids]
    assert cell_defect(ids, corners) == ""
    turned = np.linalg.qr(np.arange(9.0).reshape(3, 3) ** 2 + np.eye(3))[0]
    for shift, overlap in (([0.99, 0.2, 0.1], True), ([1.0, 0.0, 0.0], False), ([2, 0, 0], False)):
        both = np.concatenate((corners, corners + shift)) @ turned
        defect = cell_defect(np.concatenate((ids, ids + ids.max() + 1)), both)
        assert ("overlap" in defect) == overlap
    inside = np.flatnonzero((np.abs(corners - 0.5) < 1e-9).all(axis=2).ravel())
    corners.reshape(-1, 3)[inside] += [0.4, 0.1, 0.05]
    assert "overlap" in cell_defect(ids, corners)


def test_a_file_that_lost_its_end_is_refused(comm, demos, folder):
    pytest.importorskip("gmsh")
    content = (demos / "plate.msh").read_bytes()
    for share in (0.3, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999):
        if comm.rank == 0:
            (folder / "cut.msh").write_bytes(content[: int(share * len(content))])
        comm.barrier()
        with pytest.raises(InputError, match=r"cut\.msh: .* the file is not complete"):
            MeshFile.open(comm, folder / "cut.msh")
        comm.barrier()


def test_a_file_with_fewer_cells_than_announced_is_refused(comm, demos, folder):
    pytest.importorskip("gmsh")
    lines = (demos / "plate.msh").read_bytes().split(b"\n")
    place = lines.index(b"$EndElements")
    del lines[place - 20 : place]
    if comm.rank == 0:
        (folder / "few.msh").write_bytes(b"\n".join(lines))
    comm.barrier()
    with pytest.raises(InputError, match=r"few\.msh|gmsh"):
        MeshFile.open(comm, folder / "few.msh")


@pytest.mark.parametrize("version", [2.2, 4.0, 4.1])
@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("dimension", [2, 3])
def test_what_gmsh_writes_is_read_and_missing_groups_are_named(
    version, binary, dimension, comm, folder
):
    gmsh = pytest.importorskip("gmsh")
    if version == 4.0 and binary:
        pytest.skip("gmsh does not write such files")
    if comm.rank == 0:
        gmsh.initialize(readConfigFiles=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.3)
        occ = gmsh.model.occ
        occ.addRectangle(0, 0, 0, 1, 1) if dimension == 2 else occ.addBox(0, 0, 0, 1, 1, 1)
        occ.synchronize()
        parts = [tag for _, tag in gmsh.model.getEntities(dimension - 1)]
        gmsh.model.addPhysicalGroup(dimension - 1, parts[:2], 1, "ground")
        gmsh.model.addPhysicalGroup(dimension - 1, parts[1:], 2, "rest")
        gmsh.model.mesh.generate(dimension)
        gmsh.write(str(folder / "groupless.msh"))
        gmsh.model.addPhysicalGroup(dimension, [1], 1, "body")
        gmsh.write(str(folder / "whole.msh"))
        gmsh.finalize()
    comm.barrier()
    assert "ground" in MeshFile.open(comm, folder / "whole.msh").side_names
    with pytest.raises(InputError, match="physical group, as the sides have"):
        MeshFile.open(comm, folder / "groupless.msh")


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_second_order_mesh_in_a_file_is_refused(dimension, comm, folder):
    gmsh = pytest.importorskip("gmsh")
    if comm.rank == 0:
        gmsh.initialize(readConfigFiles=False)
        gmsh.option.setNumber("General.Terminal", 0)
        occ = gmsh.model.occ
        occ.addDisk(0, 0, 0, 1, 1) if dimension == 2 else occ.addSphere(0, 0, 0, 1)
        occ.synchronize()
        for d in (dimension - 1, dimension):
            gmsh.model.addPhysicalGroup(d, [tag for _, tag in gmsh.model.getEntities(d)], 1)
        gmsh.model.mesh.generate(dimension)
        gmsh.model.mesh.setOrder(2)
        gmsh.write(str(folder / "curved.msh"))
        gmsh.finalize()
    comm.barrier()
    with pytest.raises(InputError, match="only straight-sided"):
        MeshFile.open(comm, folder / "curved.msh")


def test_a_mesh_file_has_one_level(demos):
    domain = MeshFile(demos / "plate.msh", 2, ("1",), 10)
    assert domain.levels() == [domain]


def test_all_boundary_facets_are_on_some_side(comm):
    sided = Square(4).make(comm)
    owned = set(boundary_facets(sided.mesh).tolist())
    listed = set(np.concatenate(list(sided.sides.values())).tolist())
    assert owned <= listed


@pytest.mark.parametrize(
    ("curve", "words"),
    [
        ("hypot(x - 0.7, y - 0.5) - 0.2", None),
        ("hypot(x - 0.7, y - 0.5) - 0.15", "vertices at a distance of 0.05 from this curve"),
        ("hypot(x - 5, y - 0.5) - 0.2", "vertices at a distance of"),
    ],
)
@pytest.mark.parametrize("refinements", [0, 1])
def test_a_curve_that_a_side_does_not_follow_is_refused(curve, words, refinements, comm, demos):
    pytest.importorskip("gmsh")
    found = MeshFile.open(comm, demos / "plate.msh")
    curves = (("hole", parsing.parse(curve, 2)),)
    domain = replace(found, refinements=refinements, curves=curves)
    if words is None:
        assert sizes(domain.make(comm), comm)["hole"] == pytest.approx(0.4 * math.pi, rel=0.01)
        return
    with pytest.raises(InputError, match=words) as refusal:
        domain.make(comm)
    assert refusal.value.subject == "geometry"
