"""What is refused, by name, and on all ranks also where one rank alone sees what is wrong."""

import re
from pathlib import Path

import basix.ufl
import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.errors import InputError, NotConvergedError
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem import checks
from dolfinx_signorini.problem.dirichlet import dirichlet
from dolfinx_signorini.problem.obstacle import ObstacleProblem
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.solvers import METHODS
from dolfinx_signorini.solvers.unbounded import moves_without_energy

COMM = MPI.COMM_WORLD
NAN, INF = float("nan"), float("inf")
ROOT = Path(__file__).parent.parent.parent


class Parts:
    """A well-posed problem in parts, to spoil one of them."""

    def __init__(self, n=8):
        self.mesh = friedrichs_keller(COMM, n)
        self.space = fem.functionspace(self.mesh, ("Lagrange", 1))
        self.u, self.v = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        self.x = ufl.SpatialCoordinate(self.mesh)
        self.stiffness = ufl.inner(ufl.grad(self.u), ufl.grad(self.v)) * ufl.dx
        self.a = self.stiffness + self.u * self.v * ufl.dx
        self.L = (self.x[0] - 0.5) * self.v * ufl.dx
        self.facets = boundary_facets(self.mesh)
        self.middle = dolfinx.mesh.compute_midpoints(self.mesh, 1, self.facets)
        self.bottom = self.facets[self.middle[:, 1] < 1e-9]

    def left(self, value):
        """A Dirichlet condition on x = 0, which meets the bottom in the origin."""
        facets = self.facets[self.middle[:, 0] < 1e-9]
        dofs = fem.locate_dofs_topological(self.space, 1, facets)
        if isinstance(value, fem.Function):
            return fem.dirichletbc(value, dofs)
        return fem.dirichletbc(PETSc.ScalarType(value), dofs, self.space)

    def spoiled(self, value):
        """A function with one value that the rank of the origin alone owns."""
        function = fem.Function(self.space)
        at = np.abs(self.space.tabulate_dof_coordinates()).max(axis=1) < 1e-12
        at[self.space.dofmap.index_map.size_local :] = False
        assert COMM.allreduce(int(at.sum())) == 1
        function.x.array[at] = value
        return function

    def problem(self, **changes):
        arguments = {"a": self.a, "L": self.L, "contact": self.facets} | changes
        return SignoriniProblem(arguments.pop("a"), arguments.pop("L"), **arguments)


@pytest.fixture
def parts():
    return Parts()


@pytest.mark.parametrize("value", [NAN, INF, -INF])
def test_load_that_is_not_finite(parts, value):
    with pytest.raises(InputError, match="load"):
        parts.problem(L=parts.spoiled(value) * parts.v * ufl.dx)
    with pytest.raises(InputError, match="load"):
        parts.problem(L=fem.Constant(parts.mesh, value) * parts.v * ufl.dx)


@pytest.mark.parametrize("value", [NAN, INF, -INF])
def test_obstacle_that_is_not_finite(parts, value):
    away = parts.spoiled(value)
    for obstacle in (
        value,
        away,
        0.0 + away,
        lambda x: np.where(x[0] + x[1] < 1e-12, value, 0.0),
        fem.Constant(parts.mesh, value) * parts.x[0],
    ):
        with pytest.raises(InputError, match="obstacle"):
            parts.problem(obstacle=obstacle)
    # Away from the contact boundary nobody asks for it.
    right = parts.facets[parts.middle[:, 0] > 1 - 1e-9]
    parts.problem(contact=right, obstacle=away).destroy()


@pytest.mark.parametrize("value", [NAN, INF])
def test_dirichlet_data_that_are_not_finite(parts, value):
    with pytest.raises(InputError, match="Dirichlet"):
        parts.problem(bcs=[parts.left(value)])
    with pytest.raises(InputError, match="Dirichlet"):
        parts.problem(bcs=[parts.left(parts.spoiled(value))])


