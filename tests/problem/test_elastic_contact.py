"""Elastic contact against what DOLFINx assembles and SciPy solves, and against closed forms.

The reference (elastic_reference.py) knows of a problem the forms, which nodes have which Dirichlet
data and constraints, by their coordinates, and the directions as functions of the coordinates.
"""

from dataclasses import dataclass, field
from typing import Any

import dolfinx
import elastic_reference as reference
import numpy as np
import pytest
import ufl
from dolfinx import fem
from elastic_reference import gathered, nodes_of
from mpi4py import MPI

from dolfinx_signorini import METHODS, ContactProblem, InputError
from dolfinx_signorini.meshes.sided_meshes import boundary_facets

COMM = MPI.COMM_WORLD
CellType = dolfinx.mesh.CellType
CELLS = {"triangles": CellType.triangle, "quadrilaterals": CellType.quadrilateral}
TIGHT = 1e-12
SAME = 1e-8


# Random problems.


def waves(rng, size, mean=0.0):
    """A smooth random function of the coordinates, shape (3, n)."""
    k, shift, height = rng.uniform(-4.0, 4.0, (3, 3)), rng.uniform(0.0, 6.0, 3), rng.normal(size=3)
    return lambda x: mean + size * (height @ np.sin(k @ x + shift[:, None]))


def directions_about(rng, centre):
    """Unit vectors near a vector, as a function of coordinates and as a UFL expression of them."""
    k, size = rng.uniform(-3.0, 3.0, (len(centre), len(centre))), rng.uniform(0.2, 0.6)

    def values(x):
        found = np.asarray(centre)[:, None] + size * np.sin(k @ x[: len(centre)])
        return found / np.linalg.norm(found, axis=0)

    def expression(domain):
        x = ufl.SpatialCoordinate(domain)
        parts = [sum(float(c) * x[j] for j, c in enumerate(row)) for row in k]
        parts = [float(c) + size * ufl.sin(p) for c, p in zip(centre, parts, strict=True)]
        found = ufl.as_vector(parts)
        return found / ufl.sqrt(ufl.dot(found, found))

    return values, expression


@dataclass
class Case:
    """A problem, and what the reference knows of it by itself."""

    problem: Any
    forms: tuple[ufl.Form, ufl.Form]
    held: np.ndarray
    values: np.ndarray
    nodes: np.ndarray
    directions: np.ndarray
    gaps: np.ndarray
    options: dict[str, Any] = field(default_factory=dict)  # what the problem was made of

    def reference(self):
        """The solution by SciPy."""
        A, b = reference.assembled(*self.forms)
        return reference.solve(A, b, self.held, self.values, self.nodes, self.directions, self.gaps)


def random_mesh(rng, kind, degree):
    """A small mesh of the unit square or cube, and its cells per side."""
    if kind == "tetrahedra":
        n = int(rng.integers(3, 6)) if degree == 1 else int(rng.integers(2, 4))
        return dolfinx.mesh.create_unit_cube(COMM, n, n, n), n
    n = int(rng.integers(6, 14)) // degree
    return dolfinx.mesh.create_unit_square(COMM, n, n, CELLS[kind]), n


def side(space, axis, end):
    """The facets on a side of the unit square or cube."""
    fdim = space.mesh.topology.dim - 1
    return dolfinx.mesh.locate_entities_boundary(
        space.mesh, fdim, lambda x: np.isclose(x[axis], end)
    )


def whole_data(rng, space, x):
    """Data for all components on the highest side: a condition, which values are held, and data."""
    size = space.dofmap.bs
    slope, level = rng.normal(size=(size, size)) * 0.03, rng.normal(size=size) * 0.03

    def shape(x):
        return level[:, None] + slope @ x[:size]

    data = fem.Function(space)
    data.interpolate(shape)
    facets = side(space, size - 1, 1.0)
    bcs = [fem.dirichletbc(data, fem.locate_dofs_topological(space, size - 1, facets))]
    held = np.tile(np.isclose(x[size - 1], 1.0)[:, None], (1, size))
    return bcs, held, np.where(held, shape(x).T, 0.0)


def component_data(rng, space, x):
    """Data for one component each: on the sides x_i = 0, and the last one on the highest side."""
    size, bcs = space.dofmap.bs, []
    held, values = np.zeros((len(x.T), size), dtype=bool), np.zeros((len(x.T), size))
    for axis in range(size):
        end = float(axis == size - 1)
        value = float(rng.normal() * 0.03)
        dofs = fem.locate_dofs_topological(space.sub(axis), size - 1, side(space, axis, end))
        bcs.append(fem.dirichletbc(value, dofs, space.sub(axis)))
        held[:, axis] = np.isclose(x[axis], end)
        values[held[:, axis], axis] = value
    return bcs, held, values


