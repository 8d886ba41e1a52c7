"""What is refused, by name, and on all ranks also where one rank alone sees what is wrong."""

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
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.solvers import METHODS
from dolfinx_signorini.solvers.unbounded import moves_without_energy

COMM = MPI.COMM_WORLD
NAN, INF = float("nan"), float("inf")


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
        basix.ufl.element("Lagrange", "triangle", 1, shape=(2,)),
        ("Bubble", 3),
    ):
        space = fem.functionspace(parts.mesh, element)
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        one = ufl.as_vector([1.0, 1.0]) if space.dofmap.bs == 2 else 1.0
        with pytest.raises(InputError, match="form a: the space"):
            parts.problem(a=ufl.inner(u, v) * ufl.dx, L=ufl.inner(one, v) * ufl.dx)


def test_loads_of_the_linearised_problem(parts):
    problem = parts.problem()
    problem.solve()
    other = fem.functionspace(parts.mesh, ("Lagrange", 2))
    for load in (parts.a, ufl.TestFunction(other) * ufl.dx, 3, parts.x[0] * ufl.dx):
        with pytest.raises(InputError, match="load"):
            problem.solve_linearised(load)
    with pytest.raises(InputError, match="rtol"):
        problem.solve_linearised(parts.L, rtol=-1.0)
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