@pytest.mark.parametrize(
    ("given", "subject"),
    [
        ({"facets": [0.5]}, "facets"),
        ({"facets": [-1]}, "facets"),
        ({"facets": [10**9]}, "facets"),
        ({"value": NAN}, "value"),
        ({"value": "0"}, "value"),
        ({"component": 2}, "component"),
        ({"component": None}, "component"),
    ],
)
def test_arguments_of_a_dirichlet_condition(parts, given, subject):
    space = fem.functionspace(parts.mesh, ("Lagrange", 1, (2,)))
    arguments = {"facets": parts.facets, "value": 0.0, "component": 0} | given
    with pytest.raises(InputError, match=subject):
        dirichlet(space, **arguments)


@pytest.mark.parametrize("value", [NAN, INF])
def test_coefficient_that_is_not_finite(parts, value):
    a = (1.0 + parts.spoiled(value)) * parts.u * parts.v * ufl.dx
    with pytest.raises(InputError, match="form a"):
        parts.problem(a=parts.a + a)


def test_obstacle_above_the_dirichlet_data(parts):
    # The two parts meet in one dof, the origin.
    bottom = {"contact": parts.bottom, "bcs": [parts.left(0.25)]}
    with pytest.raises(InputError, match=r"obstacle: 0\.5 .* Dirichlet data 0\.25 at \(0, 0, 0\)"):
        parts.problem(obstacle=0.5, **bottom)
    with pytest.raises(InputError, match="obstacle"):
        parts.problem(obstacle=lambda x: np.where(x[0] < 1e-12, 0.26, -1.0), **bottom)
    # Above away from that dof, or equal at it: allowed, and the data win.
    problem = parts.problem(obstacle=lambda x: 0.25 + x[0], **bottom)
    u = problem.solve()
    assert (u.x.array[problem.fixed_dofs] == 0.25).all()
    problem.destroy()


@pytest.mark.parametrize("mean", [0.0, 1e-3, 1.0])
def test_singular_operator_with_unbounded_functional_or_many_solutions(parts, mean):
    load = (parts.x[0] - 0.5 + mean) * parts.v * ufl.dx
    with pytest.raises(InputError, match="load.*unbounded" if mean else "load.*not unique"):
        parts.problem(a=parts.stiffness, L=load)


@pytest.mark.parametrize("method", METHODS)
def test_singular_operator_with_a_load_that_presses(parts, method, solve_with_scipy):
    load = (parts.x[0] - 0.6) * parts.v * ufl.dx
    problem = parts.problem(a=parts.stiffness, L=load)
    u = problem.solve(method, rtol=1e-10)
    reference = solve_with_scipy(problem)
    problem.destroy()
    assert np.abs(u.x.array[: len(reference)] - reference).max(initial=0.0) <= 1e-8
    assert COMM.allreduce(float(reference.sum())) > 0.0


def test_a_problem_without_contact_is_none_of_this_program(parts):
    nowhere = np.empty(0, dtype=np.int32)
    for changes in ({}, {"a": parts.stiffness}, {"bcs": [parts.left(1.0)]}):
        with pytest.raises(InputError, match="there is no facet: the problem is linear") as refusal:
            parts.problem(contact=nowhere, **changes)
        assert refusal.value.subject == "contact"


def test_dirichlet_data_everywhere_leave_no_contact(parts):
    dofs = fem.locate_dofs_topological(parts.space, 1, parts.facets)
    bc = fem.dirichletbc(PETSc.ScalarType(1.0), dofs, parts.space)
    zero = fem.Constant(parts.mesh, 0.0) * parts.v * ufl.dx
    problem = parts.problem(a=parts.stiffness, L=zero, bcs=[bc])
    u = problem.solve()
    problem.destroy()
    assert np.abs(u.x.array - 1.0).max(initial=0.0) <= 1e-7


