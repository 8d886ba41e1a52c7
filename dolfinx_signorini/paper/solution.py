"""The problem of Christof and Haubner."""

import ufl
from dolfinx import fem

from dolfinx_signorini.manufactured import ManufacturedSolution
from dolfinx_signorini.meshes import boundary_facets
from dolfinx_signorini.problem import SignoriniProblem
from dolfinx_signorini.quadrature import PAPER_RULE, QuadratureRule


def paper_problem(
    exact: ManufacturedSolution, degree: int = 1, rule: QuadratureRule = PAPER_RULE
) -> SignoriniProblem:
    """Return the paper's problem (S_h): (u, v)_H1, load f, contact everywhere, obstacle 0.

    Args:
        exact: Solution and load; the load is integrated on the cells of its support only.
        degree: Polynomial degree of the Lagrange elements.
        rule: Quadrature rule of the load.

    Source: Christof and Haubner, Section 2.3.
    """
    domain = exact.mesh
    space = fem.functionspace(domain, ("Lagrange", degree))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx
    dx = ufl.Measure(
        "dx", domain, subdomain_data=[(1, exact.support_cells())], metadata=rule.metadata
    )
    return SignoriniProblem(a, exact.load * v * dx(1), contact=boundary_facets(domain))