def contact_part(rng, space, x, n, where):
    """Facets of the sides in contact, their nodes, and the mean of the outward normals."""
    size, fdim = space.dofmap.bs, space.dofmap.bs - 1
    top = np.floor(0.7 * n) / n + 1e-9  # clear of the data on the highest side
    facets, nodes = [], np.zeros(len(x.T), dtype=bool)
    centre = np.zeros(size)
    if where in ("bottom", "corner"):
        facets.append(side(space, size - 1, 0.0))
        nodes |= np.isclose(x[size - 1], 0.0)
        centre[size - 1] = -1.0
    if where in ("right", "corner"):
        right = dolfinx.mesh.locate_entities_boundary(
            space.mesh, fdim, lambda x: np.isclose(x[0], 1.0) & (x[size - 1] <= top)
        )
        facets.append(right)
        nodes |= np.isclose(x[0], 1.0) & (x[size - 1] <= top)
        centre[0] = 1.0
    return np.concatenate(facets), np.flatnonzero(nodes), centre / np.linalg.norm(centre)


def normals(x, where):
    """The outward normals at nodes on a side of the unit square or cube."""
    size = 3 if np.ptp(x[2]) > 0.0 else 2
    found = np.zeros((size, len(x.T)))
    found[0 if where == "right" else size - 1] = 1.0 if where == "right" else -1.0
    return found


def given_direction(rng, space, centre, where, way):
    """A direction in one of the forms that users have, and its values as a callable."""
    size = len(centre)
    if way == "normal":
        return None, lambda x: normals(x, where)
    values, expression = directions_about(rng, centre)
    if way == "constant":
        vector = values(rng.uniform(size=(3, 1)))[:, 0]
        given = (tuple(vector), list(vector), vector)[rng.integers(3)]
        return given, lambda x: np.tile(vector[:, None], (1, len(x.T)))
    if way == "callable":
        return values, values
    if way == "expression":
        return expression(space.mesh), values
    function = fem.Function(fem.functionspace(space.mesh, ("Lagrange", 2, (size,))))
    function.interpolate(values)
    if space.element.basix_element.degree == 1:  # the nodes of degree 1 are nodes of degree 2
        return function, values
    own = fem.Function(space)
    own.interpolate(values)
    return own, values


def given_gap(rng, space):
    """A gap in one of the forms that users have, and its values as a callable."""
    scalar = fem.functionspace(space.mesh, ("Lagrange", space.element.basix_element.degree))
    way = rng.integers(4)
    if way == 0:
        number = float(rng.uniform(0.0, 0.15))
        return number, lambda x: np.full(len(x.T), number)
    shape = waves(rng, 0.1, 0.1)
    if way == 1:
        return shape, shape
    if way == 2:
        function = fem.Function(scalar)
        function.interpolate(shape)
        return function, shape
    scale, slope = float(rng.normal() * 0.2), float(rng.uniform(1.0, 4.0))
    x = ufl.SpatialCoordinate(space.mesh)
    expression = scale * ufl.sin(slope * x[0]) * ufl.cos(x[1])
    return expression, lambda x: scale * np.sin(slope * x[0]) * np.cos(x[1])


WAYS = ("normal", "constant", "callable", "expression", "function")
FEW = [
    ("triangles", 1, "bottom", "normal", "whole"),
    ("triangles", 1, "corner", "constant", "components"),
    ("triangles", 2, "bottom", "expression", "components"),
    ("triangles", 2, "corner", "callable", "whole"),
    ("quadrilaterals", 1, "right", "constant", "components"),
    ("quadrilaterals", 1, "corner", "function", "whole"),
    ("quadrilaterals", 2, "bottom", "normal", "whole"),
    ("quadrilaterals", 2, "corner", "expression", "components"),
    ("tetrahedra", 1, "bottom", "constant", "components"),
    ("tetrahedra", 1, "corner", "callable", "whole"),
    ("tetrahedra", 2, "bottom", "normal", "components"),
    ("tetrahedra", 2, "right", "function", "whole"),
]


def drawn(rng):
    """A combination of what FEW lists."""
    kind = ("triangles", "quadrilaterals", "tetrahedra")[rng.integers(3)]
    where = ("bottom", "right", "corner")[rng.integers(3)]
    way = WAYS[rng.integers(5)]
    if way == "normal" and where == "corner":
        way = "constant"  # no normal is meant at the corner
    return kind, int(rng.integers(1, 3)), where, way, ("whole", "components")[rng.integers(2)]


