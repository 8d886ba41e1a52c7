"""The comparison of configurations: what is measured, resumed, compared and written."""

import csv
import json
import math
import time
from dataclasses import replace
from pathlib import Path

import pytest
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini import InputError, friedrichs_keller
from dolfinx_signorini.base.records import Records
from dolfinx_signorini.base.tables import markdown_table
from dolfinx_signorini.commands.main import main
from dolfinx_signorini.meshes.quadrature import QuadratureRule
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.references import carried
from dolfinx_signorini.studies.paper.solution import paper_family
from dolfinx_signorini.studies.tradeoff import measuring
from dolfinx_signorini.studies.tradeoff.comparing import (
    accuracies,
    cheapest,
    compared,
    order_table,
    pareto_front,
    slope,
    target_table,
    targets,
)
from dolfinx_signorini.studies.tradeoff.family import GRADED_P2, UNIFORM_P1, UNIFORM_P2, Kind
from dolfinx_signorini.studies.tradeoff.grid import FIRST, adapted_kinds, grid, ladder
from dolfinx_signorini.studies.tradeoff.measuring import Meter
from dolfinx_signorini.studies.tradeoff.results import result_files
from dolfinx_signorini.studies.tradeoff.runs import (
    Configuration,
    Run,
    exact_solution,
    levels,
)

SCENES = Path(__file__).parents[3] / "demos" / "scenes"
PHASES = {"coarse", "mesh", "forms", "assembly", "solve"}


def make_family(rule: int):
    return paper_family(rule=QuadratureRule("Gauss-Jacobi", rule))


def row(error: float, total: float, mesh: str = "uniform", degree: int = 1, **entries: object):
    own = {"errors": {"L2": error}, "total": total, "mesh": mesh, "degree": degree}
    own |= {"purpose": "main", "norm": None, "accuracy": None, "ranks": 1, "method": "cascade"}
    return own | entries


def test_the_pareto_front_has_what_nothing_beats() -> None:
    rows = [
        row(1.0, 1.0),
        row(0.5, 2.0),
        row(0.6, 3.0),
        row(0.1, 4.0),
        row(0.1, 5.0),
        row(2.0, 1.0),
    ]
    front = pareto_front(rows, "L2")
    assert front == [rows[0], rows[1], rows[3]]


def test_the_cheapest_row_is_accurate_enough() -> None:
    rows = [row(1.0, 1.0), row(0.5, 2.0), row(0.4, 1.5)]
    assert cheapest(rows, "L2", 0.5) == rows[2]
    assert cheapest(rows, "L2", 0.39) is None


def test_targets_are_powers_of_ten_and_the_best_of_uniform_p1() -> None:
    rows = [row(0.5, 1.0), row(0.02, 2.0), row(0.003, 1.0, degree=2)]
    assert targets(rows, "L2") == [0.1, 0.02, 0.01]


def test_the_loop_is_asked_for_what_others_reach_and_for_a_digit_more() -> None:
    rows = [row(0.5, 1.0), row(0.0206, 2.0), row(0.003, 1.0, degree=2)]
    assert accuracies(rows, "L2") == [0.1, 0.02, 0.01, 0.001]
    assert accuracies([row(0.1, 1.0)], "L2") == [0.1, 0.095, 0.01]


def test_the_slope_is_that_of_the_finer_rows() -> None:
    rows = [row(n**-1.5, 1.0, unknowns=n) for n in (1000, 10, 100, 10_000)]
    coarse = [row(7.0, 1.0, unknowns=n) for n in (2, 4, 6, 8)]
    assert slope([*rows, *coarse], "L2") == pytest.approx(1.5)
    assert slope(rows[:2], "L2") == pytest.approx(1.5)
    assert slope(rows[:1], "L2") is None


def test_rows_are_compared_in_the_norm_that_they_were_adapted_for() -> None:
    adapted = {"mesh": "adapted", "accuracy": 0.2, "norm": "L2"}
    reached, short = (
        row(0.1, 1.0, estimate=0.19, **adapted),
        row(0.1, 1.0, estimate=0.21, **adapted),
    )
    uniform, swept = row(0.3, 1.0), row(0.3, 1.0, purpose="rule")
    rows = [reached, short, uniform, swept]
    assert compared(rows, "L2") == [reached, uniform]
    assert compared(rows, "H1") == [uniform]


