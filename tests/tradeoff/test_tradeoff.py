"""The comparison of configurations: what is measured, resumed, compared and written."""

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini import InputError, friedrichs_keller
from dolfinx_signorini.commands.main import main
from dolfinx_signorini.norms import error_norms
from dolfinx_signorini.paper.solution import paper_family
from dolfinx_signorini.quadrature import QuadratureRule
from dolfinx_signorini.records import Records
from dolfinx_signorini.references import carried
from dolfinx_signorini.tradeoff import measuring
from dolfinx_signorini.tradeoff.comparing import cheapest, pareto_front, targets
from dolfinx_signorini.tradeoff.grid import Item, grid
from dolfinx_signorini.tradeoff.kinds import GRADED_P1, GRADED_P2, UNIFORM_P1, UNIFORM_P2, Kind
from dolfinx_signorini.tradeoff.measuring import measure_grid
from dolfinx_signorini.tradeoff.results import result_files
from dolfinx_signorini.tradeoff.runs import (
    Configuration,
    exact_solution,
    levels,
    solve_configuration,
)

SCENES = Path(__file__).parents[2] / "demos" / "scenes"
PHASES = {"coarse", "mesh", "forms", "assembly", "solve"}


def make_family(rule: int):
    return paper_family(rule=QuadratureRule("Gauss-Jacobi", rule))


def row(error: float, total: float, graded: bool = False, degree: int = 1, n: int = 10):
    return {
        "errors": {"L2": error},
        "total": total,
        "graded": graded,
        "degree": degree,
        "n": n,
        "method": "cascade",
    }


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


@pytest.mark.parametrize("n", [5, 8, 22, 24, 48, 101, 104, 208])
def test_levels_of_graded_meshes_are_coarse(n: int) -> None:
    coarse = levels(Configuration(GRADED_P2, n))
    assert coarse and coarse == sorted(coarse)
    assert all(m <= max(n / 2, 5) for m in coarse)


def test_rows_hold_what_was_measured(comm: MPI.Comm, folder: Path) -> None:
    items = [
        # Loose, by a method that does the same on any partition of the mesh.
        Item(Configuration(UNIFORM_P1, 12, method="bncg", rtol=1e-2)),
        Item(Configuration(GRADED_P2, 12, rtol=1e-7), rule=5, purpose="rule"),
    ]
    norms = ["L4", "W1_inf"]
    records = Records(comm, folder / "rows.jsonl", {})
    rows = measure_grid(records, make_family, items, norms, repeats=2)
    assert len(records.rows) == 2
    for measured, item in zip(rows, items, strict=True):
        run = solve_configuration(comm, make_family(item.rule), item.configuration)
        errors = error_norms(run.u, exact_solution(run, None), norms)
        assert measured["unknowns"] == run.unknowns
        for norm in norms:
            assert math.isclose(measured["errors"][norm], errors[norm], rel_tol=1e-6)
        difference = fem.Function(run.posed.problem.space)
        difference.x.array[:] = -run.u.x.array
        difference.x.array[:] += run.posed.problem.solve("bqnls", rtol=1e-11).x.array
        algebraic = error_norms(difference, None, norms)
        for norm in norms:
            if item.configuration.method == "bncg":
                assert math.isclose(measured["algebraic"][norm], algebraic[norm], rel_tol=1e-3)
            else:
                assert 0.0 < measured["algebraic"][norm] <= 1e-6 * errors[norm]
        run.destroy()
        assert set(measured["seconds"]) == PHASES
        assert 0.0 < measured["fastest"] <= measured["total"] <= measured["slowest"]
        assert measured["peak_bytes"] > 20e6 * comm.size
        assert measured["natural_residual"] <= item.configuration.rtol
        assert 0.5 < measured["errors_interpolated"]["L4"] / measured["errors"]["L4"] < 1.5
    assert len(rows[0]["detachment_points"]) == 0
    assert abs(rows[1]["detachment_points"][0][0] - 0.5) < 0.1


