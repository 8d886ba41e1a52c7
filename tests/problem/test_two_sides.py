"""Lower and upper obstacles, in the domain and on the boundary, against what DOLFINx assembles.

The conditions of Karush, Kuhn and Tucker decide: matrix and load are assembled here, without the
package, and so are the interpolants of the obstacles and the dofs that have them.
"""

from dataclasses import dataclass

import basix
import basix.ufl
import dolfinx
import numpy as np
import pytest
import scipy.sparse as sp
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from hypothesis import given
from hypothesis import strategies as st
from mpi4py import MPI
from petsc4py import PETSc
from scipy.optimize import lsq_linear

from dolfinx_signorini import ObstacleProblem, SignoriniProblem, bernstein_space
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.dirichlet import dirichlet

COMM = MPI.COMM_WORLD
CellType = dolfinx.mesh.CellType
KINDS = ("triangles", "perturbed", "quadrilaterals", "tetrahedra")
TIGHT = 1e-12
SAME = 1e-13  # between obstacles of size 1 that were evaluated twice, at points that round apart


def largest(values):
    """The largest absolute value of an array on all ranks."""
    return COMM.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX)


def total(values):
    """The sum of an array over all ranks."""
    return COMM.allreduce(float(np.sum(values)))


# Random problems.


def random_mesh(rng, kind, degree):
    """A small mesh of the unit square or cube."""
    if kind == "tetrahedra":
        n = max(2, int(rng.integers(3, 7)) // degree)
        return dolfinx.mesh.create_unit_cube(COMM, n, n, n)
    n = max(3, int(rng.integers(6, 20)) // degree)
    cells = CellType.quadrilateral if kind == "quadrilaterals" else CellType.triangle
    diagonal = dolfinx.mesh.DiagonalType.crossed if rng.random() < 0.5 else None
    options = {} if diagonal is None else {"diagonal": diagonal}
    domain = dolfinx.mesh.create_unit_square(COMM, n, n, cells, **options)
    if kind == "perturbed":
        x, nodes = domain.geometry.x, domain.geometry.index_map().size_global
        noise = rng.uniform(-0.2 / n, 0.2 / n, (nodes, 2))[domain.geometry.input_global_indices]
        inside = ((x[:, :2] > 1e-9) & (x[:, :2] < 1.0 - 1e-9)).all(axis=1)
        x[inside, :2] += noise[inside]
    return domain


def waves(rng, size, mean=0.0):
    """A smooth random function of the coordinates."""
    k, shift, height = rng.uniform(-6.0, 6.0, (4, 3)), rng.uniform(0.0, 6.0, 4), rng.normal(size=4)
    return lambda x: mean + size * (height @ np.sin(k @ x + shift[:, None]))


def interpolant(space, shape):
    """The function with the values of a callable at the nodes, or at the control points."""
    u, element = fem.Function(space), space.element.basix_element
    if element.lagrange_variant == basix.LagrangeVariant.bernstein:
        nodal = basix.ufl.element(
            "Lagrange",
            space.mesh.topology.cell_name(),
            element.degree,
            lagrange_variant=basix.LagrangeVariant.equispaced,
        )
        values = fem.Function(fem.functionspace(space.mesh, nodal))
        values.interpolate(shape)
        u.interpolate(values)
    else:
        u.interpolate(shape)
    u.x.scatter_forward()
    return u


def given_as(rng, space, shape):
    """An obstacle in one of the forms that users have."""
    way = rng.integers(3)
    if way == 0:
        return shape
    g = interpolant(space, shape)
    return g if way == 1 else g + 0.0 * ufl.SpatialCoordinate(space.mesh)[0]


def dofs_of(space, dim, entities):
    """Mark the dofs on entities that any rank names."""
    marks, owned = fem.Function(space), space.mesh.topology.index_map(dim).size_local
    space.mesh.topology.create_connectivity(dim, space.mesh.topology.dim)
    here = entities[entities < owned]
    marks.x.array[fem.locate_dofs_topological(space, dim, here, remote=False)] = 1.0
    marks.x.scatter_reverse(dolfinx.la.InsertMode.add)
    return marks.x.array[: space.dofmap.index_map.size_local] > 0.0


@dataclass
class Case:
    """A problem with what the checks know of it by themselves; dofs are those of this rank."""

    problem: ObstacleProblem | SignoriniProblem
    a: ufl.Form
    L: ufl.Form
    lower: np.ndarray
    upper: np.ndarray
    held: np.ndarray
    values: np.ndarray
    entities: object
    rim: object = None  # where an obstacle on the boundary is tighter than one in the domain
    rim_bound: str = ""


def chosen_cells(rng, domain):
    """Some cells in one of the ways that users name them, and these cells."""
    tdim = domain.topology.dim
    index_map = domain.topology.index_map(tdim)
    everything = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
    way = rng.integers(3)
    if way == 0:
        return None, everything
    left = dolfinx.mesh.compute_midpoints(domain, tdim, everything)[:, 0] < rng.uniform(0.4, 0.9)
    if way == 1:
        return everything[left], everything[left]
    tags = dolfinx.mesh.meshtags(domain, tdim, everything, np.where(left, 7, 3).astype(np.int32))
    return (tags, 7), everything[left]


def random_case(seed, kind=None, degree=None, bernstein=None, on_boundary=None, sides=None):
    """Pose a random problem; what is None is drawn.

    With "both" for `on_boundary` there are obstacles in the domain and one on the boundary.
    """
    rng = np.random.default_rng(seed)
    drawn = (KINDS[rng.integers(4)], int(rng.integers(1, 4)), bool(rng.random() < 0.5))
    kind, degree = kind or drawn[0], degree or drawn[1]
    bernstein = drawn[2] if bernstein is None else bernstein
    on_boundary = bool(rng.random() < 0.4) if on_boundary is None else on_boundary
    sides = sides or ("both", "both", "lower", "upper")[rng.integers(4)]
    domain = random_mesh(rng, kind, degree)
    simplices = kind != "quadrilaterals"
    space = (
        bernstein_space(domain, degree)
        if bernstein and simplices
        else fem.functionspace(domain, ("Lagrange", degree))
    )
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    linear = fem.functionspace(domain, ("Lagrange", 1))
    k, c, f = (fem.Function(linear) for _ in range(3))
    bump, clamped = waves(rng, 0.4), rng.random() < 0.6
    k.interpolate(lambda x: np.exp(bump(x)))
    c.x.array[:] = 0.0 if clamped and rng.random() < 0.5 else rng.uniform(0.1, 10.0)
    f.interpolate(waves(rng, 10.0 ** rng.uniform(0.5, 2.0), rng.normal() * 5.0))
    a = (k * ufl.inner(ufl.grad(u), ufl.grad(v)) + c * u * v) * ufl.dx
    L = f * v * ufl.dx
    low, wide = waves(rng, 0.1, -0.2), waves(rng, 0.1)
    width = rng.uniform(0.0, 0.4)

    def high(x):
        return low(x) + width + np.abs(wide(x))

    # The bottom has Dirichlet data in the middle of both obstacles, which hence do not contradict.
    fdim = domain.topology.dim - 1
    bottom = dolfinx.mesh.locate_entities_boundary(domain, fdim, lambda x: np.isclose(x[1], 0.0))
    owned = space.dofmap.index_map.size_local
    g, h = interpolant(space, low), interpolant(space, high)
    if sides == "both":  # coefficients out of order, where values are not, become their mean
        mean, wrong = 0.5 * (g.x.array + h.x.array), g.x.array > h.x.array
        g.x.array[wrong] = h.x.array[wrong] = mean[wrong]
    bcs, held, values = [], np.zeros(owned, dtype=bool), np.zeros(owned)
    if clamped:
        data = fem.Function(space)
        data.x.array[:] = 0.5 * (g.x.array + h.x.array)
        held = dofs_of(space, fdim, bottom)
        values = data.x.array[:owned].copy()
        bcs = [fem.dirichletbc(data, fem.locate_dofs_topological(space, fdim, bottom))]
    given = {
        name: given_as(rng, space, shape)
        for name, shape in (("lower", low), ("upper", high))
        if sides in (name, "both")
    }
    if on_boundary == "both":
        case = Case(None, a, L, None, None, held, values, None)
        return with_a_rim(rng, case, space, (low, high), given, bcs)
    if on_boundary:
        facets = boundary_facets(domain)
        if rng.random() < 0.5:
            facets = dolfinx.mesh.locate_entities_boundary(
                domain, fdim, lambda x: np.isclose(x[0], 0.0) | np.isclose(x[1], 1.0)
            )
        problem = SignoriniProblem(a, L, contact=facets, bcs=bcs, **given)
        dim, entities = fdim, facets
    else:
        argument, entities = chosen_cells(rng, domain)
        problem = ObstacleProblem(a, L, cells=argument, bcs=bcs, **given)
        dim = fdim + 1
    has = dofs_of(space, dim, entities) & ~held
    lower = np.where(has & (sides != "upper"), g.x.array[:owned], -np.inf)
    upper = np.where(has & (sides != "lower"), h.x.array[:owned], np.inf)
    return Case(problem, a, L, lower, upper, held, values, (dim, entities))


def with_a_rim(rng, case, space, floors, given, bcs):
    """Complete a case: obstacles in the domain, and another one on some sides of the boundary.

    The rim is above the lower floor at some places, and below at others; so is an upper one.
    """
    domain, owned, (low, high) = space.mesh, space.dofmap.index_map.size_local, floors
    bound, wave = ("lower", "upper")[rng.integers(2)], waves(rng, 0.4)
    base, towards = (low, 1.0) if bound == "lower" else (high, -1.0)
    facets = dolfinx.mesh.locate_entities_boundary(
        domain, domain.topology.dim - 1, lambda x: np.isclose(x[0], 0.0) | np.isclose(x[1], 1.0)
    )

    def rim(x):
        return base(x) + towards * (high(x) - low(x)) * np.minimum(0.45, wave(x))

    argument, cells = chosen_cells(rng, domain)
    case.problem = ObstacleProblem(
        case.a,
        case.L,
        cells=argument,
        bcs=bcs,
        contact=facets,
        obstacle=given_as(rng, space, rim),
        bound=bound,
        **given,
    )
    dim = domain.topology.dim
    case.entities = [(dim, cells), (dim - 1, facets)]
    inside, at_rim = (dofs_of(space, *zone) for zone in case.entities)
    limits = {}
    for name, sign, floor in (("lower", 1.0, low), ("upper", -1.0, high)):
        values = interpolant(space, floor).x.array[:owned]
        limit = np.where(inside & (name in given), values, -sign * np.inf)
        if name == bound:
            height = interpolant(space, rim).x.array[:owned]
            case.rim = at_rim & (sign * (height - limit) >= 0.0)
            limit = np.where(case.rim, height, limit)
        limits[name] = limit
    lower, upper = limits["lower"], limits["upper"]
    wrong = lower > upper  # coefficients, where values are not out of order
    lower[wrong] = upper[wrong] = 0.5 * (lower[wrong] + upper[wrong])
    lower[case.held], upper[case.held] = -np.inf, np.inf
    case.lower, case.upper, case.rim_bound = lower, upper, bound
    return case


# What decides, without the package.


class Assembled:
    """Matrix and load of a problem as DOLFINx assembles them, without any boundary conditions."""

    def __init__(self, a, L):
        self.A, self.b = fem_petsc.assemble_matrix(fem.form(a)), None
        self.A.assemble()
        self.b = fem_petsc.assemble_vector(fem.form(L))
        self.b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        with self.A.getDiagonal() as diagonal:
            self.diagonal = np.array(diagonal)

    def reactions(self, values):
        """A u - b at the dofs of this rank."""
        x, y = self.A.createVecs()
        x.array_w[:] = values
        self.A.mult(x, y)
        found = y.array_r - self.b.array_r
        for item in (x, y):
            item.destroy()
        return found

    def destroy(self):
        self.A.destroy()
        self.b.destroy()


def reference(case, assembled):
    """The solution by SNES vinewtonrsls with a direct solver, or where SNES fails by BVLS."""
    A, b = assembled.A.copy(), assembled.b.copy()
    first = A.getOwnershipRange()[0]
    rows = (np.flatnonzero(case.held) + first).astype(np.int32)
    x = A.createVecRight()
    x.array_w[:] = np.where(case.held, case.values, 0.0)
    A.zeroRowsColumns(rows, 1.0, x, b)
    lower, upper = x.duplicate(), x.duplicate()
    lower.array_w[:] = np.where(np.isfinite(case.lower), case.lower, PETSc.NINFINITY)
    upper.array_w[:] = np.where(np.isfinite(case.upper), case.upper, PETSc.INFINITY)

    def residual(snes, x, f):
        A.mult(x, f)
        f.axpy(-1.0, b)

    snes, r = PETSc.SNES().create(COMM), x.duplicate()
    snes.setType("vinewtonrsls")
    snes.setFunction(residual, r)
    snes.setJacobian(lambda snes, x, J, P: None, A)
    snes.setVariableBounds(lower, upper)
    snes.setTolerances(rtol=0.0, stol=0.0, atol=1e-12 * (1.0 + b.norm()), max_it=60)
    snes.getKSP().setType("preonly")
    snes.getKSP().getPC().setType("lu")
    if COMM.size > 1:
        snes.getKSP().getPC().setFactorSolverType("mumps")
    snes.solve(None, x)
    found = x.array_r.copy() if snes.getConvergedReason() > 0 else bounded(A, b, lower, upper)
    for item in (snes, r, lower, upper, x, A, b):
        item.destroy()
    return found


def bounded(A, b, lower, upper):
    """Minimise 1/2 x.Ax - b.x between bounds on rank 0, as dense least squares by BVLS."""
    first, last = A.getOwnershipRange()
    part = sp.csr_matrix(A.getValuesCSR()[::-1], shape=(last - first, A.getSize()[1]))
    parts = COMM.gather((part, b.array_r.copy(), lower.array_r.copy(), upper.array_r.copy()))
    x = None
    if parts is not None:
        matrices, *vectors = zip(*parts, strict=True)
        b, lower, upper = (np.concatenate(v) for v in vectors)
        factor = np.linalg.cholesky(sp.vstack(matrices).toarray())
        lower[lower < -1e15], upper[upper > 1e15] = -np.inf, np.inf
        upper = np.maximum(upper, lower + 1e-14 * (1.0 + np.abs(lower)))  # BVLS wants room
        bounds, right = (lower, upper), np.linalg.solve(factor, b)
        x = lsq_linear(factor.T, right, bounds, method="bvls", tol=1e-15).x
    return COMM.bcast(x)[first:last]


def check_kkt(case, tolerance=1e-8):
    """Check what characterises the solution, and what the problem hands out; return u."""
    problem, assembled = case.problem, Assembled(case.a, case.L)
    owned = problem.space.dofmap.index_map.size_local
    u = problem.u.x.array[:owned].copy()
    force = assembled.reactions(u)
    scale = largest(assembled.b.array_r) + largest(assembled.diagonal * u)
    assert (u >= case.lower - SAME).all() and (u <= case.upper + SAME).all()
    assert np.array_equal(u[case.held], case.values[case.held])
    low, high = u <= case.lower + SAME, u >= case.upper - SAME
    wrong = np.where(low & high, 0.0, force)
    wrong[low & ~high] = np.minimum(force[low & ~high], 0.0)
    wrong[high & ~low] = np.maximum(force[high & ~low], 0.0)
    wrong[case.held] = 0.0
    assert largest(wrong) <= tolerance * scale
    # What the problem hands out.
    has = np.isfinite(case.lower) | np.isfinite(case.upper)
    nearest = np.where(has, np.minimum(u - case.lower, case.upper - u), 0.0)
    assert largest(nearest[has] - problem.gap.x.array[:owned][has]) <= 1e-12
    assert np.array_equal(np.sort(problem.contact_dofs), np.flatnonzero(has))
    assert np.array_equal(np.sort(problem.active), np.flatnonzero(low | high))
    assert problem.result.active_dofs == total(low | high)
    # Forces push up (positive) at a lower obstacle; with an upper one alone the sign is turned.
    forces = problem.sign * problem.forces.x.array[:owned]
    expected = np.where((low | high) & has, force, 0.0)
    assert largest(forces - expected) <= tolerance * scale
    assert abs(problem.force - total(expected)) <= tolerance * scale * len(u) * COMM.size
    zones = [(problem, case.entities)]
    if case.rim is not None:
        side = low if case.rim_bound == "lower" else high
        inside, boundary = problem.zones
        at_rim = np.where(case.rim & side & ~case.held, expected, 0.0)
        for zone, known in ((boundary, at_rim), (inside, expected - at_rim)):
            own = problem.sign * zone.forces.x.array[:owned]
            assert largest(np.where(low & high, 0.0, own - known)) <= tolerance * scale
        assert problem.boundary.force + inside.force == pytest.approx(problem.force)
        assert largest(problem.pressure.x.array - inside.pressure.x.array) == 0.0
        zones = list(zip(problem.zones, case.entities, strict=True))
    for zone, (dim, entities) in zones:
        integral = problem.sign * integrated(problem.space, dim, entities, zone.pressure)
        assert integral == pytest.approx(zone.force, rel=1e-8, abs=1e-8 * scale)
    assembled_u = reference(case, assembled)
    assert largest(u - assembled_u) <= 1e-8 * max(1.0, largest(u))
    assembled.destroy()
    return u


def integrated(space, dim, entities, function):
    """The integral of a function over cells or facets of the boundary that this rank owns."""
    domain = space.mesh
    entities = np.sort(entities[entities < domain.topology.index_map(dim).size_local])
    tags = dolfinx.mesh.meshtags(domain, dim, entities, np.ones(len(entities), dtype=np.int32))
    kind = "dx" if dim == domain.topology.dim else "ds"
    over = ufl.Measure(kind, domain, subdomain_data=tags)
    return total(fem.assemble_scalar(fem.form(function * over(1))))


FEW = [
    (0, "triangles", 1, False, False, "both"),
    (1, "perturbed", 1, False, False, "both"),
    (2, "perturbed", 2, True, False, "both"),
    (3, "triangles", 3, True, False, "upper"),
    (4, "triangles", 2, False, False, "both"),
    (5, "quadrilaterals", 1, False, False, "both"),
    (6, "quadrilaterals", 2, False, False, "lower"),
    (7, "tetrahedra", 1, False, False, "both"),
    (8, "tetrahedra", 2, True, False, "both"),
    (9, "triangles", 1, False, True, "both"),
    (10, "perturbed", 2, True, True, "both"),
    (11, "tetrahedra", 1, False, True, "both"),
    (12, "quadrilaterals", 2, False, True, "both"),
    (13, "triangles", 1, False, "both", "lower"),
    (14, "perturbed", 2, True, "both", "both"),
    (15, "quadrilaterals", 2, False, "both", "upper"),
    (16, "tetrahedra", 1, False, "both", "both"),
]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("which", FEW, ids=lambda which: "-".join(map(str, which[1:])))
def test_karush_kuhn_tucker(which, seed):
    case = random_case(100 * seed + which[0], *which[1:])
    case.problem.solve(rtol=TIGHT)
    check_kkt(case)
    case.problem.destroy()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1000, 1300))
