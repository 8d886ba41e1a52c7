"""Problems of elastic contact, and what the reference knows of each by itself."""

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

from dolfinx_signorini import ContactProblem

COMM = MPI.COMM_WORLD
CellType = dolfinx.mesh.CellType
CELLS = {"triangles": CellType.triangle, "quadrilaterals": CellType.quadrilateral}
TIGHT = 1e-12
SAME = 1e-8


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
