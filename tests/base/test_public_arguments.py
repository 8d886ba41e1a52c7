"""Every argument of every public function against wrong types, objects, ranges and meshes."""

import inspect

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_signorini as signorini
from dolfinx_signorini import InputError

COMM = MPI.COMM_WORLD
NAN = float("nan")
SCENE = """
[domain]
shape = "square"
cells = 4
[equation]
reaction = 1
load = "x - 0.6"
[contact]
sides = "all"
"""


class Things:
    """What public functions take, and the like of it on another mesh."""

    def __init__(self, folder):
        self.mesh, self.other_mesh = (signorini.friedrichs_keller(COMM, n) for n in (4, 5))
        self.quadrilaterals = mesh.create_unit_square(COMM, 2, 2, mesh.CellType.quadrilateral)
        self.cube = mesh.create_unit_cube(COMM, 2, 2, 2)
        self.exact, self.other_exact = map(signorini.christof_haubner, (self.mesh, self.other_mesh))
        self.x, self.other_x = map(ufl.SpatialCoordinate, (self.mesh, self.other_mesh))
        self.facets = signorini.boundary_facets(self.mesh)
        self.problem, self.unsolved = self.pose(self.mesh), self.pose(self.mesh)
        self.problem.solve()
        self.in_space = self.pose(self.cube)
        self.in_space.solve()
        self.state = self.problem.contact_state()
        self.sided = signorini.SidedMesh(self.mesh, {"floor": self.facets})
        self.terms = signorini.EnergyTerms(reaction=1.0, load=20.0 * (self.x[0] - 0.6))
        path = folder / "scene.toml"
        if COMM.rank == 0:
            path.write_text(SCENE)
        COMM.barrier()
        self.path = str(path)
        self.scene = signorini.load_scene(path)
        self.other_function = fem.Function(fem.functionspace(self.other_mesh, ("Lagrange", 1)))

        self.moved = fem.Function(fem.functionspace(self.mesh, ("Lagrange", 1, (2,))))
        space = self.moved.function_space
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        self.elastic = signorini.elasticity(u, v, 1.0, 0.3)
        self.weight = v[1] * ufl.dx
        top = mesh.locate_entities_boundary(self.mesh, 1, lambda x: x[1] > 1.0 - 1e-9)
        self.facets_below = mesh.locate_entities_boundary(self.mesh, 1, lambda x: x[1] < 1e-9)
        dofs = fem.locate_dofs_topological(space, 1, top)
        self.clamped = fem.dirichletbc(np.zeros(2), dofs, space)

    def pose(self, domain):
        space = fem.functionspace(domain, ("Lagrange", 1))
        u, v, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(domain)
        a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
        facets = signorini.boundary_facets(domain)
        return signorini.SignoriniProblem(a, 20.0 * (x[0] - 0.6) * v * ufl.dx, contact=facets)


@pytest.fixture(scope="module")
def things(tmp_path_factory):
    return Things(COMM.bcast(tmp_path_factory.mktemp("public") if COMM.rank == 0 else None))


def displacement(t):
    return fem.Function(fem.functionspace(t.mesh, ("Lagrange", 1, (2,))))