def test_karush_kuhn_tucker_of_many(seed):
    case = random_case(seed)
    case.problem.solve(rtol=TIGHT)
    check_kkt(case)
    case.problem.destroy()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2000, 2200))
def test_karush_kuhn_tucker_of_many_with_a_rim(seed):
    case = random_case(seed, on_boundary="both")
    case.problem.solve(rtol=TIGHT)
    check_kkt(case)
    case.problem.destroy()


# Properties.


class Held:
    """A membrane between two floors whose data are functions, clamped at the left.

    Args:
        lower, upper: Whether there is such a floor.
        on_boundary: Whether the floors are on the boundary alone.
    """

    def __init__(self, lower=True, upper=True, on_boundary=False, n=10):
        domain = friedrichs_keller(COMM, n)
        self.space = fem.functionspace(domain, ("Lagrange", 1))
        self.data = {
            name: fem.Function(self.space) for name in ("lower", "upper", "load", "clamped")
        }
        self.reaction = fem.Constant(domain, 0.0)
        u, v = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        left = dolfinx.mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], 0.0))
        dofs = fem.locate_dofs_topological(self.space, 1, left)
        floors = {"lower": lower, "upper": upper}
        arguments = {name: self.data[name] for name, there in floors.items() if there}
        if on_boundary:
            kind, arguments["contact"] = SignoriniProblem, boundary_facets(domain)
        else:
            kind = ObstacleProblem
        self.problem = kind(
            (ufl.inner(ufl.grad(u), ufl.grad(v)) + self.reaction * u * v) * ufl.dx,
            self.data["load"] * v * ufl.dx,
            bcs=[fem.dirichletbc(self.data["clamped"], dofs)],
            **arguments,
        )

    def solve(self, reaction=0.0, **values):
        """Set data to callables, arrays or numbers, solve, and return the values of u."""
        self.reaction.value = reaction
        for name, value in values.items():
            if callable(value):
                self.data[name].interpolate(value)
            else:
                self.data[name].x.array[:] = value
        return self.problem.solve(rtol=TIGHT).x.array.copy()

    def handed_out(self):
        """What the problem hands out after a solve, by name."""
        problem = self.problem
        functions = {name: getattr(problem, name).x.array for name in ("gap", "pressure", "forces")}
        return {"u": problem.u.x.array.copy(), "force": np.array(problem.force), **functions}