def random_case(seed, which=None):
    """Pose a random problem."""
    rng = np.random.default_rng(seed)
    kind, degree, where, way, data = which or drawn(rng)
    domain, n = random_mesh(rng, kind, degree)
    size = domain.geometry.dim
    space = fem.functionspace(domain, ("Lagrange", degree, (size,)))
    modulus, poisson = 10.0 ** rng.uniform(-1.0, 3.0), rng.uniform(0.0, 0.42)
    spring = 0.0 if rng.random() < 0.7 else modulus * rng.uniform(0.1, 3.0)
    constants = [fem.Constant(domain, float(c)) for c in (modulus, poisson, spring)]
    x = nodes_of(space)
    bcs, held, values = (whole_data if data == "whole" else component_data)(rng, space, x)
    contact, nodes, centre = contact_part(rng, space, x, n, where)
    load, traction = fem.Function(space), fem.Function(space)
    for function, push in ((load, 0.3), (traction, 0.1)):
        parts = [waves(rng, 0.1 * modulus, push * modulus * c) for c in centre]
        function.interpolate(lambda x, parts=parts: np.stack([part(x) for part in parts]))
    a, L = reference.elastic(space, *constants[:2], load, traction, constants[2])
    direction, directions = given_direction(rng, space, centre, where, way)
    gap, gaps = given_gap(rng, space)
    options = {"contact": contact, "gap": gap, "direction": direction, "bcs": bcs}
    problem = ContactProblem(a, L, **options)
    at = x[:, nodes]
    return Case(
        problem, (a, L), held, values, nodes, directions(at).T, gaps(at) + 0.0 * at[0], options
    )


# What is compared.


def largest(values):
    return float(np.abs(values).max(initial=0.0))


def check(case, tolerance=SAME):
    """Compare what a solved problem hands out with the reference, which this returns."""
    problem, found = case.problem, case.reference()
    assert largest(gathered(problem.u) - found.u) <= tolerance * largest(found.u)
    forces = gathered(problem.forces)
    assert forces.shape == found.forces.shape
    assert largest(forces - found.forces) <= tolerance * found.scale
    assert problem.force.shape == (found.u.shape[1],)
    assert largest(problem.force - found.forces.sum(axis=0)) <= tolerance * found.scale * len(
        forces
    )
    gap, pressure = gathered(problem.gap), gathered(problem.pressure)
    assert gap.shape == pressure.shape == (len(forces),)
    assert largest((gap - found.gap)[case.nodes]) <= tolerance * largest(found.u)
    nodes = reference.gathered_numbers(problem.space, problem.contact_nodes)
    assert np.array_equal(nodes, case.nodes)
    active = reference.gathered_numbers(problem.space, problem.active)
    in_contact = np.zeros(len(gap), dtype=bool)
    in_contact[active] = True
    assert np.array_equal(active, case.nodes[gap[case.nodes] == 0.0])
    assert gap[case.nodes].min() >= 0.0 and pressure.min() >= 0.0
    assert not forces[~in_contact].any()
    assert problem.unknowns == len(forces) * forces.shape[1]
    assert problem.result.active_dofs == len(active)
    if found.margin > 1e-6:
        assert np.array_equal(active, np.flatnonzero(found.multipliers))
    assert integral(problem, case.options["contact"]) == pytest.approx(
        np.linalg.norm(found.forces, axis=1).sum(), rel=1e-7, abs=1e-8 * found.scale
    )
    return found


def integral(problem, contact):
    """The integral of the pressure over the facets in contact."""
    domain = problem.space.mesh
    fdim = domain.topology.dim - 1
    facets = np.unique(contact[contact < domain.topology.index_map(fdim).size_local])
    tags = dolfinx.mesh.meshtags(domain, fdim, facets, np.ones(len(facets), dtype=np.int32))
    over = ufl.ds(domain, subdomain_data=tags)(1)
    return COMM.allreduce(fem.assemble_scalar(fem.form(problem.pressure * over)))


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


# A problem to vary.


