"""Scenes to an accuracy: they are solved on adapted meshes, and written like any other."""

import json

import numpy as np
import pytest
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini import InputError
from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.commands.main import main
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.pictures.contact_boundary import gather_contact_boundary
from dolfinx_signorini.scenes import load_scene, solve_scene
from dolfinx_signorini.scenes.output.summary import summarise

DETACHING = """
accuracy = 4e-3
norm = "W1_4"
[domain]
shape = "square"
[contact]
sides = "bottom"
bound = "{bound}"
[[dirichlet]]
sides = ["left", "right", "top"]
[solution]
u = "{sign}hypot(x - 0.41337, y)^1.5*sin(1.5*atan2(y, x - 0.41337))"
manufactured = true
"""


@pytest.mark.parametrize("rtol", [1e-6, 1e-10])
def test_the_residual_of_a_scene_holds_with_an_accuracy_too(rtol, comm, parse):
    text = DETACHING.format(bound="lower", sign="-")
    scene = parse(f"rtol = {rtol}\n{text}")
    result = solve_scene(scene, comm, norm="L2", accuracy=3e-5, degree=1)
    assert "multigrid" in result.solve.preconditioner  # no factors, which leave rounding alone
    assert result.found.reached and 0.0 < result.solve.natural_residual <= rtol
    result.destroy()


@pytest.mark.parametrize(("bound", "sign"), [("lower", "-"), ("upper", "")])
def test_a_scene_reaches_the_accuracy_of_its_file(comm, parse, bound, sign):
    result = solve_scene(parse(DETACHING.format(bound=bound, sign=sign)), comm)
    error = error_norms(result.u, result.posed.exact, ["W1_4"])["W1_4"]
    summary = summarise(result, [gather_contact_boundary(result.posed.problem)])
    gap = result.gap.x.array.copy()
    # The pressure is 1.5 r^{1/2} at the distance r from the point. What the corner of the bottom
    # carries is the force of Dirichlet data.
    space = result.u.function_space
    degree, x = space.element.basix_element.degree, space.mesh.geometry.x
    inner = x[(x[:, 1] == 0.0) & (x[:, 0] < 1.0), 0].max(initial=0.0)
    inner = comm.allreduce(inner, op=MPI.MAX)
    at = np.linspace(inner, 1.0, 2001)
    corner = np.trapezoid(
        1.5 * np.sqrt(at - 0.41337) * ((at - inner) / (1.0 - inner)) ** degree, at
    )
    assert error <= result.found.estimate <= 4e-3
    result.destroy()
    assert error >= 8e-4
    assert gap.min(initial=0.0) >= -1e-12
    force = 0.58663**1.5 - corner
    assert abs(summary.forces["contact"]) == pytest.approx(force, rel=1e-4)
    assert summary.forces["contact"] * (1.0 if bound == "lower" else -1.0) > 0.0
    assert summary.imbalance <= 1e-4
    # The obstacle is the solution on the whole facet with the point, 1/64 long, and next to the
    # facet far from the solution.
    assert summary.detachment_points[0] == pytest.approx((0.41337, 0.0), abs=0.02)


CUBIC = """
[domain]
shape = "square"
cells = 8
[equation]
load = "-1 - 2*y"
[contact]
sides = "bottom"
obstacle = "-0.4"
[[dirichlet]]
sides = "top"
value = 0
"""


@pytest.mark.parametrize("accuracy", [1e-8, 1e-13])
def test_a_solution_in_the_space_is_found_to_rounding(comm, parse, accuracy):
    # No residual relative to the error is reached where rounding is all that is left.
    result = solve_scene(parse(CUBIC), comm, accuracy=accuracy, norm="Linf")
    assert result.found.reached
    exact = fem.Function(result.u.function_space)
    exact.interpolate(lambda x: x[1] ** 2 / 2 + x[1] ** 3 / 3 - 13 * x[1] / 30 - 0.4)
    exact.x.array[:] -= result.u.x.array
    # On one rank 3e-14, and on three ranks, whose sums have another order, 2e-13.
    assert error_norms(exact, None, ["Linf"])["Linf"] <= ROUNDING
    result.destroy()


HARDLY_PRESSED = """
degree = 2
[domain]
shape = "square"
cells = 8
[define]
r2 = "(x - {x})^2 + (y - {y})^2"
bump = "exp(-{narrow}*r2)"
[equation]
reaction = 1
load = "(1 + 4*{narrow} - 4*{narrow}^2*r2)*bump"
[contact]
sides = "bottom"
obstacle = "bump"
bound = "upper"
[[dirichlet]]
sides = ["left", "right", "top"]
value = "bump"
"""


@pytest.mark.parametrize("x,y,narrow", [(0.7781, 0.4421, 11533.2), (0.7867, 0.4492, 2287.6)])
def test_cells_that_move_a_solution_off_what_hardly_presses_are_divided(comm, parse, x, y, narrow):
    """The whole side is in contact without a pressure, and the load moves coarse solutions off."""
    scene = parse(HARDLY_PRESSED.format(x=x, y=y, narrow=narrow))
    result = solve_scene(scene, comm, accuracy=1e-8, norm="L2_boundary", max_unknowns=40_000)
    assert result.found.reached
    space = result.u.function_space
    below = mesh.locate_entities_boundary(space.mesh, 1, lambda x: np.isclose(x[1], 0.0))
    dofs = fem.locate_dofs_topological(space, 1, below)
    # Coefficients of the Bernstein basis, of which values are means; the bump is smaller.
    assert comm.allreduce(np.abs(result.u.x.array[dofs]).max(initial=0.0), op=MPI.MAX) <= 1e-8
    result.destroy()


