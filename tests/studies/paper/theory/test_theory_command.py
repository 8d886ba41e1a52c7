"""Checks, rows on disk, and the command with its document."""

import math

import numpy as np
import pytest
from mpi4py import MPI

from dolfinx_signorini.commands import main as cli
from dolfinx_signorini.commands import theory as command
from dolfinx_signorini.studies.paper.theory import checks, families
from dolfinx_signorini.studies.paper.theory.proven import interpolation_constant
from dolfinx_signorini.studies.paper.theory.statements import MEASURED, STATEMENTS, select

COMM = MPI.COMM_WORLD


def figures(order):
    return [(n, 3.0 * n**-order) for n in (50, 100, 200)]


@pytest.mark.parametrize(
    ("order", "holds"), [(1.5, True), (1.46, True), (1.44, False), (1.56, False), (2.0, False)]
)
def test_an_order_lies_between_two_limits(order, holds):
    verdict = checks.Order(1.5, 1.5).judge(figures(order))
    assert verdict.holds == holds
    assert verdict.measured == f"order {order:.3f}"


def test_no_order_of_zeros():
    assert not checks.Order(1.0, 2.0).judge([(50, 0.0), (100, 0.0)]).holds


def test_an_inequality_holds_on_every_mesh():
    rule = checks.Within(0.0, 1.0)
    assert rule.judge([(50, 0.0), (100, 1.0)]).holds
    for value in (1.0 + 1e-6, -1e-6, math.nan):
        assert not rule.judge([(50, value), (100, 0.5)]).holds


def test_a_slope_in_the_logarithm():
    grows = [(n, 7.0 + 0.3 * math.log(n)) for n in (50, 100)]
    assert checks.Slope(0.3).judge(grows).holds
    assert not checks.Slope(0.4).judge(grows).holds
    assert not checks.Slope(0.3).judge([(50, 7.0), (100, 7.0)]).holds


def test_values_are_normalised():
    read = checks.value_of({"of": "deep/e", "power": 1.0, "to": 4.0})
    n = 50
    row = {"n": n, "deep": {"e": 2.0 / n}}
    assert read(row) == pytest.approx(16.0)


def test_the_constant_of_the_interpolation():
    # -r^{3/2} sin(3/2 theta) on rings of triangles far from the point, where the Hessian hardly
    # changes within a triangle, against the quadrature over the angle.
    nodes, weights = np.polynomial.legendre.leggauss(4)
    s, w = 0.5 * (nodes + 1.0), 0.5 * weights
    low, high = 40, 80  # radii in units of h
    i, j = np.meshgrid(np.arange(-high, high), np.arange(0, high))
    z0 = (i + 1j * j).ravel()
    z0 = z0[(np.abs(z0 + 0.5 + 0.5j) > low) & (np.abs(z0 + 0.5 + 0.5j) < high)]
    total = 0.0
    for corners in ((0.0, 1.0, 1.0 + 1.0j), (1.0 + 1.0j, 1.0j, 0.0)):
        u = [-((z0 + c) ** 1.5).imag for c in corners]
        a, b = corners[1] - corners[0], corners[2] - corners[0]
        det = a.real * b.imag - a.imag * b.real
        gx = ((u[1] - u[0]) * b.imag - (u[2] - u[0]) * a.imag) / det
        gy = ((u[2] - u[0]) * a.real - (u[1] - u[0]) * b.real) / det
        for p, wp in zip(s, w, strict=True):
            for q, wq in zip(s, w, strict=True):
                z = z0 + corners[0] + a * p * (1.0 - q) + b * p * q
                slope = 1.5 * np.sqrt(z)
                error = (-slope.imag - gx) ** 4 + (-slope.real - gy) ** 4
                total += wp * wq * p * det * float(error.sum())
    assert total / math.log(high / low) == pytest.approx(interpolation_constant(), rel=0.02)


def test_constants_are_printed_as_they_are_computed():
    first, second, third = MEASURED["4.4.1"].checks
    assert first.rule.constant == interpolation_constant()
    assert first.proven == f"B = {first.rule.constant:.4f}"
    assert second.proven == f"10^4 B = {second.rule.constant:.0f}"
    assert third.proven == f"{third.rule.constant:.5f}"


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (3e-13, "< 1e-09"), (-3e-13, "< 1e-09"), (1.5e-5, "1.50e-05"), (0.25, "0.2500")],
)
def test_rounding_is_printed_as_a_bound(value, text):
    assert checks.number(value) == text


def test_selection():
    assert [s.key for s in select(["3.6", "3.4", "3.6"])] == ["3.6", "3.4"]
    assert select(None) == list(STATEMENTS)
    assert MEASURED.keys() < {s.key for s in STATEMENTS}


@pytest.fixture
def small(monkeypatch):
    """Let the command run on meshes that show the mechanics only."""
    monkeypatch.setattr(command, "SMALLEST", 51)


def run(folder, *arguments):
    return cli.main(["theory", "--out", str(folder), "--max-n", "51", *arguments])


@pytest.mark.usefixtures("small")
def test_the_command_writes_and_resumes(folder, monkeypatch, capsys):
    assert run(folder, "--statement", "enclosure") == 0
    text = (folder / "theory.md").read_text()
    rows = (folder / "rows.jsonl").read_text()
    printed = capsys.readouterr().out
    COMM.barrier()
    assert "### Where contact is, enclosed" in text
    assert "Theorem 3.6" not in text
    assert "--statement enclosure" in text
    assert "theory/enclosure.png" in text
    assert (folder / "theory" / "enclosure.png").stat().st_size > 10_000
    if COMM.rank == 0:
        assert "### Where contact is, enclosed" in printed
    # All rows are there: nothing is computed again, and the document is the same.
    monkeypatch.setattr(families, "compute_row", None)
    assert run(folder, "--statement", "enclosure") == 0
    assert (folder / "theory.md").read_text() == text
    assert (folder / "rows.jsonl").read_text() == rows


@pytest.mark.usefixtures("small")
def test_a_stopped_run_goes_on(folder, monkeypatch):
    compute, done = families.compute_row, []

    def until_the_first(comm, experiment, n):
        if len(done) == 1:
            raise KeyboardInterrupt
        done.append(n)
        return compute(comm, experiment, n)

    monkeypatch.setattr(families, "compute_row", until_the_first)
    assert run(folder, "--statement", "2.4.3") == 130
    assert done == [25]
    rows = (folder / "rows.jsonl").read_text()
    COMM.barrier()
    monkeypatch.setattr(families, "compute_row", compute)
    assert run(folder, "--statement", "2.4.3") == 0
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
