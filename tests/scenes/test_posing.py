"""Scenes as discrete problems: what they need and no more, and what does not change the answer."""

from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.data import parsing
from dolfinx_signorini.data.interfaces.jumps import integrable
from dolfinx_signorini.data.interfaces.rules import measures_for
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.elements import control_points
from dolfinx_signorini.meshes.quadrature import CELL_RULE
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.problem.signorini import DEFAULT_RTOL, SignoriniProblem
from dolfinx_signorini.scenes import pose, solve_scene
from dolfinx_signorini.scenes.expectations import expect

SCENE = """
rtol = 1e-11
degree = {degree}
[domain]
shape = "square"
cells = 16
[equation]
diffusion = {diffusion}
load = "{load}"
{reaction}
[contact]
sides = "bottom"
bound = "{bound}"
obstacle = "{obstacle}"
[[dirichlet]]
sides = "top"
value = "{value}"
[[neumann]]
sides = "left"
flux = "{flux}"
"""
LOWER = {
    "degree": 1,
    "diffusion": '"1 + x*y"',
    "load": "-8*(1 + x)",
    "reaction": "reaction = 2",
    "bound": "lower",
    "obstacle": "-0.3 + 0.2*cos(6*x)",
    "value": "0.1*x",
    "flux": "y - 1",
}


def values(result):
    """The values of u at all nodes, in the order of their coordinates.

    A partition is not reproducible: another mesh of the same scene has other local numbers.
    """
    space = result.u.function_space
    owned = space.dofmap.index_map.size_local
    nodes = control_points(space)[:owned].round(10)
    table = np.column_stack((nodes, result.u.x.array[:owned]))
    table = np.concatenate(space.mesh.comm.allgather(table))
    return table[np.lexsort(table[:, :3].T), 3]


def solved(scene, comm):
    result = solve_scene(scene, comm)
    u, active = values(result), result.solve.active_dofs
    result.destroy()
    return u, active


@pytest.mark.parametrize("degree", [1, 2])
def test_an_upper_obstacle_is_a_lower_one_upside_down(degree, comm, parse):
    below = LOWER | {"degree": degree}
    above = below | {
        "bound": "upper",
        "load": "8*(1 + x)",
        "obstacle": "0.3 - 0.2*cos(6*x)",
        "value": "-0.1*x",
        "flux": "1 - y",
    }
    (u, active), (w, mirrored) = (solved(parse(SCENE.format(**s)), comm) for s in (below, above))
    assert 0 < active == mirrored
    assert np.abs(u + w).max() <= 1e-10


def test_translation_by_an_extension_of_the_obstacle(comm, parse):
    """Christof and Haubner, Section 2.2: u - w solves the problem for 0 and L - a(w, .)."""
    posed = pose(parse(SCENE.format(**LOWER)), comm)
    problem = posed.problem
    u = problem.solve(rtol=1e-12)
    space = problem.space
    w = fem.Function(space)
    w.interpolate(lambda x: (-0.3 + 0.2 * np.cos(6.0 * x[0])) * (1.0 + x[1] * np.sin(x[0])))
    load = sum(posed.sources.values(), -ufl.action(posed.a, w))
    top = fem.locate_dofs_topological(space, 1, posed.sided.sides["top"])
    data = fem.Function(space)
    data.interpolate(lambda x: 0.1 * x[0])
    data.x.array[:] -= w.x.array
    twin = SignoriniProblem(
        posed.a, load, contact=problem.contact, bcs=[fem.dirichletbc(data, top)]
    )
    translated = twin.solve(rtol=1e-12)
    difference = u.x.array - w.x.array - translated.x.array
    active = problem.result.active_dofs, twin.result.active_dofs
    problem.destroy()
    twin.destroy()
    assert 0 < active[0] == active[1]
    assert comm.allreduce(float(np.abs(difference).max()), op=MPI.MAX) <= 1e-9