def scenes(seed, size):
    """Random obstacles, at least 0.01 apart, and loads that press against both of them."""
    rng = np.random.default_rng(seed)
    low, wide, load = waves(rng, 0.1, -0.1), waves(rng, 0.1), waves(rng, size)
    return {
        "lower": low,
        "upper": lambda x: low(x) + 0.01 + np.abs(wide(x)),
        "load": load,
        "clamped": lambda x: low(x) + 0.005 + 0.5 * np.abs(wide(x)),
    }


SEEDS, SIZES = st.integers(0, 10**6), st.floats(1.0, 100.0)


def same(one, other, tolerance=1e-9):
    """Whether two arrays are the same on all ranks, beside the size of the first one."""
    return largest(np.asarray(one) - np.asarray(other)) <= tolerance * max(1.0, largest(one))


@pytest.fixture(scope="module")
def pair():
    """Two problems between two floors."""
    problems = Held(), Held()
    yield problems
    for each in problems:
        each.problem.destroy()


@given(seed=SEEDS, size=SIZES)
def test_upside_down(pair, seed, size):
    scene = scenes(seed, size)
    one, other = pair
    one.solve(**scene)
    values = {name: one.data[name].x.array for name in scene}
    values["lower"], values["upper"] = values["upper"], values["lower"]
    other.solve(**{name: -value for name, value in values.items()})
    mirrored = other.handed_out()
    for name, value in one.handed_out().items():
        assert same(value, mirrored[name] if name == "gap" else -mirrored[name]), name
    assert np.array_equal(one.problem.active, other.problem.active)


