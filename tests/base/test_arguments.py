"""Every argument of the problem against wrong types, objects, ranges, meshes: all are refused."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini import (
    InputError,
    SidedMesh,
    SignoriniProblem,
    boundary_facets,
    friedrichs_keller,
)

COMM = MPI.COMM_WORLD


class Setting:
    """A problem on one mesh, and things of another mesh and of other spaces."""

    def __init__(self):
        self.mesh, self.other_mesh = (friedrichs_keller(COMM, n) for n in (6, 5))
        self.space = fem.functionspace(self.mesh, ("Lagrange", 1))
        self.twin = fem.functionspace(self.mesh, ("Lagrange", 1))
        self.other = fem.functionspace(self.other_mesh, ("Lagrange", 1))
        self.u, self.v = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        self.a = (ufl.inner(ufl.grad(self.u), ufl.grad(self.v)) + self.u * self.v) * ufl.dx
        self.L = -fem.Constant(self.mesh, 1.0) * self.v * ufl.dx
        self.facets = boundary_facets(self.mesh)

    def problem(self, **changes):
        arguments = {"a": self.a, "L": self.L, "contact": self.facets} | changes
        return SignoriniProblem(arguments.pop("a"), arguments.pop("L"), **arguments)

    def condition(self, space):
        facets = boundary_facets(space.mesh)
        dofs = fem.locate_dofs_topological(space, 1, facets)
        return fem.dirichletbc(0.5, dofs, space)

    def tags(self, dimension, domain=None):
        domain = self.mesh if domain is None else domain
        domain.topology.create_entities(dimension)
        entities = np.arange(domain.topology.index_map(dimension).size_local, dtype=np.int32)
        return mesh.meshtags(domain, dimension, entities, np.ones_like(entities))

    def tagged(self, value):
        """A measure of the cells, all of which have a tag."""
        count = self.mesh.topology.index_map(2).size_local
        tags = mesh.meshtags(
            self.mesh,
            2,
            np.arange(count, dtype=np.int32),
            np.full(count, value, dtype=np.int32),
        )
        return ufl.Measure("dx", domain=self.mesh, subdomain_data=tags)

    def start(self, value):
        """A function with one value that the last rank alone has."""
        start = fem.Function(self.space)
        start.x.array[: COMM.rank == COMM.size - 1] = value
        return start

    def interior(self):
        """An owned facet inside the domain, on some rank, and none on the others."""
        self.mesh.topology.create_entities(1)
        count = self.mesh.topology.index_map(1).size_local
        return np.setdiff1d(np.arange(count, dtype=np.int32), self.facets)[:1]


@pytest.fixture(scope="module")
def setting():
    return Setting()


WRONG = {
    # The form a.
    "a: a number": ("form a", lambda s: {"a": 1.0}),
    "a: None": ("form a", lambda s: {"a": None}),
    "a: a string": ("form a", lambda s: {"a": "u*v*dx"}),
    "a: linear": ("form a", lambda s: {"a": s.L}),
    "a: two spaces": (
        "form a",
        lambda s: {"a": s.u * ufl.TestFunction(s.twin) * ufl.dx},
    ),
    "a: with the load": ("form a", lambda s: {"a": s.a - s.L}),
    "a: the trial function twice": ("form a", lambda s: {"a": s.u * s.u * s.v * ufl.dx}),
    "a: a coefficient of another mesh": (
        "form a",
        lambda s: {"a": s.a + fem.Function(s.other) * s.u * s.v * ufl.dx(domain=s.mesh)},
    ),
    "a: two sets of tags": (
        "form a",
        lambda s: {"a": s.u * s.v * s.tagged(1) + s.u * s.v * s.tagged(2)(2)},
    ),
    "a: with tags and without": ("form a", lambda s: {"a": s.a + s.u * s.v * s.tagged(1)(1)}),
    # The load.
    "L: two sets of tags": ("load", lambda s: {"L": s.v * s.tagged(1)(1) + s.v * s.tagged(2)(2)}),
    "L: a number": ("load", lambda s: {"L": 0.0}),
    "L: None": ("load", lambda s: {"L": None}),
    "L: bilinear": ("load", lambda s: {"L": s.a}),
    "L: the test function twice": ("load", lambda s: {"L": s.v * s.v * ufl.dx}),
    "L: another space": ("load", lambda s: {"L": ufl.TestFunction(s.twin) * ufl.dx}),
    "L: another mesh": ("load", lambda s: {"L": ufl.TestFunction(s.other) * ufl.dx}),
    "L: a coefficient of another mesh": (
        "load",
        lambda s: {"L": fem.Function(s.other) * s.v * ufl.dx(domain=s.mesh)},
    ),
    # The contact boundary.
    "contact: None": ("contact", lambda s: {"contact": None}),
    "contact: a string": ("contact", lambda s: {"contact": "bottom"}),
    "contact: rows of different lengths": ("contact", lambda s: {"contact": [[1, 2], [3]]}),
    "contact: tags with a value that is none": (
        "contact",
        lambda s: {"contact": (s.tags(1), object())},
    ),
    "contact: tags with a text": ("contact", lambda s: {"contact": (s.tags(1), "1")}),
    "contact: tags with half a number": ("contact", lambda s: {"contact": (s.tags(1), 0.5)}),
    "contact: floats": ("contact", lambda s: {"contact": s.facets.astype(float) + 0.5}),
    "contact: negative": ("contact", lambda s: {"contact": np.array([-1])}),
    "contact: out of range": ("contact", lambda s: {"contact": np.array([10**6])}),
    "contact: too large for a facet": ("contact", lambda s: {"contact": np.array([2**40])}),
    "contact: an interior facet": ("contact", lambda s: {"contact": s.interior()}),
    "contact: no facet": ("contact", lambda s: {"contact": np.empty(0, dtype=np.int32)}),
    "contact: a table": ("contact", lambda s: {"contact": s.facets.reshape(-1, 1)}),
    "contact: a mask": ("contact", lambda s: {"contact": np.ones(10, dtype=bool)}),
    "contact: tags of cells": ("contact", lambda s: {"contact": s.tags(2)}),
    "contact: tags of vertices": ("contact", lambda s: {"contact": s.tags(0)}),
    "contact: tags of inner facets": ("contact", lambda s: {"contact": s.tags(1)}),
    "contact: tags of another mesh": (
        "contact",
        lambda s: {"contact": s.tags(1, s.other_mesh)},
    ),
    # The obstacle.
    "obstacle: None": ("obstacle", lambda s: {"obstacle": None}),
    "obstacle: a string": ("obstacle", lambda s: {"obstacle": "x"}),
    "obstacle: a truth value": ("obstacle", lambda s: {"obstacle": True}),
    "obstacle: nan": ("obstacle", lambda s: {"obstacle": float("nan")}),
    "obstacle: a trial function": ("obstacle", lambda s: {"obstacle": s.u}),
    "obstacle: a test function in it": ("obstacle", lambda s: {"obstacle": 2.0 * s.v}),
    "obstacle: a normal": ("obstacle", lambda s: {"obstacle": ufl.FacetNormal(s.mesh)[0]}),
    "obstacle: complex": ("obstacle", lambda s: {"obstacle": lambda x: 1j * x[0]}),
    "obstacle: a vector": (
        "obstacle",
        lambda s: {"obstacle": ufl.SpatialCoordinate(s.mesh)},
    ),
    "obstacle: a function of another mesh": (
        "obstacle",
        lambda s: {"obstacle": fem.Function(s.other)},
    ),
    "obstacle: coordinates of another mesh": (
        "obstacle",
        lambda s: {"obstacle": ufl.SpatialCoordinate(s.other_mesh)[0]},
    ),
    "obstacle: a callable of the wrong shape": (
        "obstacle",
        lambda s: {"obstacle": lambda x: np.zeros(len(x) + 4)},
    ),
    # The rest.
    "bound: unknown": ("bound", lambda s: {"bound": "both"}),
    "bound: an array": ("bound", lambda s: {"bound": np.ones(3)}),
    "petsc_options_prefix: a number": (
        "petsc_options_prefix",
        lambda s: {"petsc_options_prefix": 3},
    ),
    "petsc_options: a text": ("petsc_options", lambda s: {"petsc_options": "ksp_type cg"}),
    "petsc_options: numbers": ("petsc_options", lambda s: {"petsc_options": {1: 2}}),
    "form_compiler_options: a list": (
        "form_compiler_options",
        lambda s: {"form_compiler_options": ["scalar_type"]},
    ),
    "jit_options: a number": ("jit_options", lambda s: {"jit_options": 3}),
    "bcs: None": ("bcs", lambda s: {"bcs": None}),
    "bcs: a condition": ("bcs", lambda s: {"bcs": s.condition(s.space)}),
    "bcs: no condition": ("bcs", lambda s: {"bcs": [0.5]}),
    "bcs: of an equal space": ("bcs", lambda s: {"bcs": [s.condition(s.twin)]}),
    "bcs: of another mesh": ("bcs", lambda s: {"bcs": [s.condition(s.other)]}),
    "u: no function": ("u", lambda s: {"u": np.zeros(3)}),
    "u: of an equal space": ("u", lambda s: {"u": fem.Function(s.twin)}),
    "u: of another mesh": ("u", lambda s: {"u": fem.Function(s.other)}),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_argument_is_named(setting, case):
    subject, change = WRONG[case]
    with pytest.raises(InputError) as caught:
        setting.problem(**change(setting))
    assert caught.value.subject == subject
    assert str(caught.value).startswith(f"{subject}: ")


def test_a_mesh_in_single_precision_is_refused():
    domain = mesh.create_unit_square(COMM, 4, 4, dtype=np.float32)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    domain.topology.create_connectivity(1, 2)
    facets = mesh.exterior_facet_indices(domain.topology)
    with pytest.raises(InputError, match="double precision") as caught:
        SignoriniProblem(u * v * ufl.dx, v * ufl.dx, contact=facets)
    assert caught.value.subject == "form a"


@pytest.mark.parametrize("wrong", [np.array([10**6]), np.array([0.5]), [[1, 2], [3]]])
def test_sides_that_are_wrong_on_one_rank_are_refused_on_all(setting, wrong):
    last = COMM.rank == COMM.size - 1
    with pytest.raises(InputError) as caught:
        SidedMesh(setting.mesh, {"floor": wrong if last else setting.facets})
    assert caught.value.subject == "sides"


def test_limits_may_be_integers_of_numpy(setting):
    problem = setting.problem()
    problem.solve(method="bncg", max_iterations=np.int64(1000))
    problem.destroy()


WRONG_IN_SOLVE = {
    "method: unknown": ("method", lambda s: {"method": "newton"}),
    "method: None": ("method", lambda s: {"method": None}),
    "rtol: zero": ("rtol", lambda s: {"rtol": 0.0}),
    "rtol: nan": ("rtol", lambda s: {"rtol": float("nan")}),
    "rtol: one": ("rtol", lambda s: {"rtol": 1.0}),
    "rtol: a string": ("rtol", lambda s: {"rtol": "small"}),
    "start: no function": ("start", lambda s: {"start": np.zeros(3)}),
    "start: another mesh": ("start", lambda s: {"start": fem.Function(s.other)}),
    "start: an equal space": ("start", lambda s: {"start": fem.Function(s.twin)}),
    "start: nan": ("start", lambda s: {"start": s.start(np.nan)}),
    "start: infinite": ("start", lambda s: {"start": s.start(-np.inf), "method": "bncg"}),
    "coarse: a function": ("coarse", lambda s: {"coarse": fem.Function(s.space)}),
    "coarse: for TAO": ("coarse", lambda s: {"coarse": 1, "method": "bncg"}),
    "max_iterations: for the cascade": ("max_iterations", lambda s: {"max_iterations": 5}),
    "max_iterations: zero": (
        "max_iterations",
        lambda s: {"max_iterations": 0, "method": "bncg"},
    ),
    "max_evaluations: a string": (
        "max_evaluations",
        lambda s: {"max_evaluations": "5", "method": "bncg"},
    ),
}


@pytest.mark.parametrize("case", WRONG_IN_SOLVE)
def test_a_wrong_argument_of_solve_is_named(setting, case):
    subject, change = WRONG_IN_SOLVE[case]
    problem = setting.problem()
    with pytest.raises(InputError) as caught:
        problem.solve(**change(setting))
    assert caught.value.subject == subject
    problem.solve()  # a refusal does no harm
    problem.destroy()


@pytest.mark.parametrize("use", ["solve", "update", "gap", "pressure", "active", "contact_state"])
def test_what_is_destroyed_is_not_used(setting, use):
    problem = setting.problem()
    problem.solve()
    problem.destroy()
    problem.destroy()
    with pytest.raises(InputError, match="destroyed"):
        result = getattr(problem, use)
        result()


@pytest.mark.parametrize("use", ["gap", "pressure", "active", "contact_state"])
def test_what_is_not_solved_has_no_solution(setting, use):
    problem = setting.problem()
    with pytest.raises(InputError, match="has not been solved"):
        result = getattr(problem, use)
        result()
    problem.destroy()


@pytest.mark.parametrize("method", ["cascade", "bqnls"])
def test_a_solution_that_was_spoiled_since_is_no_start(setting, method):
    problem = setting.problem()
    problem.solve(method)
    problem.u.x.array[:1] = np.nan
    with pytest.raises(InputError) as caught:
        problem.solve(method)
    assert caught.value.subject == "u"
    problem.solve(method, warm_start=False)
    problem.destroy()
