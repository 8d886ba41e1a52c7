"""Where results go: nothing of the user's is deleted, and nothing that was computed is lost."""

import errno
import io
import json
import os
import resource
import sys

import dolfinx
import pytest
from mpi4py import MPI

from dolfinx_signorini.commands.main import main
from dolfinx_signorini.commands.printing import Guarded
from dolfinx_signorini.scenes.output import fields, files
from dolfinx_signorini.scenes.output import folder as folders
from dolfinx_signorini.scenes.output.folder import output_folder

SCENE = """
[domain]
shape = "square"
cells = 30
[equation]
load = -1
[contact]
sides = "bottom"
obstacle = -0.1
[[dirichlet]]
sides = "top"
value = 0
"""


@pytest.fixture
def solve(comm, folder, capsys):
    """Solve the scene with arguments; return the exit code and what was printed."""
    if comm.rank == 0:
        (folder / "scene.toml").write_text(SCENE)
    comm.barrier()

    def solve(*arguments):
        code = main(["solve", str(folder / "scene.toml"), *map(str, arguments)])
        comm.barrier()
        return code, capsys.readouterr()

    return solve


def first(comm, action):
    """Call a function on rank 0; what follows sees its effect on all ranks."""
    if comm.rank == 0:
        action()
    comm.barrier()


def names(comm, folder):
    comm.barrier()
    found = sorted(p.name for p in folder.iterdir())
    comm.barrier()
    return found


def test_folders_of_the_user_next_to_the_results_stay(solve, comm, folder):
    first(comm, (folder / "out.part").mkdir)
    first(comm, lambda: (folder / "out.part" / "thesis.txt").write_text("mine"))
    assert solve("--out", folder / "out", "--outputs", "boundary")[0] == 0
    assert names(comm, folder) == ["out", "out.part", "scene.toml"]
    assert (folder / "out.part" / "thesis.txt").read_text() == "mine"
    assert names(comm, folder / "out") == ["boundary.csv", "record.json"]


def test_all_files_are_written_inside_the_output_folder(solve, comm, folder, monkeypatch):
    """The folder may be a mount point, beside which nothing can be written or renamed."""
    first(comm, (folder / "out").mkdir)
    places = []
    monkeypatch.setattr(
        files, "write_file", lambda path, text, old=files.write_file: (places.append(path),
                                                                      old(path, text))
    )  # fmt: skip
    assert solve("--out", folder / "out", "--outputs", "boundary")[0] == 0
    assert all(path.is_relative_to(folder / "out") for path in places)
    assert bool(places) == (comm.rank == 0)


def test_two_runs_into_one_folder_do_not_share_files(comm, folder):
    out = folder / "out"
    with output_folder(comm, out, ()) as one, output_folder(comm, out, ()) as two:
        assert one != two
        first(comm, lambda: (one / "record.json").write_text('{"versions": {}, "run": 1}'))
    assert names(comm, out) == ["record.json"]


@pytest.mark.parametrize("name", ["report.html", "record.json"])
def test_files_of_the_user_are_not_replaced(name, solve, comm, folder):
    first(comm, (folder / "out").mkdir)
    first(comm, lambda: (folder / "out" / name).write_text('{"mine": 1}'))
    code, printed = solve("--out", folder / "out", "--report")
    assert code == 2 and printed.out == ""
    assert comm.rank or f"has a {name} that is no result" in printed.err
    assert (folder / "out" / name).read_text() == '{"mine": 1}'
    assert names(comm, folder / "out") == [name]


@pytest.mark.parametrize("name", ["contact_boundary.csv", "contact_boundary.png"])
def test_files_of_the_user_that_a_scene_with_two_zones_writes_are_not_replaced(
    name, solve, comm, folder
):
    first(comm, (folder / "out").mkdir)
    first(comm, lambda: (folder / "out" / name).write_text("mine"))
    code, printed = solve("--out", folder / "out", "--outputs", "boundary,pictures")
    assert code == 2 and printed.out == ""
    assert comm.rank or f"has a {name} that is no result" in printed.err
    assert (folder / "out" / name).read_text() == "mine"


def test_files_that_an_earlier_run_did_not_write_stay(solve, comm, folder):
    out = folder / "out"
    assert solve("--out", out, "--outputs", "boundary")[0] == 0
    assert json.loads((out / "record.json").read_text())["files"] == names(comm, out)
    first(comm, lambda: (out / "solution.png").write_text("mine"))
    assert solve("--out", out, "--outputs", "boundary")[0] == 0
    assert (out / "solution.png").read_text() == "mine"
    assert solve("--out", out, "--outputs", "pictures")[0] == 2