@given(seed=SEEDS, size=SIZES, shift=st.floats(-10.0, 10.0), reaction=st.sampled_from([0.0, 3.0]))
def test_shifted(pair, seed, size, shift, reaction):
    scene = scenes(seed, size)
    one, other = pair
    u = one.solve(reaction, **scene)
    values = {name: one.data[name].x.array + shift for name in ("lower", "upper", "clamped")}
    values["load"] = one.data["load"].x.array + reaction * shift
    moved = other.solve(reaction, **values)
    assert same(u + shift, moved)
    for name, value in one.handed_out().items():
        assert name == "u" or same(value, other.handed_out()[name], 1e-8), name


@pytest.mark.parametrize("on_boundary", [False, True])
@pytest.mark.parametrize("far", [100.0, 1e20, 1e300])
def test_a_floor_far_away_is_none(on_boundary, far):
    scene = scenes(5, 1.0) | {"load": lambda x: 100.0 * np.sin(7.0 * x[0]) * np.cos(5.0 * x[1])}
    both, lower, upper = (
        Held(low, high, on_boundary) for low, high in ((True, True), (True, False), (False, True))
    )
    expected = lower.solve(**scene)
    assert same(expected, both.solve(**{**scene, "upper": far}))
    assert both.problem.force == pytest.approx(lower.problem.force) and lower.problem.force > 0.0
    expected = upper.solve(**scene)
    assert same(expected, both.solve(**{**scene, "lower": -far}))
    assert both.problem.force == pytest.approx(upper.problem.force) and upper.problem.force < 0.0
    # The pressure of the only obstacle is positive, and that of the upper one of two negative.
    assert same(both.problem.pressure.x.array, -upper.problem.pressure.x.array, 1e-8)
    for each in (both, lower, upper):
        each.problem.destroy()