def test_form_that_is_not_symmetric(parts):
    advection = parts.u.dx(0) * parts.v * ufl.dx
    for factor in (1.0, 1e-3, -1.0):
        with pytest.raises(InputError, match="form a: not symmetric"):
            parts.problem(a=parts.a + factor * advection)
    near_origin = parts.spoiled(1.0) * parts.u.dx(0) * parts.v * ufl.dx
    with pytest.raises(InputError, match="form a: not symmetric"):
        parts.problem(a=parts.a + near_origin)


@pytest.mark.parametrize(
    ("shift", "word"), [(-1.0, r"a\(1, 1\)"), (-1000.0, "diagonal"), (-1e6, "diagonal")]
)
def test_form_that_is_indefinite(parts, shift, word):
    with pytest.raises(InputError, match=f"form a: not positive definite.*{word}"):
        parts.problem(a=parts.stiffness + shift * parts.u * parts.v * ufl.dx)


@pytest.mark.parametrize("method", ["cascade", "bntr"])
@pytest.mark.parametrize("measure", [ufl.dx, ufl.ds])
def test_an_energy_without_a_bound(parts, measure, method):
    """The derivative in y is not in the form, and nothing but the bottom is held from below."""
    problem = parts.problem(
        a=parts.u.dx(0) * parts.v.dx(0) * ufl.dx,
        L=-fem.Constant(parts.mesh, 1.0) * parts.v * measure,
        contact=parts.bottom,
    )
    with pytest.raises(InputError, match=r"form a: .*unbounded below"):
        problem.solve(method)
    problem.destroy()


@pytest.mark.parametrize("load", [-1.0, -1e-200, -1e100])
def test_an_energy_without_a_bound_on_a_mesh_for_multigrid(load):
    """Conjugate gradients do not break down, as factorizations do: they go on and on."""
    parts = Parts(60)
    problem = parts.problem(
        a=parts.u.dx(0) * parts.v.dx(0) * ufl.dx,
        L=fem.Constant(parts.mesh, load) * parts.v * ufl.dx,
        contact=parts.bottom,
    )
    with pytest.raises(InputError, match=r"form a: .*unbounded below"):
        problem.solve()
    problem.destroy()


@pytest.mark.parametrize("method", METHODS[1:])
def test_an_energy_without_a_bound_that_a_limit_of_iterations_hides(parts, method):
    problem = parts.problem(
        a=parts.u.dx(0) * parts.v.dx(0) * ufl.dx,
        L=-fem.Constant(parts.mesh, 1.0) * parts.v * ufl.dx,
        contact=parts.bottom,
    )
    with pytest.raises((InputError, NotConvergedError), match=r"form a.*unbounded below") as caught:
        problem.solve(method, max_iterations=20)
    assert "loosen" not in str(caught.value)
    problem.destroy()


@pytest.mark.parametrize("weak", [1e-3, 1e-9])
def test_a_direction_that_hardly_counts_is_no_energy_without_a_bound(parts, weak):
    a = parts.u.dx(0) * parts.v.dx(0) * ufl.dx + weak * parts.u.dx(1) * parts.v.dx(1) * ufl.dx
    problem = parts.problem(
        a=a, L=-fem.Constant(parts.mesh, 1.0) * parts.v * ufl.dx, contact=parts.bottom
    )
    assert not moves_without_energy(problem.system)
    with pytest.raises(NotConvergedError):
        problem.solve("bncg", max_iterations=2)
    problem.destroy()


@pytest.mark.parametrize("method", ["cascade", "bntr", "tron"])
@pytest.mark.parametrize("reaction", [1e-5, 1e-2])
def test_a_bounded_energy_that_is_almost_flat(reaction, method):
    """The load presses away from the obstacle, and next to nothing holds: u is 1 / reaction."""
    parts = Parts(8)
    a = parts.stiffness + reaction * parts.u * parts.v * ufl.dx
    problem = parts.problem(a=a, L=fem.Constant(parts.mesh, 1.0) * parts.v * ufl.dx)
    u = problem.solve(method)
    assert reaction * u.x.array == pytest.approx(1.0, rel=1e-3)
    problem.destroy()


