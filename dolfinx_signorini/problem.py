"""The Signorini problem as users pose and solve it."""

from collections.abc import Mapping
from typing import Any

import ufl
from dolfinx import fem

from dolfinx_signorini.errors import InputError
from dolfinx_signorini.manufactured import ManufacturedSolution
from dolfinx_signorini.meshes import boundary_facets
from dolfinx_signorini.quadrature import PAPER_RULE, QuadratureRule
from dolfinx_signorini.solvers import cascade, tao
from dolfinx_signorini.solvers.pressure import ContactState, contact_state
from dolfinx_signorini.solvers.residual import SolveResult
from dolfinx_signorini.system import DiscreteProblem

METHODS = ("cascade", *tao.METHODS)


class SignoriniProblem(DiscreteProblem):
    """A variational inequality with a one-sided constraint on part of the boundary.

    Find u >= g on the contact boundary with a(u, v - u) >= L(v - u) for all v >= g there. The
    arguments, attributes and errors are those of `DiscreteProblem`:

        problem = SignoriniProblem(a, L, contact=facets, obstacle=g, bcs=[bc])
        u = problem.solve().u
    """

    def solve(
        self,
        method: str = "cascade",
        *,
        coarse: ContactState | None = None,
        rtol: float | None = None,
        options: Mapping[str, Any] | None = None,
        **limits: Any,
    ) -> SolveResult:
        """Solve the discrete problem.

        Args:
            method: "cascade" predicts the active set from the coarse solution, if there is one,
                solves linear systems with CG and algebraic multigrid, and lets TAO accept the
                result. Any bound-constrained type of TAO (`tao.METHODS`) does it all alone.
            coarse: The contact state of a coarser solution (`contact_state`).
            rtol: The natural residual to reach, relative to the data; the method's own default
                (`cascade.DEFAULT_RTOL`, `tao.DEFAULT_RTOL`) keeps the algebraic error small
                against that of the discretisation.
            options: PETSc options, without prefix, of the linear solver or of TAO.
            limits: For TAO: start, max_iterations, max_evaluations, see `solve_tao`.

        Raises:
            InputError: An argument makes no sense, or the form is found to be indefinite.
            NotConvergedError: The residual was not reached.
        """
        if method == "cascade":
            if limits:
                raise InputError(f"{', '.join(limits)}: only for the methods of TAO")
            rtol = cascade.DEFAULT_RTOL if rtol is None else rtol
            return cascade.solve_contact(self, coarse, rtol=rtol, options=options)
        if coarse is not None:
            raise InputError("coarse: only for the cascade; TAO's methods take start")
        rtol = tao.DEFAULT_RTOL if rtol is None else rtol
        return tao.solve_tao(self, method, rtol=rtol, options=options, **limits)

    def contact_state(self, u: fem.Function) -> ContactState:
        """Return a solution with its pressure density, for the next finer mesh."""
        return contact_state(self, u)


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
