"""The job `sweep`, options that all jobs have, and the messages of the logger."""

import csv
import io
import json
import logging
import math
import re
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from dolfinx import mesh
from dolfinx.io import XDMFFile
from mpi4py import MPI

from dolfinx_signorini import __version__
from dolfinx_signorini.base import logs
from dolfinx_signorini.base.errors import InputError, NotConvergedError
from dolfinx_signorini.base.records import Records, Wanted
from dolfinx_signorini.commands import main as cli
from dolfinx_signorini.commands.options import completion
from dolfinx_signorini.commands.sweep import draw_sweep
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.scenes.solving import solve_scene

COMM = MPI.COMM_WORLD
SCENES = Path(__file__).parents[2] / "demos" / "scenes"
# -u'' = 0 between a flux at the top and the floor 0 at the bottom: the floor bears the whole flux.
PRESSED = """
[domain]
shape = "square"
cells = 4

[contact]
sides = "bottom"
obstacle = 0

[[neumann]]
sides = "top"
flux = -1

[solution]
u = "-y"
"""


@pytest.fixture(autouse=True)
def keep_stdout(monkeypatch):
    """The command line silences stdout of all ranks but one."""
    monkeypatch.setattr(sys, "stdout", sys.stdout)


@pytest.fixture
def scene(folder):
    if COMM.rank == 0:
        (folder / "pressed.toml").write_text(PRESSED)
    COMM.barrier()
    return folder / "pressed.toml"


def sweep(scene, folder, *values, more=()):
    arguments = ["sweep", str(scene), "neumann.1.flux", *values, "--out", str(folder / "out")]
    return cli.main([*arguments, *more])


def test_the_table_has_the_force_of_each_value(scene, folder, capsys):
    assert sweep(scene, folder, "-1", "-2.5") == 0
    said = capsys.readouterr()
    if COMM.rank:
        assert said.out == said.err == ""
        return
    rows = list(csv.DictReader((folder / "out" / "sweep.csv").read_text().splitlines()))
    assert [row["neumann.1.flux"] for row in rows] == ["-1", "-2.5"]
    for row, force in zip(rows, (1.0, 2.5), strict=True):
        assert float(row["force of contact"]) == pytest.approx(force, rel=1e-6)
        assert float(row["in contact"]) == pytest.approx(1.0)
    assert float(rows[0]["error L2"]) < 1e-6
    assert float(rows[1]["error L2"]) == pytest.approx(1.5 / 3**0.5, rel=1e-6)  # of -2.5 y
    assert (folder / "out" / "sweep.png").read_bytes().startswith(b"\x89PNG")
    assert "neumann.1.flux = -2.5: 25 unknowns" in said.err
    assert said.out.count("\n") == 4


def test_a_sweep_goes_on_with_further_values(scene, folder, capsys):
    assert sweep(scene, folder, "-1", more=["-q"]) == 0
    assert capsys.readouterr().err == ""
    if COMM.rank == 0:
        assert not (folder / "out" / "sweep.png").exists()  # no plot of one point
    assert sweep(scene, folder, "-1", "-2") == 0
    assert sweep(scene, folder, "-1", more=["-q"]) == 0
    if COMM.rank == 0:  # nor one of the points of an earlier run
        assert not (folder / "out" / "sweep.png").exists()
    assert sweep(scene, folder, "-1", "-2") == 0
    said = capsys.readouterr().err
    if COMM.rank == 0:
        assert "neumann.1.flux = -1: already done" in said
        assert "neumann.1.flux = -2: 25 unknowns" in said
        lines = (folder / "out" / "rows.jsonl").read_text().splitlines()
        assert [json.loads(line).get("value") for line in lines] == [None, "-1", "-2"]
    assert sweep(scene, folder, "-1", "x^") == 2
    if COMM.rank == 0:
        assert "--set neumann.1.flux" in capsys.readouterr().err


def write_mesh(path, cells):
    """Write the unit square with four sides, each with a tag of its own, as XDMF."""
    domain = friedrichs_keller(COMM, cells)
    middles = mesh.compute_midpoints(domain, 1, facets := boundary_facets(domain))
    tags = np.argmin(np.stack([middles.T[:2], 1.0 - middles.T[:2]]).reshape(4, -1), axis=0)
    sides = mesh.meshtags(domain, 1, facets, tags.astype(np.int32))
    sides.name = "sides"
    with XDMFFile(COMM, path, "w") as file:
        file.write_mesh(domain)
        domain.topology.create_connectivity(1, 2)
        file.write_meshtags(sides, domain.geometry)


