"""Checks, rows on disk, and the command with its document."""

import math

import pytest
from mpi4py import MPI

from dolfinx_signorini.commands import main as cli
from dolfinx_signorini.commands import theory as command
from dolfinx_signorini.paper.theory import evidence, experiments
from dolfinx_signorini.paper.theory.proven import ProvenOrder
from dolfinx_signorini.paper.theory.report import Document
from dolfinx_signorini.paper.theory.statements import STATEMENTS, select

COMM = MPI.COMM_WORLD
# Numbers of the paper that have to have a row.
PAPER = ("3.2", "3.3", "3.4", "3.5", "3.6", "4.1", "4.2", "4.3", "5.2", "5.4", "5.6", "5.7", "6.1")


def family(order, cells=(50, 100, 200)):
    return [{"n": n, "e": 3.0 * n**-order, "deep": {"e": n**-order}} for n in cells]


@pytest.mark.parametrize(("order", "holds"), [(1.5, True), (1.46, True), (1.44, False), (2, True)])
def test_an_order_holds_within_a_twentieth(order, holds):
    found = evidence.order_check(
        "e", family(order), evidence.entry("e"), ProvenOrder(1.5, True, "")
    )
    assert found.holds == holds
    assert found.measured == f"{order:.3f} (N = 100 to 200)"
    assert found.proven == "order 1.5 - eps"


def test_a_reason_is_given_where_it_is_needed():
    for order, reason in ((1.5, ""), (1.8, "because")):
        found = evidence.order_check(
            "e", family(order), evidence.entry("deep", "e"), ProvenOrder(1.5, False, ""), "because"
        )
        assert found.reason == reason


def test_an_inequality_holds_up_to_rounding():
    assert evidence.bound_check("", "<= 0", -1.0).holds
    assert evidence.bound_check("", ">= 0", 1.0).holds
    assert evidence.bound_check("", "<= 1", 1.0 + 1e-11).holds
    for value in (1e-6, math.nan):
        assert not evidence.bound_check("", "<= 0", value).holds
        assert not evidence.bound_check("", ">= 0", -value).holds


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (3e-13, "< 1e-09"), (-3e-13, "< 1e-09"), (1.5e-5, "1.500e-05"), (0.25, "0.2500")],
)
def test_rounding_is_printed_as_a_bound(value, text):
    assert evidence.number(value) == text


def test_tables_are_aligned():
    text = evidence.order_table(family(2.0), {"e": evidence.entry("e")}, {"N^2 e": lambda row: 3.0})
    lines = text.splitlines()
    assert len({len(line) for line in lines}) == 1
    head = [cell.strip() for cell in lines[0].split("|")[1:-1]]
    assert head == ["N", "e", "order", "N^2 e"]
    assert [cell.strip() for cell in lines[3].split("|")[1:-1]] == [
        "100",
        "3.000e-04",
        "2.000",
        "3.000",
    ]


def test_every_statement_of_the_paper_has_its_experiment():
    keys = {statement.key for statement in STATEMENTS}
    assert keys >= set(PAPER)
    known = experiments.experiments()
    for statement in STATEMENTS:
        assert set(statement.experiments) <= set(known)


def test_selection():
    assert [s.key for s in select(["3.6", "3.4", "3.6"])] == ["3.6", "3.4"]
    assert select(None) == list(STATEMENTS)


@pytest.fixture
def small(monkeypatch):
    """Let the command run on meshes that show the mechanics only."""
    monkeypatch.setattr(command, "SMALLEST", 51)


def run(folder, *arguments):
    return cli.main(["theory", "--out", str(folder), "--max-n", "51", *arguments])


@pytest.mark.usefixtures("small")
def test_the_command_writes_and_resumes(folder, monkeypatch, capsys):
    assert run(folder, "--statement", "5.5") == 0
    text = (folder / "theory.md").read_text()
    rows = (folder / "rows.jsonl").read_text()
    printed = capsys.readouterr().out
    COMM.barrier()
    assert "## Definition 5.5, condition (A_h)" in text
    assert "Theorem 3.6" not in text
    assert "--statement 5.5" in text
    assert "theory/contact_sets.png" in text
    assert (folder / "theory" / "contact_sets.png").stat().st_size > 10_000
    if COMM.rank == 0:
        assert "## Definition 5.5, condition (A_h)" in printed
    # All rows are there: nothing is computed again, and the document is the same.
    monkeypatch.setattr(experiments, "compute_row", None)
    assert run(folder, "--statement", "5.5") == 0
    assert (folder / "theory.md").read_text() == text
    assert (folder / "rows.jsonl").read_text() == rows


@pytest.mark.usefixtures("small")
def test_a_stopped_run_goes_on(folder, monkeypatch):
    compute, done = experiments.compute_row, []

    def until_the_second(comm, experiment, n):
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(n)
        return compute(comm, experiment, n)

    monkeypatch.setattr(experiments, "compute_row", until_the_second)
    assert run(folder, "--statement", "2.2") == 130
    assert done == [15, 31]
    rows = (folder / "rows.jsonl").read_text()
    COMM.barrier()
    monkeypatch.setattr(experiments, "compute_row", compute)
    assert run(folder, "--statement", "2.2") == 0
    whole = (folder / "rows.jsonl").read_text()
    assert whole.startswith(rows)
    assert whole.count("\n") == rows.count("\n") + 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--statement", "9.9"], "--statement: unknown '9.9'"),
        (["--max-n", "100"], "--max-n: must lie between 201 and 1001, not 100"),
        (["--max-n", "many"], "argument --max-n"),
    ],
)
def test_arguments_that_make_no_sense(folder, capsys, arguments, message):
    assert cli.main(["theory", "--out", str(folder), *arguments]) == 2
    if COMM.rank == 0:
        assert message in capsys.readouterr().err
    assert not (folder / "rows.jsonl").exists()


@pytest.mark.slow
def test_every_check_holds(folder):
    chosen = list(STATEMENTS)
    rows = experiments.run_experiments(COMM, experiments.experiments(), 201, folder)
    for key, found in Document(chosen, rows, 201).checks.items():
        for check in found:
            assert check.holds, (key, check)