def test_a_scene_assembles_what_it_mentions_and_no_more(comm, parse):
    bare = """
    [domain]
    shape = "square"
    cells = 4
    [contact]
    sides = "bottom"
    [[dirichlet]]
    sides = "top"
    value = 0
    """
    posed = pose(parse(bare), comm)
    assert len(posed.a.integrals()) == 1
    assert posed.sources == {} and posed.exact is None
    assert comm.allreduce(len(posed.problem.obstacle)) == 5
    posed.problem.destroy()
    full = pose(parse(SCENE.format(**LOWER)), comm)
    assert len(full.a.integrals()) == 2
    assert list(full.sources) == ["load", "flux"]
    full.problem.destroy()


def test_zeros_are_not_assembled(comm, parse):
    scene = LOWER | {"reaction": "reaction = 0", "load": "0*x", "flux": "0", "diffusion": "1"}
    posed = pose(parse(SCENE.format(**scene)), comm)
    assert len(posed.a.integrals()) == 1
    assert posed.sources == posed.reactions == {}
    posed.problem.destroy()


def test_a_scalar_diffusion_is_a_multiple_of_the_identity(comm, parse):
    tensor = LOWER | {"diffusion": '[["1 + x*y", 0], ["0*x", "1 + x*y"]]'}
    u, w = (solved(parse(SCENE.format(**s)), comm)[0] for s in (LOWER, tensor))
    assert comm.allreduce(float(np.abs(u - w).max(initial=0.0)), op=MPI.MAX) <= 1e-10


@pytest.mark.parametrize(
    ("load", "reason"), [("-1", None), ("x - 0.75", None), ("0*x", "unique"), ("1", "unbounded")]
)
def test_pure_contact_is_solved_exactly_when_it_is_solvable(load, reason, comm, parse):
    """Without reaction and Dirichlet data: the mean load has to press against the obstacle."""
    scene = parse(
        "[domain]\nshape = 'square'\ncells = 12\n[contact]\nsides = 'all'"
        f"\nobstacle = '0.1*sin(9*x)'\n[equation]\nload = '{load}'"
    )
    if reason is None:
        result = solve_scene(scene, comm)
        assert result.solve.natural_residual <= DEFAULT_RTOL
        result.destroy()
        return
    with pytest.raises(InputError, match=reason):
        pose(scene, comm)


def test_a_scene_of_higher_degree_is_more_accurate(comm, parse):
    text = """
    [domain]
    shape = "square"
    cells = 15
    [contact]
    sides = "bottom"
    [[dirichlet]]
    sides = ["left", "right", "top"]
    [solution]
    u = "-hypot(x - 0.5, y)^1.5*sin(1.5*atan2(y, x - 0.5))"
    manufactured = true
    norms = ["L2"]
    """
    errors = []
    for degree in (1, 2):
        result = solve_scene(replace(parse(text), degree=degree), comm)
        errors.append(error_norms(result.u, result.posed.exact, ["L2"])["L2"])
        result.destroy()
    assert errors[1] < 0.25 * errors[0]


JUMPS = """
rtol = 1e-12
degree = {degree}
[domain]
shape = "square"
cells = {cells}
[equation]
load = "{load}"
reaction = "{reaction}"
[contact]
sides = "bottom"
obstacle = -10
[[dirichlet]]
sides = ["left", "right"]
value = 0
[solution]
u = "{u}"
"""
A_JUMP = 0.37  # no mesh line


@pytest.mark.parametrize("cells", [9, 20])
@pytest.mark.parametrize(
    ("formula", "exact", "tolerance"),
    [
        ("where(x < 0.37, 1, 0)", A_JUMP, 1e-13),
        ("1 + sign(y - 0.37)", 2.0 * (1.0 - A_JUMP), 1e-13),
        ("where(x + y < 0.8, 2, 0)", 2.0 * 0.32, 1e-13),
        ("where((x - 0.4)^2 + (y - 0.5)^2 < 0.09, 2, 0)", 0.18 * np.pi, 1e-6),
        ("where(x < 0.37, 1, 0) * where(y < 0.37, 1, 0)", A_JUMP**2, 1e-13),
        ("abs(x - 0.37)", 0.5 * (A_JUMP**2 + (1.0 - A_JUMP) ** 2), 1e-13),
        ("max(min(9*(x - 0.37), 1), 0)", 1.0 - A_JUMP - 0.5 / 9.0, 1e-6),
        ("where(x > 0.37, log(x - 0.37), 0)", 0.63 * (np.log(0.63) - 1.0), 2e-4),
    ],
)
def test_a_jump_inside_cells_is_integrated(formula, exact, tolerance, cells, comm):
    """The integrals with all linear functions are those of the formula: so is the first moment."""
    domain = friedrichs_keller(comm, cells)
    f = integrable(parsing.parse(formula), domain, 1)
    measure = ufl.dx(metadata=CELL_RULE.metadata)
    found = comm.allreduce(fem.assemble_scalar(fem.form(f * measure)))
    assert found == pytest.approx(exact, abs=3e-4 if "^2" in formula or "log" in formula else 1e-4)