@pytest.mark.parametrize("n", [5, 8, 22, 24, 48, 101, 104, 208])
def test_levels_of_graded_meshes_are_coarse(n: int) -> None:
    coarse = levels(Configuration(GRADED_P2, n))
    assert coarse and coarse == sorted(coarse)
    assert all(m <= max(n / 2, 5) for m in coarse)


def test_rows_hold_what_was_measured(comm: MPI.Comm, folder: Path) -> None:
    items = [
        # Loose, by a method that does the same on any partition of the mesh.
        Configuration(UNIFORM_P1, 12, method="bncg", rtol=1e-2, purpose="tolerance"),
        Configuration(GRADED_P2, 12, rtol=1e-7, rule=5, purpose="tolerance"),
    ]
    norms = ["L4", "W1_inf"]
    records = Records(comm, folder / "rows.jsonl", {})
    rows = Meter(records, make_family, norms, repeats=2).measured(items)
    assert len(records.rows) == 2
    for measured, item in zip(rows, items, strict=True):
        run = Run(comm, make_family(item.rule), item)
        errors = error_norms(run.u, exact_solution(run, None), norms)
        assert measured["unknowns"] == run.unknowns
        for norm in norms:
            assert math.isclose(measured["errors"][norm], errors[norm], rel_tol=1e-6)
        difference = fem.Function(run.posed.problem.space)
        difference.x.array[:] = -run.u.x.array
        difference.x.array[:] += run.posed.problem.solve("bqnls", rtol=1e-11).x.array
        algebraic = error_norms(difference, None, norms)
        for norm in norms:
            if item.method == "bncg":
                assert math.isclose(measured["algebraic"][norm], algebraic[norm], rel_tol=1e-3)
            else:
                assert 0.0 <= measured["algebraic"][norm] <= 1e-6 * errors[norm]
        run.destroy()
        assert set(measured["seconds"]) == PHASES
        assert 0.0 < measured["fastest"] <= measured["total"] <= measured["slowest"]
        assert measured["peak_bytes"] > 20e6 * comm.size
        assert measured["natural_residual"] <= item.rtol
    assert len(rows[0]["detachment_points"]) == 0
    assert abs(rows[1]["detachment_points"][0][0] - 0.5) < 0.1


