"""What limits the orders of convergence, and that the measured orders are the predicted ones."""

import itertools
import math
from dataclasses import replace

import basix.ufl
import numpy as np
import pytest
from dolfinx import mesh

from dolfinx_signorini.commands.main import main
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.orders import expected_order, expected_orders
from dolfinx_signorini.scenes import solve_scene
from dolfinx_signorini.scenes.domains.kinds import Square
from dolfinx_signorini.scenes.domains.polygons import Polygon
from dolfinx_signorini.scenes.expectations import expect
from dolfinx_signorini.scenes.regularity import largest_angle

# r^{1/2} sin(theta/2) about (1/2, 0): Dirichlet data to the right of it, no flux to the left, and
# a flux that presses against an obstacle at the top.
CHANGE = """
[domain]
shape = "polygon"
vertices = [[0, 0], [0.5, 0], [1, 0], [1, 1], [0, 1]]
width = 0.1
[contact]
sides = 4
[[dirichlet]]
sides = [2, 3, 5]
[[neumann]]
sides = 1
[solution]
u = "sqrt(max(0, (hypot(x - 0.5, y) - x + 0.5)/2))"
manufactured = true
"""
CORNER = """
[domain]
shape = "polygon"
vertices = {vertices}
width = 0.5
[equation]
load = -1
reaction = 1
{diffusion}
[contact]
sides = {contact}
obstacle = -1
[[dirichlet]]
sides = {dirichlet}
value = 0
"""
L_SHAPE = "[[0, 0], [1, 0], [1, 1], [-1, 1], [-1, -1], [0, -1]]"
WEDGE = "[[0, 0], [1, 0], [-1, 1]]"  # 135 degrees at (0, 0)


def test_a_detachment_point_alone_gives_the_orders_of_the_paper():
    for name, order in expected_orders(1, 1.5).items():
        assert order == expected_order(name), name


@pytest.fixture(autouse=True)
def gmsh():
    pytest.importorskip("gmsh")


@pytest.mark.parametrize(
    ("vertices", "contact", "dirichlet", "point", "angle", "exponent"),
    [
        (L_SHAPE, "[1, 2, 3, 4, 5]", "6", (0, 0), 270, 1 / 3),  # contact meets Dirichlet
        (L_SHAPE, "3", "[1, 2, 6]", (0, 0), 270, 2 / 3),  # Dirichlet on both sides
        (L_SHAPE, "3", "2", (0, 0), 270, 2 / 3),  # no flux on both sides
        (L_SHAPE, "[1, 6]", "3", (0, 0), 270, 2 / 3),  # contact on both sides
        (WEDGE, "1", "3", (0, 0), 135, 2 / 3),
        ("[[0, 0], [1, 0], [2, 0], [2, 1], [0, 1]]", "1", "4", (1, 0), 180, 1 / 2),
    ],
)
def test_exponents_at_corners(vertices, contact, dirichlet, point, angle, exponent, comm, parse):
    text = CORNER.format(vertices=vertices, contact=contact, dirichlet=dirichlet, diffusion="")
    scene = parse(text)
    expectation = expect(scene, scene.domain.make(comm))
    x, y = point
    wanted = f"({x}, {y}), angle {angle} degrees"
    assert any(wanted in note and f"u ~ r^{exponent:.3g}" in note for note in expectation.notes)
    assert expectation.orders["H1"] == pytest.approx(exponent, rel=1e-6)
    assert expectation.orders["L2"] == pytest.approx(2 * exponent, rel=1e-6)
    assert any("not convex" in note for note in expectation.notes) == (angle > 180)


def test_an_anisotropic_diffusion_turns_angles(comm, parse):
    """With K = diag(k, 1) the domain to look at is (x / sqrt(k), y)."""
    text = CORNER.format(
        vertices=WEDGE, contact="1", dirichlet="3", diffusion="diffusion = [[9, 0], [0, 1]]"
    )
    scene = parse(text)
    angle = math.pi - math.atan2(1.0, 1.0 / 3.0)
    orders = expect(scene, scene.domain.make(comm)).orders
    assert orders["H1"] == pytest.approx(min(1.0, math.pi / (2.0 * angle)), rel=1e-6)


def test_a_square_has_no_corner_that_matters(comm, parse):
    text = (
        "[domain]\nshape = 'square'\ncells = 4\n[equation]\nreaction = 1\n[contact]\nsides = 'all'"
    )
    scene = parse(text)
    expectation = expect(scene, scene.domain.make(comm))
    assert expectation.notes == ()
    assert expectation.orders == expected_orders(1, 1.5)


def test_orders_where_dirichlet_meets_neumann_on_a_straight_side(comm, parse):
    scene = parse(CHANGE)
    norms = ["L2", "H1", "Linf"]
    errors, cells = [], []
    for width in (0.1, 0.05, 0.025):
        result = solve_scene(replace(scene, domain=Polygon(scene.domain.corners, width)), comm)
        errors.append(error_norms(result.u, result.posed.exact, norms))
        cells.append(result.u.function_space.mesh.topology.index_map(2).size_global)
        predicted = result.expectation.orders
        result.destroy()
    assert predicted["L2"] == pytest.approx(1.0)
    assert [predicted["H1"], predicted["Linf"]] == pytest.approx([0.5, 0.5])
    for norm in norms:
        slope = np.polyfit(-0.5 * np.log(cells), np.log([e[norm] for e in errors]), 1)[0]
        assert slope == pytest.approx(predicted[norm], abs=0.12), norm


@pytest.mark.parametrize("job", ["check", "solve"])
def test_the_command_says_why_orders_are_reduced(job, comm, folder, capsys):
    path = folder / "change.toml"
    if comm.rank == 0:
        path.write_text(CHANGE)
    comm.barrier()
    assert main([job, str(path)]) == 0
    if comm.rank == 0:
        out = capsys.readouterr().out
        assert "expected orders          L2 1, L4 1, Linf 0.5, H1 0.5 (uniform meshes" in out
        assert "; W1_4, W1_inf of the solution infinite" in out
        assert "reduced orders" in out
        assert "(0.5, 0), angle 180 degrees, Dirichlet meets Neumann: u ~ r^0.5" in out


def test_a_scene_with_more_unknowns_starts_from_coarser_meshes():
    levels = [domain.cells for domain in Square(1001).levels()]
    assert levels[-1] == 1001 and levels[0] <= 80
    assert all(n % 2 == 1 for n in levels)
    assert all(2.0 <= b / a <= 9.0 for a, b in itertools.pairwise(levels))


def test_the_largest_angle_is_that_at_the_tip_of_a_crack(comm):
    """All around the tip the angles add up to 2 pi, as around a vertex inside of the domain."""
    angles = np.arange(9) * math.pi / 4.0
    points = np.vstack(([0.0, 0.0], np.column_stack((np.cos(angles), np.sin(angles)))))
    cells = np.array([[0, k, k + 1] for k in range(1, 9)])[: None if comm.rank == 0 else 0]
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    points = points[: None if comm.rank == 0 else 0]
    cracked = mesh.create_mesh(comm, cells, x=points, e=element)
    assert largest_angle(cracked) == pytest.approx(math.tau)
