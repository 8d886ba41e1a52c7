"""An example on one mesh, with u_h and R_h(u) from integrals that are consistent with each other.

The proofs of the paper use Green's formula (u, w)_H1 = (f, w) + <du/dn, w>. To make what follows
from the formula hold to rounding, and not just to the accuracy of some quadrature rule, two of the
three terms are integrated, (u, w)_H1 and <du/dn, w>, and the load of (S_h) is their difference.
"""

import functools
from dataclasses import replace

import numpy as np
import ufl
from dolfinx import fem, mesh
from ufl.core.expr import Expr

from dolfinx_signorini.accuracy.terms import assembled
from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.arrays import LocalIndices, union
from dolfinx_signorini.base.errors import NotConvergedError
from dolfinx_signorini.base.petsc import destroy
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.meshes.quadrature import QuadratureRule
from dolfinx_signorini.meshes.sided_meshes import (
    boundary_facets,
    cells_near_ball,
    facet_cells,
    owned_cells,
)
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.solvers.linear.iterative import IterativeSolver
from dolfinx_signorini.solvers.linear.solver import set_residual
from dolfinx_signorini.studies.paper.solution import PAPER_RULE, h1_product
from dolfinx_signorini.studies.paper.theory.boundary import (
    BoundaryCurve,
    ContactSet,
    contact_set_of_nodes,
)
from dolfinx_signorini.studies.paper.theory.examples import Example, Point

# On the cells near a singular point the gradient of u is like the root of the distance to the
# point. On other cells the rule is the paper's.
NEAR_CELL_RULE = QuadratureRule("Gauss-Jacobi", 63)
NEAR_FACET_RULE = QuadratureRule("Gauss-Jacobi", 127)
FINE_RULE = QuadratureRule("Gauss-Jacobi", 15)  # of other facets, and of a load by itself
NEAR = 3.0  # cells: how far "near" reaches
# Of every solve of the theory; rounding keeps a mesh of 1001 cells per side above 1e-12.
THEORY_RTOL = 1e-11