def test_recorded_rows_are_not_measured_again(
    comm: MPI.Comm, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    items = [Item(Configuration(UNIFORM_P1, n)) for n in (4, 6)]
    records = Records(comm, folder / "rows.jsonl", {})
    first = measure_grid(records, make_family, items[:1], ["L2"], repeats=1)
    again = Records(comm, folder / "rows.jsonl", {})
    both = measure_grid(again, make_family, items, ["L2"], repeats=1)
    assert both[0] == first[0]

    def fail(*_: object) -> None:
        raise AssertionError("measured again")

    monkeypatch.setattr(measuring, "solve_configuration", fail)
    assert measure_grid(again, make_family, items, ["L2"], repeats=1) == both


def test_the_grid_respects_its_limit() -> None:
    for limit in (500, 5000, 110_000):
        for item in grid(limit):
            c = item.configuration
            assert (c.kind.degree * c.n) ** 2 < limit
    assert all(
        not item.configuration.kind.graded for item in grid(20_000, dimension=3, sweeps=False)
    )


def test_a_finer_solution_stands_in_for_the_exact_one(comm: MPI.Comm) -> None:
    norms = ["L4", "Linf", "W1_4", "W1_inf"]
    fine = solve_configuration(comm, paper_family(), Configuration(GRADED_P2, 40))
    coarse = solve_configuration(comm, paper_family(), Configuration(UNIFORM_P1, 10))
    exact = error_norms(coarse.u, coarse.posed.exact, norms)
    estimated = error_norms(coarse.u, exact_solution(coarse, fine), norms)
    for norm in norms:
        assert math.isclose(estimated[norm], exact[norm], rel_tol=0.03)
    fine.destroy()
    coarse.destroy()


def test_a_linear_function_is_carried_without_change(comm: MPI.Comm) -> None:
    run = solve_configuration(comm, paper_family(), Configuration(UNIFORM_P2, 6))
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
        (Configuration(Kind(False, 5), 4), "degree"),
        (Configuration(UNIFORM_P1, 4, method="newton"), "method"),
    ):
        with pytest.raises(InputError, match=message):
            solve_configuration(comm, paper_family(), configuration)
    with pytest.raises(InputError, match="plane"):
        solve_configuration(comm, replace(paper_family(), dimension=3), Configuration(GRADED_P1, 4))


@pytest.mark.slow
def test_the_command_on_the_paper(comm: MPI.Comm, folder: Path) -> None:
    out = folder / "out"
    arguments = ["tradeoff", "--out", str(out), "--max-unknowns", "800", "--repeats", "1"]
    assert main(arguments) == 0
    if comm.rank == 0:
        report = json.loads((out / "tradeoff.json").read_text())
        with (out / "tradeoff.csv").open() as file:
            table = list(csv.DictReader(file))
        assert len(table) == len(report["rows"]) == len(grid(800))
        for norm in report["settings"]["norms"]:
            assert (out / f"work_precision_{norm}.png").stat().st_size > 10_000
            assert (out / f"work_precision_{norm}.svg").stat().st_size > 10_000
            errors = [entry["error"] for entry in report["pareto"][norm]]
            assert errors == sorted(errors, reverse=True)
        assert "uniform P1" in (out / "targets.txt").read_text()
        written = {path.name for path in out.iterdir()} - {"rows.jsonl"}
        assert written == set(result_files(report["settings"]["norms"]))
    assert main([*arguments, "--page", str(folder / "page.md")]) == 2  # rows are missing


@pytest.mark.slow
def test_the_command_on_a_scene_without_a_known_solution(comm: MPI.Comm, folder: Path) -> None:
    arguments = ["tradeoff", str(SCENES / "obstacle.toml"), "--out", str(folder), "--norms", "H1"]
    assert main([*arguments, "--max-unknowns", "700", "--repeats", "1"]) == 0
    if comm.rank == 0:
        assert "errors against: graded P2" in (folder / "targets.txt").read_text()


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


def test_the_phases_of_a_run_are_those_of_its_last_solve(comm):
    run = solve_configuration(comm, paper_family(), Configuration(UNIFORM_P1, 70))
    own = sum(run.result.seconds.values())
    run.destroy()
    assert run.seconds["solve"] >= 0.999 * own
    assert min(run.seconds.values()) >= 0.0