def test_rows_of_another_mesh_are_not_taken_for_those_of_this_one(folder):
    text = PRESSED.replace('"bottom"', "1").replace('"top"', "3")
    file = 'shape = "file"\nfile = "mesh.xdmf"\ntags = "sides"'
    scene = folder / "file.toml"
    if COMM.rank == 0:
        scene.write_text(text.replace('shape = "square"\ncells = 4', file))
    for cells in (4, 5):
        write_mesh(folder / "mesh.xdmf", cells)
        assert sweep(scene, folder, "-1", "-2") == 0
        rows = (folder / "out" / "sweep.csv").read_text().splitlines()
        unknowns = [int(row["unknowns"]) for row in csv.DictReader(rows)]
        assert unknowns == 2 * [(cells + 1) ** 2]
        assert "mesh" not in rows[0]


@pytest.mark.parametrize(
    ("fails", "code", "why"),
    [
        ("1", 2, "is not negative"),  # found when the problem is posed
        ("x^", 2, "--set neumann.1.flux"),  # found in the scene file
        ("-3", 3, "a residual too large"),
    ],
)
def test_a_value_that_fails_costs_its_own_row_only(
    scene, folder, capsys, monkeypatch, fails, code, why
):
    def solve(scene, comm):
        if "neumann.1.flux=-3" in scene.overrides:
            raise NotConvergedError("a residual too large", 1.0, "no more steps")
        return solve_scene(scene, comm)

    monkeypatch.setattr("dolfinx_signorini.commands.sweep.solve_scene", solve)
    assert sweep(scene, folder, "-1", fails, "-2", more=["-q"]) == code
    said = capsys.readouterr()
    if COMM.rank:
        assert said.out == said.err == ""
        return
    assert said.err.count("\n") == 1
    assert f"neumann.1.flux = {fails}: not solved: " in said.err and why in said.err
    line = said.out.splitlines()[3]
    assert line.split()[:3] == [fails, "not", "solved:"] and why in line
    rows = list(csv.DictReader((folder / "out" / "sweep.csv").read_text().splitlines()))
    assert [row["neumann.1.flux"] for row in rows] == ["-1", fails, "-2"]
    assert [bool(row["not solved"]) for row in rows] == [False, True, False]
    assert float(rows[2]["force of contact"]) == pytest.approx(2.0, rel=1e-6)
    lines = (folder / "out" / "rows.jsonl").read_text().splitlines()
    assert [json.loads(line).get("value") for line in lines] == [None, "-1", "-2"]
    assert (folder / "out" / "sweep.png").exists()


def test_a_sweep_without_any_solution_says_why(scene, folder, capsys):
    assert sweep(scene, folder, "1", "2") == 2
    said = capsys.readouterr()
    if COMM.rank == 0:
        assert said.out.count("is not negative") == 2
        assert not (folder / "out" / "sweep.png").exists()


def test_values_may_begin_with_a_minus(scene, folder, capsys):
    assert sweep(scene, folder, "-1e0", "-2-0*x", "-(1 + 2)") == 0
    if COMM.rank == 0:
        lines = (folder / "out" / "sweep.csv").read_text().splitlines()
        assert [line.split(",")[0] for line in lines[1:]] == ["-1e0", "-2-0*x", "-(1 + 2)"]
    for values in (["-x"], ["-1", "-x"]):
        capsys.readouterr()
        assert sweep(scene, folder, *values) == 2
        assert COMM.rank or "goes behind --" in capsys.readouterr().err


def test_rows_of_another_sweep_are_refused(scene, folder, capsys):
    assert sweep(scene, folder, "-1") == 0
    assert sweep(scene, folder, "-1", more=["--set", "domain.cells=5"]) == 2
    if COMM.rank == 0:
        assert "holds results for set = []" in capsys.readouterr().err


def test_one_point_is_no_plot():
    row = {"value": "1", "in contact": 0.5, "force of contact": 1.0}
    with pytest.raises(InputError, match="two values"):
        draw_sweep("key", [row])
    figure = draw_sweep("key", [row, row | {"value": "two"}])
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == ["1", "two"]


def test_more_norms_than_colours_are_drawn():
    errors = {f"error L{p}": 1.0 / p for p in range(1, 12)}
    row = {"value": "1", "in contact": 0.5, "force of contact": 1.0, **errors}
    figure = draw_sweep("key", [row, row | {"value": "2"}])
    assert len(figure.axes[2].lines) == len(errors)


