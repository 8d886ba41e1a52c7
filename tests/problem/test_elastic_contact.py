"""Elastic contact against what DOLFINx assembles and SciPy solves, and against closed forms.

The reference (elastic_reference.py) knows of a problem the forms, which nodes have which Dirichlet
data and constraints, by their coordinates, and the directions as functions of the coordinates.
"""

import dolfinx
import elastic_reference as reference
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from elastic_cases import (
    CELLS,
    COMM,
    FEW,
    TIGHT,
    Pressed,
    assert_same,
    check,
    largest,
    random_case,
    side,
)
from elastic_reference import gathered, nodes_of

from dolfinx_signorini import METHODS, ContactProblem, bernstein_space, elasticity


@pytest.mark.parametrize("which", FEW, ids=lambda which: "-".join(map(str, which)))
def test_random_problems(which):
    case = random_case(FEW.index(which), which)
    case.problem.solve(rtol=TIGHT)
    check(case)
    case.problem.destroy()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1000, 1200))
def test_many_random_problems(seed):
    case = random_case(seed)
    case.problem.solve(rtol=TIGHT)
    check(case)
    case.problem.destroy()


@pytest.mark.parametrize("method", METHODS)
def test_all_methods(method):
    case = random_case(3, FEW[0])
    case.problem.solve(method=method, rtol=1e-10)
    check(case, 1e-6)
    case.problem.destroy()


