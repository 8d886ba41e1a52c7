"""Bounds whose data are wrong on purpose: one number alone covers what the data miss.

A bound is told data that are not those of the problem, and how far both are apart. Where nothing is
in contact, the error is the dual norm of the residual of the true data, and at least the norm of a
Galerkin solution, which knows nothing of bounds. The bounds are so close to this norm that half of
the number is too little.
"""

import math
from dataclasses import replace
from inspect import signature

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx.fem.petsc import LinearProblem
from energy_cases import sampled_bound
from petsc4py import PETSc

from dolfinx_signorini.bounds.frames import cell_frames
from dolfinx_signorini.bounds.remainders import Remainders
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.meshes.sided_meshes import boundary_facets
from dolfinx_signorini.problem.obstacle import ObstacleProblem
from dolfinx_signorini.problem.signorini import SignoriniProblem

NEEDS_PREFIX = "petsc_options_prefix" in signature(LinearProblem.__init__).parameters
FINER = 6  # the degree of the space of the Galerkin solution
AREA = 0.005  # of the sliver


def triangle(comm, width):
    """One triangle from the origin to a part of the line x = 1."""
    corners = np.array([[0.0, 0.0], [1.0, -width / 2], [1.0, width / 2]])
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    first = comm.rank == 0
    cells = np.array([[0, 1, 2]] if first else [], dtype=np.int64).reshape(-1, 3)
    return mesh.create_mesh(comm, cells, x=corners if first else corners[:0], e=element)


def sliver(comm):
    return triangle(comm, 2.0 * AREA)


def equilateral(comm):
    return triangle(comm, 2.0 / math.sqrt(3.0))


def squares(comm):
    return mesh.create_unit_square(comm, 8, 8)


def cubes(comm):
    return mesh.create_unit_cube(comm, 2, 2, 2)


WAVES = {squares: 8, cubes: 2}  # cells on each side


class Data:
    """A problem on a mesh: A, c and f, the flux on the right, and on the left perhaps u = 0."""

    def __init__(self, domain, A=1.0, c=0.0, f=0.0, q=0.0, fixed=False):
        self.domain, self.fixed, self.data = domain, fixed, (A, c, f, q)
        self.A, self.c, self.f, self.q = (
            fem.Constant(domain, value) if isinstance(value, float) else value
            for value in self.data
        )
        dim = domain.topology.dim - 1
        self.right, self.left = (
            mesh.locate_entities_boundary(domain, dim, lambda x, end=end: np.isclose(x[0], end))
            for end in (1.0, 0.0 if fixed else np.inf)
        )
        marks = mesh.meshtags(domain, dim, self.right, np.ones(len(self.right), dtype=np.int32))
        self.ds = ufl.Measure("ds", domain, subdomain_data=marks)

    def energy(self, w, v):
        gradients = self.A * ufl.dot(ufl.grad(w), ufl.grad(v))
        return (gradients + self.c * w * v) * ufl.dx(self.domain)

    def work(self, v):
        return self.f * v * ufl.dx(self.domain) + self.q * v * self.ds(1)

    def conditions(self, space):
        dofs = fem.locate_dofs_topological(space, self.domain.topology.dim - 1, self.left)
        return [fem.dirichletbc(PETSc.ScalarType(0.0), dofs, space)]

    def solution(self, degree, in_cells=False):
        """The solved problem, and its strong form; the obstacle is far away."""
        space = fem.functionspace(self.domain, ("Lagrange", degree))
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        forms, bcs = (self.energy(u, v), self.work(v)), self.conditions(space)
        contact = np.setdiff1d(boundary_facets(self.domain), np.union1d(self.right, self.left))
        if in_cells:
            problem = ObstacleProblem(*forms, lower=-10.0, bcs=bcs)
        else:
            problem = SignoriniProblem(*forms, contact=contact, obstacle=-10.0, bcs=bcs)
        problem.solve(rtol=1e-8)
        A, c, f, q = self.data
        neumann, dirichlet = [(q, self.right)], [(0.0, self.left)]
        terms = EnergyTerms(A, c, f, neumann, (), dirichlet if self.fixed else ())
        return problem, terms

    def least_error(self, u):
        """The norm of the Galerkin solution for the residual of u: not above the error of u."""
        space = fem.functionspace(self.domain, ("Lagrange", FINER))
        e, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        solver = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
        prefix = {"petsc_options_prefix": "test_remainders_"} if NEEDS_PREFIX else {}
        residual = self.work(v) - self.energy(u, v)
        e = LinearProblem(
            self.energy(e, v), residual, self.conditions(space), petsc_options=solver, **prefix
        ).solve()
        found = fem.assemble_scalar(fem.form(self.energy(e, e)))
        return math.sqrt(self.domain.comm.allreduce(found))


