"""The study: the paper's digits, the same rows whatever the method, and rows that resume."""

import json
from dataclasses import asdict, replace

import basix
import pytest
from dolfinx import fem

from dolfinx_signorini.box_meshes import friedrichs_keller
from dolfinx_signorini.errors import InputError
from dolfinx_signorini.norms import error_norms
from dolfinx_signorini.orders import eoc
from dolfinx_signorini.paper.sampling import LINF, PAPER_NAMES, W1_INF, paper_errors
from dolfinx_signorini.paper.solution import PAPER_RULE, christof_haubner
from dolfinx_signorini.paper.study import PAPER_NORMS, StudySettings, run_study
from dolfinx_signorini.paper.tables import paper_table
from dolfinx_signorini.quadrature import FACET_RULE
from dolfinx_signorini.records import Records

# Relative differences from Table 1, and absolute ones from the orders of Table 2.
DIGITS = {"L4": 1e-4, "W1_4": 1e-4, LINF: 1e-4, W1_INF: 2e-4, "H1_2_boundary": 1.3e-2}
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
                figures[str(row["n"])][PAPER_NAMES.get(norm, norm)], rel=tolerance
            ), norm
    for norm, tolerance in ORDERS.items():
        errors = [row["errors"][norm] for row in rows]
        (order,) = eoc([1.0 / n for n in cells], errors)
        known = orders[str(cells[1])][PAPER_NAMES.get(norm, norm)]
        assert order == pytest.approx(known, abs=tolerance), norm


@pytest.mark.parametrize("method", ["bqnls", "bntr"])
def test_the_method_does_not_matter(comm, folder, method):
    settings = StudySettings(norms=("L4", "W1_inf", W1_INF, "H1_2_boundary"))
    (cascade,) = run_study(comm, [51], settings, folder / "cascade")
    (tao,) = run_study(comm, [51], replace(settings, method=method), folder / method)
    assert tao["errors"] == pytest.approx(cascade["errors"], rel=1e-5)
    assert tao["linear_solves"] == 0 < cascade["linear_solves"]
    assert tao["active_dofs"] == pytest.approx(cascade["active_dofs"], abs=30)


def test_rows_are_on_disk_and_are_not_computed_again(comm, folder, caplog):
    settings = StudySettings(norms=("L4", LINF))
    first = run_study(comm, [11, 21], settings, folder)
    caplog.clear()
    with caplog.at_level("INFO", "dolfinx_signorini"):
        assert run_study(comm, [11, 21, 41], settings, folder)[:2] == first
    assert caplog.text.count("already done") == (2 if comm.rank == 0 else 0)
    lines = (folder / "rows.jsonl").read_text().splitlines()
    assert [json.loads(line).get("n") for line in lines] == [None, 11, 21, 41]
    for row in first:
        assert row["unknowns"] == (row["n"] + 1) ** 2
        assert row["ranks"] == comm.size
        assert 0.0 <= row["natural_residual"] <= 1e-7


def test_a_row_does_not_depend_on_the_rows_before(comm, folder):
    settings = StudySettings(norms=("L4", W1_INF, LINF, "Linf", "H1_2_boundary"))
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


def test_samples_of_sup_norms_are_those_of_the_paper(comm):
    """The largest at vertices and midpoints, and the largest at the 16 points of the rule."""
    domain = friedrichs_keller(comm, 2)
    function = fem.Function(fem.functionspace(domain, ("Lagrange", 4)))
    function.interpolate(lambda x: x[0] ** 4)  # midpoints and vertices: multiples of 1/4
    points, _ = PAPER_RULE.points(basix.CellType.triangle)
    assert len(points) == 16
    # Of the triangles with an edge on x = 1, one has two vertices there, of which the second or
    # the third in its counterclockwise order is where the points are the densest.
    nearest = 1.0 - 0.5 * min(points.min(), (1.0 - points.sum(axis=1)).min())
    values = paper_errors(function, None, (LINF, W1_INF, "Linf", "W1_inf"), PAPER_RULE)
    assert values[LINF] == pytest.approx(1.0, rel=1e-13)
    assert 4.0 * 0.85**3 < values[W1_INF] <= 4.0 * nearest**3 * (1 + 1e-13)
    assert values["Linf"] == pytest.approx(1.0, rel=1e-13)
    assert values["W1_inf"] == pytest.approx(4.0, rel=1e-13)


def test_the_order_of_names_and_the_sampling_do_not_change_other_norms(comm):
    exact = christof_haubner(friedrichs_keller(comm, 9))
    zero = fem.Function(fem.functionspace(exact.mesh, ("Lagrange", 1)))
    names = (W1_INF, "W1_4", "H1_2_boundary", LINF, "L4", "Linf_boundary", "H1_2_boundary_spectral")
    together = paper_errors(zero, exact, names, PAPER_RULE)
    assert tuple(together) == names
    for name in names:
        alone = paper_errors(zero, exact, [name], PAPER_RULE)[name]
        assert alone == pytest.approx(together[name], rel=1e-14, abs=0.0)
    general = [name for name in names if name not in PAPER_NAMES]
    expected = {name: together[name] for name in general}
    found = error_norms(zero, exact, general, PAPER_RULE, FACET_RULE)
    assert found == pytest.approx(expected, rel=1e-14, abs=0.0)