@pytest.mark.parametrize("degree", [1, 2])
def test_karush_kuhn_tucker(degree):
    """Nothing holds the body but its data, its load and forces against the direction in contact."""
    pressed = Pressed(degree=degree)
    pressed.solve()
    case, problem = pressed.case, pressed.problem
    found = {name: gathered(getattr(problem, name)) for name in ("u", "forces", "pressure")}
    A, b = reference.assembled(*case.forms)
    reactions = (A @ found["u"].ravel() - b).reshape(-1, 2)
    scale = largest(b) + largest(reactions)
    at, directions = case.nodes, case.directions
    normal = (reactions[at] * directions).sum(axis=1)
    gap = case.gaps - (found["u"][at] * directions).sum(axis=1)
    assert largest(reactions[at] - normal[:, None] * directions) <= 1e-9 * scale
    assert normal.max() <= 1e-9 * scale and normal.min() < -1e-3 * scale
    assert gap.min() >= -1e-13 and gap.max() > 1e-2
    assert largest(normal * gap) <= 1e-10 * scale
    assert largest(found["forces"][at] - reactions[at]) <= 1e-9 * scale
    inside = ~case.held.any(axis=1)
    inside[at] = False
    assert largest(reactions[inside]) <= 1e-9 * scale and not found["forces"][inside].any()
    # Load, reactions at the data, and the contact force are in balance.
    load = b.reshape(-1, 2).sum(axis=0)
    balance = load + reactions[case.held.all(axis=1)].sum(axis=0) + problem.force
    assert largest(balance) <= 1e-9 * scale
    assert largest(problem.force - found["forces"].sum(axis=0)) <= 1e-12 * scale
    assert found["pressure"].min() >= 0.0
    check(case)
    pressed.problem.destroy()


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("size", [2, 3])
def test_uniform_pressure(size, degree):
    """A block that is pressed flat has one stress, which all elements have exactly."""
    n = 4 if size == 3 else 8
    create = dolfinx.mesh.create_unit_cube if size == 3 else dolfinx.mesh.create_unit_square
    domain = create(COMM, *[n // degree] * size)
    space = fem.functionspace(domain, ("Lagrange", degree, (size,)))
    nothing = fem.Constant(domain, (0.0,) * size)
    numbers = [fem.Constant(domain, c) for c in (7.0, 0.25, 0.0)]
    forms = reference.elastic(space, *numbers[:2], nothing, nothing, numbers[2])
    bcs = []
    for axis in range(size):
        end = float(axis == size - 1)
        dofs = fem.locate_dofs_topological(space.sub(axis), size - 1, side(space, axis, end))
        bcs.append(fem.dirichletbc(-0.1 * end, dofs, space.sub(axis)))
    bottom = side(space, size - 1, 0.0)
    problem = ContactProblem(*forms, contact=bottom, gap=0.0, bcs=bcs)
    problem.solve(rtol=TIGHT)
    wide = 0.25 / (1.0 - 0.25) if size == 2 else 0.25
    exact = 0.1 * 7.0 / (1.0 - 0.25**2 if size == 2 else 1.0)
    x, u, pressure = nodes_of(space), gathered(problem.u), gathered(problem.pressure)
    at = np.isclose(x[size - 1], 0.0)
    assert pressure[at] == pytest.approx(exact, rel=1e-9)
    assert not pressure[~at].any()
    assert problem.force == pytest.approx([0.0] * (size - 1) + [exact], rel=1e-9, abs=1e-9)
    assert u[:, 0] == pytest.approx(0.1 * wide * x[0], abs=1e-10)
    assert u[:, size - 1] == pytest.approx(-0.1 * x[size - 1], abs=1e-10)
    # Vertices of degree 2 on triangles have no force, so that rounding decides about their gap.
    assert largest(gathered(problem.gap)[at]) <= 1e-13
    problem.destroy()


@pytest.mark.parametrize("direction", ["given", None])
@pytest.mark.parametrize("degree", [1, 2])
def test_turning_turns_the_solution(degree, direction):
    flat, turned = Pressed(degree=degree), Pressed(degree=degree, angle=0.7, direction=direction)
    expected, found = flat.solve(), turned.solve()
    for name in ("u", "forces", "force"):
        found[name] = found[name] @ turned.turn
    assert_same(found, expected)
    for each in (flat, turned):
        each.problem.destroy()


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_units_of_force(scale):
    """E and loads in other units: the same displacement, forces in these units."""
    plain, scaled = Pressed(), Pressed(scale=scale)
    expected, found = plain.solve(), scaled.solve()
    for name in ("forces", "force", "pressure"):
        found[name] = found[name] / scale
    assert_same(found, expected)
    for each in (plain, scaled):
        each.problem.destroy()


def test_directions_of_any_length():
    """The constraint is u.d <= g with d as given, and the pressure is a force per area."""
    case = random_case(2, ("triangles", 1, "corner", "callable", "whole"))
    case.problem.destroy()
    direction = case.options["direction"]
    case.options |= {
        "direction": lambda x: (0.5 + 2.0 * x[1]) * direction(x),
        "gap": lambda x: 0.02 + 0.05 * x[1] - 0.03 * x[0],
    }
    x = nodes_of(case.problem.space)[:, case.nodes]
    case.directions *= (0.5 + 2.0 * x[1])[:, None]
    case.gaps = 0.02 + 0.05 * x[1] - 0.03 * x[0]
    case.problem = ContactProblem(*case.forms, **case.options)
    case.problem.solve(rtol=TIGHT)
    found = check(case)
    assert 2 < (found.multipliers > 0.0).sum() < len(case.nodes) - 2
    case.problem.destroy()


@pytest.mark.parametrize("kind", ["Bernstein", "nodal"])
def test_a_direction_is_the_same_in_words_of_ufl_and_of_numpy(kind):
    """A direction that varies, as an expression, as a function and as a callable."""
    domain = mesh.create_rectangle(COMM, [(0.0, 0.0), (1.0, 0.7)], (8, 6))
    if kind == "Bernstein":
        space = bernstein_space(domain, 2, (2,))
    else:
        space = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    bottom, top = (
        mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y))
        for y in (0.0, 0.7)
    )
    held = fem.dirichletbc(fem.Function(space), fem.locate_dofs_topological(space, 1, top))
    load = ufl.inner(fem.Constant(domain, (3.0, -20.0)), v) * ufl.dx

    def values(x):
        return np.stack([0.8 * np.sin(6.0 * x[0]), np.full(x.shape[1], -1.0)])

    expression, forces = ufl.as_vector([0.8 * ufl.sin(6.0 * x[0]), -1.0]), []
    for direction in (expression, values):
        keywords = {"contact": bottom, "gap": 0.01, "direction": direction, "bcs": [held]}
        problem = ContactProblem(elasticity(u, v, 200.0, 0.3), load, **keywords)
        problem.solve(rtol=1e-11)
        forces.append(problem.force)
        problem.destroy()
    assert forces[1] == pytest.approx(forces[0], rel=1e-8) and forces[0][1] > 1.0