def test_a_jump_inside_tetrahedra_is_integrated(comm):
    domain = mesh.create_unit_cube(comm, 5, 5, 5)
    measure = ufl.dx(metadata=CELL_RULE.metadata)
    wedge = A_JUMP - (1.0 - (1.0 - A_JUMP) ** 3) / 12.0
    ball = "where((x-0.4)^2 + (y-0.52)^2 + (z-0.45)^2 < 0.09, 1, 0)"
    for text, exact, tolerance in (
        ("where(z < 0.37, 1, 0)", A_JUMP, 1e-13),
        ("where(x+y+z < 1, 6, 0)", 1.0, 1e-13),
        ("where(x < 0.37, 1, 0) * where(x + 2*y < z, 0, 1)", wedge, 1e-13),
        (ball, 0.036 * np.pi, 1e-4),
    ):
        f = integrable(parsing.parse(text, 3), domain, 1)
        found = comm.allreduce(fem.assemble_scalar(fem.form(f * measure)))
        assert found == pytest.approx(exact, rel=tolerance)


@pytest.mark.parametrize(
    ("point", "power", "degree"),
    [((0.4, 0.61), -0.8, 1), ((1.0 / 12.0, 1.0 / 6.0), -1.4, 2), ((0.5, 0.25), -0.8, 4)],
)
def test_a_pole_inside_cells_is_integrated(point, power, degree, comm):
    """As div(r^n (x, y)) = (n + 2) r^n, integrals of r^n are integrals over the boundary."""
    domain, (a, b) = friedrichs_keller(comm, 4), point  # in a cell, in its middle, at a vertex
    formula = parsing.parse(f"hypot(x - {a!r}, y - {b!r})^{power}")
    (dx,) = measures_for(domain, [([formula], degree)], degree)
    f = integrable(formula, domain, degree) * dx
    found = comm.allreduce(fem.assemble_scalar(fem.form(f)))
    t, weights = np.polynomial.legendre.leggauss(200)
    t, exact = 0.5 * (t + 1.0), 0.0
    for away, along in ((a, b), (1.0 - a, b), (b, a), (1.0 - b, a)):
        exact += 0.5 * away * weights @ np.hypot(away, t - along) ** power / (power + 2.0)
    assert found == pytest.approx(exact, rel=3e-5)


@pytest.mark.parametrize(
    "formula", ["where(x < 0.5, 1, 0)", "abs(x - 0.25)", "sign(x - y)", "sin(x)", "where(x<2,1,0)"]
)
def test_a_jump_on_mesh_lines_costs_nothing(formula, comm):
    f = integrable(parsing.parse(formula), friedrichs_keller(comm, 8), 1)
    assert not ufl.algorithms.extract_coefficients(f)


