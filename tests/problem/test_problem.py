"""The surface of SignoriniProblem: changed data, warm starts, both bounds, what a solve leaves."""

import copy
import gc

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.errors import InputError, NotConvergedError
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.elements import control_points
from dolfinx_signorini.problem.signorini import SignoriniProblem

COMM = MPI.COMM_WORLD
TIGHT = 1e-12
CONSTANTS = {"weight": -2.5, "reaction": 1.0, "height": -0.12, "top": 0.02}
FUNCTIONS = {
    "wind": lambda x: 0.5 * x[1],
    "stiffness": lambda x: 1.0 + x[0],
    "bump": lambda x: 0.1 * x[0] ** 2 - 0.02,
    "left": lambda x: 0.02 * x[1],
}


def square(n=12):
    return friedrichs_keller(COMM, n)


def side(domain, axis, place):
    """The facets of a side of the unit square."""
    return dolfinx.mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[axis], place))


class Membrane:
    """A membrane over a floor, clamped at the left and at the top; all of its data can change.

    The lower left corner belongs to the contact boundary and has Dirichlet data.

    Args:
        domain: The mesh.
        obstacle: Whether the floor is an "expression", a "function" or a "callable".
        sign: -1 for the same problem upside down.
        degree: The degree of the elements.
        given: Whether the problem is given the function to be filled.
        contact: The contact boundary; the lower side by default.
        values: Data other than those at first: numbers and arrays.
    """

    def __init__(
        self,
        domain,
        obstacle="expression",
        sign=1.0,
        degree=1,
        given=False,
        contact=None,
        values=(),
    ):
        space = fem.functionspace(domain, ("Lagrange", degree))
        self.given = fem.Function(space) if given else None
        d = {name: fem.Constant(domain, value) for name, value in CONSTANTS.items()}
        d |= {name: fem.Function(space) for name in FUNCTIONS}
        self.data = d
        for name, value in {**FUNCTIONS, **dict(values)}.items():
            self.change(name, value)
        if sign < 0.0:
            d["left"].x.array[:] *= -1.0
            d["top"].value *= -1.0
        trial, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        x = ufl.SpatialCoordinate(domain)
        stiff = d["stiffness"] * ufl.inner(ufl.grad(trial), ufl.grad(v))
        left, top = (
            fem.locate_dofs_topological(space, 1, side(domain, *s)) for s in ((0, 0), (1, 1))
        )
        floors = {
            "expression": sign * (d["height"] + d["bump"] * (1.0 + x[0])),
            "function": d["bump"],
            "callable": lambda y: d["height"].value + 0.1 * y[0] ** 2 - 0.02,
        }
        self.problem = SignoriniProblem(
            (stiff + d["reaction"] * trial * v) * ufl.dx,
            sign * (d["weight"] * (1.0 + x[0]) + d["wind"]) * v * ufl.dx,
            contact=side(domain, 1, 0.0) if contact is None else contact,
            obstacle=floors[obstacle],
            bound="lower" if sign > 0.0 else "upper",
            bcs=[fem.dirichletbc(d["left"], left), fem.dirichletbc(d["top"], top, space)],
            u=self.given,
        )

    def change(self, name, value):
        """Set a Constant to a number, or a Function to an array or a callable of x."""
        item = self.data[name]
        if isinstance(item, fem.Constant):
            item.value = value
        elif callable(value):
            item.interpolate(value)
        else:
            item.x.array[:] = value

    def solve(self, *arguments, **options):
        return self.problem.solve(*arguments, rtol=TIGHT, **options)


def largest(values):
    """The largest absolute value of an array on all ranks."""
    return COMM.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX)


def total(values):
    """The sum of an array over all ranks."""
    return COMM.allreduce(float(np.sum(values)))


def equals_a_fresh_problem(membrane, obstacle, values):
    """Compare a solved problem with a new one of the same data, pressure and gap included."""
    domain = membrane.problem.space.mesh
    fresh = Membrane(domain, obstacle, values=values)
    u = fresh.solve(warm_start=False)
    for mine, other in (
        (membrane.problem.u, u),
        (membrane.problem.gap, fresh.problem.gap),
        (membrane.problem.pressure, fresh.problem.pressure),
    ):
        difference = largest(mine.x.array - other.x.array)
        assert difference <= 1e-8 * max(1.0, largest(other.x.array)), mine.name
    assert np.array_equal(membrane.problem.active, fresh.problem.active)
    fresh.problem.destroy()


