"""Parts of the error: positive and negative, near the singular points and away from them."""

from collections.abc import Iterable

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_signorini.norms import error_norms
from dolfinx_signorini.paper.theory.discretisation import Discretisation, cell_size
from dolfinx_signorini.references import Reference

REACH = 8.0  # cells: how far "near" reaches


def expression_norms(
    space: fem.FunctionSpace, expression: Expr, norms: Iterable[str], grad: Expr | None = None
) -> dict[str, float]:
    """Return norms of an expression on the domain, by the paper's quadrature rule.

    Args:
        space: Any space on the expression's mesh.
        expression: The expression.
        norms: Names of norms, see `dolfinx_signorini.norms.parse_norm`.
        grad: Its gradient, where a norm needs it.
    """
    zero = ufl.as_ufl(0.0)
    gradient = (zero, zero) if grad is None else (grad[0], grad[1])
    return error_norms(fem.Function(space), Reference(space.mesh, expression, gradient), norms)


def signed_parts(discretisation: Discretisation) -> dict[str, float]:
    """Return the L^4 norms of (u - u_h)^+ and (u - u_h)^- (Propositions 5.4 and 5.7)."""
    error = discretisation.exact.u - discretisation.u_h
    space = discretisation.space
    return {
        name: expression_norms(space, ufl.max_value(sign * error, 0.0), ["L4"])["L4"]
        for name, sign in (("plus", 1.0), ("minus", -1.0))
    }


def near_and_far(
    discretisation: Discretisation, norms: Iterable[str]
) -> dict[str, dict[str, float]]:
    """Return norms of u - u_h within REACH cells of the singular points, and outside.

    For L^p and W^{1,p} the p-th powers of both parts add up to the p-th power of the whole.
    """
    exact, u_h = discretisation.exact, discretisation.u_h
    error, grad = exact.u - u_h, ufl.as_vector(exact.grad) - ufl.grad(u_h)
    return {
        part: expression_norms(discretisation.space, mask * error, norms, mask * grad)
        for part, mask in _masks(discretisation).items()
    }


def near_and_far_supercloseness(discretisation: Discretisation) -> dict[str, float]:
    """Return the H^1 norms of R_h(u) - u_h near the singular points, and away from them."""
    difference = discretisation.difference(discretisation.ritz, discretisation.u_h)
    space, grad = discretisation.space, ufl.grad(difference)
    return {
        part: expression_norms(space, mask * difference, ["H1"], mask * grad)["H1"]
        for part, mask in _masks(discretisation).items()
    }


def _masks(discretisation: Discretisation) -> dict[str, Expr]:
    """One near the singular points, or one away from them, and zero elsewhere."""
    domain = discretisation.space.mesh
    radius = fem.Constant(domain, np.float64(REACH * cell_size(domain)))
    x = ufl.SpatialCoordinate(domain)
    near: Expr = ufl.as_ufl(0.0)
    for point in discretisation.scene.singular:
        distance = ufl.sqrt(sum((x[i] - point[i]) ** 2 for i in range(2)))
        near = ufl.max_value(near, ufl.conditional(ufl.lt(distance, radius), 1.0, 0.0))
    return {"near": near, "far": 1.0 - near}
