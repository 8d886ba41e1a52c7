"""Problems on the unit square and cube with known solutions, which nobody is told."""

import math

import numpy as np
import ufl
from dolfinx import fem, mesh

from dolfinx_signorini.base import compat
from dolfinx_signorini.bounds.energy_bound import bound_by_flux
from dolfinx_signorini.bounds.frames import cell_frames
from dolfinx_signorini.bounds.remainders import NOTHING, Solved
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.meshes.sided_meshes import facet_cells
from dolfinx_signorini.problem.dirichlet import dirichlet
from dolfinx_signorini.problem.signorini import SignoriniProblem

KAPPA = 2.0  # of Robin conditions


def sampled_bound(problem, terms, rest=NOTHING):
    """The bound without enclosures: data that are no polynomials are known at points."""
    return bound_by_flux(Solved(problem, terms, cell_frames(problem.space.mesh), rest))


class Case:
    """A problem posed for a solution that presses on an obstacle on the lowest side.

    Args:
        domain: A mesh of the unit square or cube.
        u: The solution; the data are those of -u for an upper obstacle.
        degree: Of the elements.
        A, c: The coefficients.
        fixed, robin: Tell the points of sides with Dirichlet and Robin conditions. The remaining
            sides have the flux of the solution.
        obstacle: On the lowest side, in any form that problems take.
        rtol: How well the problem is solved.
        told: Whether the problem knows the Dirichlet data between the nodes.
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
        rtol=1e-10,
        told=False,
    ):
        self.domain, self.A, self.c = domain, A, c
        d = domain.topology.dim
        self.exact = u = -u if upper else u
        normal = ufl.FacetNormal(domain)

        def side(test):
            none = np.empty(0, dtype=np.int32)
            return mesh.locate_entities_boundary(domain, d - 1, test) if test else none

        self.contact = side(lambda x: np.isclose(x[d - 1], 0.0))
        held, on_robin = side(fixed), side(robin)
        every = side(lambda x: np.full(x.shape[1], True))
        rest = np.setdiff1d(every, np.concatenate((self.contact, held, on_robin)))
        flux, load = ufl.dot(A * ufl.grad(u), normal), -ufl.div(A * ufl.grad(u)) + c * u
        marks = [(1, rest), (2, on_robin), (3, self.contact)]
        pairs = [(k, owned_pairs(domain, facets)) for k, facets in marks]
        rule = {"quadrature_degree": 12 if d == 2 else 8}
        self.dx = ufl.dx(domain, metadata=rule)
        self.ds = ufl.Measure("ds", domain, subdomain_data=pairs, metadata=rule)
        space = fem.functionspace(domain, ("Lagrange", degree))
        w, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        a = (ufl.dot(A * ufl.grad(w), ufl.grad(v)) + c * w * v) * self.dx
        a += KAPPA * w * v * self.ds(2)
        L = load * v * self.dx + flux * v * self.ds(1) + (flux + KAPPA * u) * v * self.ds(2)
        bcs = []
        if fixed and told:
            bcs = [dirichlet(space, held, u)]
        elif fixed:
            g = fem.Function(space)
            g.interpolate(fem.Expression(u, compat.interpolation_points(space.element)))
            bcs = [fem.dirichletbc(g, fem.locate_dofs_topological(space, d - 1, held))]
        self.terms = EnergyTerms(
            diffusion=A,
            reaction=c,
            load=load,
            neumann=[(flux, rest), (flux + KAPPA * u, on_robin)],
            robin=[(KAPPA, on_robin)] if robin else [],
            dirichlet=[(u, held)] if fixed else [],
        )
        bound = "upper" if upper else "lower"
        self.problem = SignoriniProblem(
            a, L, contact=self.contact, obstacle=obstacle, bound=bound, bcs=bcs
        )
        self.problem.solve(rtol=rtol)

    def error(self):
        """Return the energy norm of the error, by a rule that the bound does not use."""
        e = self.problem.u - self.exact
        rule = {"quadrature_degree": 19 if self.domain.topology.dim == 2 else 9}
        energy = (ufl.dot(self.A * ufl.grad(e), ufl.grad(e)) + self.c * e * e) * self.dx(
            metadata=rule
        ) + KAPPA * e * e * self.ds(2, metadata=rule)
        return math.sqrt(self.domain.comm.allreduce(fem.assemble_scalar(fem.form(energy))))


def owned_pairs(domain, facets):
    """Return the owned facets among some as (cell, local facet) pairs, flat."""
    owned = domain.topology.index_map(domain.topology.dim - 1).size_local
    return facet_cells(domain, facets[facets < owned]).flatten()


def square(comm, n=12):
    """Return a mesh of the unit square."""
    return mesh.create_unit_square(comm, n, n)


def cube(comm, n=4):
    """Return a mesh of the unit cube."""
    return mesh.create_unit_cube(comm, n, n, n)


def polynomial(x):
    """In contact on the whole lowest side of the square."""
    return -x[1] * (1 + x[0] ** 2) + x[1] ** 2 * x[0]


def in_space(x):
    """In contact on the whole lowest side of the cube, and 0 on the highest one."""
    return -x[2] * (1 - x[2]) * (1 + x[0] * x[1])


def detaching(x, end=0.5):
    """-Im z^(3/2): contact right of a point of the lowest side; harmonic in the plane."""
    x0, x1 = x[0] - end, x[len(x) - 1]
    r = ufl.sqrt(x0 * x0 + x1 * x1)
    C, S = ufl.sqrt(abs(r + x0) / 2), ufl.sqrt(abs(r - x0) / 2)
    return -S * (3 * C * C - S * S)


def narrow(x, centre=0.513, half=0.06):
    """Contact on an interval of the lowest side alone: Re of the integral of the root of z^2 - k^2;
    harmonic."""
    X, y = x[0] - centre, x[1]
    angle = (ufl.atan2(y, X - half) + ufl.atan2(y, X + half)) / 2
    size = (((X - half) ** 2 + y**2) * ((X + half) ** 2 + y**2)) ** 0.25
    p, q = size * ufl.cos(angle), size * ufl.sin(angle)
    return (X * p - y * q - half**2 * ufl.ln(ufl.sqrt((X + p) ** 2 + (y + q) ** 2) / half)) / 2


def top(x):
    """Whether points are on the upper side of the square."""
    return np.isclose(x[1], 1.0)


def roof(x):
    """Whether points are on the upper side of the cube."""
    return np.isclose(x[2], 1.0)


def left(x):
    """Whether points are on the left side."""
    return np.isclose(x[0], 0.0)