@pytest.fixture
def assemblies(monkeypatch):
    """Count the assemblies of matrices and vectors, calls of dolfinx to itself left out."""
    counts = {"assemble_matrix": 0, "assemble_vector": 0}
    inside = []
    for name in counts:
        assemble = getattr(fem.petsc, name)

        def counting(*arguments, _name=name, _assemble=assemble, **options):
            counts[_name] += not inside
            inside.append(_name)
            try:
                return _assemble(*arguments, **options)
            finally:
                inside.pop()

        monkeypatch.setattr(fem.petsc, name, counting)

    def since_last_time():
        found = tuple(counts.values())
        counts.update(dict.fromkeys(counts, 0))
        return found

    return since_last_time


@pytest.mark.parametrize("given", [True, False])
def test_solve_fills_one_function_and_returns_it(given, solve_with_scipy):
    membrane = Membrane(square(), given=given)
    problem = membrane.problem
    before = problem.u
    u = membrane.solve()
    assert u is before and u is problem.u and (membrane.given is u or not given)
    owned = problem.b.getLocalSize()
    assert largest(u.x.array[:owned] - solve_with_scipy(problem)) <= 1e-9
    first = u.x.array.copy()
    membrane.change("weight", -5.0)
    for method in ("cascade", "bntr"):
        assert membrane.solve(method) is u
        assert largest(u.x.array[:owned] - solve_with_scipy(problem)) <= 1e-9
    assert largest(u.x.array - first) > 1e-2
    problem.destroy()


# What changes, the kind of the obstacle, and how often matrix and load are assembled for it.
CHANGES = {
    "constant in the load": ("weight", -4.0, "expression", (0, 1)),
    "function in the load": ("wind", lambda x: -3.0 * x[0], "expression", (0, 1)),
    "constant in the form": ("reaction", 30.0, "expression", (1, 1)),
    "function in the form": ("stiffness", lambda x: 1.5 - x[0], "expression", (1, 1)),
    "constant in the obstacle": ("height", -0.08, "expression", (0, 0)),
    "function in the obstacle": ("bump", lambda x: 0.06 * x[0], "expression", (0, 0)),
    "obstacle as a function": ("bump", lambda x: 0.2 * x[0] ** 2 - 0.1, "function", (0, 0)),
    "obstacle as a callable": ("height", -0.08, "callable", (0, 0)),
    "constant as Dirichlet data": ("top", 0.5, "expression", (0, 1)),
    "function as Dirichlet data": ("left", lambda x: 0.5 * x[1], "expression", (0, 1)),
}


@pytest.mark.parametrize("method", ["cascade", "tron"])
@pytest.mark.parametrize("change", CHANGES)
def test_changed_data_are_seen_and_nothing_else_is_assembled(change, method, assemblies):
    name, value, obstacle, expected = CHANGES[change]
    membrane = Membrane(square(), obstacle)
    assert assemblies() == (1, 1)
    first = membrane.solve(method).x.array.copy()
    assert assemblies() == (0, 0)
    membrane.change(name, value)
    second = membrane.solve(method).x.array.copy()
    assert assemblies() == expected
    assert largest(second - first) > 1e-3
    assert largest(membrane.solve(method).x.array - second) <= 1e-9
    assert assemblies() == (0, 0)
    now = value if isinstance(value, float) else membrane.data[name].x.array
    equals_a_fresh_problem(membrane, obstacle, {name: now})
    membrane.problem.destroy()


def of_one_rank(space, wanted):
    """The wanted owned dofs that no other rank has, on the first rank with some; else none."""
    index_map = space.dofmap.index_map
    shared = np.concatenate(COMM.allgather(index_map.ghosts)) - index_map.local_range[0]
    dofs = np.setdiff1d(wanted, shared)
    counts = COMM.allgather(len(dofs))
    assert max(counts) > 0
    return dofs if COMM.rank == next(i for i, n in enumerate(counts) if n) else dofs[:0]


@pytest.mark.parametrize(
    ("name", "shift", "obstacle"),
    [
        ("wind", -40.0, "expression"),
        ("stiffness", 3.0, "expression"),
        ("bump", 0.1, "expression"),
        ("bump", 0.1, "function"),
        ("left", 0.3, "expression"),
    ],
)
def test_values_that_changed_on_one_rank_alone_are_seen_by_all(name, shift, obstacle):
    membrane = Membrane(square(), obstacle)
    first, problem = membrane.solve().x.array.copy(), membrane.problem
    wanted = {"bump": problem.contact_dofs, "left": problem.fixed_dofs}
    owned = np.arange(problem.b.getLocalSize())
    values = membrane.data[name].x.array
    values[of_one_rank(problem.space, wanted.get(name, owned))] += shift
    assert largest(membrane.solve().x.array - first) > 1e-3
    equals_a_fresh_problem(membrane, obstacle, {name: values})
    problem.destroy()