@pytest.mark.parametrize("method", METHODS)
def test_indefinite_form_that_only_a_solver_can_notice(method, monkeypatch):
    # Beyond some number of unknowns the assembly does not look for negative directions.
    monkeypatch.setattr(checks, "MOST_UNKNOWNS", 0)
    # Clamped, -Laplace - 40 has one negative eigenvalue, for no constant; it is not solved.
    parts = Parts(16)
    dofs = fem.locate_dofs_topological(parts.space, 1, parts.facets[parts.middle[:, 1] > 1e-9])
    bc = fem.dirichletbc(PETSc.ScalarType(0.0), dofs, parts.space)
    a = parts.stiffness - 40.0 * parts.u * parts.v * ufl.dx
    problem = parts.problem(a=a, L=parts.v * ufl.dx, contact=parts.bottom, bcs=[bc], obstacle=0.0)
    with pytest.raises((InputError, NotConvergedError)) as caught:
        problem.solve(method)
    if method not in ("bntr", "tron"):  # they meet it inside their linear solver
        assert "form a: not positive definite" in str(caught.value)
    problem.destroy()


def test_forms_and_spaces_of_the_wrong_kind(parts):
    with pytest.raises(InputError, match="form a"):
        parts.problem(a=parts.v * ufl.dx)
    for load in (parts.a, parts.x[0] * ufl.dx, 0 * parts.L):
        with pytest.raises(InputError, match="load"):
            parts.problem(L=load)
    for element in (
        ("Discontinuous Lagrange", 1),
        ("Bubble", 3),
    ):
        space = fem.functionspace(parts.mesh, element)
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        with pytest.raises(InputError, match="form a: the space must be"):
            parts.problem(a=ufl.inner(u, v) * ufl.dx, L=v * ufl.dx)


