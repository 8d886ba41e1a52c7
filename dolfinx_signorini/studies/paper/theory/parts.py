"""Parts of the error, by sign and by place, and the discrete W^{2,p} seminorm.

The gradient of a function of V_h jumps across the inner edges E, by J_E in the normal direction.
J_E / h plays the part of a second derivative in the cells beside E, whose area is like h^2:

    |v_h|_{2,p,h} = ( sum over E of |E|^2 (|J_E| / |E|)^p )^{1/p}.

On quasi-uniform meshes the seminorm of approximations of u stays bounded if u is in W^{2,p}, and
grows like h^{a - 2 + 2/p} if u is like r^a with a smaller a than that allows.
"""

import math
from collections.abc import Collection

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_signorini.base import compiled
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.references import Reference
from dolfinx_signorini.studies.paper.solution import PAPER_RULE
from dolfinx_signorini.studies.paper.theory.discretisation import (
    Discretisation,
    cell_size,
    difference,
)

REACH = 8.0  # cells: how far "near" reaches


def expression_norms(
    space: fem.FunctionSpace, expression: Expr, norms: Collection[str], grad: Expr | None = None
) -> dict[str, float]:
    """Return norms of an expression on the domain, by the paper's rule: sums of parts are exact.

    Args:
        space: Any space on the expression's mesh.
        expression: The expression.
        norms: Names of norms.
        grad: The gradient of the expression, where a norm needs it.
    """
    zero = ufl.as_ufl(0.0)
    gradient = (zero, zero) if grad is None else (grad[0], grad[1])
    exact = Reference(space.mesh, expression, gradient)
    return error_norms(fem.Function(space), exact, norms, PAPER_RULE)


def signed_parts(discretisation: Discretisation) -> dict[str, float]:
    """Return the L^4 norms of (u - u_h)^+ and (u - u_h)^- (Propositions 5.4 and 5.7)."""
    error = discretisation.exact.u - discretisation.u_h
    space = discretisation.space
    return {
        name: expression_norms(space, ufl.max_value(sign * error, 0.0), ["L4"])["L4"]
        for name, sign in (("plus", 1.0), ("minus", -1.0))
    }


def near_and_far(
    discretisation: Discretisation, norms: Collection[str]
) -> dict[str, dict[str, float]]:
    """Return norms of u - u_h within REACH cells of the singular points, and outside.

    For L^p and W^{1,p} the p-th powers of both parts add up to the p-th power of the whole.
    """
    exact, u_h = discretisation.exact, discretisation.u_h
    grad = ufl.as_vector(exact.grad) - ufl.grad(u_h)
    return _parts(discretisation, exact.u - u_h, grad, norms)


def near_and_far_supercloseness(discretisation: Discretisation) -> dict[str, float]:
    """Return the H^1 norms of R_h(u) - u_h near the singular points, and away from them."""
    v = difference(discretisation.ritz, discretisation.u_h)
    return {part: n["H1"] for part, n in _parts(discretisation, v, ufl.grad(v), ["H1"]).items()}


def _parts(
    discretisation: Discretisation, v: Expr, grad: Expr, norms: Collection[str]
) -> dict[str, dict[str, float]]:
    """Norms of v times a mask: one near the singular points, one away from them, else zero."""
    domain = discretisation.space.mesh
    radius = fem.Constant(domain, np.float64(REACH * cell_size(domain)))
    x = ufl.SpatialCoordinate(domain)
    near: Expr = ufl.as_ufl(0.0)
    for point in discretisation.example.singular:
        distance = ufl.sqrt(sum((x[i] - point[i]) ** 2 for i in range(2)))
        near = ufl.max_value(near, ufl.conditional(ufl.lt(distance, radius), 1.0, 0.0))
    return {
        part: expression_norms(discretisation.space, mask * v, norms, mask * grad)
        for part, mask in (("near", near), ("far", 1.0 - near))
    }


def second_seminorms(function: fem.Function, exponents: tuple[float, ...]) -> dict[str, float]:
    """Return the discrete W^{2,p} seminorms of a piecewise linear function, by p as a text."""
    domain = function.function_space.mesh
    n = ufl.FacetNormal(domain)
    jump = abs(ufl.jump(ufl.grad(function), n))
    edge = ufl.FacetArea(domain)("+")
    dS = ufl.dS(metadata={"quadrature_degree": 0})
    result = {}
    for p in exponents:
        power = fem.Constant(domain, float(p))  # type: ignore[arg-type]
        form = compiled.form(edge ** (1.0 - power) * ufl.max_value(jump, 1e-30) ** power * dS)
        total = domain.comm.allreduce(float(fem.assemble_scalar(form)))
        result[f"{p:g}"] = math.pow(total, 1.0 / p)
    return result
