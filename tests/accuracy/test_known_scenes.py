"""The promise of an accuracy, on scenes whose solutions the adaptive loop is not told."""

from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
from known import SCENES, Known, true_error

from dolfinx_signorini.scenes import solve_scene
from dolfinx_signorini.scenes.files.reading import parse_scene

LIMIT = 300_000
REQUESTS = [
    (name, norm, accuracy)
    for name, known in SCENES.items()
    for norm, accuracies in known.accuracies.items()
    for accuracy in accuracies
]
OTHERS = (
    "layer",
    "jump of the diffusion",
    "jump across a circle",
    "strip of load",
    "edge of a cube",
)
STRIP = (("H1", 5e-4), ("W1_4", 7e-3))
# One norm for each scene, in turn; the slow test has all of them.
QUICK = [
    (name, norm, SCENES[name].accuracies[norm][1])
    for name, norm in zip(
        [name for name in SCENES if name not in OTHERS],
        cycle(("Linf", "H1")),
        strict=False,
    )
]


def shares(comm, requests):
    """Return the true error over the accuracy of each request that was reached."""
    found = {}
    for name, norm, accuracy in requests:
        scene = parse_scene(SCENES[name].text, Path(f"{name}.toml"), comm)
        result = solve_scene(scene, comm, accuracy=accuracy, norm=norm, max_unknowns=LIMIT)
        if result.found.reached:
            found[name, norm, accuracy] = true_error(result.u, SCENES[name], norm) / accuracy
        else:
            assert result.found.steps[-1].unknowns > LIMIT / 20
        result.destroy()
    return found


def test_the_true_error_is_below_the_accuracy(comm):
    found = shares(comm, QUICK)
    assert len(found) == len(QUICK)
    assert {key: share for key, share in found.items() if share > 1.0} == {}
    assert np.median(list(found.values())) > 0.2


def test_a_load_that_jumps_along_a_mesh_line_is_estimated_and_resolved(comm):
    # Where all cells are cut at the same share of their width, the true errors were 1.2 and 1.7
    # times what was asked for.
    requests = [("strip of load", norm, accuracy) for norm, accuracy in STRIP]
    found = shares(comm, requests)
    assert len(found) == len(STRIP)
    assert max(found.values()) < 1.0


@pytest.mark.parametrize("degree", [2, 3])
def test_what_is_left_between_a_curve_and_its_facets_is_estimated(comm, degree):
    # Of the stiff side slivers are cut off, some of which have no point of a rule: on average their
    # step moves the whole inside of the circle.
    known, accuracy = SCENES["jump across a circle"], 1e-4
    scene = parse_scene(known.text, Path("circle.toml"), comm)
    result = solve_scene(scene, comm, accuracy=accuracy, norm="L2", degree=degree)
    error, estimate = true_error(result.u, known, "L2"), result.found.estimate
    result.destroy()
    assert error <= estimate <= accuracy
    assert estimate <= 4.0 * error


def test_a_reaction_that_jumps_far_is_definite_on_all_ranks(comm):
    # On three ranks smoothers that leave out couplings between ranks were indefinite.
    text = """
[domain]
shape = "square"
cells = 8
[equation]
reaction = "where(x > 0.71*y + 0.13, 1e4, 0)"
load = "where(x < 3/5, 0, 8*y)"
[contact]
sides = "bottom"
obstacle = "cos(2*x)"
[[dirichlet]]
sides = ["left", "right", "top"]
value = "cos(2*x)"
"""
    scene = parse_scene(text, Path("reaction.toml"), comm)
    result = solve_scene(scene, comm, accuracy=1e-2, norm="L2")
    result.destroy()
    assert result.found.reached


def test_derivatives_on_small_cells_do_not_feel_the_algebraic_error(comm):
    # An end of the solves by nodal values let the loop divide where only their rounding was large.
    text = """
[domain]
shape = "square"
cells = 8
[define]
p = "max(0, x - 0.6)^2"
w = "y*sin(2*x) - 4*y*p + cos(2*x + y)"
r = "where(x > 0.71*y + 0.13, 1e4, 0)"
[equation]
reaction = "r"
load = "4*y*sin(2*x) + 5*cos(2*x + y) + where(x < 0.6, 0, 8*y) + r*w"
[contact]
sides = "bottom"
obstacle = "cos(2*x) - max(0, 0.6 - x)^2"
[[dirichlet]]
sides = ["left", "right", "top"]
value = "w"
"""

    def u(x, y):
        return y * np.sin(2 * x) - 4 * y * np.maximum(0, x - 0.6) ** 2 + np.cos(2 * x + y)

    def gradient(x, y):
        across = 2 * y * np.cos(2 * x) - 8 * y * np.maximum(0, x - 0.6) - 2 * np.sin(2 * x + y)
        return across, np.sin(2 * x) - 4 * np.maximum(0, x - 0.6) ** 2 - np.sin(2 * x + y)

    scene = parse_scene(text, Path("small.toml"), comm)
    result = solve_scene(scene, comm, accuracy=0.021, norm="W1_4", degree=1)
    error = true_error(result.u, Known(text, u, gradient, {}), "W1_4")
    reached, unknowns = result.found.reached, result.found.steps[-1].unknowns
    result.destroy()
    assert reached and error < 0.021
    assert unknowns < 20_000  # 25,000 with the divisions for nothing


@pytest.mark.parametrize(
    "accuracy",
    [
        3e-11,
        pytest.param(
            1e-11, marks=pytest.mark.xfail(strict=True, reason="rounding, at about 1.1e-11")
        ),
    ],
)
def test_an_accuracy_far_below_the_tolerance_of_a_solve_is_reached(comm, accuracy):
    request = "jump of the diffusion", "Linf", accuracy
    assert 0.0 < shares(comm, [request])[request] < 1.0


@pytest.mark.slow
def test_the_true_error_is_below_every_accuracy(comm):
    found = shares(comm, REQUESTS)
    assert len(found) > 0.9 * len(REQUESTS)
    assert {key: share for key, share in found.items() if share > 1.0} == {}
    assert np.median(list(found.values())) > 0.2


def test_a_note_names_a_diffusion_that_jumps_inside_cells(comm):
    scene = parse_scene(SCENES["jump across a circle"].text, Path("jump.toml"), comm)
    result = solve_scene(scene, comm, accuracy=0.3, norm="H1", degree=1)
    result.destroy()
    assert any("the diffusion jumps" in note for note in result.expectation.notes)
    scene = parse_scene(SCENES["jump of the diffusion"].text, Path("line.toml"), comm)
    result = solve_scene(scene, comm, accuracy=1.0, norm="H1")
    result.destroy()
    assert not any("the diffusion jumps" in note for note in result.expectation.notes)