def test_data_refused_together_with_a_changed_load_are_seen_when_they_make_sense_again():
    membrane = Membrane(square())
    membrane.solve()
    membrane.change("weight", -4.0)
    membrane.change("height", 1.0)  # above the Dirichlet data
    with pytest.raises(InputError, match="obstacle"):
        membrane.solve()
    membrane.change("height", -0.08)
    membrane.solve()
    equals_a_fresh_problem(membrane, "expression", {"weight": -4.0, "height": -0.08})
    membrane.problem.destroy()


@pytest.mark.parametrize("name", ["weight", "stiffness", "height", "left"])
def test_a_value_that_is_refused_leaves_a_problem_that_can_be_solved(name):
    membrane = Membrane(square())
    membrane.solve()
    data = membrane.data[name]
    numbers = data.x.array if isinstance(data, fem.Function) else data.value
    before = np.array(numbers)
    numbers[...] = np.nan
    for _ in range(2):
        with pytest.raises(InputError):
            membrane.solve()
        assert has_no_state(membrane.problem)
    numbers[...] = 1.1 * before
    membrane.solve()
    equals_a_fresh_problem(membrane, "expression", {name: 1.1 * before})
    membrane.problem.destroy()


@pytest.mark.parametrize("obstacle", ["expression", "callable"])
def test_a_mesh_that_has_moved_is_seen_by_an_update(obstacle, assemblies):
    membrane = Membrane(square(), obstacle)
    first = membrane.solve().x.array.copy()
    agree(membrane.problem)  # also what the pressure is made of belongs to the old mesh
    values = {name: membrane.data[name].x.array for name in FUNCTIONS}
    x = membrane.problem.space.mesh.geometry.x
    x[:, 0], x[:, 1] = x[:, 0] ** 1.5, x[:, 1] ** 2  # the same square
    assemblies()
    membrane.problem.update(matrix=True)
    assert assemblies() == (1, 1)
    assert largest(membrane.solve().x.array - first) > 1e-3
    assert assemblies() == (0, 0)
    equals_a_fresh_problem(membrane, obstacle, values)
    membrane.problem.destroy()


@pytest.mark.parametrize("bound", [1.0, -1.0])
def test_a_warm_start_searches_and_solves_nothing_again(bound, monkeypatch):
    def no_search(*arguments, **options):
        raise AssertionError("a search between meshes")

    monkeypatch.setattr(fem, "create_interpolation_data", no_search)
    membrane = Membrane(square(24), sign=bound)
    first = membrane.problem.solve().x.array.copy()
    again = membrane.problem.solve()
    result = membrane.problem.result
    assert result.linear_solves <= 1 and result.linear_iterations == 0 and result.iterations == 0
    assert np.array_equal(again.x.array, first)
    membrane.problem.solve("bqnls", rtol=1e-6)
    assert membrane.problem.result.iterations == 0
    # A floor that falls a little leaves nothing in contact, but the set in contact is known.
    lower = {"height": CONSTANTS["height"] - 1e-3}
    cold = Membrane(square(24), sign=bound, values=lower)
    cold.problem.solve()
    membrane.change("height", lower["height"])
    membrane.problem.solve()
    warm, cold_result = membrane.problem.result, cold.problem.result
    assert warm.linear_solves <= cold_result.linear_solves
    assert warm.linear_iterations < cold_result.linear_iterations
    for item in (membrane, cold):
        item.problem.destroy()


@pytest.mark.parametrize("method", ["cascade", "bncg", "bntr"])
def test_an_upper_bound_is_the_lower_one_upside_down(method):
    lower, upper = (Membrane(square(), sign=sign) for sign in (1.0, -1.0))
    u, minus_u = lower.solve(method), upper.solve(method)
    below, above = lower.problem, upper.problem
    assert largest(u.x.array) > 0.1
    assert largest(u.x.array + minus_u.x.array) <= 1e-9
    assert largest(below.obstacle + above.obstacle) == 0.0
    assert np.array_equal(below.active, above.active)
    assert (minus_u.x.array[above.contact_dofs] <= above.obstacle).all()
    for mine, other in ((below.gap, above.gap), (below.pressure, above.pressure)):
        assert (other.x.array >= 0.0).all()
        assert largest(other.x.array) > 0.01
        assert largest(mine.x.array - other.x.array) <= 1e-8
    below.destroy()
    above.destroy()