class Pressed:
    """A square whose highest side is moved down onto a bump, turned about the origin.

    Attributes:
        problem: The problem.
        case: What the reference knows of it.
    """

    def __init__(self, n=12, degree=1, angle=0.0, scale=1.0, direction="given", kind=None):
        cells = CellType.triangle if kind is None else kind
        domain = dolfinx.mesh.create_unit_square(COMM, n, n, cells)
        space = fem.functionspace(domain, ("Lagrange", degree, (2,)))
        x = nodes_of(space)
        top, bottom = side(space, 1, 1.0), side(space, 1, 0.0)
        held = np.tile(np.isclose(x[1], 1.0)[:, None], (1, 2))
        nodes = np.flatnonzero(np.isclose(x[1], 0.0))
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        domain.geometry.x[:, :2] = domain.geometry.x[:, :2] @ turn.T
        self.turn, self.domain, self.space = turn, domain, space
        self._order = np.lexsort(np.rint(x[:2] * 2.0 * n * degree))  # of whatever partition
        self.modulus = fem.Constant(domain, scale)
        self.weight = fem.Constant(domain, turn @ [0.1, -0.5] * scale)
        self.height = fem.Constant(domain, 0.0)
        self.moved = fem.Constant(domain, turn @ [0.05, -0.1])
        zero, nothing = fem.Constant(domain, 0.0), fem.Constant(domain, (0.0, 0.0))
        forms = reference.elastic(
            space, self.modulus, fem.Constant(domain, 0.3), self.weight, nothing, zero
        )
        along = ufl.dot(ufl.as_vector(turn[:, 0]), ufl.SpatialCoordinate(domain))
        options = {
            "contact": bottom,
            "gap": 0.4 * (along - 0.4) ** 2 - self.height,
            "direction": turn @ [0.0, -1.0] if direction == "given" else direction,
            "bcs": [fem.dirichletbc(self.moved, fem.locate_dofs_topological(space, 1, top), space)],
        }
        self.problem = ContactProblem(*forms, **options)
        directions = np.tile(turn @ [0.0, -1.0], (len(nodes), 1))
        self._parts = forms, held, nodes, directions, x[0, nodes], options

    @property
    def case(self):
        forms, held, nodes, directions, along, options = self._parts
        values = np.where(held, self.moved.value, 0.0)
        gaps = 0.4 * (along - 0.4) ** 2 - self.height.value
        return Case(self.problem, forms, held, values, nodes, directions, gaps, options)

    def solve(self, **options):
        self.problem.solve(rtol=TIGHT, **options)
        return self.handed_out()

    def handed_out(self):
        """All results, at the nodes in an order that does not depend on the partition."""
        problem = self.problem
        names = ("u", "forces", "pressure", "gap")
        found = {name: gathered(getattr(problem, name))[self._order] for name in names}
        active = reference.gathered_numbers(problem.space, problem.active)
        touching = np.flatnonzero(np.isin(self._order, active))
        return found | {"force": problem.force, "active": touching}


def assert_same(one, other, tolerance=SAME):
    for name, value in other.items():
        if name == "active":
            assert np.array_equal(one[name], value)
        else:
            assert largest(one[name] - value) <= tolerance * largest(value), name


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


# Refusals.


def refused(subject, *more, forms=None, **options):
    """Check that a problem is refused with the name of an argument."""
    pressed = Pressed(n=4)
    given = pressed.case.options | options
    forms = forms(pressed) if forms else pressed.case.forms
    with pytest.raises(InputError) as caught:
        ContactProblem(*forms, **given).solve()
    assert caught.value.subject in (subject, *more), str(caught.value)
    pressed.problem.destroy()
    return str(caught.value)


