"""What the commands print and write: numbers that fit together, files that other programs read."""

import csv
import json
import re
import time
from html.parser import HTMLParser

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem

from dolfinx_signorini.commands.main import main
from dolfinx_signorini.pictures.contact_boundary import gather_contact_boundary
from dolfinx_signorini.scenes import load_scene, solve_scene
from dolfinx_signorini.scenes.output import fields
from dolfinx_signorini.scenes.output.fields import write_fields
from dolfinx_signorini.scenes.output.summary import summarise

FILES = ["boundary.csv", "contact.png", "fields.bp", "record.json", "report.html", "solution.png"]
UPPER = """
title = "A <ceiling> & a wall"
degree = 2
[domain]
shape = "square"
cells = 12
[equation]
load = "9*y"
[contact]
sides = ["top", "right"]
bound = "upper"
obstacle = "0.1 + 0.2*(1 - y)"
[[dirichlet]]
sides = "bottom"
value = 0
"""


class Page(HTMLParser):
    """Collects what a page refers to, and its text."""

    def __init__(self):
        super().__init__()
        self.references, self.words, self.open = [], [], []

    def handle_starttag(self, tag, attrs):
        self.references += [v for k, v in attrs if k in ("src", "href", "srcset", "data", "action")]
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


@pytest.fixture
def run(comm, folder, capsys):
    """Solve a text with arguments, and return the folder of its results and what was printed."""

    def run(text, *arguments):
        if comm.rank == 0:
            (folder / "scene.toml").write_text(text)
        comm.barrier()
        out = folder / "out"
        assert main(["solve", str(folder / "scene.toml"), "--out", str(out), *arguments]) == 0
        comm.barrier()
        return out, capsys.readouterr().out

    return run