# Functions, what they are given, and for each argument what is refused.
NO_MESH = (None, "square", 4)
NO_INTEGER = (None, "4", 2.5, NAN, True)
NO_TEXTS = (None, "L2", 4, [4], [None])
TABLE = {
    "bernstein_space": (
        lambda t: {"domain": t.mesh, "degree": 2},
        lambda t: {
            "domain": (*NO_MESH, t.quadrilaterals),
            "degree": (*NO_INTEGER, 0, -1, 9),
            "shape": (None, 2, "2", (0,), (2.0,)),
        },
    ),
    "boundary_facets": (lambda t: {"domain": t.mesh}, lambda t: {"domain": NO_MESH}),
    "box_mesh": (
        lambda t: {"comm": COMM, "lines": [[0.0, 1.0, 3.0], np.linspace(0.0, 1.0, 5)]},
        lambda t: {
            "comm": (None, 4, "world"),
            "lines": (None, 4, "lines", [4, 4], [[0.0, 1.0]], [[0.0, 1.0], [1.0, 0.0]], [[], []]),
        },
    ),
    "christof_haubner": (
        lambda t: {"domain": t.mesh, "detachment": (0.5, 0.0), "radius": 0.45},
        lambda t: {
            "domain": (*NO_MESH, t.cube, t.quadrilaterals),
            "detachment": (None, 0.5, "ab", (0.5,), (NAN, 0.0), t.x),
            "radius": (None, "1", 0.0, -1.0, NAN, t.x[0]),
        },
    ),
    "coarse_levels": (
        lambda t: {"n": 100, "dimension": 2, "coarsest": 10, "ratio": 4},
        lambda t: {
            "n": (*NO_INTEGER, 0, -3),
            "dimension": (*NO_INTEGER, 1, 4),
            "coarsest": (*NO_INTEGER[1:], 0),
            "ratio": (*NO_INTEGER[1:], 1, -1),
        },
    ),
    "detachment_points": (
        lambda t: {"problem": t.problem},
        lambda t: {"problem": (None, t.mesh, t.problem.u, t.unsolved, t.in_space)},
    ),
    "energy_bound": (
        lambda t: {"problem": t.problem, "terms": t.terms},
        lambda t: {
            "problem": (None, t.problem.u, t.unsolved),
            "terms": (
                {"load": 1.0},
                signorini.EnergyTerms(load=t.other_x[0]),
                signorini.EnergyTerms(load=t.x),
                signorini.EnergyTerms(dirichlet=[(0.0, np.array([10**6]))]),
            ),
        },
    ),
    "error_norms": (
        lambda t: {
            "u_h": t.problem.u,
            "exact": t.exact,
            "norms": ["L2"],
            "rule": None,
            "boundary_rule": None,
            "of": None,
        },
        lambda t: {
            "u_h": (None, t.problem, t.other_function, np.zeros(3)),
            "exact": (0.0, t.x[0], t.other_exact),
            "norms": (*NO_TEXTS, ["L2", "junk"], ["L0.5"]),
            "rule": (7, "default"),
            "boundary_rule": (7, "default"),
            "of": (7, "stress", lambda u: 1.0),
        },
    ),
    "friedrichs_keller": (
        lambda t: {"comm": COMM, "n": 4},
        lambda t: {"comm": (None, 4, "world"), "n": (*NO_INTEGER, 0, -1)},
    ),
    "gmsh_mesh": (
        lambda t: {"model": None, "comm": COMM, "dimension": 2},
        lambda t: {
            "model": (None, "model", t.mesh),
            "comm": (None, 4),
            "dimension": (*NO_INTEGER, 1, 4),
        },
    ),
    "gmsh_projection": (
        lambda t: {"model": None, "dimension": 1, "group": 1},
        lambda t: {
            "model": (None, "model", t.mesh),
            "dimension": (*NO_INTEGER, 0, 3),
            "group": (*NO_INTEGER, 0, -1),
        },
    ),
    "interpolated": (
        lambda t: {"reference": t.exact, "degree": 2},
        lambda t: {"reference": (None, t.x[0], 1.0), "degree": (*NO_INTEGER, 0, -1, 40)},
    ),
    "load_scene": (
        lambda t: {"path": t.path, "comm": COMM, "overrides": (), "adapted": False},
        lambda t: {
            "path": (None, 4, t.path + ".not", SCENE),
            "comm": (None, 4),
            "overrides": (None, "domain.cells=4", [4], ["domain.cells"], ["domain.cells=-1"]),
            "adapted": (None, "yes", 4),
        },
    ),
    "manufacture": (
        lambda t: {"domain": t.mesh, "u": t.x[0] ** 2, "diffusion": 2.0, "reaction": 1.0},
        lambda t: {
            "domain": NO_MESH,
            "u": (None, "x", t.x, t.other_x[0], NAN),
            "diffusion": ("1", t.x, t.other_x[0], NAN),
            "reaction": ("1", t.x, t.other_x[0], NAN),
        },
    ),
    "solve_adaptively": (
        lambda t: {
            "pose": lambda sided: t.pose(sided.mesh),
            "sided": t.sided,
            "norm": "L2",
            "of": ufl.grad,
            "accuracy": 100.0,
            "budget": None,
            "max_unknowns": 10**5,
            "rtol": 1e-8,
            "on_step": lambda step: None,
            "geometry": None,
            "read_data": True,
        },
        lambda t: {
            "pose": (None, t.problem, {}, {2: None}, lambda sided: None, lambda sided: t.problem.u),
            "sided": (None, t.mesh, {"floor": t.facets}),
            "norm": (None, 2, "junk", "L0.5", lambda u: u, "H1", "L2_boundary"),
            "of": (
                *(4, lambda u: u, lambda u: 1.0, lambda u: ufl.grad(u) ** 2, lambda u: u[3]),
                *(lambda u: ufl.grad(ufl.grad(u)), lambda u: ufl.as_vector([1.0, 2.0])),
            ),
            "accuracy": ("1", 0.0, -1.0, NAN, True),
            "budget": ("1", 0.0, -1.0, NAN, True),
            "max_unknowns": (None, "1", 0, -1, NAN),
            "rtol": ("1", 0.0, 1.0, NAN),
            "on_step": (None, 4),
            "geometry": (4, {1: None}, {"roof": None}, {"floor": 4}),
            "read_data": (None, 1, "yes"),
        },
    ),
    "solve_cascade": (
        lambda t: {
            "make_problem": lambda n, _: t.pose(signorini.friedrichs_keller(COMM, n)),
            "levels": [2, 4],
            "method": "cascade",
            "rtol": None,
            "coarse_rtol": None,
            "coarse": None,
            "on_level": lambda problem: None,
        },
        lambda t: {
            "make_problem": (None, t.problem, lambda n, _: None),
            "levels": (None, 4, "24", []),
            "method": (None, "newton", 4, np.zeros(2)),
            "rtol": ("1", 0.0, 1.0, NAN),
            "coarse_rtol": ("1", 0.0, 1.0, NAN),
            "coarse": (t.problem, t.problem.u),
            "on_level": (None, 4),
        },
    ),
    "solve_scene": (
        lambda t: {
            "scene": t.scene,
            "comm": COMM,
            "accuracy": None,
            "budget": None,
            "norm": None,
            "max_unknowns": 10**5,
            "degree": None,
            "on_step": lambda step: None,
            "phases": None,
        },
        lambda t: {
            "scene": (None, t.path, {}),
            "comm": (None, 4),
            "accuracy": ("1", 0.0, -1.0, NAN),
            "budget": ("1", 0.0, -1.0, NAN),
            "norm": (2, "junk", lambda u: u),
            "max_unknowns": (None, "1", 0, NAN),
            "degree": ("2", 0, 5, 1.5),
            "on_step": (None, 4),
            "phases": (0.0, {}),
        },
    ),
    "stress_intensity": (
        lambda t: {
            "problem": t.problem,
            "point": (0.5, 0.0),
            "terms": t.terms,
            "radius": None,
        },
        lambda t: {
            "problem": (None, t.problem.u, t.unsolved, t.in_space),
            "point": (None, 0.5, (0.5,), (NAN, 0.0), (0.5, 0.0, 0.0), (9.0, 9.0)),
            "terms": ({}, signorini.EnergyTerms(load=t.other_x[0])),
            "radius": ("1", 0.0, -1.0, NAN, 50.0),
        },
    ),
    "SidedMesh": (
        lambda t: {"mesh": t.mesh, "sides": {"floor": t.facets}, "regions": {}},
        lambda t: {
            "mesh": NO_MESH,
            "sides": (
                None,
                [t.facets],
                {"floor": 0.5},
                {"floor": np.array([0.5])},
                {"floor": np.array([-1])},
                {"floor": np.array([10**6])},
                {4: t.facets},
            ),
            "regions": (None, [0], {"left": 0.5}, {"left": np.array([10**6])}, {4: np.array([0])}),
        },
    ),
    "EnergyTerms": (
        lambda t: {
            "diffusion": 1.0,
            "reaction": 1.0,
            "load": 1.0,
            "neumann": [],
            "robin": [],
            "dirichlet": [],
        },
        lambda t: {
            **{name: ("1", [1.0], NAN) for name in ("diffusion", "reaction", "load")},
            **{
                name: (None, 4, "ab", [4], [(1.0,)], [("1", t.facets)], [(1.0, 0.5)])
                for name in ("neumann", "robin", "dirichlet")
            },
        },
    ),
    "QuadratureRule": (
        lambda t: {"scheme": "default", "degree": 3},
        lambda t: {"scheme": (None, 4, "junk"), "degree": (*NO_INTEGER, -1, 10**6)},
    ),
    "von_mises": (
        lambda t: {"u": displacement(t), "young": 1.0, "poisson": 0.3},
        lambda t: {
            "u": (None, 1.0, t.x[0], t.problem.u),
            "young": (0.0, -1.0),
            "poisson": (0.5, -1.0),
            "plane": (None, 1, "junk"),
        },
    ),
    "dirichlet": (
        lambda t: {"space": t.problem.space, "facets": np.array([0]), "value": 0.0},
        lambda t: {
            "space": (None, 1.0, t.mesh),
            "facets": (None, "x", [0.5], [-1], [10**6]),
            "value": (None, "x", NAN, t.other_function, t.other_x[0]),
            "component": ("x", 0.5, -1, 1),
        },
    ),
    "ObstacleProblem": (
        lambda t: {"a": t.problem.a, "L": t.problem.L, "lower": -0.1},
        lambda t: {
            "a": (None, 1.0, t.problem.L, "u*v*dx"),
            "L": (None, 1.0, t.problem.a),
            "lower": (None, "x", NAN, t.other_function, t.other_x[0]),
            "upper": ("x", NAN, -0.2, t.other_function, t.other_x[0]),
            "cells": ("x", 1.5, [-1], [10**6], np.empty(0, dtype=np.int32)),
            "contact": ("x", 1.5, [-1], [10**6], np.empty(0, dtype=np.int32)),
            "obstacle": (0.5, NAN),
            "bound": ("upper", 1.0),
            "bcs": (1.0, [1.0]),
            "u": (1.0, t.other_function),
            "petsc_options_prefix": (1.0,),
            "petsc_options": (1.0, {1: "cg"}),
            "form_compiler_options": (1.0,),
            "jit_options": (1.0,),
        },
    ),
    "ContactProblem": (
        lambda t: {"a": t.elastic, "L": t.weight, "contact": t.facets_below, "bcs": [t.clamped]},
        lambda t: {
            "a": (None, 1.0, t.problem.a, t.weight, "u*v*dx"),
            "L": (None, 1.0, t.problem.L, t.elastic),
            "contact": (None, "x", 1.5, [-1], [10**6], np.empty(0, dtype=np.int32)),
            "gap": (None, "x", NAN, t.x, t.other_function, t.other_x[0]),
            "direction": ("x", 1.0, (1.0,), (0.0, 0.0), (NAN, 1.0), t.x[0]),
            "bcs": (1.0, [1.0]),
            "held_weakly": (None, "x", 1, NAN),
            "u": (1.0, t.problem.u, t.other_function),
            "petsc_options_prefix": (1.0,),
            "petsc_options": (1.0, {1: "cg"}),
            "form_compiler_options": (1.0,),
            "jit_options": (1.0,),
        },
    ),
    "elasticity": (
        lambda t: {"u": t.moved, "v": t.moved, "young": 1.0, "poisson": 0.3},
        lambda t: {
            "u": (None, 1.0, t.x[0], t.problem.u),
            "v": (None, 1.0),
            "young": (None, "1", 0.0, -1.0, NAN),
            "poisson": (None, "1", 0.5, -1.0, NAN),
            "plane": (None, 1, "junk"),
        },
    ),
    "stress": (
        lambda t: {"u": t.moved, "young": 1.0, "poisson": 0.3},
        lambda t: {
            "u": (None, 1.0, t.x[0], t.problem.u),
            "young": (None, "1", 0.0, -1.0, NAN),
            "poisson": (None, "1", 0.5, -1.0, NAN),
            "plane": (None, 1, "junk"),
        },
    ),
    "weighted_strain": (
        lambda t: {"u": t.moved, "young": 1.0, "poisson": 0.3},
        lambda t: {
            "u": (None, 1.0, t.x[0], t.problem.u),
            "young": (None, "1", 0.0, -1.0, NAN),
            "poisson": (None, "1", 0.5, -1.0, NAN),
            "plane": (None, 1, "junk"),
        },
    ),
    "ContactState": (
        lambda t: {"u": t.state.u, "density": t.state.density},
        lambda t: {
            "u": (None, t.problem, np.zeros(3), t.other_function),
            "density": (None, t.problem, np.zeros(3), t.other_function),
        },
    ),
    "Reference": (
        lambda t: {"mesh": t.mesh, "u": t.exact.u, "grad": t.exact.grad},
        lambda t: {
            "mesh": NO_MESH,
            "u": (None, "x", t.x, t.other_x[0]),
            "grad": (None, t.x, (t.x[0],), ("x", "y"), t.other_exact.grad),
            "support": (1.0, ((0.0,), 1.0), ((0.0, 0.0), -1.0)),
            "singular": (None, (0.0, 0.0), ((0.0,),), ((NAN, 0.0),)),
        },
    ),
    "ManufacturedSolution": (
        lambda t: {"mesh": t.mesh, "u": t.exact.u, "grad": t.exact.grad, "load": t.exact.load},
        lambda t: {
            "mesh": NO_MESH,
            "u": (None, "x", t.x, t.other_x[0]),
            "grad": (None, t.x, (t.x[0],), t.other_exact.grad),
            "load": (None, "x", t.x, t.other_x[0]),
            "flux": ("x", t.x, t.other_x[0]),
            "support": (1.0, ((0.0,), 1.0)),
            "singular": (None, ((0.0,),)),
        },
    ),
}
# What functions return, and what test_arguments.py has.
RESULTS = {
    "ContactZone",
    "AdaptiveSolution",
    "DetachmentPoint",
    "EnergyBound",
    "InputError",
    "NotConvergedError",
    "Scene",
    "SceneResult",
    "SolveResult",
    "StressIntensity",
}


def test_the_table_has_every_public_function_and_argument(things):
    public = {name for name in signorini.__all__ if callable(getattr(signorini, name))}
    assert public - RESULTS - {"SignoriniProblem"} == set(TABLE)
    for name, (_, wrong) in TABLE.items():
        parameters = inspect.signature(getattr(signorini, name)).parameters
        assert set(wrong(things)) == set(parameters), name


@pytest.mark.parametrize("name", TABLE)
def test_a_wrong_argument_of_a_public_function_is_refused(things, name):
    function = getattr(signorini, name)
    right, wrong = (part(things) for part in TABLE[name])
    if name not in (
        "stress_intensity",
        "gmsh_mesh",
        "gmsh_projection",
    ):  # which need a finer mesh, and a model
        function(**right)
    for argument, values in wrong.items():
        for value in values:
            try:
                function(**right | {argument: value})
            except InputError as error:
                assert str(error)
            else:
                pytest.fail(f"{name}({argument}={value!r}) is accepted")