def test_recorded_rows_are_not_measured_again(
    comm: MPI.Comm, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    items = [Configuration(UNIFORM_P1, n) for n in (4, 6)]
    records = Records(comm, folder / "rows.jsonl", {})
    first = Meter(records, make_family, ["L2"], repeats=1).measured(items[:1])
    meter = Meter(Records(comm, folder / "rows.jsonl", {}), make_family, ["L2"], repeats=1)
    both = meter.measured(items)
    assert both[0] == first[0]

    def fail(*_: object) -> None:
        raise AssertionError("measured again")

    monkeypatch.setattr(measuring, "Run", fail)
    assert meter.measured(items) == both


def test_an_item_that_takes_long_is_timed_once(
    comm: MPI.Comm, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    records = Records(comm, folder / "rows.jsonl", {})
    meter = Meter(records, make_family, ["L2"], repeats=2)
    (often,) = meter.measured([Configuration(UNIFORM_P1, 4)])
    monkeypatch.setattr(measuring, "ENOUGH", 1e-9)
    (once,) = meter.measured([Configuration(UNIFORM_P1, 6)])
    assert (often["repeats"], once["repeats"]) == (2, 1)


def test_the_adaptive_loop_is_charged_for_all_of_its_steps(comm: MPI.Comm) -> None:
    configuration = Configuration(Kind("adapted", 2), 4, norm="L4", accuracy=2e-3)
    start = time.perf_counter()
    run = Run(comm, paper_family(), configuration)
    wall = time.perf_counter() - start
    assert run.found is not None and run.found.reached
    assert run.found.seconds <= run.total_seconds <= wall
    assert set(run.seconds) == PHASES
    assert run.unknowns == run.found.steps[-1].unknowns
    assert error_norms(run.u, run.posed.exact, ["L4"])["L4"] <= 2e-3
    run.destroy()


def test_a_climb_ends_at_its_limit_and_leaves_out_what_is_reached(
    comm: MPI.Comm, folder: Path
) -> None:
    meter = Meter(Records(comm, folder / "rows.jsonl", {}), make_family, ["L4", "H1"], repeats=1)
    kind = Kind("adapted", 2)
    (first,) = meter.climbed(ladder(kind, "L4", [1.0], 3000))
    estimate = first["estimate"]
    asked = [1.0, 1.5 * estimate, 0.5 * estimate, 1e-4 * estimate, 1e-5 * estimate]
    rows = meter.climbed(ladder(kind, "L4", asked, 3000))
    assert [row["accuracy"] for row in rows] == [asked[0], asked[2], asked[3]]
    assert [row["estimate"] <= row["accuracy"] for row in rows] == [True, True, False]
    assert all(row["unknowns"] <= 3000 and list(row["errors"]) == ["L4"] for row in rows)
    assert compared(rows, "L4") == rows[:2]


@pytest.mark.parametrize("dimension", [2, 3])
def test_first_meshes_of_the_loop_are_within_the_limit(dimension: int) -> None:
    assert adapted_kinds(100, dimension) == []
    kinds = adapted_kinds(110_000, dimension)
    assert [kind.degree for kind in kinds] == list(range(1, 5 if dimension == 2 else 4))
    for limit in (500, 1000, 3000):
        for kind in adapted_kinds(limit, dimension):
            assert (2 * kind.degree * FIRST[dimension] + 1) ** dimension <= limit


def test_the_grid_respects_its_limit() -> None:
    for limit in (500, 5000, 110_000):
        for item in grid(limit):
            c = item
            assert (c.kind.degree * c.n) ** 2 < limit
    assert all(item.kind.mesh == "uniform" for item in grid(20_000, dimension=3, sweeps=False))


def test_a_finer_solution_stands_in_for_the_exact_one(comm: MPI.Comm) -> None:
    norms = ["L4", "Linf", "W1_4", "W1_inf"]
    fine = Run(comm, paper_family(), Configuration(GRADED_P2, 40))
    coarse = Run(comm, paper_family(), Configuration(UNIFORM_P1, 10))
    exact = error_norms(coarse.u, coarse.posed.exact, norms)
    estimated = error_norms(coarse.u, exact_solution(coarse, fine), norms)
    for norm in norms:
        assert math.isclose(estimated[norm], exact[norm], rel_tol=0.03)
    fine.destroy()
    coarse.destroy()


def test_a_linear_function_is_carried_without_change(comm: MPI.Comm) -> None:
    run = Run(comm, paper_family(), Configuration(UNIFORM_P2, 6))
    run.u.interpolate(lambda x: 1.0 + x[0] - 2.0 * x[1])
    domain = friedrichs_keller(comm, 5)
    known = carried(run.u, domain)
    run.destroy()
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1)))
    u.interpolate(lambda x: 1.0 + x[0] - 2.0 * x[1])
    errors = error_norms(u, known, ["Linf", "W1_inf"])
    assert max(errors.values()) < 1e-11


def test_configurations_without_sense_are_refused(comm: MPI.Comm) -> None:
    for configuration, message in (
        (Configuration(UNIFORM_P1, 0), "cell across"),
        (Configuration(Kind("uniform", 5), 4), "degree"),
        (Configuration(UNIFORM_P1, 4, method="newton"), "method"),
        (Configuration(UNIFORM_P1, 4, norm="L2"), "norm"),
        (Configuration(Kind("adapted", 1), 4), "norm"),
    ):
        with pytest.raises(InputError, match=message):
            Run(comm, paper_family(), configuration)
    with pytest.raises(InputError, match="plane"):
        Run(comm, replace(paper_family(), dimension=3), Configuration(GRADED_P2, 4))