def test_arguments_go_before_the_scene(comm, parse):
    scene = parse(DETACHING.format(bound="lower", sign="-"))
    result = solve_scene(scene, comm, accuracy=1e-4, norm="L4")
    assert error_norms(result.u, result.posed.exact, ["L4"])["L4"] <= 1e-4
    result.destroy()
    result = solve_scene(scene, comm, budget=30.0, max_unknowns=20_000, degree=1)
    request = result.found.request
    assert (request.budget, request.accuracy, request.target.name) == (30.0, None, "W1_4")
    assert 5_000 <= result.posed.problem.unknowns <= 20_000
    assert result.u.function_space.element.basix_element.degree == 1
    result.destroy()


def test_the_command_says_and_writes_what_was_chosen(comm, demos, folder, capfd):
    out = folder / "results"
    arguments = ["--accuracy", "0.05", "--norm", "W1_inf", "--out", str(out)]
    assert main(["solve", str(demos / "mixed.toml"), *arguments]) == 0
    comm.barrier()
    if comm.rank == 0:
        lines = {line[2:22].strip(): line for line in capfd.readouterr().out.splitlines()}
        assert {"asked for", "came out", "balance of forces"} <= set(lines)
        record = json.loads((out / "record.json").read_text())
        assert record["options"] == {"accuracy": 0.05, "norm": "W1_inf", "degree": 2}
        last = record["meshes"][-1]
        assert last["estimate"] <= 0.05 < record["meshes"][-2]["estimate"]
        assert last["unknowns"] == record["summary"]["unknowns"]
        assert f"{last['estimate']:.2e}" in lines["came out"]
        assert f"{last['estimate']:.2e}" in (out / "report.html").read_text()
        rows = np.genfromtxt(out / "boundary.csv", delimiter=",", names=True)
        assert rows["gap"].min() >= -1e-12


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('norm = "L0"', "line 3: norm: "),
        ("norm = 2", "line 3: norm: must be a text"),
    ],
)
def test_what_does_not_go_with_an_accuracy_is_refused(parse, line, message):
    text = DETACHING.format(bound="lower", sign="-").replace('norm = "W1_4"', line)
    with pytest.raises(InputError, match=message):
        parse(text)


@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf", '"small"', "true"])
def test_an_accuracy_that_makes_no_sense_is_refused(parse, value):
    text = DETACHING.format(bound="lower", sign="-").replace("4e-3", value)
    with pytest.raises(InputError, match="line 2: accuracy: must be"):
        parse(text)


def test_a_norm_needs_an_accuracy(parse):
    text = DETACHING.format(bound="lower", sign="-").replace("accuracy = 4e-3", "")
    with pytest.raises(InputError, match="line 3: norm: there is no 'accuracy'"):
        parse(text)


@pytest.mark.parametrize(
    ("scene", "arguments", "message"),
    [
        ("mixed", ["--accuracy", "-1"], "accuracy: must be a positive number"),
        ("mixed", ["--accuracy", "nan"], "accuracy: must be a positive number"),
        ("mixed", ["--accuracy", "1", "--norm", "L0"], "norm: "),
        ("mixed", ["--accuracy", "1", "--budget", "1"], "not allowed with"),
        ("mixed", ["--norm", "L4"], "--norm: goes with --accuracy or --budget"),
        ("mixed", ["--max-unknowns", "9"], "--max-unknowns: goes with --accuracy or --budget"),
        ("mixed", ["--budget", "1", "--max-unknowns", "0"], "--max-unknowns: must be a positive"),
        (
            "mixed",
            ["--accuracy", "1", "--max-unknowns", "9"],
            "--max-unknowns: the coarsest",
        ),
    ],
)
def test_a_request_that_cannot_be_met_is_refused(
    comm, demos, folder, capfd, scene, arguments, message
):
    out = folder / "results"
    path = str(demos / f"{scene}.toml")
    assert main(["solve", path, "--out", str(out), *arguments]) == 2
    comm.barrier()
    assert not out.exists()
    if comm.rank == 0:
        error = capfd.readouterr().err
        assert message in error and "Traceback" not in error


def test_the_best_solution_is_written_where_the_accuracy_is_not_reached(comm, demos, folder, capfd):
    out = folder / "results"
    limits = ["--accuracy", "1e-9", "--max-unknowns", "2000"]
    assert main(["solve", str(demos / "mixed.toml"), "--out", str(out), *limits]) == 3
    comm.barrier()
    if comm.rank == 0:
        assert "a finer mesh has more than 2000 unknowns" in capfd.readouterr().out
        record = json.loads((out / "record.json").read_text())
        assert 500 <= record["summary"]["unknowns"] <= 2000


def test_a_budget_is_kept(comm, parse):
    scene = parse(DETACHING.format(bound="lower", sign="-"))
    solve_scene(scene, comm, accuracy=0.1).destroy()  # the forms are compiled
    result = solve_scene(scene, comm, budget=1.5)
    result.destroy()
    assert result.found.seconds <= 3.0
    assert result.found.stopped == "the next step would take longer than the time that is left"


def test_the_mesh_of_a_file_is_refined(comm, demos):
    scene = load_scene(demos / "plate.toml", comm)
    coarse = solve_scene(scene, comm)
    fine = solve_scene(scene, comm, accuracy=1e-3, norm="H1")
    coarse.destroy()
    fine.destroy()
    assert fine.found.reached
    assert fine.posed.problem.unknowns > coarse.posed.problem.unknowns
    assert "in H1; the accuracy is reached" in repr(fine) and len(repr(fine)) < 200
