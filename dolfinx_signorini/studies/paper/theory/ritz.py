"""The Ritz projection: Lemma 3.2, Lemma 3.3 and the supercloseness of Theorem 3.6."""

from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.meshes.quadrature import QuadratureRule
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.studies.paper.theory.discretisation import (
    Discretisation,
    assembled,
    difference,
)
from dolfinx_signorini.studies.paper.theory.one_sided import edge_data, solve_linear_program

LOAD_RULE = QuadratureRule("Gauss-Jacobi", 15)
STABLE = ("W1_2", "W1_16", "W1_inf")  # norms in which R_h is stable
DOMAIN_NORMS = ("L2", "L3", "L4", "H1", "W1_3", "W1_4")
TRACE_NORMS = ("L2_boundary", "L3_boundary", "L4_boundary", "H1_2_boundary")
RITZ_NORMS = (*DOMAIN_NORMS, *TRACE_NORMS, "H1_2_boundary_spectral")


def ritz_errors(discretisation: Discretisation) -> dict[str, float]:
    """Return the norms of u - R_h(u) that Lemma 3.2 bounds."""
    return error_norms(discretisation.ritz, discretisation.exact, RITZ_NORMS)


def ritz_stability(discretisation: Discretisation) -> dict[str, float]:
    """Return norms of R_h(v) over those of v, which are bounded in W^{1,p}, 2 <= p <= inf."""
    zero = fem.Function(discretisation.space)
    v = error_norms(zero, discretisation.exact, STABLE)
    return {norm: w / v[norm] for norm, w in error_norms(discretisation.ritz, None, STABLE).items()}


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
    curve = discretisation.curve
    flux_function = fem.Function(discretisation.space)
    flux_function.x.array[: discretisation.flux.getLocalSize()] = discretisation.flux.array_r
    flux = curve.values(flux_function)
    data = edge_data(discretisation)
    pulled = bool((flux < -SOLVED * discretisation.moments.norm(3)).any())
    minimum = -np.inf
    if not pulled:
        y = solve_linear_program(discretisation.comm, data, np.maximum(flux, 0.0), bounded=False)
        minimum = min(float(flux @ y), 0.0)
    return ObstacleCheck(
        identity=_identity(discretisation),
        minimum=minimum,
        minimum_nodes=-float(flux @ data.u[:, 0]),
    )


def _identity(discretisation: Discretisation) -> float:
    """The load integrated by itself against that of (S_h): (u, w)_H1 is (R_h(u), w)_H1."""
    d, v = discretisation, ufl.TestFunction(discretisation.space)
    defect = assembled(d.exact.load * v * ufl.dx(metadata=LOAD_RULE.metadata))
    defect.axpy(-1.0, d.b)
    value = d.norm(d.riesz(defect)) / supercloseness(d)
    defect.destroy()
    return value