def bent_normals(space, bottom):
    """Nodes of a bottom that is a graph, with the normals of its facets averaged by their areas."""
    degree, x = space.element.basix_element.degree, nodes_of(space)
    nodes = np.flatnonzero(bottom)
    nodes = nodes[np.argsort(x[0, nodes])]
    edges = np.diff(x[:2, nodes[::degree]])  # from vertex to vertex
    down = np.stack([edges[1], -edges[0]])  # as long as the edge: the area is the weight
    found = np.repeat(down, degree, axis=1)
    found = np.concatenate([found, down[:, -1:]], axis=1)
    found[:, degree:-1:degree] += down[:, :-1]
    return nodes, (found / np.linalg.norm(found, axis=0)).T


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", CELLS)
def test_normals_of_a_bent_side(kind, degree):
    """On a side that is not straight the normals at vertices are averages."""
    pressed = Pressed(n=12 // degree, degree=degree, kind=CELLS[kind])
    bottom = np.isclose(nodes_of(pressed.space)[1], 0.0)
    x, y = pressed.domain.geometry.x.T[:2]
    pressed.domain.geometry.x[:, 0] = x + 0.12 * np.sin(2.0 * np.pi * x)  # edges of many lengths
    pressed.domain.geometry.x[:, 1] = y + 0.1 * (1.0 - y) * np.sin(4.0 * x)
    pressed.height.value = 0.02
    case = pressed.case
    nodes, case.directions = bent_normals(pressed.space, bottom)
    case.gaps = 0.4 * (nodes_of(pressed.space)[0, nodes] - 0.4) ** 2 - 0.02
    case.options |= {"direction": None}
    case.problem = ContactProblem(*case.forms, **case.options)
    case.problem.solve(rtol=TIGHT)
    order = np.argsort(nodes)
    case.nodes, case.directions, case.gaps = nodes[order], case.directions[order], case.gaps[order]
    found = check(case)
    assert 2 < (found.multipliers > 0.0).sum() < len(nodes)
    case.problem.destroy()


# Loops.


def test_a_loop_is_what_new_problems_find():
    """Each step changes other data, and is compared with a new problem and with SciPy."""
    loop = Pressed()
    steps = [
        {"height": 0.03},
        {"weight": (0.4, -0.1)},
        {"moved": (-0.02, -0.2)},
        {"modulus": 3.0},
        {"height": -0.2, "moved": (0.0, 0.05)},  # no contact at all
        {"height": 0.05, "moved": (0.0, -0.1), "modulus": 0.5},
    ]
    data = {}
    counts = []
    for step in steps:
        data |= step
        for name, value in step.items():
            getattr(loop, name).value = value
        fresh = Pressed()
        for name, value in data.items():
            getattr(fresh, name).value = value
        found, expected = loop.solve(), fresh.solve()
        if len(expected["active"]):
            assert_same(found, expected)
        check(loop.case)
        counts.append(len(expected["active"]))
        fresh.problem.destroy()
    assert counts[4] == 0 and min(counts[:4] + counts[5:]) > 0 and len(set(counts)) > 3
    loop.problem.destroy()


def test_a_cold_start_and_a_warm_one():
    pressed = Pressed(degree=2)
    expected = pressed.solve()
    assert_same(pressed.solve(), expected)
    assert_same(pressed.solve(warm_start=False), expected)
    pressed.problem.destroy()


# The cascade.


@pytest.mark.parametrize("degree", [1, 2])
def test_a_coarse_state(degree):
    """The state of coarser problems changes no solution, and saves linear solves."""
    state, solves = None, []
    for n in (8, 16, 32, 64):
        level = Pressed(n=n // degree, degree=degree)
        found = level.solve(coarse=state)
        solves.append(level.problem.result.linear_solves)
        state = level.problem.contact_state()
    check(level.case)
    alone = Pressed(n=64 // degree, degree=degree)
    assert_same(found, alone.solve())
    assert max(solves[1:]) <= 4, solves
    assert solves[-1] <= alone.problem.result.linear_solves
    alone.problem.destroy()