@pytest.mark.slow
def test_the_command_on_the_paper(comm: MPI.Comm, folder: Path) -> None:
    out = folder / "out"
    arguments = ["tradeoff", "--out", str(out), "--max-unknowns", "800", "--repeats", "1"]
    assert main(arguments) == 0
    if comm.rank == 0:
        report = json.loads((out / "tradeoff.json").read_text())
        with (out / "tradeoff.csv").open() as file:
            table = list(csv.DictReader(file))
        assert len(table) == len(report["rows"]) > len(grid(800))
        assert {row["mesh"] for row in report["rows"]} == {"uniform", "graded", "adapted"}
        for norm in report["settings"]["norms"]:
            assert (out / f"work_precision_{norm}.png").stat().st_size > 10_000
            assert (out / f"work_precision_{norm}.svg").stat().st_size > 10_000
            errors = [entry["error"] for entry in report["pareto"][norm]]
            assert errors == sorted(errors, reverse=True)
        assert "uniform P1" in (out / "targets.txt").read_text()
        written = {path.name for path in out.iterdir()} - {"rows.jsonl"}
        assert written == set(result_files(report["settings"]["norms"]))
    assert main([*arguments, "--page", str(folder / "page.md")]) == (0 if comm.size == 1 else 2)
    if comm.rank == 0 and comm.size == 1:
        page = (folder / "page.md").read_text()
        for norm in report["settings"]["norms"]:
            cheapest_rows = target_table(compared(report["rows"], norm), norm)
            assert markdown_table(*cheapest_rows) in page
            assert f"(page/work_precision_{norm}.png)" in page
            assert (folder / "page" / f"work_precision_{norm}.png").stat().st_size > 10_000
        assert (folder / "page" / "phases.png").stat().st_size > 10_000


def test_the_table_of_targets_has_the_fastest_of_all_beside_uniform_p1() -> None:
    common = {"n": 4, "rtol": None, "max_unknowns": None}
    rows = [
        row(0.5, 1.0, unknowns=10, **common),
        row(0.02, 8.0, unknowns=90, **common),
        row(0.003, 2.0, degree=2, unknowns=40, **common),
    ]
    _, lines = target_table(rows, "L2")
    own = ("uniform P2, N = 4", "40", "2", "uniform P1, N = 4", "8", "4.0")
    assert lines == [
        ("1.000e-01", *own),
        ("2.000e-02*", *own),
        ("1.000e-02", *own[:3], *lines[2][4:]),
    ]
    assert lines[2][4] == "uniform P1 does not get there"


def test_orders_are_told_beside_what_approximation_allows() -> None:
    rows = [row(n**-1.0, 1.0, unknowns=n * n) for n in (4, 8, 16, 32)]
    columns, lines = order_table(rows, ["L2"])
    assert columns[-1] == "L2"
    assert lines[0] == ("uniform P1", "1024", "1.00 (2)")
    assert ("uniform P2", "0", "- (2.5)") in lines
    assert ("graded P2", "0", "- (3)") in lines


@pytest.mark.slow
def test_the_command_on_a_scene_without_a_known_solution(comm: MPI.Comm, folder: Path) -> None:
    arguments = ["tradeoff", str(SCENES / "obstacle.toml"), "--out", str(folder), "--norms", "H1"]
    assert main([*arguments, "--max-unknowns", "700", "--repeats", "1"]) == 0
    if comm.rank == 0:
        assert "errors against: adapted P3" in (folder / "targets.txt").read_text()


def test_the_command_refuses_nonsense(comm: MPI.Comm, capfd: pytest.CaptureFixture[str]) -> None:
    for arguments, message in (
        (["--norms", "L0"], "--norms"),
        (["--repeats", "0"], "--repeats"),
        (["--max-unknowns", "3"], "--max-unknowns"),
        (["missing.toml"], "missing.toml"),
        ([str(SCENES / "obstacle.toml"), "--page", "x.md"], "--page"),
    ):
        assert main(["tradeoff", *arguments]) == 2
        if comm.rank == 0:
            assert message in capfd.readouterr().err


def test_a_page_on_several_ranks_needs_rows_on_one(comm, folder, capfd):
    if comm.size == 1:
        pytest.skip("is about several ranks")
    page = folder / "page.md"
    assert main(["tradeoff", "--out", str(folder / "out"), "--page", str(page)]) == 2
    assert not page.exists()
    if comm.rank == 0:
        assert "--page: is of rows on one rank" in capfd.readouterr().err


def test_the_phases_of_a_run_are_those_of_its_last_solve(comm):
    run = Run(comm, paper_family(), Configuration(UNIFORM_P1, 70))
    own = sum(run.result.seconds.values())
    run.destroy()
    assert run.seconds["solve"] >= 0.999 * own
    assert min(run.seconds.values()) >= 0.0