def scalar_forms(pressed):
    space = fem.functionspace(pressed.domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    return ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, fem.Constant(space.mesh, 1.0) * v * ufl.dx


def test_a_scalar_space_is_refused():
    refused("form a", forms=scalar_forms, bcs=[])


@pytest.mark.parametrize(
    "direction",
    [
        (1.0,),
        (0.0, 0.0, -1.0),
        1.0,
        "down",
        (0.0, 0.0),
        (0.0, np.nan),
        (np.inf, 1.0),
        lambda x: -np.ones((1, len(x.T))),
        lambda x: np.stack([0.0 * x[0], 0.0 * x[0]]),
        lambda x: np.stack([0.0 * x[0], x[0] - 0.5]),  # zero at one node
        lambda x: np.full((2, len(x.T)), np.nan),
    ],
    ids=str,
)
def test_directions_that_make_no_sense(direction):
    refused("direction", direction=direction)


def test_a_scalar_function_as_direction():
    pressed = Pressed(n=4)
    scalar = fem.Function(fem.functionspace(pressed.domain, ("Lagrange", 1)))
    options = pressed.case.options | {"direction": scalar}
    with pytest.raises(InputError) as caught:
        ContactProblem(*pressed.case.forms, **options)
    assert caught.value.subject == "direction"
    pressed.problem.destroy()


@pytest.mark.parametrize(
    "gap",
    [np.nan, "none", (0.0, 1.0), lambda x: x[:2], lambda x: np.full(len(x.T), np.nan)],
    ids=str,
)
def test_gaps_that_make_no_sense(gap):
    refused("gap", gap=gap)


def test_normals_at_a_corner_are_none():
    """No average of two normals that are perpendicular is meant; with a direction there is one."""
    pressed = Pressed(n=4)
    both = np.concatenate([side(pressed.space, 1, 0.0), side(pressed.space, 0, 1.0)])
    options = pressed.case.options | {"contact": both}
    with pytest.raises(InputError) as caught:
        ContactProblem(*pressed.case.forms, **options | {"direction": None})
    assert caught.value.subject == "direction"
    ContactProblem(*pressed.case.forms, **options | {"direction": (0.6, -0.8)}).destroy()
    pressed.problem.destroy()


def test_no_facets():
    refused("contact", contact=np.empty(0, dtype=np.int32))


def held_at(pressed, axis, where, component=None):
    """Conditions that hold all components, or one, on a side."""
    space = pressed.space
    if component is None:
        dofs = fem.locate_dofs_topological(space, 1, side(space, axis, where))
        return [fem.dirichletbc(pressed.moved, dofs, space)]
    part = space.sub(component)
    dofs = fem.locate_dofs_topological(part, 1, side(space, axis, where))
    return [fem.dirichletbc(0.0, dofs, part)]


@pytest.mark.parametrize("which", ["nothing", "one translation", "the other", "a rotation"])
def test_a_body_that_is_not_held(which):
    pressed = Pressed(n=4)
    bcs = []
    if which == "one translation":  # slides along the highest side
        bcs = held_at(pressed, 1, 1.0, 1)
    elif which == "the other":
        bcs = held_at(pressed, 0, 0.0, 0)
    elif which == "a rotation":  # about the corner: all other motions are held
        space = pressed.space
        corner = dolfinx.mesh.locate_entities_boundary(
            space.mesh, 0, lambda x: np.isclose(x[0], 0.0) & np.isclose(x[1], 1.0)
        )
        dofs = fem.locate_dofs_topological(space, 0, corner)
        bcs = [fem.dirichletbc(pressed.moved, dofs, space)]
    options = pressed.case.options | {"bcs": bcs}
    with pytest.raises(InputError) as caught:
        ContactProblem(*pressed.case.forms, **options).solve()
    assert caught.value.subject in ("bcs", "form a")
    pressed.problem.destroy()


def test_a_body_on_springs_needs_no_data():
    """A form that is positive for rigid motions holds the body."""
    domain = dolfinx.mesh.create_unit_square(COMM, 6, 6)
    space = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    numbers = [fem.Constant(domain, c) for c in (1.0, 0.3, 2.0)]
    push, nothing = fem.Constant(domain, (0.0, -1.0)), fem.Constant(domain, (0.0, 0.0))
    forms = reference.elastic(space, *numbers[:2], push, nothing, numbers[2])
    bottom, x = side(space, 1, 0.0), nodes_of(space)
    options = {"contact": bottom, "gap": lambda x: 0.5 * x[0]}
    problem = ContactProblem(*forms, **options)
    problem.solve(rtol=TIGHT)
    nodes = np.flatnonzero(np.isclose(x[1], 0.0))
    held = np.zeros((len(x.T), 2), dtype=bool)
    down = np.tile([0.0, -1.0], (len(nodes), 1))
    check(Case(problem, forms, held, 0.0 * held, nodes, down, 0.5 * x[0, nodes], options))
    problem.destroy()


def test_all_of_the_boundary_may_be_the_argument():
    """Nodes whose components are all held have no constraint, and the others have theirs."""
    pressed = Pressed(n=8)
    options = pressed.case.options | {
        "contact": boundary_facets(pressed.domain),
        "direction": (0.0, -1.0),
        "gap": 0.3,
    }
    pressed.weight.value = (0.0, -3.0)
    problem = ContactProblem(*pressed.case.forms, **options)
    problem.solve(rtol=TIGHT)
    x, case = nodes_of(pressed.space), pressed.case
    on = np.isclose(x[:2], 0.0).any(axis=0) | np.isclose(x[:2], 1.0).any(axis=0)
    nodes = np.flatnonzero(on & ~np.isclose(x[1], 1.0))
    down, gaps = np.tile([0.0, -1.0], (len(nodes), 1)), np.full(len(nodes), 0.3)
    A, b = reference.assembled(*case.forms)
    found = reference.solve(A, b, case.held, case.values, nodes, down, gaps)
    assert (found.multipliers > 0.0).any()
    assert largest(gathered(problem.u) - found.u) <= SAME * largest(found.u)
    assert largest(gathered(problem.forces) - found.forces) <= SAME * found.scale
    for each in (problem, pressed.problem):
        each.destroy()
