"""The study: the paper's digits, the same rows whatever the method, and rows that resume."""

import json
from dataclasses import asdict, replace

import pytest

from dolfinx_signorini.errors import InputError
from dolfinx_signorini.orders import eoc
from dolfinx_signorini.paper.study import PAPER_NORMS, StudySettings, run_study
from dolfinx_signorini.paper.tables import paper_table
from dolfinx_signorini.records import Records

# Relative differences from Table 1, and absolute ones from the orders of Table 2.
DIGITS = {"L4": 1e-4, "W1_4": 1e-4, "Linf": 1e-4, "W1_inf": 2e-4, "H1_2_boundary": 1.3e-2}
ORDERS = {norm: 4e-3 if norm == "H1_2_boundary" else 1e-3 for norm in PAPER_NORMS}


@pytest.mark.parametrize(
    "cells", [[101, 201], pytest.param([301, 401], marks=pytest.mark.slow)], ids=str
)
def test_digits_and_orders_of_the_paper(comm, folder, cells):
    rows = run_study(comm, cells, StudySettings(), folder)
    figures, orders = paper_table(1), paper_table(2)
    for row in rows:
        for norm, tolerance in DIGITS.items():
            assert row["errors"][norm] == pytest.approx(
                figures[str(row["n"])][norm], rel=tolerance
            ), norm
    for norm, tolerance in ORDERS.items():
        errors = [row["errors"][norm] for row in rows]
        (order,) = eoc([1.0 / n for n in cells], errors)
        assert order == pytest.approx(orders[str(cells[1])][norm], abs=tolerance), norm


@pytest.mark.parametrize("method", ["bqnls", "bntr"])
def test_the_method_does_not_matter(comm, folder, method):
    settings = StudySettings(norms=("L4", "W1_inf", "H1_2_boundary"))
    (cascade,) = run_study(comm, [51], settings, folder / "cascade")
    (tao,) = run_study(comm, [51], replace(settings, method=method), folder / method)
    assert tao["errors"] == pytest.approx(cascade["errors"], rel=1e-5)
    assert tao["linear_solves"] == 0 < cascade["linear_solves"]
    assert tao["active_dofs"] == pytest.approx(cascade["active_dofs"], abs=30)


def test_rows_are_on_disk_and_are_not_computed_again(comm, folder, capsys):
    settings = StudySettings(norms=("L4", "Linf"))
    first = run_study(comm, [11, 21], settings, folder)
    capsys.readouterr()
    assert run_study(comm, [11, 21, 41], settings, folder)[:2] == first
    said = capsys.readouterr().err
    if comm.rank == 0:
        assert said.count("already done") == 2
    lines = (folder / "rows.jsonl").read_text().splitlines()
    assert [json.loads(line).get("n") for line in lines] == [None, 11, 21, 41]
    for row in first:
        assert row["unknowns"] == (row["n"] + 1) ** 2
        assert row["ranks"] == comm.size
        assert 0.0 <= row["natural_residual"] <= 1e-7


def test_a_row_does_not_depend_on_the_rows_before(comm, folder):
    settings = StudySettings(norms=("L4", "W1_inf", "Linf", "H1_2_boundary"))
    many = run_study(comm, [21, 41, 81], settings, folder / "many")
    (alone,) = run_study(comm, [81], settings, folder / "alone")
    assert alone["errors"] == pytest.approx(many[-1]["errors"], rel=1e-6)


def test_other_settings_do_not_mix(comm, folder):
    settings = StudySettings(norms=("L4",))
    run_study(comm, [9], settings, folder)
    with pytest.raises(InputError, match="norms"):
        run_study(comm, [9], replace(settings, norms=("L2",)), folder)
    records = Records(comm, folder / "rows.jsonl", asdict(settings))
    assert [row["n"] for row in records.rows] == [9]