def ring(x):
    """A polynomial whose mean over the sliver is zero, like the slowest wave there."""
    return x[0] ** 2 - 0.5


def beside(x):
    """A polynomial on the sliver that is orthogonal to those of degree 1 in x."""
    return x[0] ** 2 - 1.2 * x[0] + 0.3


RING = math.sqrt(AREA / 12.0)  # its norm


def on_the_right(value):
    """A number on the facet of the triangle on the line x = 1."""

    def rest(domain):
        middles = cell_frames(domain).corners.sum(axis=1)[:, None] - cell_frames(domain).corners
        return np.where(np.isclose(middles[..., 0], 2.0), value, 0.0)

    return rest


# The mesh; what is told; what is true instead; the remainder; how far the bound is above the error.
CASES = {
    "a load": (sliver, {"c": 1e-2}, {"f": ring}, {"load": RING}, 1.6),
    "a load, with a strong reaction": (sliver, {"c": 1e8}, {"f": ring}, {"load": RING}, 1.1),
    "the mean of a load, with a reaction": (
        sliver, {"c": 1.0}, {"f": lambda x: 1.0}, {"load_mean": 1.0}, 1.1,
    ),
    "the mean of a load": (
        squares, {"fixed": True}, {"f": lambda x: 1.0}, {"load_mean": 1.0}, 1.2,
    ),
    # The solution that is computed is 1.
    "a reaction": (
        sliver, {"c": 1.0, "f": 1.0}, {"c": lambda x: 1.0 + 0.1 * ring(x)},
        {"reaction": 0.1 * RING}, 1.4,
    ),
    "the mean of a reaction": (
        sliver, {"c": 1.0, "f": 1.0}, {"c": lambda x: 1.1}, {"reaction_mean": 0.1}, 1.1,
    ),
    "a flux": (
        equilateral, {"c": 1e-2}, {"q": lambda x: x[1]},
        {"flux": on_the_right((2.0 / math.sqrt(3.0)) ** 1.5 / math.sqrt(12.0))}, 1.9,
    ),
    "the mean of a flux": (
        sliver, {"c": 1.0}, {"q": lambda x: 1.0}, {"flux_mean": on_the_right(1.0)}, 1.1,
    ),
    # The solution that is computed is x.
    "a diffusion": (
        squares, {"fixed": True, "q": 1.0}, {"A": lambda x: 1.1}, {"diffusion": 0.1}, 1.1,
    ),
    # Polynomials of higher degree than the flux can meet: nothing is missed of them.
    "a load beside its projection": (sliver, {"c": 1e-2, "f": beside}, {}, {}, 2.5),
    "a load beside its projection, with a strong reaction": (
        sliver, {"c": 1e8, "f": beside}, {}, {}, 1.1,
    ),
    "a flux beside its projection": (
        equilateral, {"c": 1e-2, "q": lambda x: x[1] ** 2 - 1.0 / 9.0}, {}, {}, 2.5,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("in_cells", [False, True])
def test_one_number_covers_what_the_data_miss(in_cells, name, comm):
    make, told, wrong, rest, most = CASES[name]
    domain = make(comm)
    x = ufl.SpatialCoordinate(domain)
    told = {key: value(x) if callable(value) else value for key, value in told.items()}
    problem, terms = Data(domain, **told).solution(1, in_cells)
    true = Data(domain, **told | {key: value(x) for key, value in wrong.items()})
    rest = {key: value(domain) if callable(value) else value for key, value in rest.items()}
    error, bound = (
        true.least_error(problem.u),
        sampled_bound(problem, terms, Remainders(**rest)),
    )
    assert error * (1.0 - 1e-6) <= bound.total <= most * error
    problem.destroy()


@pytest.mark.parametrize("strange", [0.01, 100.0])
def test_a_diffusion_that_is_another_one_on_some_cells(strange, comm):
    """As where a jump cuts cells: the share of these cells is 1 here."""
    domain, told = squares(comm), {"fixed": True, "q": 1.0}
    x = ufl.SpatialCoordinate(domain)
    problem, terms = Data(domain, **told).solution(1)
    A = ufl.conditional(abs(x[0] - 0.5625) < 0.0625, strange, 1.0)
    middles = cell_frames(domain).corners.mean(axis=1)[:, 0]
    share = (abs(middles - 0.5625) < 0.0625).astype(float)
    thin = np.array([share, *np.full((2, len(share)), strange)])
    error = Data(domain, A, **told).least_error(problem.u)
    bound = sampled_bound(problem, terms, Remainders(thin=thin))
    assert error <= bound.total <= 1.1 * error
    problem.destroy()


def test_an_inverse_of_the_diffusion_that_is_known_roughly(comm):
    domain = squares(comm)
    true = Data(domain, f=1.0, fixed=True)
    problem, terms = true.solution(1)
    one = np.ones(domain.topology.index_map(2).size_local)
    rest = Remainders(
        inverse_entries=[0.25], inverse=0.75, least_diffusion=one, largest_diffusion=one
    )
    error, bound = true.least_error(problem.u), sampled_bound(problem, terms, rest)
    assert error <= bound.total <= 1.1 * error
    problem.destroy()


LIFTED = {
    "in the plane": (squares, 0.0, {}, 1.5),
    "in the plane, with a reaction": (squares, 1e4, {}, 1.25),
    "in space": (cubes, 0.0, {}, 1.85),
    "in space, with a reaction": (cubes, 100.0, {}, 1.25),
    "in space, with a strong reaction": (cubes, 800.0, {}, 1.25),
    "in space, with a diffusion that is missed": (cubes, 100.0, {"diffusion": 1.0}, 1.25),
}


@pytest.mark.parametrize("name", LIFTED)
def test_dirichlet_data_between_the_nodes(name, comm):
    """Waves that vanish at the nodes, with the energy of cosh(k (1 - x)) cos(2 n pi y)."""
    make, c, missed, most = LIFTED[name]
    domain, n = make(comm), WAVES[make]
    x = ufl.SpatialCoordinate(domain)
    data = Data(domain, 1e-8 if missed else 1.0, c, fixed=True)
    problem, terms = data.solution(1)
    wave = 0.5 - 0.5 * ufl.cos(2.0 * n * math.pi * x[1])
    if missed:
        one = np.ones(domain.topology.index_map(3).size_local)
        missed = missed | {
            "least_diffusion": one,
            "largest_diffusion": one,
            "inverse_entries": [1.0],
        }
    k = math.hypot(2.0 * n * math.pi, math.sqrt(c))
    error = 0.5 * math.sqrt(math.sqrt(c) * math.tanh(math.sqrt(c)) + 0.5 * k * math.tanh(k))
    terms = replace(terms, dirichlet=[(wave, data.left)])
    bound = sampled_bound(problem, terms, Remainders(**missed))
    assert error <= bound.total <= most * error
    problem.destroy()