class Discretisation(SignoriniProblem):
    """The problem (S_h) of an example on one mesh of linear elements:

        discretisation = Discretisation(paper_example(), friedrichs_keller(comm, 25))
        distance = discretisation.norm(difference(discretisation.ritz, discretisation.u_h))

    Args:
        example: The example.
        domain: A mesh of the unit square.

    Attributes:
        exact: The solution on this mesh.
        terms: The strong form.
        curve: The boundary.
        load: The values of the linear form for the basis functions, as coefficients.
        flux: <du/dn, phi_i> for every basis function.
        moments: (u, phi_i)_H1.
    """

    def __init__(self, example: Example, domain: mesh.Mesh):
        self.example, self.exact = example, example.exact(domain)
        space = fem.functionspace(domain, ("Lagrange", 1))
        v = ufl.TestFunction(space)
        flux = self._flux(v)
        self.terms = EnergyTerms(reaction=1.0, load=self.exact.load)
        load = self._product(v) - flux
        super().__init__(h1_product(space), load, contact=boundary_facets(domain))
        self.curve = BoundaryCurve(space)
        self.flux, self.load = assembled(flux, space), fem.Function(space)
        self.system.fill(self.load, self.b)
        self.moments = self.load.copy()
        self.moments.x.array[:] += self.flux.x.array

    @property
    def u_h(self) -> fem.Function:
        """The solution of (S_h), solved without a coarser one unless `solve` came first."""
        return self.solve(rtol=THEORY_RTOL) if self.result is None else self.u

    @functools.cached_property
    def ritz(self) -> fem.Function:
        """R_h(u), the Ritz projection of the solution (Definition 3.1)."""
        return self.riesz(self.moments)

    def riesz(self, load: fem.Function) -> fem.Function:
        """Return the function of V_h whose H^1 products with the basis are given.

        Raises:
            NotConvergedError: The linear solver did not reach its tolerance.
        """
        return self._linear_solution(load, fem.Function(self.space), held=False)

    def harmonic(self, boundary_values: fem.Function) -> fem.Function:
        """Return the extension of boundary values with the smallest H^1 norm in V_h.

        Raises:
            NotConvergedError: The linear solver did not reach its tolerance.
        """
        return self._linear_solution(fem.Function(self.space), boundary_values, held=True)

    def product(self, v: fem.Function, w: fem.Function) -> float:
        """Return (v, w)_H1 for two functions of V_h."""
        return compiled.integral(ufl.action(ufl.action(self.a, w), v))

    def norm(self, v: fem.Function) -> float:
        """Return the H^1 norm of a function of V_h."""
        return float(np.sqrt(max(self.product(v, v), 0.0)))

    def exact_product(self, w: fem.Function) -> float:
        """Return (u, w)_H1 for a function of V_h and the exact u."""
        owned = slice(self.space.dofmap.index_map.size_local)
        product = self.moments.x.array[owned] @ w.x.array[owned]
        return float(self.comm.allreduce(float(product)))

    @property
    def contact_set(self) -> ContactSet:
        """{u_h = 0} on the boundary: the edges with both nodes in contact, and single nodes.

        The pressure is the force on a node divided by the diagonal entry of A: in the unit of u.
        """
        gap, pressure = self.curve.values(self.u_h), self.forces
        pressure.x.array[self.contact_dofs] /= self.system.contact_diagonal
        return contact_set_of_nodes(self.curve, gap, self.curve.values(pressure))

    def _linear_solution(self, load: fem.Function, start: fem.Function, held: bool) -> fem.Function:
        """Solve A x = load, with the values of the start held at the boundary or with none held."""
        b, x, rest = map(self.system.vector_of, (load, start, start))
        system = replace(self.system, b=b, obstacle=start.x.array[self.contact_dofs])
        mask = np.full(len(self.contact_dofs), held)

        def defect() -> float:
            return set_residual(system, x, mask, None, rest) * float(rest.norm())

        scale = defect()
        solver = IterativeSolver(system, self._prefix)
        if scale > 0.0:
            solver.solve(system, x, mask, THEORY_RTOL * scale)
        reached, result = defect(), fem.Function(self.space)
        self.system.fill(result, x)
        destroy(solver, b, x, rest)
        if not reached <= 2.0 * THEORY_RTOL * scale:
            message = "the linear solver did not converge"
            raise NotConvergedError(message, reached / scale, "iterations")
        return result

    def _product(self, v: ufl.Argument) -> ufl.Form:
        """(u, v)_H1 with the exact u and its gradient."""
        integrand = ufl.inner(ufl.as_vector(self.exact.grad), ufl.grad(v)) + self.exact.u * v
        cells, points = self.exact.support_cells(), self.example.singular
        domain = self.exact.mesh
        return integrated(integrand, domain, "dx", cells, points, PAPER_RULE, NEAR_CELL_RULE)

    def _flux(self, v: ufl.Argument) -> ufl.Form:
        """<du/dn, v> on the boundary."""
        domain = self.exact.mesh
        integrand = ufl.dot(ufl.as_vector(self.exact.grad), ufl.FacetNormal(domain)) * v
        facets = facet_cells(domain, boundary_facets(domain))
        points = self.example.singular
        return integrated(integrand, domain, "ds", facets, points, FINE_RULE, NEAR_FACET_RULE)


def integrated(
    integrand: Expr,
    domain: mesh.Mesh,
    measure: str,
    entities: LocalIndices,
    points: tuple[Point, ...],
    far_rule: QuadratureRule,
    near_rule: QuadratureRule,
) -> ufl.Form:
    """Return an integral over entities by two rules, one of which is for those near some points.

    Args:
        integrand: The integrand.
        domain: The mesh.
        measure: dx for cells, or ds for facets as pairs of a cell and a local facet.
        entities: The cells or facets.
        points: Where the integrand is singular.
        far_rule, near_rule: The rules.
    """
    cells = entities if entities.ndim == 1 else entities[:, 0]
    near = np.isin(cells, near_cells(domain, points))
    parts = [(1, entities[~near].flatten()), (2, entities[near].flatten())]
    dx = ufl.Measure(measure, domain, subdomain_data=parts)
    far, close = dx(1, metadata=far_rule.metadata), dx(2, metadata=near_rule.metadata)
    return integrand * far + integrand * close


def near_cells(domain: mesh.Mesh, points: tuple[Point, ...]) -> LocalIndices:
    """Return the owned cells within `NEAR` cell diameters of points."""
    radius = NEAR * cell_size(domain)
    return union(cells_near_ball(domain, point, radius) for point in points)


def cell_size(domain: mesh.Mesh) -> float:
    """Return the largest cell diameter, the same on all ranks."""
    return highest(domain.comm, domain.h(domain.topology.dim, owned_cells(domain)))