@pytest.mark.parametrize(("degree", "order"), [(1, 1.8), (2, 2.48)])
def test_errors_decrease_where_the_load_jumps_inside_cells(degree, order, comm, parse):
    """-u'' = f with f = 1 on x < a = 1/3, and 0 beyond: cells of all meshes are cut at a third."""
    a = 1.0 / 3.0
    c = a - 0.5 * a**2
    u = f"where(x < 1/3, {c!r}*x - x^2/2, {c - a!r}*x + {0.5 * a**2!r})"
    data = {"degree": degree, "load": "where(x < 1/3, 1, 0)", "reaction": "0", "u": u}
    errors = []
    for cells in (4, 8, 16, 32):
        result = solve_scene(parse(JUMPS.format(cells=cells, **data)), comm)
        errors.append(error_norms(result.u, result.posed.exact, ["L2"])["L2"])
        result.destroy()
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders.min() >= order


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_a_reaction_and_a_diffusion_that_jump_are_those_of_the_forms(degree, comm, parse):
    """The energies of polynomials of the degree are the integrals of the exact coefficients."""
    data = {"degree": degree, "load": "1", "reaction": "where(x < 0.37, 5, 1)", "u": "0"}
    text = JUMPS.format(cells=7, **data) + '[define]\nk = "where(x < 0.37, 1, 9)"'
    text = text.replace("[equation]", '[equation]\ndiffusion = "k"')
    posed = pose(parse(text), comm)
    w = fem.Function(posed.problem.space)
    w.interpolate(lambda x: x[0] ** degree)
    energy = comm.allreduce(fem.assemble_scalar(fem.form(ufl.action(ufl.action(posed.a, w), w))))
    power = 2 * degree - 1
    exact = degree**2 / power * (A_JUMP**power + 9.0 * (1.0 - A_JUMP**power))
    power = 2 * degree + 1
    exact += (5.0 * A_JUMP**power + 1.0 - A_JUMP**power) / power
    posed.problem.destroy()
    assert energy == pytest.approx(exact, rel=2e-4)


def test_between_vertices_coefficients_beyond_the_obstacle_are_no_data_beyond(comm, parse):
    """u >= 0 meets Dirichlet data along edges, with coefficients of both signs on coarse meshes."""
    scene = parse("""
degree = 2
[domain]
shape = "cube"
cells = 2
[define]
X = "x - 0.4137"
w = "0 - hypot(X, z)^1.5*sin(1.5*atan2(z, X))"
[contact]
sides = "bottom"
obstacle = 0
[[dirichlet]]
sides = ["left", "right", "front", "back", "top"]
value = "w"
""")
    result = solve_scene(scene, comm)
    space = result.u.function_space
    vertices = np.unique(space.dofmap.list[:, :4])
    x, _, z = control_points(space)[vertices].T
    exact = -(np.hypot(x - 0.4137, z) ** 1.5) * np.sin(1.5 * np.arctan2(z, x - 0.4137))
    error = float(np.abs(result.u.x.array[vertices] - exact).max(initial=0.0))
    result.destroy()
    assert comm.allreduce(error, op=MPI.MAX) < 0.02


LAYERS = """
degree = {degree}
[domain]
shape = "square"
cells = {cells}
[equation]
diffusion = "{diffusion}"
[contact]
sides = "bottom"
obstacle = -5
[[dirichlet]]
sides = ["left", "right"]
value = "where(x < 0.5, x, 0.45 + 0.1*x)"
[solution]
u = "where(x < 0.5, x, 0.45 + 0.1*x)"
norms = ["L2", "H1", "Linf"]
"""


@pytest.mark.parametrize("degree", [1, 2])
def test_orders_where_the_diffusion_jumps_inside_of_cells(degree, comm, parse):
    errors = []
    for cells in (15, 63):
        scene = parse(LAYERS.format(degree=degree, cells=cells, diffusion="where(x < 0.5, 1, 10)"))
        result = solve_scene(scene, comm)
        errors.append(error_norms(result.u, result.posed.exact, scene.norms))
        expectation = result.expectation
        assert any("jumps inside of cells" in note for note in expectation.notes)
        result.destroy()
    for norm, expected in (("L2", 1.0), ("H1", 0.5), ("Linf", 1.0)):
        assert expectation.orders[norm] == expected
        assert np.log(errors[0][norm] / errors[1][norm]) / np.log(63 / 15) == pytest.approx(
            expected, abs=0.1
        )


@pytest.mark.parametrize(
    ("diffusion", "cells"),
    [("where(x < 0.5, 1, 10)", 16), ("where(x < 0.5, 1, 1)", 15), ("1 + abs(x - 0.5)", 15)],
)
def test_no_order_is_lost_where_facets_follow_the_jump_or_there_is_none(
    diffusion, cells, comm, parse
):
    scene = parse(LAYERS.format(degree=1, cells=cells, diffusion=diffusion))
    expectation = expect(scene, scene.domain.make(comm))
    assert expectation.orders["H1"] == 1.0
    assert not any("jumps inside of cells" in note for note in expectation.notes)