def test_what_is_out_of_scope_is_told_where_to_go(parts):
    space = fem.functionspace(parts.mesh, basix.ufl.element("Lagrange", "triangle", 1, shape=(2,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    elastic = {"a": ufl.inner(u, v) * ufl.dx, "L": v[0] * ufl.dx}
    parts.mesh.topology.create_connectivity(1, 2)
    count = parts.mesh.topology.index_map(1).size_local
    cells = np.arange(parts.mesh.topology.index_map(2).size_local, dtype=np.int32)
    tagged = dolfinx.mesh.meshtags(parts.mesh, 2, cells, np.zeros_like(cells))
    inside = "inside of the domain, and not on the boundary; ObstacleProblem"
    for changes, subject, message, use in (
        (
            elastic,
            "form a",
            "vectors of 2 components, and the unknown is a scalar",
            "ContactProblem(",
        ),
        ({"contact": np.arange(count)}, "contact", inside, "ObstacleProblem("),
        ({"contact": tagged}, "contact", "tags of dimension 2, not of facets", "ObstacleProblem("),
    ):
        with pytest.raises(InputError, match=message) as refusal:
            parts.problem(**changes)
        assert refusal.value.subject == subject
        (page,) = re.findall(r"docs/[\w/]+\.md", refusal.value.message)
        assert use in (ROOT / page).read_text()


@pytest.mark.parametrize("released", [[10**7], [-1], [0.5], "a", "free"])
def test_dofs_that_are_not_in_contact_cannot_be_released(parts, released):
    problem = parts.problem()
    problem.solve()
    free = np.setdiff1d(problem.contact_dofs, problem.active)[:1]
    if COMM.allreduce(len(free)) == 0:
        free = np.array([10**7])
    with pytest.raises(InputError) as error:
        problem.solve_linearised(parts.L, released=free if released == "free" else released)
    assert error.value.subject == "released"
    problem.destroy()


@pytest.mark.parametrize("subject, given", [("path", 3), ("path", b"a.png"), ("path", True),
                                            ("sides", {"a": [10**6]}), ("sides", {"a": [-1]}),
                                            ("sides", {3: []})])  # fmt: skip
def test_arguments_of_a_plot(parts, subject, given):
    problem = parts.problem()
    problem.solve()
    with pytest.raises(InputError) as error:
        problem.plot(**{subject: given})
    assert error.value.subject == subject
    problem.destroy()


def test_loads_of_the_linearised_problem(parts):
    problem = parts.problem()
    problem.solve()
    other = fem.functionspace(parts.mesh, ("Lagrange", 2))
    for load in (parts.a, ufl.TestFunction(other) * ufl.dx, 3, parts.x[0] * ufl.dx):
        with pytest.raises(InputError, match="load"):
            problem.solve_linearised(load)
    with pytest.raises(InputError, match="rtol"):
        problem.solve_linearised(parts.L, rtol=-1.0)
    finer = fem.functionspace(parts.mesh, ("Lagrange", 2))
    with pytest.raises(InputError, match="another function space"):
        problem.solve_linearised(fem.Function(finer))
    problem.destroy()


def test_a_refused_problem_leaves_a_usable_communicator(parts):
    # Every rank has left the refused call: the next collective one is not out of step.
    for _ in range(3):
        with pytest.raises(InputError):
            parts.problem(obstacle=parts.spoiled(NAN))
    problem = parts.problem()
    problem.solve()
    assert problem.result.natural_residual <= 1e-7
    problem.destroy()


@pytest.mark.parametrize("n", [8, 64])
def test_a_small_reaction_is_one_on_every_mesh(n):
    """Row sums alone lose a reaction of 1e-9 in the rounding of a fine mesh; the form does not."""
    parts = Parts(n)
    for size, singular in ((1e-9, False), (1e-15, True)):
        small = fem.Constant(parts.mesh, size)
        a = parts.stiffness + small * parts.u * parts.v * ufl.dx
        pressed = parts.problem(a=a, L=-parts.v * ufl.dx)
        assert pressed.system.singular == singular
        pressed.destroy()
        if singular:
            with pytest.raises(InputError, match=r"load.*unbounded"):
                parts.problem(a=a, L=parts.v * ufl.dx)
        else:
            parts.problem(a=a, L=parts.v * ufl.dx).destroy()


def test_cells_with_facets_of_two_kinds():
    cell = dolfinx.mesh.CellType.prism
    domain = dolfinx.mesh.create_unit_cube(COMM, 3, 3, 3, cell)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    with pytest.raises(InputError, match="not of prism cells"):
        SignoriniProblem(u * v * ufl.dx, v * ufl.dx, contact=np.arange(3, dtype=np.int32))


def test_no_contact_facet_is_refused_on_a_mesh_that_knows_no_facets_yet():
    domain = dolfinx.mesh.create_unit_square(COMM, 3, 3)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    with pytest.raises(InputError, match="contact: there is no facet"):
        SignoriniProblem(u * v * ufl.dx, v * ufl.dx, contact=[])


@pytest.mark.parametrize("bound", ["lower", "upper"])
def test_an_obstacle_farther_away_than_numbers_reach_is_refused(bound):
    sign = -1.0 if bound == "lower" else 1.0
    with pytest.raises(InputError, match="obstacle: too far away"):
        Parts().problem(obstacle=sign * np.finfo(float).max, bound=bound)
    # The default suite turns warnings of NumPy into errors.
    problem = Parts().problem(obstacle=sign * 1e300, bound=bound)
    problem.solve()
    assert problem.result.active_dofs == 0
    problem.solve(coarse=problem.contact_state())
    assert problem.result.active_dofs == 0
    problem.destroy()


@pytest.mark.parametrize("far", [-1e20, -1e100, -1e250])
@pytest.mark.parametrize("n", [20, 40, 80])
def test_a_body_that_only_contact_holds_does_not_feel_an_obstacle_out_of_reach(n, far):
    domain = friedrichs_keller(MPI.COMM_WORLD, n)
    V = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    form, load = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, -v * ufl.dx
    found = []
    for place in (far, -10.0):
        problem = SignoriniProblem(
            form,
            load,
            contact=boundary_facets(domain),
            obstacle=lambda x, place=place: np.where(x[0] < 0.5, -0.1, place),
        )
        found.append(problem.solve().x.array.copy())
        assert problem.result.linear_solves < 10
        problem.destroy()
    assert np.abs(found[0] - found[1]).max(initial=0.0) < 1e-5


class Between:
    """An obstacle problem between two floors, to spoil one of its arguments."""

    def __init__(self):
        self.parts = Parts()
        index_map = self.parts.mesh.topology.index_map(2)
        self.cells = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)

    def problem(self, **changes):
        arguments = {"a": self.parts.a, "L": self.parts.L, "lower": -1.0, "upper": 1.0} | changes
        return ObstacleProblem(arguments.pop("a"), arguments.pop("L"), **arguments)

    def refused(self, subject, words="", **changes):
        """Whether a problem is refused on all ranks, with a subject and words."""
        with pytest.raises(InputError, match=words) as refusal:
            self.problem(**changes)
        assert COMM.allgather(refusal.value.subject) == [subject] * COMM.size


@pytest.fixture
def between():
    return Between()


def test_no_obstacle_in_the_domain(between, parts):
    words = "give one of them, or both"
    between.refused("lower, upper", words, lower=None, upper=None)


@pytest.mark.parametrize("name", ["lower", "upper"])
def test_an_obstacle_with_several_values_at_a_node(name, between):
    """Which cell's value counts would depend on the number of ranks."""
    parts, domain = between.parts, between.parts.mesh
    broken = fem.Function(fem.functionspace(domain, ("DG", 0)))
    smooth = fem.Function(fem.functionspace(domain, ("Lagrange", 2)))
    sign = -0.1 if name == "lower" else 0.1
    for obstacle in (broken, sign + broken * ufl.SpatialCoordinate(domain)[0], smooth.dx(0)):
        between.refused(name, "several values at a node", **{name: obstacle})
    of_cells = ufl.CellVolume(domain), sign + ufl.Circumradius(domain)
    for obstacle in of_cells:
        between.refused(name, "quantities of cells have several", **{name: obstacle})
    between.refused(name, "each side of a facet", **{name: ufl.avg(smooth)})
    arguments = {"lower": -1.0, "upper": 1.0, name: sign + 0.01 * smooth}
    ObstacleProblem(parts.a, parts.L, **arguments).destroy()


@pytest.mark.parametrize("value", [NAN, INF, -INF])
@pytest.mark.parametrize("name", ["lower", "upper"])
def test_bounds_that_are_not_finite(between, name, value):
    x, away = between.parts.x, between.parts.spoiled(value)
    for obstacle in (
        value,
        away,
        0.0 + away,
        lambda x: np.where(x[0] + x[1] < 1e-12, value, 0.0),
        fem.Constant(between.parts.mesh, value) * x[0],
    ):
        between.refused(name, "finite", **{name: obstacle})
        with pytest.raises(InputError) as refusal:
            between.parts.problem(**{name: obstacle})
        assert refusal.value.subject == name


def test_a_lower_obstacle_above_the_upper_one(between):
    away = between.parts.spoiled(2.0)
    place = r"lies below the lower obstacle 2 at \(0, 0, 0\)"
    between.refused("upper", f"1 {place}", lower=away)
    between.refused("upper", f"-3 {place}", lower=away, upper=between.parts.x[0] - 3.0)
    with pytest.raises(InputError, match=place):
        between.parts.problem(lower=away, upper=1.0)
    # By as much as rounding, one may lie above the other.
    problem = between.problem(lower=lambda x: 0.1 + 0.2 + 0.0 * x[0], upper=0.3)
    assert problem.solve().x.array == pytest.approx(0.3, rel=1e-15)
    problem.destroy()


def test_an_upper_obstacle_on_the_boundary_below_one_in_the_domain_is_named(comm):
    domain = dolfinx.mesh.create_unit_square(comm, 4, 4)
    V = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    below = dolfinx.mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    with pytest.raises(InputError, match=r"obstacle: -0.25 lies below the lower obstacle -0.2 at"):
        ObstacleProblem(
            (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx,
            1.0 * v * ufl.dx,
            lower=-0.2,
            contact=below,
            obstacle=-0.25,
            bound="upper",
        )


def test_a_lower_obstacle_above_the_upper_one_after_a_change(between):
    floor = fem.Constant(between.parts.mesh, 0.0)
    problem = between.problem(lower=0.0 * between.parts.x[0] + floor)
    problem.solve()
    floor.value = 2.0
    with pytest.raises(InputError, match="upper: 1 lies below the lower obstacle 2"):
        problem.solve()
    floor.value = 0.5
    assert (problem.solve().x.array >= 0.5).all()
    problem.destroy()


def test_bounds_beyond_the_dirichlet_data(between):
    bcs = [between.parts.left(0.25)]
    at = r"Dirichlet data 0\.25 at \(0, 0, 0\)"
    between.refused("lower", f"0.5 lies above the {at}", lower=0.5, bcs=bcs)
    between.refused("upper", f"-0.5 lies below the {at}", upper=-0.5, bcs=bcs)
    between.problem(lower=0.25, bcs=bcs).destroy()


def test_an_obstacle_beside_a_lower_one(between):
    for name in ("lower", "upper"):
        with pytest.raises(InputError) as refusal:
            between.parts.problem(obstacle=0.5, **{name: 0.0})
        assert refusal.value.subject == "obstacle"


def test_cells_that_do_not_exist(between):
    parts = between.parts
    other = friedrichs_keller(COMM, 4)
    some = np.arange(other.topology.index_map(2).size_local, dtype=np.int32)
    foreign = dolfinx.mesh.meshtags(other, 2, some, np.zeros_like(some))
    of_facets = dolfinx.mesh.meshtags(parts.mesh, 1, parts.facets, np.zeros_like(parts.facets))
    tags = dolfinx.mesh.meshtags(parts.mesh, 2, between.cells, np.zeros_like(between.cells))
    on_one_rank = [10**6] if COMM.rank == COMM.size - 1 else between.cells
    for cells, words in (
        ([10**6], "1000000 is no cell"),
        (on_one_rank, "1000000 is no cell"),
        ([-1], "-1 is no cell"),
        ([], "there is no cell"),
        ((tags, 7), "there is no cell"),
        (of_facets, "tags of dimension 1, not of cells"),
        (foreign, "belong to another mesh"),
        ((tags, "water"), "integers"),
        ([0.5], "cells are given by an array of their indices"),
        ("water", "cells are given by an array of their indices"),
    ):
        between.refused("cells", words, cells=cells)
    between.problem(cells=(tags, 0)).destroy()


@pytest.mark.parametrize("name", ["lower", "upper"])
def test_bounds_that_raise_on_one_rank(between, name):
    def at_the_origin(x):
        if (np.abs(x).max(axis=0) < 1e-12).any():
            raise ValueError("nothing is known of the origin")
        return 0.0 * x[0]

    between.refused(name, "nothing is known of the origin", **{name: at_the_origin})
    for wrong in (lambda x: np.zeros(3), lambda x: 1j * x[0], lambda x: "high"):
        between.refused(name, "the callable returned no values", **{name: wrong})


@pytest.mark.parametrize("name", ["lower", "upper"])
def test_bounds_of_the_wrong_kind(between, name):
    foreign = fem.Function(fem.functionspace(friedrichs_keller(COMM, 3), ("Lagrange", 1)))
    for wrong in ("0", [0.0], foreign):
        between.refused(name, "", **{name: wrong})


@pytest.mark.parametrize("name", ["lower", "upper"])
def test_bounds_farther_away_than_numbers_reach(between, name):
    far = np.finfo(float).max * (-1.0 if name == "lower" else 1.0)
    between.refused(name, "too far away", **{name: far})
    other = {"lower": "upper", "upper": "lower"}[name]
    between.refused(name, "too far away", **{name: far, other: None})


def test_bounds_on_a_part_of_the_mesh_that_nothing_else_holds(between):
    """The form vanishes on constants: both obstacles bound the energy, one of them may not."""
    singular = {"a": between.parts.stiffness}
    up = fem.Constant(between.parts.mesh, 1.0) * between.parts.v * ufl.dx
    between.refused("load", "unbounded", L=up, upper=None, **singular)
    between.refused("load", "unbounded", L=-up, lower=None, **singular)
    for load, value in ((up, 1.0), (-up, -1.0)):
        problem = between.problem(L=load, **singular)
        assert problem.solve().x.array == pytest.approx(value)
        problem.destroy()


@pytest.mark.parametrize("method", ["cascade", "bntr", "bqnls"])
def test_a_balanced_load_between_two_obstacles(between, method):
    """A small load leaves room to move the body; a large one has contact on both sides."""
    parts, size = between.parts, fem.Constant(between.parts.mesh, 1.0)
    load = size * (parts.x[0] - 0.5) * parts.v * ufl.dx
    problem = between.problem(a=parts.stiffness, L=load)
    limits = {} if method == "cascade" else {"max_iterations": 1000}
    with pytest.raises(InputError, match=r"load: .*not unique"):
        problem.solve(method, **limits)
    assert problem.result is None
    size.value = 100.0
    u = problem.solve(method)
    # The solution is odd about the middle, and linear outside of the contact only at most.
    places = parts.space.tabulate_dof_coordinates()[:, 0]
    owned = u.x.array[: parts.space.dofmap.index_map.size_local]
    assert abs(COMM.allreduce(float(owned.sum()))) <= 1e-3  # u is odd about the middle
    assert (u.x.array[places < 1e-9] == -1.0).all() and (u.x.array[places > 1 - 1e-9] == 1.0).all()
    problem.destroy()


def test_a_body_of_two_that_no_obstacle_reaches():
    """Two squares that do not touch, and cells of one of them alone."""
    domain = two_squares()
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    a, load = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, -v * ufl.dx
    index_map = domain.topology.index_map(2)
    cells = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
    left = cells[dolfinx.mesh.compute_midpoints(domain, 2, cells)[:, 0] < 1.5]
    with pytest.raises(InputError, match=r"vanishes on constants.*give cells") as refusal:
        ObstacleProblem(a, load, lower=0.0, cells=left)
    assert refusal.value.subject == "cells"
    problem = ObstacleProblem(a, load, lower=0.0)
    assert np.abs(problem.solve().x.array).max(initial=0.0) <= 1e-12
    problem.destroy()


def two_squares():
    """The squares (0, 1)^2 and (2, 3) x (0, 1), each cut into two triangles."""
    square = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    x = np.concatenate((square, square + np.array([2.0, 0.0])))
    cells = np.array([[0, 1, 3], [0, 2, 3], [4, 5, 7], [4, 6, 7]], dtype=np.int64)
    if COMM.rank:
        x, cells = x[:0], cells[:0]
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    return dolfinx.mesh.create_mesh(COMM, cells, x=x, e=ufl.Mesh(element))


def test_a_space_that_is_a_part_of_another_one():
    domain = dolfinx.mesh.create_unit_square(COMM, 3, 3)
    part = fem.functionspace(domain, ("Lagrange", 1, (2,))).sub(0)
    u, v = ufl.TrialFunction(part), ufl.TestFunction(part)
    facets = dolfinx.mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    with pytest.raises(InputError, match="form a: its space is a part of another one"):
        SignoriniProblem(u * v * ufl.dx, v * ufl.dx, contact=facets)