def test_contact_as_facets_and_as_tags_is_the_same():
    domain = square()
    lower, right = side(domain, 1, 0.0), side(domain, 0, 1.0)
    facets = np.unique(np.concatenate((lower, right)))

    def tags(parts):
        indices = np.concatenate([part for part, _ in parts])
        values = np.concatenate([np.full(len(part), value, np.int32) for part, value in parts])
        order = np.argsort(indices)
        return dolfinx.mesh.meshtags(domain, 1, indices[order], values[order])

    both, all_sides = tags([(facets, 3)]), [(lower, 3), (right, 5), (side(domain, 1, 1.0), 7)]
    every = tags(all_sides)
    solutions = []
    for contact in (
        facets,
        list(facets),
        tuple(facets),
        both,
        (both, 3),
        (both, np.int8(3)),
        (both, np.array(3)),
        (every, (3, 5)),
        (every, [5, 3]),
        (every, {3, 5}),
        (every, np.array([3, 5])),
    ):
        problem = Membrane(domain, contact=contact, values={"height": -0.2}).problem
        assert np.array_equal(np.sort(problem.contact), facets)
        solutions.append((problem.solve().x.array.copy(), problem.contact_dofs))
        problem.destroy()
    for values, dofs in solutions[1:]:
        assert np.array_equal(values, solutions[0][0])
        assert np.array_equal(dofs, solutions[0][1])
    only = Membrane(domain, contact=(every, 3)).problem
    assert np.array_equal(np.sort(only.contact), np.sort(lower))
    only.destroy()


@pytest.mark.parametrize("method", ["cascade", "bqnls"])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_gap_pressure_and_active_set_agree(sign, degree, method):
    membrane = Membrane(square(), sign=sign, degree=degree)
    membrane.problem.solve(method)
    agree(membrane.problem)
    membrane.change("weight", -3.5)  # and so after a warm start
    membrane.problem.solve(method)
    agree(membrane.problem)
    membrane.problem.destroy()


def agree(problem):
    """Check the relations of a solution with its pressure, dof by dof."""
    gap, pressure = problem.gap.x.array, problem.pressure.x.array
    active, contact = problem.active, problem.contact_dofs
    assert active.dtype == np.int32 and np.isin(active, contact).all()
    free = np.setdiff1d(contact, active)
    assert 0 < total(len(active)) < total(len(contact))
    assert (gap * pressure == 0.0).all()
    assert (gap[active] == 0.0).all() and (gap[free] > 0.0).all()
    assert (pressure[free] == 0.0).all() and (pressure >= 0.0).all()
    inside = np.setdiff1d(np.arange(problem.b.getLocalSize()), contact)
    assert (pressure[inside] == 0.0).all()
    fixed = np.intersect1d(inside, problem.fixed_dofs)
    assert (gap[np.setdiff1d(inside, fixed)] == 0.0).all()
    # Where a fixed dof lies on the contact boundary: the corner, 0.1 above the floor -0.12 - 0.02.
    at = control_points(problem.space)
    corner = fixed[(at[fixed, :2] == 0.0).all(axis=1)]
    assert gap[corner] == pytest.approx(0.14) and total(len(corner)) == 1
    force = problem.system.layout.weights * pressure[contact]
    x = problem.system.vector_of(problem.u)
    multiplier = problem.system.multiplier(x)
    x.destroy()
    assert total(force) > 0.1
    size = problem.b.norm()
    assert largest(force - multiplier) <= 2e-7 * size
    assert total(force) == pytest.approx(total(multiplier), abs=1e-6 * size)


def test_gap_is_that_of_the_last_solve_while_data_change():
    membrane = Membrane(square())
    problem = membrane.problem
    membrane.solve()
    gap, pressure = problem.gap.x.array.copy(), problem.pressure.x.array.copy()
    membrane.data["bump"].x.array[:] -= 1.0
    membrane.change("weight", -9.0)
    agree(problem)
    assert np.array_equal(problem.gap.x.array, gap)
    assert np.array_equal(problem.pressure.x.array, pressure)
    problem.destroy()


