"""The Ritz projection beside u_h, parts of the error, and the discrete W^{2,p} seminorm.

The gradient of a function of V_h jumps across the inner edges E, by J_E in the normal direction.
J_E / h plays the part of a second derivative in the cells beside E, whose area is like h^2:

    |v_h|_{2,p,h} = ( sum over E of |E|^2 (|J_E| / |E|)^p )^{1/p}.

On quasi-uniform meshes the seminorm of approximations of u stays bounded if u is in W^{2,p}, and
grows like h^{a - 2 + 2/p} if u is like r^a with a smaller a than that allows.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_signorini.accuracy.terms import assembled, difference
from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.references import Reference
from dolfinx_signorini.studies.paper.solution import PAPER_RULE
from dolfinx_signorini.studies.paper.theory.discretisation import (
    FINE_RULE,
    Discretisation,
    cell_size,
)
from dolfinx_signorini.studies.paper.theory.one_sided import edge_data, solve_linear_program

REACH = 8.0  # cells: how far "near" reaches


def supercloseness(discretisation: Discretisation) -> float:
    """Return ||R_h(u) - u_h||_H1 (Theorem 3.6)."""
    return discretisation.norm(difference(discretisation.ritz, discretisation.u_h))


@dataclass(frozen=True)
class ObstacleCheck:
    """How well R_h(u) solves the problem with the obstacle R_h(u) - u (Lemma 3.3).

    The variational inequality says that (R_h(u), v_h - R_h(u))_H1 - (f, v_h - R_h(u)), which is
    <du/dn, v_h - R_h(u)>, is not negative for any admissible v_h: the smallest value is 0.

        check = check_obstacle_problem(discretisation)
        assert check.minimum > -1e-9

    Attributes:
        identity: The H^1 norm of the Riesz representative of (R_h(u), .)_H1 - (f, .) - <du/dn, .>
            over ||R_h(u) - u_h||_H1, with the load f integrated by itself: quadrature.
        minimum: The smallest value for the obstacle along the whole of every edge; -inf where
            some <du/dn, phi_i> is negative.
        minimum_nodes: The smallest value for the obstacle at the nodes only.
    """

    identity: float
    minimum: float
    minimum_nodes: float


def check_obstacle_problem(discretisation: Discretisation) -> ObstacleCheck:
    """Check Lemma 3.3 for the exact solution."""
    d, data = discretisation, edge_data(discretisation)
    flux = d.curve.values(d.flux)
    pulled = bool((flux < -SOLVED * highest(d.comm, np.abs(d.moments.x.array))).any())
    minimum = -np.inf
    if not pulled:
        y = solve_linear_program(data, np.maximum(flux, 0.0), bounded=False)
        minimum = min(float(flux @ y), 0.0)
    # The load integrated by itself against that of (S_h): (u, w)_H1 is (R_h(u), w)_H1.
    load = d.exact.load * ufl.TestFunction(d.space) * ufl.dx(metadata=FINE_RULE.metadata)
    identity = d.norm(d.riesz(difference(assembled(load, d.space), d.load))) / supercloseness(d)
    return ObstacleCheck(identity, minimum, -float(flux @ data.u[:, 0]))


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
    gradient = (ufl.as_ufl(0.0),) * 2 if grad is None else (grad[0], grad[1])
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
    discretisation: Discretisation, norms: Collection[str], v: fem.Function | None = None
) -> dict[str, dict[str, float]]:
    """Return norms of a function within REACH cells of the singular points, and outside.

    For L^p and W^{1,p} the p-th powers of both parts add up to the p-th power of the whole.

    Args:
        discretisation: The discretisation.
        norms: Names of norms.
        v: A function of V_h; None for u - u_h.
    """
    exact, u_h, domain = discretisation.exact, discretisation.u_h, discretisation.space.mesh
    if v is None:
        value, grad = exact.u - u_h, ufl.as_vector(exact.grad) - ufl.grad(u_h)
    else:
        value, grad = v, ufl.grad(v)
    radius = fem.Constant(domain, np.float64(REACH * cell_size(domain)))
    x, near = ufl.SpatialCoordinate(domain), ufl.as_ufl(0.0)
    for point in discretisation.example.singular:
        distance = ufl.sqrt(sum((x[i] - point[i]) ** 2 for i in range(2)))
        near = ufl.max_value(near, ufl.conditional(ufl.lt(distance, radius), 1.0, 0.0))
    return {
        part: expression_norms(discretisation.space, mask * value, norms, mask * grad)
        for part, mask in (("near", near), ("far", 1.0 - near))
    }


def second_seminorms(function: fem.Function, exponents: tuple[float, ...]) -> dict[str, float]:
    """Return the discrete W^{2,p} seminorms of a piecewise linear function, by p as a text."""
    domain = function.function_space.mesh
    jump = abs(ufl.jump(ufl.grad(function), ufl.FacetNormal(domain)))
    edge = ufl.FacetArea(domain)("+")
    dS = ufl.dS(metadata={"quadrature_degree": 0})
    result = {}
    for p in exponents:
        power = fem.Constant(domain, np.float64(p))
        total = compiled.integral(edge ** (1.0 - power) * ufl.max_value(jump, 1e-30) ** power * dS)
        result[f"{p:g}"] = total ** (1.0 / p)
    return result
