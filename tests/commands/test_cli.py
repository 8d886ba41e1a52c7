"""The command line: exit codes, one-line refusals, and runs that survive SIGKILL."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import pytest
from mpi4py import MPI

from dolfinx_signorini import __version__
from dolfinx_signorini.commands import main as cli
from dolfinx_signorini.commands import reproduce
from dolfinx_signorini.pictures.picture import picture_files
from dolfinx_signorini.solvers.linear.projected import Projected

TABLES = ("table1.csv", "table2.csv")
# A job of its own inside of one that mpirun started: mpirun does not nest.
alone = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes of its own")
QUICK = ("--norms", "L4,Linf,W1_inf,H1_2_boundary")


@pytest.fixture(autouse=True)
def keep_stdout(monkeypatch):
    """The command line silences stdout of all ranks but one."""
    monkeypatch.setattr(sys, "stdout", sys.stdout)


def refused(capsys, comm, *arguments):
    """Run a command that has to be refused; return its message."""
    assert cli.main(arguments) == 2
    captured = capsys.readouterr()
    if comm.rank:
        assert captured.err == ""
        return None
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    return captured.err


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ((), "JOB"),
        (("nonsense",), "nonsense"),
        (("reproduce", "--max-n", "0"), "--max-n"),
        (("reproduce", "--max-n", "100"), "--max-n"),
        (("reproduce", "--max-n", "-101"), "--max-n"),
        (("reproduce", "--max-n", "1000000"), "--max-n"),
        (("reproduce", "--max-n", "many"), "--max-n"),
        (("reproduce", "--max-n", "201.5"), "--max-n"),
        (("reproduce", "--norms", ""), "--norms"),
        (("reproduce", "--norms", "L4,,Linf"), "--norms"),
        (("reproduce", "--norms", "L4,L0.5"), "L0.5"),
        (("reproduce", "--norms", "L4,W3_4"), "W3_4"),
        (("reproduce", "--method", "simplex"), "simplex"),
        (("reproduce", "--rtol", "0"), "--rtol"),
        (("reproduce", "--rtol", "nan"), "--rtol"),
        (("reproduce", "--rtol", "-1e-8"), "--rtol"),
        (("reproduce", "--unknown"), "--unknown"),
    ],
)
def test_arguments_that_make_no_sense(comm, capsys, folder, arguments, word):
    if arguments and arguments[0] == "reproduce":
        arguments = (*arguments, "--out", str(folder / "new"))
    message = refused(capsys, comm, *arguments)
    assert message is None or word in message
    assert not (folder / "new").exists()


def test_output_folders_that_cannot_be_used(comm, capsys, folder):
    if comm.rank == 0:
        (folder / "file").write_text("in the way\n")
        (folder / "foreign").mkdir()
        (folder / "foreign" / "rows.jsonl").write_text("x,y\n1,2\n")
        (folder / "half").mkdir()
        (folder / "half" / "rows.jsonl").write_text('{"settings": {"method": "cas')
        (folder / "other").mkdir()
        (folder / "other" / "rows.jsonl").write_text('{"settings": {"method": "bncg"}}\n')
    comm.barrier()
    for out in ("file", "file/below", "foreign", "half", "other"):
        message = refused(capsys, comm, "reproduce", "--max-n", "101", "--out", str(folder / out))
        assert message is None or str(folder / out) in message
    message = refused(capsys, comm, "reproduce", "--max-n", "101", "--out", "/proc/results")
    assert message is None or "/proc/results" in message


@pytest.mark.parametrize(
    ("job", "name"),
    [
        ("reproduce", "table1.csv"),
        ("reproduce", "results.json"),
        ("reproduce", "convergence.svg"),
        ("theory", "theory.md"),
        ("theory", "theory/one_sided.png"),
        ("tradeoff", "targets.txt"),
        ("tradeoff", "work_precision_L4.png"),
    ],
)
def test_files_of_others_are_not_overwritten(comm, capsys, folder, job, name):
    path = folder / name
    if comm.rank == 0:
        path.parent.mkdir(exist_ok=True)
        path.write_text("the user's own")
    comm.barrier()
    message = refused(capsys, comm, job, "--out", str(folder))
    assert message is None or f"has a {name} that is no result of this program" in message
    assert path.read_text() == "the user's own"
    assert not (folder / "rows.jsonl").exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is unwritable for root")
def test_a_folder_without_permission(comm, capsys, folder):
    if comm.rank == 0:
        folder.chmod(0o500)
    comm.barrier()
    message = refused(capsys, comm, "reproduce", "--max-n", "101", "--out", str(folder / "new"))
    assert message is None or "cannot be written" in message


def test_help_speaks_once(comm, capsys):
    for arguments in (["--help"], ["reproduce", "--help"]):
        with pytest.raises(SystemExit) as caught:
            cli.main(arguments)
        assert caught.value.code == 0
        said = capsys.readouterr().out
        assert ("usage" in said) == (comm.rank == 0)
    versions = reproduce.versions()
    assert versions["dolfinx_signorini"] == __version__
    assert set(versions) == {"dolfinx_signorini", "dolfinx", "petsc"}


def test_a_solver_that_does_not_converge(comm, capsys, folder):
    arguments = ("reproduce", "--max-n", "101", "--rtol", "1e-30", "--method", "bntr")
    assert cli.main([*arguments, "--out", str(folder)]) == 3
    said = capsys.readouterr().err
    if comm.rank == 0:
        assert "bntr stopped at a relative natural residual" in said
        assert "Traceback" not in said


def test_results_are_written_in_every_form(comm, capsys, folder):
    assert cli.main(["reproduce", "--max-n", "101", *QUICK, "--out", str(folder)]) == 0
    said = capsys.readouterr().out
    if comm.rank:
        assert said == ""
        return
    assert "5.87" in said and "Table 1" in said
    assert said.strip() in (folder / "tables.txt").read_text().strip()
    report = json.loads((folder / "results.json").read_text())
    figure = report["tables"]["table1"]["101"]["L4"]
    assert figure["value"] == report["rows"][0]["errors"]["L4"]
    assert abs(figure["difference"]) < 1e-4
    assert figure["agrees"] and "All printed digits agree" in said
    assert "| 101 " in (folder / "table1.md").read_text()
    for name in ("solution_and_load", "bottom_edge"):
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert "</svg>" in (folder / f"{name}.svg").read_text()
    # Each file that was written is one that would be in the way where another program wrote it.
    written = {path.name for path in folder.iterdir()} - {"rows.jsonl"}
    declared = {*reproduce.TABLES, *picture_files(reproduce.PICTURES)}
    # Orders and their picture need two meshes.
    assert declared - written == {
        "table2.md",
        "table2.csv",
        *picture_files(["convergence"]),
    }
    assert written <= declared


def environment():
    """This environment without what tells a process that mpirun started it."""
    kept = {
        key: value
        for key, value in os.environ.items()
        if not key.startswith(("PMIX_", "PRTE_LAUNCHED", "OMPI_COMM_", "OMPI_UNIVERSE_SIZE"))
    }
    kept["PYTHONPATH"] = str(Path(cli.__file__).parents[2])
    return kept


def command(out, *arguments, ranks=1):
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    job = [sys.executable, "-m", "dolfinx_signorini", "reproduce", *QUICK, "--out", str(out)]
    return [*launcher, *job, *arguments]


def run(out, *arguments, ranks=1):
    done = subprocess.run(
        command(out, *arguments, ranks=ranks),
        env=environment(),
        capture_output=True,
        text=True,
        timeout=300,
    )
    return done.returncode, done.stdout, done.stderr


def run_here(out, *arguments):
    """The same without a process of its own, which is quicker."""
    said, told = StringIO(), StringIO()
    with redirect_stdout(said), redirect_stderr(told):
        code = cli.main(["reproduce", *QUICK, "--out", str(out), *arguments])
    return code, said.getvalue(), told.getvalue()


def figures(folder):
    """All values of both tables."""
    values = {}
    for name in filter(lambda name: (folder / name).exists(), TABLES):
        for row in csv.DictReader((folder / name).read_text().splitlines()):
            for key, value in row.items():
                if value and key != "N" and not key.endswith("_difference"):
                    values[name, row["N"], key] = float(value)
    return values


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of a run that nobody disturbed, and the values in its tables."""
    folder = tmp_path_factory.mktemp("whole")
    code, out, err = run_here(folder, "--max-n", "201")
    assert code == 0, err
    assert "Table 2" in out
    return folder, figures(folder)