@pytest.mark.parametrize("on_boundary", [False, True])
def test_floors_that_meet(on_boundary):
    """Where both floors are one, u is there, and the force has the sign that is needed."""
    held = Held(on_boundary=on_boundary)
    scene = scenes(8, 60.0)
    u = held.solve(**{**scene, "upper": scene["lower"], "clamped": scene["lower"]})
    problem, owned = held.problem, held.space.dofmap.index_map.size_local
    lower = held.data["lower"].x.array
    dofs = problem.contact_dofs
    assert np.array_equal(u[dofs], lower[dofs])
    assert np.array_equal(np.sort(problem.active), np.sort(dofs))
    assert problem.result.active_dofs == total(len(dofs))
    assembled = Assembled(problem.a, problem.L)
    force = assembled.reactions(u[:owned])
    assert same(problem.forces.x.array[dofs], force[dofs], 1e-10)
    assert COMM.allreduce(bool((force[dofs] > 0).any()), op=MPI.LOR)
    assert COMM.allreduce(bool((force[dofs] < 0).any()), op=MPI.LOR)
    # The derivative in the direction of a load holds all of the dofs with an obstacle.
    v = ufl.TestFunction(held.space)
    z, forces = problem.solve_linearised(v * ufl.dx, rtol=1e-12)
    assert largest(z.x.array[dofs]) == 0.0
    along = Assembled(problem.a, v * ufl.dx)
    assert same(forces.x.array[dofs], along.reactions(z.x.array[:owned])[dofs], 1e-10)
    for item in (assembled, along, problem):
        item.destroy()