@pytest.mark.parametrize("name", ["", " ", "\0"])
def test_a_folder_without_a_name_is_refused(name, solve, comm):
    code, printed = solve("--out", name)
    assert code == 2
    assert comm.rank or "argument --out: must name a folder" in printed.err


def test_the_current_folder_takes_results(solve, comm, folder, monkeypatch):
    first(comm, (folder / "here").mkdir)
    monkeypatch.chdir(folder / "here")
    assert solve("--out", ".", "--outputs", "boundary")[0] == 0
    assert names(comm, folder / "here") == ["boundary.csv", "record.json"]
    assert names(comm, folder) == ["here", "scene.toml"]


def test_the_root_folder_is_refused_or_takes_results(solve, comm, monkeypatch):
    def refuse(**_):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(folders.tempfile, "mkdtemp", refuse)  # writes nothing where root may
    code, printed = solve("--out", "/", "--report")
    assert code == 2 and printed.out == ""
    assert comm.rank or printed.err.startswith("error: output folder /: cannot be written")


@pytest.mark.parametrize("output", ["fields", "boundary", "pictures", "report"])
def test_a_disk_that_fills_up_costs_no_summary(output, solve, comm, folder, monkeypatch):
    """The size of files is limited, too, for what does not ask how much room there is."""

    def fails(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def allocate(file, start, size):
        if size > folders.PROBE:
            fails()

    monkeypatch.setattr(folders.os, "posix_fallocate", allocate)
    if output != "fields":
        monkeypatch.setattr(files, "write_file", fails)
    code, printed = solve("--out", folder / "out", "--outputs", output)
    assert code == 2
    if comm.rank == 0:
        assert "in contact" in printed.out
        wanted = f"output folder {folder / 'out'}: cannot be written: No space left on device"
        assert wanted in printed.err and "Traceback" not in printed.err
    assert names(comm, folder) == ["scene.toml"]


def test_a_disk_that_is_full_before_the_run_is_found_at_once(solve, comm, folder, monkeypatch):
    def fails(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(folders.os, "posix_fallocate", fails)
    code, printed = solve("--out", folder / "out", "--report")
    assert code == 2 and printed.out == ""
    assert comm.rank or "No space left on device" in printed.err
    assert names(comm, folder) == ["scene.toml"]


@pytest.mark.skipif(not dolfinx.has_adios2, reason="ADIOS2 is missing")
def test_fields_that_cannot_be_written_abort_nothing(solve, comm, folder, monkeypatch):
    if comm.size > 1:
        pytest.skip("ADIOS2 fails on one rank only, and waits for it on the others")
    monkeypatch.setattr(fields, "reserve", lambda folder, size: None)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        code, printed = solve("--out", folder / "out", "--outputs", "fields")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert code == 2 and "in contact" in printed.out
    assert "cannot be written: File too large" in printed.err
    assert names(comm, folder) == ["scene.toml"]


class Full(io.StringIO):
    """A standard output on a full disk, which fails when its buffer is written."""

    def flush(self):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_output_that_nobody_can_read_costs_no_files(solve, comm, folder, monkeypatch):
    monkeypatch.setattr(sys, "stdout", Full())
    code, printed = solve("--out", folder / "out", "--outputs", "boundary")
    assert names(comm, folder / "out") == ["boundary.csv", "record.json"]
    if comm.rank == 0:
        assert code == 2
        message = "error: standard output: cannot be written: No space left on device\n"
        assert printed.err == message


def test_a_title_that_a_terminal_cannot_show_is_written_otherwise():
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    guarded = Guarded(stream)
    print("Höhe", file=guarded)
    guarded.flush()
    assert stream.buffer.getvalue() == b"H\\xf6he\n"


@pytest.mark.pure
def test_a_stop_at_any_line_leaves_nothing(tmp_path):
    """A signal is raised at the first, second, ... line that runs while the folder is made."""
    out, file = tmp_path / "out", folders.__file__

    def stop_at(line):
        count = 0

        def trace(frame, event, argument):
            nonlocal count
            count += event == "line"
            if count == line + 1:
                raise KeyboardInterrupt
            return trace if frame.f_code.co_filename == file else None

        sys.settrace(trace)
        try:
            with output_folder(MPI.COMM_SELF, out, ("boundary",)):
                sys.settrace(None)
                return True
        except KeyboardInterrupt:
            return False
        finally:
            sys.settrace(None)

    line = 0
    while not stop_at(line):
        assert not out.exists(), line
        line += 1
    assert line > 20
