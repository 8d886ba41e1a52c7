"""The Ritz projection: Lemma 3.2, Lemma 3.3 and the supercloseness of Theorem 3.6."""

from dataclasses import dataclass

import numpy as np
from dolfinx import fem

from dolfinx_signorini.norms import error_norms
from dolfinx_signorini.paper.theory.discretisation import (
    THEORY_RTOL,
    Discretisation,
    difference,
)
from dolfinx_signorini.paper.theory.one_sided import edge_data, solve_linear_program
from dolfinx_signorini.problem import SignoriniProblem
from dolfinx_signorini.references import interpolant

DOMAIN_NORMS = ("L2", "L3", "L4", "H1", "W1_3", "W1_4")
TRACE_NORMS = ("L2_boundary", "L3_boundary", "L4_boundary", "H1_2_boundary")
RITZ_NORMS = (*DOMAIN_NORMS, *TRACE_NORMS, "H1_2_boundary_spectral")


def ritz_errors(discretisation: Discretisation) -> dict[str, float]:
    """Return the norms of u - R_h(u) that Lemma 3.2 bounds."""
    return error_norms(discretisation.ritz, discretisation.exact, RITZ_NORMS)


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
        identity: The largest |(R_h(u), phi_i)_H1 - (f, phi_i) - <du/dn, phi_i>| relative to the
            largest (u, phi_i)_H1: rounding and the tolerance of the linear solver.
        minimum: The smallest value for the obstacle along the whole of every edge.
        minimum_nodes: The smallest value for the obstacle at the nodes only.
        distance_nodes: The H^1 distance of R_h(u) from the solution with the obstacle at the nodes.
    """

    identity: float
    minimum: float
    minimum_nodes: float
    distance_nodes: float


def check_obstacle_problem(discretisation: Discretisation) -> ObstacleCheck:
    """Check Lemma 3.3 for the exact solution."""
    curve = discretisation.curve
    flux_function = fem.Function(discretisation.space)
    flux_function.x.array[: discretisation.flux.getLocalSize()] = discretisation.flux.array_r
    flux = np.maximum(curve.values(flux_function), 0.0)  # as it is but for rounding
    data = edge_data(discretisation)
    y = solve_linear_program(discretisation.comm, data, flux, bounded=False)
    return ObstacleCheck(
        identity=_identity(discretisation),
        minimum=min(float(flux @ y), 0.0),
        minimum_nodes=-float(flux @ data.u[:, 0]),
        distance_nodes=_nodal_distance(discretisation),
    )


def _identity(discretisation: Discretisation) -> float:
    x = discretisation.system.vector_of(discretisation.ritz)
    defect = x.duplicate()
    discretisation.A.mult(x, defect)
    defect.axpy(-1.0, discretisation.b)
    defect.axpy(-1.0, discretisation.flux)
    value = float(defect.norm(3) / discretisation.moments.norm(3))
    x.destroy()
    defect.destroy()
    return value


def _nodal_distance(discretisation: Discretisation) -> float:
    """Solve with the obstacle R_h(u) - u at the nodes, and compare with R_h(u)."""
    u = interpolant(discretisation.space, discretisation.exact.u)
    problem = SignoriniProblem(
        *discretisation.forms,
        contact=discretisation.contact,
        obstacle=difference(discretisation.ritz, u),
    )
    solution = problem.solve(rtol=THEORY_RTOL)
    problem.destroy()
    return discretisation.norm(difference(solution, discretisation.ritz))