STATE = ("gap", "pressure", "active")


def has_no_state(problem):
    """Whether gap, pressure, active set and contact state are all refused."""
    for name in STATE:
        with pytest.raises(InputError, match="problem"):
            getattr(problem, name)
    with pytest.raises(InputError, match="problem"):
        problem.contact_state()
    return True


def test_before_a_solve_and_after_one_that_failed_there_is_no_state():
    membrane = Membrane(square())
    problem = membrane.problem
    assert has_no_state(problem) and problem.result is None
    membrane.solve()
    expected = problem.u.x.array.copy()
    agree(problem)
    with pytest.raises(NotConvergedError):
        problem.solve("bncg", max_iterations=1, warm_start=False)
    assert has_no_state(problem) and problem.result is None
    assert "not solved" in repr(problem)
    assert largest(membrane.solve().x.array - expected) <= 1e-9
    agree(problem)
    problem.destroy()


def test_an_update_with_other_data_leaves_no_state_of_the_old_ones():
    membrane = Membrane(square())
    membrane.solve()
    membrane.change("weight", -4.0)
    membrane.problem.update()
    assert has_no_state(membrane.problem)
    membrane.solve()
    agree(membrane.problem)
    equals_a_fresh_problem(membrane, "expression", {"weight": -4.0})
    membrane.problem.destroy()


def living():
    """The number of PETSc objects that have not been destroyed."""
    gc.collect()
    return sum(issubclass(type(item), PETSc.Object) and bool(item) for item in gc.get_objects())


@pytest.mark.parametrize("way", ["destroy", "del"])
def test_petsc_objects_are_freed_with_the_problem(way):
    before = living()
    problem = Membrane(square()).problem
    for method in ("cascade", "bntr"):
        problem.solve(method)
        agree(problem)
    state = problem.contact_state()
    matrix, load, u, result = copy.copy(problem.A), copy.copy(problem.b), problem.u, problem.result
    assert living() > before + 2
    if way == "destroy":
        problem.destroy()
        problem.destroy()
    else:
        del problem
    assert matrix.getRefCount() == load.getRefCount() == 1  # these two themselves
    matrix.destroy()
    load.destroy()
    assert living() == before
    assert np.array_equal(u.x.array, state.u.x.array) and largest(u.x.array) > 0.1
    assert result.natural_residual <= 1e-7 and result.active_dofs > 0


def test_petsc_objects_are_freed_where_a_problem_is_refused_or_a_solve_fails():
    domain = square()
    before = living()
    with pytest.raises(InputError, match="load"):
        Membrane(domain, values={"wind": np.nan})
    assert living() == before
    problem = Membrane(domain).problem
    for _ in range(2):
        with pytest.raises(NotConvergedError):
            problem.solve("bqnls", max_iterations=1)
    problem.destroy()
    assert living() == before


def test_a_destroyed_problem_is_not_solved():
    problem = Membrane(square()).problem
    problem.solve()
    problem.destroy()
    for call in (problem.solve, problem.update, problem.contact_state, lambda: problem.A):
        with pytest.raises(InputError, match="destroyed"):
            call()
    with pytest.raises(InputError, match="destroyed"):
        problem.solve("bncg", warm_start=False)


def test_the_text_of_a_problem_says_what_it_is():
    problem = Membrane(square(), sign=-1.0, degree=2).problem
    assert "625 dofs of degree 2, u <= g" in repr(problem) and "not solved" in repr(problem)
    problem.solve()
    active = total(len(problem.active))
    assert active == problem.result.active_dofs
    assert f"{active:.0f} dofs in contact" in repr(problem)
    problem.destroy()


def test_a_plot_shows_gap_and_pressure_along_the_boundary(folder):
    problem = Membrane(square()).problem
    with pytest.raises(InputError, match="problem"):
        problem.plot()
    problem.solve()
    figure = problem.plot(folder / "contact.png")
    assert (figure is None) == (COMM.rank > 0)
    for function in (problem.gap, problem.pressure):
        dofs = np.append(problem.contact_dofs, problem.fixed_dofs)
        size = largest(function.x.array[dofs])
        if figure is not None:
            drawn = [line.get_ydata() for axes in figure.axes for line in axes.lines]
            assert any(len(y) == 13 and np.nanmax(y) == pytest.approx(size) for y in drawn)
    if figure is not None:
        assert (folder / "contact.png").read_bytes().startswith(b"\x89PNG")
    problem.destroy()