@pytest.mark.parametrize("on_boundary", [False, True])
def test_a_loop_of_moving_floors(on_boundary):
    """Each step is what a new problem finds, the second one as the first."""
    loop = Held(on_boundary=on_boundary)
    for step in range(6):
        scene = scenes(21, 40.0)
        low, high, load = (scene[name] for name in ("lower", "upper", "load"))
        moved = {
            "lower": lambda x, low=low, step=step: low(x) + 0.02 * step * x[0],
            "upper": lambda x, high=high, step=step: high(x) + 0.03 * step * x[0] * x[1] + 0.1,
            "load": lambda x, load=load, step=step: load(x) * np.cos(0.7 * step),
            "clamped": scene["clamped"],
        }
        if step == 3:  # only the floors move
            del moved["load"]
        loop.solve(**moved)
        fresh = Held(on_boundary=on_boundary)
        fresh.solve(**{name: function.x.array for name, function in loop.data.items()})
        expected = fresh.handed_out()
        for name, value in loop.handed_out().items():
            assert same(value, expected[name], 1e-8), (step, name)
        assert np.array_equal(loop.problem.active, fresh.problem.active)
        fresh.problem.destroy()
    loop.problem.destroy()


@pytest.mark.parametrize("on_boundary", [False, True])
def test_linearised_is_the_difference_quotient(on_boundary):
    """While no dof changes sides the solution depends linearly on the load."""
    held = Held(on_boundary=on_boundary)
    before = held.solve(**scenes(33, 50.0))
    problem = held.problem
    forces, active = problem.forces.x.array.copy(), problem.active.copy()
    low, high = (same_as(held, name) for name in ("lower", "upper"))
    assert total(low) and total(high)
    direction = fem.Function(held.space)
    direction.interpolate(lambda x: np.sin(3.0 * x[0]) + x[1])
    load = direction * ufl.TestFunction(held.space) * ufl.dx
    z, moved = problem.solve_linearised(load, rtol=1e-13)
    step = 1e-5
    after = held.solve(load=held.data["load"].x.array + step * direction.x.array)
    assert np.array_equal(problem.active, active)
    assert same(z.x.array, (after - before) / step, 1e-6)
    assert same(moved.x.array, (problem.forces.x.array - forces) / step, 1e-6)
    problem.destroy()