def test_versions_and_completion(capsys):
    with pytest.raises(SystemExit) as caught:
        cli.main(["--version"])
    assert caught.value.code == 0
    said = capsys.readouterr().out
    assert (f"dolfinx_signorini {__version__}, dolfinx 0." in said) == (COMM.rank == 0)
    pytest.importorskip("shtab")
    script = completion(cli.make_parser(), "bash")
    assert "--max-unknowns" in script and "sweep" in script


def test_completion_without_shtab_is_refused(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert cli.main(["--completion", "bash"]) == 2
    if COMM.rank == 0:
        assert "apt install python3-shtab" in capsys.readouterr().err


@pytest.mark.parametrize("before", [True, False])
@pytest.mark.parametrize(("option", "told"), [("-q", ()), ("-v", ("matrix", "1 linear solves"))])
def test_quiet_and_verbose(scene, capsys, option, told, before):
    arguments = [option, "solve", str(scene)] if before else ["solve", str(scene), option]
    assert cli.main(arguments) == 0
    said = capsys.readouterr()
    if COMM.rank:
        assert said.out == said.err == ""
        return
    assert "force of contact" in said.out
    assert all(word in said.err for word in told)
    assert bool(said.err) == bool(told)


def test_what_takes_long_is_told_while_it_lasts_and_in_the_end(monkeypatch, caplog, serial):
    with caplog.at_level(logging.INFO, logger="dolfinx_signorini"):
        with logs.Progress("a short step"):
            pass
        assert not caplog.records
        monkeypatch.setattr(logs, "PATIENCE", 0.02)
        with logs.Progress("a long step", total=4.0) as progress:
            progress.advance(1.0)
            time.sleep(0.2)
            told = [record.getMessage() for record in caplog.records]
    assert told and all(line.startswith("  a long step: 25 %, ") for line in told)
    assert all(line.endswith(" left") for line in told)
    assert caplog.records[-1].getMessage().startswith("a long step: 0.")


@pytest.mark.parametrize("made", [{}, {"disable": False}])
def test_a_signal_may_come_before_a_bar_is_complete(made, monkeypatch):
    told = []
    monkeypatch.setattr(sys, "unraisablehook", told.append)
    bar = logs._Bar.__new__(logs._Bar)
    vars(bar).update(made)
    del bar
    assert not told


def test_the_time_that_is_left_follows_the_work_that_is_done(monkeypatch, caplog, serial):
    monkeypatch.setattr(logs, "PATIENCE", 0.0)
    began = time.perf_counter()
    with (
        caplog.at_level(logging.INFO, logger="dolfinx_signorini"),
        logs.Progress("work", total=1e6) as progress,
    ):
        time.sleep(0.3)
        progress.advance(1e4)  # 1 % in 0.3 s or more: 99 times as long is left
        line = caplog.records[-1].getMessage()
    spent = time.perf_counter() - began
    left = line.split(", ")[-1].split()[0]
    minutes, seconds = map(int, left.split(":"))
    assert 29 <= 60 * minutes + seconds <= math.ceil(99.0 * spent)
    assert "work: 1 %" in line


def test_rows_that_are_there_count_as_no_work(folder, caplog, monkeypatch, serial):
    monkeypatch.setattr(logs, "PATIENCE", 0.0)
    records = Records(COMM, folder / "rows.jsonl", {})
    records.append({"n": 1})
    wanted = [Wanted(f"n = {n}", {"n": n}, dict, work=float(n)) for n in (1, 4, 12)]
    with caplog.at_level(logging.INFO, logger="dolfinx_signorini"):
        assert records.table("rows", wanted) == [{"n": 1}, {"n": 4}, {"n": 12}]
    told = [record.getMessage() for record in caplog.records]
    assert "n = 1: already done" in told
    assert sum("rows: 25 %" in line for line in told) >= 1  # 4 of 4 + 12


@pytest.mark.parametrize("listening", [True, False])
def test_a_bar_is_for_a_terminal_that_listens(monkeypatch, listening, serial):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(logs, "PATIENCE", 0.0)
    handler = logs.listen(logging.INFO if listening else logging.WARNING)
    try:
        with logs.Progress("work", total=2.0) as progress:
            progress.advance()
            logs.log.warning("a message")
    finally:
        logs.log.removeHandler(handler)
        logs.log.setLevel(logging.NOTSET)
    shown = screen.getvalue()
    assert ("work: 50 %, " in shown and "\r" in shown) == listening
    # The message has a line of its own, not the rest of a bar's line.
    assert "a message" in re.split("[\r\n]", shown)