def rows_in(folder):
    path = folder / "rows.jsonl"
    return path.read_bytes().count(b"\n") if path.exists() else 0


@alone
@pytest.mark.parametrize(
    "moment",
    [pytest.param("inside the first row", marks=pytest.mark.slow), "after the first row"],
)
def test_a_run_killed_at_any_time_resumes_to_the_same_tables(whole, tmp_path, moment):
    lines = 1 if moment == "inside the first row" else 2
    process = subprocess.Popen(
        command(tmp_path, "--max-n", "201"),
        env=environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    limit = time.monotonic() + 120.0
    while rows_in(tmp_path) < lines and time.monotonic() < limit:
        assert process.poll() is None, "the run ended before it was killed"
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert rows_in(tmp_path) == lines
    assert not (tmp_path / "table1.csv").exists()
    code, _, err = run_here(tmp_path, "--max-n", "201")
    assert code == 0, err
    assert err.count("already done") == lines - 1
    assert figures(tmp_path) == pytest.approx(whole[1], rel=1e-6, abs=0.0)


@alone
def test_a_row_cut_in_the_middle_is_computed_again(whole, tmp_path):
    folder, values = whole
    settings, first, second = (folder / "rows.jsonl").read_bytes().splitlines(keepends=True)
    (tmp_path / "rows.jsonl").write_bytes(settings + first + second[: len(second) // 2])
    code, _, err = run_here(tmp_path, "--max-n", "201")
    assert code == 0, err
    assert "N = 101: already done" in err
    assert "N = 201: already done" not in err
    lines = (tmp_path / "rows.jsonl").read_text().splitlines()
    assert [json.loads(line).get("n") for line in lines] == [None, 101, 201]
    assert figures(tmp_path) == pytest.approx(values, rel=1e-6, abs=0.0)


@alone
@pytest.mark.skipif(shutil.which("mpirun") is None, reason="there is no mpirun")
def test_two_ranks_give_the_same_tables(whole, tmp_path):
    code, out, err = run(tmp_path, "--max-n", "101", ranks=2)
    assert code == 0, err
    assert out.count("Table 1") == 1
    values = {key: value for key, value in whole[1].items() if key[:2] == ("table1.csv", "101")}
    assert len(values) > 2
    assert figures(tmp_path) == pytest.approx(values, rel=1e-6, abs=0.0)


@alone
@pytest.mark.parametrize("ranks", [1, 2])
def test_a_refusal_is_one_line_and_exit_code_2(tmp_path, ranks):
    (tmp_path / "file").write_text("in the way\n")
    code, out, err = run(tmp_path / "file", ranks=ranks)
    assert code == 2
    assert out == ""
    assert err.count("error: ") == 1
    assert "file" in err
    assert "Traceback" not in err


SLOW = """
[domain]
shape = "square"
cells = 400
[contact]
sides = "bottom"
obstacle = -0.1
[equation]
load = -1
[[dirichlet]]
sides = "top"
value = 0
"""


def started(*arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "dolfinx_signorini", *arguments],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def solve_until(number, tmp_path):
    """Send a signal to a run that has its temporary folder; return the process and its errors."""
    (tmp_path / "slow.toml").write_text(SLOW)
    process = started("solve", str(tmp_path / "slow.toml"), "--out", str(tmp_path / "out"))
    limit = time.monotonic() + 60.0
    while not list(tmp_path.glob("out/.part-*")) and time.monotonic() < limit:
        assert process.poll() is None, "the run ended before it was stopped"
        time.sleep(0.005)
    process.send_signal(number)
    return process, process.communicate(timeout=60)[1]


@alone
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_run_that_is_stopped_leaves_nothing(tmp_path, number):
    process, told = solve_until(number, tmp_path)
    assert process.returncode == 128 + number
    assert "Traceback" not in told
    assert not (tmp_path / "out").exists()


@alone
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_what_petsc_calls_stops_the_run(tmp_path, monkeypatch, capsys, number):
    """PETSc makes an error of its own out of the interrupt."""

    def interrupted(*_):
        os.kill(os.getpid(), number)
        time.sleep(1.0)

    monkeypatch.setattr(Projected, "apply", interrupted)
    (tmp_path / "slow.toml").write_text(SLOW)
    arguments = ["--set", "domain.cells=80", "--out", str(tmp_path / "out")]
    assert cli.main(["solve", str(tmp_path / "slow.toml"), *arguments]) == 128 + number
    assert "Traceback" not in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@alone
def test_what_a_killed_run_leaves_is_removed_by_the_next(tmp_path):
    solve_until(signal.SIGKILL, tmp_path)
    assert len(list(tmp_path.glob("out/.part-*"))) == 1
    arguments = ["--out", str(tmp_path / "out"), "--outputs", "boundary"]
    assert (
        cli.main(["solve", str(tmp_path / "slow.toml"), "--set", "domain.cells=4", *arguments]) == 0
    )
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["boundary.csv", "record.json"]


@alone
@pytest.mark.parametrize("console", [False, True])
def test_an_interruption_while_modules_are_loaded_shows_no_traceback(tmp_path, console):
    # A module that the package loads sends the signal, whenever this is.
    (tmp_path / "basix.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n")
    script = tmp_path / "dolfinx-signorini"
    script.write_text("from dolfinx_signorini.commands.main import main\nmain()\n")
    done = subprocess.run(
        [sys.executable, *([str(script)] if console else ["-m", "dolfinx_signorini"]), "--version"],
        env=environment() | {"PYTHONPATH": f"{tmp_path}:{environment()['PYTHONPATH']}"},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_a_table_that_cannot_be_written_is_refused(capsys, comm, folder, monkeypatch):
    # The folder that is in the way seems to appear after the check of the output folder.
    monkeypatch.setattr(reproduce, "check_outputs", lambda *_: None)
    if comm.rank == 0:
        (folder / "table1.md").mkdir()
    comm.barrier()
    assert cli.main(["reproduce", "--max-n", "101", *QUICK, "--out", str(folder)]) == 2
    if comm.rank == 0:
        assert (
            capsys.readouterr().err.splitlines()[-1].endswith("cannot be written: Is a directory")
        )
