"""The bound of the energy error against exact solutions that the bound is not told."""

import math

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini.accuracy.energy_bound import energy_bound
from dolfinx_signorini.accuracy.strong_form import EnergyTerms
from dolfinx_signorini.meshes import friedrichs_keller
from dolfinx_signorini.paper.solution import christof_haubner, paper_problem
from dolfinx_signorini.problem import SignoriniProblem
from dolfinx_signorini.quadrature import QuadratureRule


class Case:
    """A problem on the unit square or cube, posed for a solution that is known.

    The solution has contact on the lowest side, where x[-1] = 0.
    """

    def __init__(
        self,
        domain,
        u,
        degree,
        *,
        A=1.0,
        c=0.0,
        fixed=None,
        robin=None,
        upper=False,
        obstacle=0.0,
        exact_data=True,
    ):
        self.domain, self.A, self.c = domain, A, c
        tdim = domain.topology.dim
        self.sign = -1.0 if upper else 1.0
        self.exact = u = self.sign * u
        x, n = ufl.SpatialCoordinate(domain), ufl.FacetNormal(domain)

        def side(test):
            return mesh.locate_entities_boundary(domain, tdim - 1, test)

        contact = side(lambda x: np.isclose(x[tdim - 1], 0.0))
        dirichlet = side(fixed) if fixed else np.empty(0, dtype=np.int32)
        on_robin = side(robin) if robin else np.empty(0, dtype=np.int32)
        every = side(lambda x: np.full(x.shape[1], True))
        rest = np.setdiff1d(every, np.concatenate((contact, dirichlet, on_robin)))
        flux = ufl.dot(A * ufl.grad(u), n)
        load = -ufl.div(A * ufl.grad(u)) + c * u
        space = fem.functionspace(domain, ("Lagrange", degree))
        w, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        self.dx = ufl.dx(domain, metadata={"quadrature_degree": 12 if tdim == 2 else 8})
        marks = [(1, rest), (2, on_robin)]
        pairs = [(k, _pairs(domain, facets)) for k, facets in marks]
        self.ds = ufl.Measure(
            "ds", domain, subdomain_data=pairs, metadata={"quadrature_degree": 12}
        )
        kappa = 2.0
        self.kappa = kappa
        a = (ufl.dot(A * ufl.grad(w), ufl.grad(v)) + c * w * v) * self.dx + kappa * w * v * self.ds(
            2
        )
        L = load * v * self.dx + flux * v * self.ds(1) + (flux + kappa * u) * v * self.ds(2)
        bcs = []
        data = []
        if fixed:
            g = fem.Function(space)
            g.interpolate(fem.Expression(u, space.element.interpolation_points()))
            dofs = fem.locate_dofs_topological(space, tdim - 1, dirichlet)
            bcs, data = [fem.dirichletbc(g, dofs)], [(u if exact_data else None, dirichlet)]
        self.terms = EnergyTerms(
            diffusion=A,
            reaction=c,
            load=load,
            neumann=[(flux, rest), (flux + kappa * u, on_robin)],
            robin=[(kappa, on_robin)] if robin else [],
            dirichlet=data,
        )
        self.problem = SignoriniProblem(
            a,
            L,
            contact=contact,
            obstacle=self.sign * obstacle,
            bound="upper" if upper else "lower",
            bcs=bcs,
        )
        self.problem.solve(rtol=1e-10)

    def error(self):
        e, rule = self.problem.u - self.exact, {"quadrature_degree": 16}
        dx, ds = self.dx(metadata=rule), self.ds(metadata=rule)
        energy = (ufl.dot(self.A * ufl.grad(e), ufl.grad(e)) + self.c * e * e) * dx
        energy += self.kappa * e * e * ds(2)
        return math.sqrt(self.domain.comm.allreduce(fem.assemble_scalar(fem.form(energy))))


def _pairs(domain, facets):
    from dolfinx_signorini.meshes import facet_cells

    owned = domain.topology.index_map(domain.topology.dim - 1).size_local
    return facet_cells(domain, facets[facets < owned]).flatten()


def detaching(x, where=0.5):
    """-Im z^(3/2): harmonic, with contact right of a point of the lowest side."""
    x0, x1 = x[0] - where, x[len(x) - 1]
    r = ufl.sqrt(x0 * x0 + x1 * x1)
    C, S = ufl.sqrt(abs(r + x0) / 2), ufl.sqrt(abs(r - x0) / 2)
    return -S * (3 * C * C - S * S)


def top(x):
    return np.isclose(x[1], 1.0)


def at_the_top_of_the_cube(x):
    return np.isclose(x[2], 1.0)


def left(x):
    return np.isclose(x[0], 0.0)


def square(comm, n=12):
    return mesh.create_unit_square(comm, n, n)


def cube(comm, n=4):
    return mesh.create_unit_cube(comm, n, n, n)


def polynomial(x):
    return -x[1] * (1 + x[0] ** 2) + x[1] ** 2 * x[0]


def in_space(x):
    return -x[2] * (1 - x[2]) * (1 + x[0] * x[1])


PLANE = {
    "polynomial": (polynomial, {}),
    "no reaction, Dirichlet and Neumann": (polynomial, {"fixed": top}),
    "reaction": (polynomial, {"c": 3.0, "fixed": left}),
    "large reaction": (polynomial, {"c": 1e6}),
    "Robin": (polynomial, {"robin": top}),
    "upper": (polynomial, {"upper": True, "fixed": left}),
    "detaching": (detaching, {"fixed": top}),
    "detaching, reaction": (detaching, {"c": 1.0}),
    "detaching, upper": (detaching, {"upper": True, "fixed": left}),
}


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("name", PLANE)
def test_plane(name, degree, comm):
    u, options = PLANE[name]
    domain = square(comm)
    case = Case(domain, u(ufl.SpatialCoordinate(domain)), degree, **options)
    bound, error = energy_bound(case.problem, case.terms), case.error()
    if comm.rank == 0:
        print(f"\nEFF {name} {degree} error {error:.3e} eff {bound.total / error:.3f} {bound}")
    assert error <= bound.total * (1 + 1e-9) + 1e-9


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("c", [0.0, 1.0])
@pytest.mark.parametrize("fixed", [None, at_the_top_of_the_cube])
@pytest.mark.parametrize("u", [in_space, detaching])
def test_space(degree, c, fixed, u, comm):
    domain = cube(comm)
    x = ufl.SpatialCoordinate(domain)
    if False:
        pytest.skip("no polynomial")
    case = Case(domain, u(x), degree, c=c, fixed=fixed)
    bound, error = energy_bound(case.problem, case.terms), case.error()
    if comm.rank == 0:
        print(
            f"\nEFF cube {u} {c} {fixed} {degree} error {error:.3e} eff {bound.total / error:.3f} {bound}"
        )
    assert error <= bound.total * (1 + 1e-9) + 1e-9
