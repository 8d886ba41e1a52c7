"""Domains and their sides: lengths, areas, cascades, mesh files, and what is refused."""

import math
import shutil

import numpy as np
import pytest
from dolfinx import mesh
from dolfinx.io import XDMFFile
from hypothesis import given
from hypothesis import strategies as st

from dolfinx_signorini.errors import InputError
from dolfinx_signorini.meshes import boundary_facets, facet_cells, facet_scale, owned_cells
from dolfinx_signorini.scenes import solve_scene
from dolfinx_signorini.scenes.domains import Cube, Square
from dolfinx_signorini.scenes.mesh_files import MeshFile
from dolfinx_signorini.scenes.polygons import Polygon

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
    from dolfinx_signorini.scenes import load_scene

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


def test_a_side_under_two_names_belongs_to_one_part(comm, demos, folder):
    pytest.importorskip("gmsh")
    from dolfinx_signorini.scenes import load_scene

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


def test_a_mesh_file_has_one_level(demos):
    domain = MeshFile(demos / "plate.msh", 2, ("1",), 10)
    assert domain.levels() == [domain]


def test_all_boundary_facets_are_on_some_side(comm):
    sided = Square(4).make(comm)
    owned = set(boundary_facets(sided.mesh).tolist())
    listed = set(np.concatenate(list(sided.sides.values())).tolist())
    assert owned <= listed