def same_as(held, name):
    """Which owned dofs with an obstacle are at it."""
    dofs = held.problem.contact_dofs
    return held.problem.u.x.array[dofs] == held.data[name].x.array[dofs]


def test_forces_balance():
    """With a reaction and without Dirichlet data the forces add up to reaction minus load."""
    domain = friedrichs_keller(COMM, 12)
    space = bernstein_space(domain, 2)
    u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
    load = 60.0 * ufl.sin(5.0 * x[0]) * ufl.cos(4.0 * x[1]) + 3.0
    problem = ObstacleProblem(
        (ufl.inner(ufl.grad(u), ufl.grad(v)) + 2.0 * u * v) * ufl.dx,
        load * v * ufl.dx,
        lower=lambda x: -0.3 - 0.1 * x[0],
        upper=0.2 + 0.1 * x[1],
    )
    u = problem.solve(rtol=TIGHT)
    expected = total(fem.assemble_scalar(fem.form((2.0 * u - load) * ufl.dx)))
    assert problem.force == pytest.approx(expected, rel=1e-8)
    pressure = problem.pressure
    assert total(fem.assemble_scalar(fem.form(pressure * ufl.dx))) == pytest.approx(expected)
    owned = pressure.x.array[problem.contact_dofs]
    assert COMM.allreduce(float(owned.max(initial=0.0)), op=MPI.MAX) > 0.0
    assert COMM.allreduce(float(owned.min(initial=0.0)), op=MPI.MIN) < 0.0
    problem.destroy()


def test_coefficients_may_be_out_of_order_where_values_are_not():
    """Next to a kink the coefficients of the obstacles of degree 2 change their order."""
    domain = friedrichs_keller(COMM, 5)
    space = bernstein_space(domain, 2)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)

    def kink(x):
        return np.abs(x[0] - 0.5)

    zero = fem.Constant(domain, 0.0)
    clamp = dirichlet(space, boundary_facets(domain), 0.0)
    problem = ObstacleProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        zero * v * ufl.dx,
        lower=lambda x: -kink(x),
        upper=kink,
        bcs=[clamp],
    )
    crossed = interpolant(space, kink).x.array < 0.0
    assert COMM.allreduce(bool(crossed.any()), op=MPI.LOR)
    assert largest(problem.solve().x.array) <= 1e-12
    problem.destroy()