def rows_of(out):
    with (out / "boundary.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("name", ["obstacle", "cube"])
def test_all_results_of_a_scene_are_written(name, run, comm, demos, folder):
    out, printed = run((demos / f"{name}.toml").read_text().replace("cells = 15", "cells = 5"),
                       "--outputs", "fields,boundary,pictures,report")  # fmt: skip
    wanted = list(FILES)
    fields = "fields.bp" if dolfinx.has_adios2 else "fields.xdmf"
    wanted = [fields if f == "fields.bp" else f for f in wanted]
    assert {p.name for p in out.iterdir()} - {"fields.h5"} == set(wanted)
    assert sorted(p.name for p in folder.iterdir()) == ["out", "scene.toml"]
    if comm.rank == 0:
        for picture in out.glob("*.png"):
            assert picture.read_bytes().startswith(b"\x89PNG")
        assert re.search(r"balance of forces +[0-9.]+e-\d\d of their sizes", printed)
        assert f"results: {out}/" in printed


def test_csv_and_record_fit_together(run):
    out, _ = run(UPPER, "--outputs", "boundary")
    record = json.loads((out / "record.json").read_text())
    rows = rows_of(out)
    gap, u, y = (np.array([float(row[key]) for row in rows]) for key in ("gap", "u", "y"))
    pressure = np.array([float(row["pressure"] or "nan") for row in rows])
    touching = np.array([row["in_contact"] == "1" for row in rows])
    assert np.abs(gap - (0.1 + 0.2 * (1.0 - y) - u)).max() <= 1e-12
    assert gap.min() >= 0.0
    known = np.isfinite(pressure)
    assert np.count_nonzero(~known) == 0  # the Dirichlet data are away from the obstacle
    assert pressure[known].min() >= 0.0
    assert touching.any() and not touching.all() and gap[touching].max() <= 1e-9
    # Values have shares of all coefficients of a facet, of which some may be in contact.
    places = np.array([[float(row["x"]), float(row["y"])] for row in rows])
    apart = np.linalg.norm(places[:, None] - places[touching], axis=2).min(axis=1) > 0.51 / 12
    assert apart.any() and np.abs(pressure[apart]).max() <= 1e-6 * np.nanmax(pressure)
    forces = record["summary"]["forces"]
    assert forces["load"] == pytest.approx(4.5)
    assert forces["contact"] < 0.0 and forces["Dirichlet sides"] < 0.0
    assert sum(forces.values()) == pytest.approx(0.0, abs=1e-6)
    assert record["summary"]["boundary_size"] == pytest.approx(2.0)


def test_forces_are_named_as_forces_and_points_have_an_uncertainty(run, comm):
    out, printed = run(UPPER, "--outputs", "boundary")
    summary = json.loads((out / "record.json").read_text())["summary"]
    assert set(summary["forces"]) == {"load", "contact", "Dirichlet sides"}
    assert len(summary["uncertainties"]) == len(summary["detachment_points"]) > 0
    if comm.rank == 0:
        assert re.search(r"force of contact +-\d", printed) and "pressure" not in printed
        assert re.search(r"detachment +\([-\d.]+, [-\d.]+\) \+- \d", printed)


WAVE = """
title = "A wave and a ceiling"
[domain]
shape = "square"
cells = 48
[equation]
load = 2
[contact]
sides = ["right"]
bound = "upper"
obstacle = "0.56 + 0.1*cos(4*pi*y)"
[[dirichlet]]
sides = "left"
value = 0
"""


@pytest.mark.parametrize("degree", [1, 2])
def test_the_contact_summary_agrees_with_itself(degree, comm, parse):
    # Contact in the middle of the wave, twice: four ends, in order on any number of ranks.
    result = solve_scene(parse(f"degree = {degree}\n{WAVE}"), comm)
    summary = summarise(result, [gather_contact_boundary(result.posed.problem)])
    force = result.posed.problem.force
    pressure, x = result.pressure, ufl.SpatialCoordinate(result.pressure.function_space.mesh)
    right = ufl.conditional(ufl.gt(x[0], 1.0 - 1e-9), pressure, 0.0) * ufl.ds
    total = comm.allreduce(fem.assemble_scalar(fem.form(right)))
    result.destroy()
    places = np.array(summary.detachment_points)
    assert places[:, 0] == pytest.approx(1.0, abs=1e-12) and len(places) == 4
    a, b, c, d = places[:, 1]
    assert 0.0 < a < b < 0.5 < c < d < 1.0
    assert summary.contact_size == pytest.approx(b - a + d - c, abs=1e-9)
    assert summary.forces["contact"] == force == pytest.approx(-total, rel=1e-9)
    assert force < 0.0


@pytest.mark.skipif(not dolfinx.has_adios2, reason="ADIOS2 is missing")
def test_fields_say_where_gap_and_pressure_are_defined(run, comm, parse):
    result = solve_scene(parse(UPPER), comm)
    written = {field.name: field.x.array for field in fields.fields_of(result)}
    problem = result.posed.problem
    owned = slice(0, problem.space.dofmap.index_map.size_local)
    inside = np.ones(problem.u.x.array.shape, dtype=bool)
    inside[problem.system.layout.obstacle_dofs] = False
    here, touching = (written[name] == 1.0 for name in ("contact_boundary", "in_contact"))
    assert (here <= ~inside)[owned].all()
    assert comm.allreduce(int((~inside & ~here)[owned].sum())) == 0
    assert not written["gap"][~here].any() and not written["pressure"][~here].any()
    assert (touching <= here).all() and not written["gap"][touching].any()
    assert (written["gap"][here & ~touching] > 0.0).all()
    assert 0 < comm.allreduce(int(touching[owned].sum())) <= result.solve.active_dofs
    result.destroy()
    out, _ = run(UPPER, "--outputs", "fields")
    if comm.rank == 0:
        written = b"".join(path.read_bytes() for path in (out / "fields.bp").iterdir())
        assert b"contact_boundary" in written and b"in_contact" in written


BESIDE_DIRICHLET = """
degree = {degree}
[domain]
shape = "square"
cells = 3
[contact]
sides = "bottom"
obstacle = 0
[[dirichlet]]
sides = ["left", "top"]
[solution]
u = "-y"
manufactured = true
"""


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_a_uniform_pressure_is_uniform_wherever_it_is_known(degree, comm, parse):
    result = solve_scene(parse(BESIDE_DIRICHLET.format(degree=degree)), comm)
    boundary = gather_contact_boundary(result.posed.problem)
    written = {field.name: field for field in fields.fields_of(result)}
    mask = written["contact_boundary"].x.array
    x = written["u"].function_space.tabulate_dof_coordinates()
    # Bernstein coefficients on the whole facet beside the Dirichlet side have a share in values.
    known = (x[:, 1] < 1e-9) & (x[:, 0] > (1e-9 if degree == 1 else 1.0 / 3.0 - 1e-9))
    assert (mask == known).all() and (written["in_contact"].x.array == known).all()
    assert written["pressure"].x.array == pytest.approx(1.0 * known, abs=1e-6)
    assert written["gap"].x.array == pytest.approx(0.0, abs=1e-9)
    assert written["u"].x.array == pytest.approx(-x[:, 1], abs=1e-6)
    if boundary is not None:  # rank 0
        pressure, place = boundary.values[:, 2], boundary.points[:, 0]
        assert (
            np.isfinite(pressure) == (place > (1e-9 if degree == 1 else 1.0 / 3.0 - 1e-9))
        ).all()
        assert pressure[np.isfinite(pressure)] == pytest.approx(1.0, abs=1e-6)
    result.destroy()


def test_the_record_repeats_the_run(run, comm, parse):
    out, _ = run(UPPER, "--outputs", "boundary")
    record = json.loads((out / "record.json").read_text())
    assert set(record["versions"]) >= {"dolfinx", "petsc", "dolfinx_signorini"}
    result = solve_scene(parse(record["scene"]), comm)
    again = summarise(result, [gather_contact_boundary(result.posed.problem)])
    result.destroy()
    assert record["summary"]["forces"] == pytest.approx(again.forces, rel=1e-9)
    assert record["summary"]["unknowns"] == again.unknowns == 25**2
    assert record["ranks"] == comm.size


def test_the_report_is_one_page_that_needs_nothing_else(run):
    out, _ = run(UPPER, "--report")
    assert {p.name for p in out.iterdir()} == {"record.json", "report.html"}
    text = (out / "report.html").read_text()
    page = Page()
    page.feed(text)
    assert page.open == []
    assert len(page.references) == 2
    assert all(r.startswith("data:image/png;base64,") for r in page.references)
    assert "://" not in text and "@import" not in text  # neither is in the alphabet of base64
    words = "".join(page.words)
    assert "A <ceiling> & a wall" in words and 'obstacle = "0.1 + 0.2*(1 - y)"' in words
    assert "<ceiling>" not in text


def test_fields_without_adios2_are_xdmf(comm, folder, monkeypatch, parse):
    scene = parse(UPPER)
    result = solve_scene(scene, comm)
    monkeypatch.setattr(dolfinx, "has_adios2", False)
    write_fields(result, folder)
    result.destroy()
    comm.barrier()
    text = (folder / "fields.xdmf").read_text()
    assert all(f'Name="{name}"' in text for name in ("u", "gap", "pressure"))
    from dolfinx.io import XDMFFile

    with XDMFFile(comm, str(folder / "fields.xdmf"), "r") as file:
        assert file.read_mesh(name="mesh").topology.index_map(0).size_global == 13**2


def test_earlier_results_are_replaced_and_other_files_stay(run, comm):
    out, _ = run(UPPER, "--outputs", "boundary,pictures")
    if comm.rank == 0:
        (out / "notes.txt").write_text("mine")
    comm.barrier()
    run(UPPER, "--outputs", "boundary")
    assert {p.name for p in out.iterdir()} == {"boundary.csv", "record.json", "notes.txt"}


def test_a_run_that_fails_leaves_earlier_results_alone(run, comm, folder, capsys):
    out, _ = run(UPPER, "--outputs", "boundary")
    before = (out / "record.json").read_bytes()
    comm.barrier()
    if comm.rank == 0:
        (folder / "bad.toml").write_text(UPPER.replace("9*y", "log(-1-y)"))
    comm.barrier()
    assert main(["solve", str(folder / "bad.toml"), "--out", str(out), "--report"]) == 2
    assert (out / "record.json").read_bytes() == before
    assert {p.name for p in folder.iterdir()} == {"out", "scene.toml", "bad.toml"}
    if comm.rank == 0:
        assert "bad.toml, line 8: equation.load: " in capsys.readouterr().err


@pytest.mark.parametrize("where", ["missing/out", "scene.toml"])
def test_a_folder_that_cannot_be_written_is_refused(where, comm, folder, capsys):
    if comm.rank == 0:
        (folder / "scene.toml").write_text(UPPER)
    comm.barrier()
    out = folder / where
    assert main(["solve", str(folder / "scene.toml"), "--out", str(out), "--report"]) == 2
    if comm.rank == 0:
        assert "output folder" in capsys.readouterr().err
        assert [p.name for p in folder.iterdir()] == ["scene.toml"]


def test_check_says_what_a_scene_needs_and_costs(comm, demos, capsys):
    assert main(["check", str(demos / "mixed.toml")]) == 0
    printed = capsys.readouterr().out
    if comm.rank == 0:
        assert "Dirichlet data of the manufactured solution on left, right" in printed
        assert "reaction" not in printed
        assert "about 10404" in printed
        assert "L2 2, L4 2, Linf 1.5, H1 1, W1_4 1, W1_inf 0.5" in printed


@pytest.mark.parametrize("name", ["paper", "mixed", "obstacle", "polygon", "plate", "cube"])
def test_check_knows_the_number_of_unknowns(name, comm, demos, capsys):
    if name in ("polygon", "plate"):
        pytest.importorskip("gmsh")
    assert main(["check", str(demos / f"{name}.toml")]) == 0
    printed = capsys.readouterr().out
    result = solve_scene(load_scene(demos / f"{name}.toml", comm), comm)
    count = result.posed.problem.unknowns
    result.destroy()
    if comm.rank == 0:
        said = int(re.search(r"unknowns +about (\d+)", printed)[1])
        assert said == pytest.approx(count, rel=0.1 if name == "polygon" else 1e-12)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("name", ["mixed", "cube"])
def test_check_counts_the_unknowns_of_both_degrees(name, degree, comm, demos, folder, capsys):
    text = (demos / f"{name}.toml").read_text().replace("cells = 101", "cells = 40")
    path = folder / "scene.toml"
    if comm.rank == 0:
        path.write_text(f"degree = {degree}\n{text}")
    comm.barrier()
    assert main(["check", str(path)]) == 0
    printed = capsys.readouterr().out
    dimension, cells = (2, 40) if name == "mixed" else (3, 15)
    if comm.rank == 0:
        said = int(re.search(r"unknowns +about (\d+)", printed)[1])
        assert said == pytest.approx((degree * cells + 1) ** dimension, rel=0.15)


def test_an_exact_solution_that_is_none_is_noted(comm, folder, capsys):
    if comm.rank == 0:
        (folder / "scene.toml").write_text(
            '[domain]\nshape = "square"\ncells = 4\n[equation]\nreaction = 1\nload = "y"\n'
            '[contact]\nsides = "bottom"\n[solution]\nu = "y"\n'
        )
    comm.barrier()
    assert main(["check", str(folder / "scene.toml")]) == 0
    if comm.rank == 0:
        assert "exact solution: flux >= 0" in capsys.readouterr().out


def test_costs_name_the_terms_of_the_scene_and_no_others(run, comm):
    _, printed = run(UPPER, "--outputs", "boundary", "--costs")
    if comm.rank == 0:
        assert "a: diffusion on cells  " in printed
        assert "fixed_values" in printed
        assert "reaction" not in printed and "exact" not in printed
    _, printed = run(UPPER, "--outputs", "boundary")
    if comm.rank == 0:
        assert "diffusion on cells" not in printed


@pytest.mark.parametrize("arguments", [[], ["--accuracy", "0.3", "--norm", "H1"]])
def test_the_phases_add_up_to_the_time_on_the_wall(arguments, comm, demos, capsys):
    command = ["solve", str(demos / "obstacle.toml"), "--set", "outputs=[]"]
    began = time.perf_counter()
    assert main([*command, *arguments]) == 0
    seconds = time.perf_counter() - began
    printed = capsys.readouterr().out
    if comm.rank == 0:
        total, phases = re.search(r"\n  time +(.+) s: (.+)\n", printed).groups()
        parts = dict(part.rsplit(" ", 1) for part in phases.split(", "))
        expected = {"adaptive loop"} if arguments else {"meshes", "assembly", "solve"}
        assert expected < set(parts)
        assert sum(map(float, parts.values())) == pytest.approx(float(total), abs=0.03)
        assert seconds - 0.3 < float(total) <= seconds + 0.01
