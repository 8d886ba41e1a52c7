"""What rows hold: the measurements of a discretisation, each a part of a row."""

import math
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np
from mpi4py import MPI

from dolfinx_signorini.accuracy.stress_intensity import stress_intensity
from dolfinx_signorini.bounds.energy_bound import energy_bound
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.references import interpolant
from dolfinx_signorini.pictures.contact_boundary import gather_contact_boundary
from dolfinx_signorini.problem.detachment import detachment_points
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.studies import TIGHT_RTOL
from dolfinx_signorini.studies.paper.solution import DETACHMENT, PAPER_RULE
from dolfinx_signorini.studies.paper.theory import parts, ritz, triangulations
from dolfinx_signorini.studies.paper.theory.cea import smallest_one_sided
from dolfinx_signorini.studies.paper.theory.contact_sets import discrete_contact_set
from dolfinx_signorini.studies.paper.theory.discretisation import (
    THEORY_RTOL,
    Discretisation,
    difference,
)
from dolfinx_signorini.studies.paper.theory.dual import dual_chains
from dolfinx_signorini.studies.paper.theory.enclosures import dual_force_bound, enclosures
from dolfinx_signorini.studies.paper.theory.mixed import (
    UnknownProblem,
    critical_exponent,
    solved_power_problem,
)
from dolfinx_signorini.studies.paper.theory.one_sided import edge_data, one_sided_approximation
from dolfinx_signorini.studies.paper.theory.seminorms import second_seminorms

Row = dict[str, Any]
Measure = Callable[[Discretisation], Row]

GRADIENT_NORMS = ("H1", "W1_2.6", "W1_4", "W1_16", "W1_inf")
TRACE = "H1_2_boundary_spectral"
ERROR_NORMS = ("L4", "L16", "Linf", *GRADIENT_NORMS, "H1_2_boundary", TRACE)
SECOND = (2.0, 3.0, 16.0)  # exponents of the discrete W^{2,p} seminorm
REFINEMENT = 4  # of the mesh of the dual solutions against that of u_h
ITERATED = 51  # cells per side: where TAO alone takes no longer than all others


def errors(d: Discretisation) -> Row:
    """Return norms of u - u_h, and the L^4 norms of both signs."""
    return {"errors": error_norms(d.u_h, d.exact, ERROR_NORMS), "signed": parts.signed_parts(d)}


def projection(d: Discretisation) -> Row:
    """Return norms of u - R_h(u)."""
    return {"ritz": ritz.ritz_errors(d)}


def stability(d: Discretisation) -> Row:
    """Return norms of R_h(v) over those of v."""
    return {"stability": ritz.ritz_stability(d)}


def supercloseness(d: Discretisation) -> Row:
    """Return ||R_h(u) - u_h||_H1, with its part near the detachment points."""
    near = parts.near_and_far_supercloseness(d) if d.example.singular else {}
    return {"supercloseness": ritz.supercloseness(d), "supercloseness_parts": near}


def one_sided(d: Discretisation) -> Row:
    """Return the w_h of Lemma 3.5."""
    found = one_sided_approximation(d)
    kept = ("norm", "below", "above", "distance", "tested", "cases")
    return {"one_sided": {name: getattr(found, name) for name in kept}}


def infimum(d: Discretisation) -> Row:
    """Return the infimum of Lemma 3.4; null on meshes where it would take long."""
    small = len(d.curve.s) <= 4 * 101
    return {"infimum": smallest_one_sided(d) if small else None}


def obstacle(d: Discretisation) -> Row:
    """Return how well R_h(u) solves the problem with the obstacle R_h(u) - u."""
    return {"obstacle": asdict(ritz.check_obstacle_problem(d))}


def near(d: Discretisation) -> Row:
    """Return parts of the error near the detachment point and away, and norms by the same rule."""
    sampled = error_norms(d.u_h, d.exact, ["L4", "L16", "W1_4", "W1_16"], PAPER_RULE)
    return {"parts": parts.near_and_far(d, ["L16", "W1_16"]), "by_paper_rule": sampled}


def contact(d: Discretisation) -> Row:
    """Return the contact set of u_h, and how the trace of u says where u touches 0."""
    touching = edge_data(d).u == 0.0
    inner, outer = touching.all(axis=1), touching.any(axis=1)
    return {
        "contact_set": asdict(discrete_contact_set(d)),
        "trace": {
            "between": float(d.curve.widths[outer & ~inner].sum()),
            "components": int(np.count_nonzero(inner & ~np.roll(inner, 1))),
        },
    }


def factors(d: Discretisation) -> Row:
    """Return the factors of r^{1/2} and r^{3/2} at the point that is found, and the seminorms."""
    assert d.u_h is d.u
    terms = EnergyTerms(reaction=1.0, load=d.exact.load)
    points = detachment_points(d)
    found = stress_intensity(
        d, min(points, key=lambda p: abs(p.position[0] - DETACHMENT[0])), terms
    )
    exact = stress_intensity(d, DETACHMENT, terms)
    return {
        "factors": {
            "half": exact.half,
            "three_halves": exact.three_halves,
            "corrected": found.corrected[0],
        },
        "second": second_seminorms(d.u_h, SECOND),
    }


def trace_interpolation(d: Discretisation) -> Row:
    """Return ||u - I_h(u)|| in H^{1/2} of the boundary (16)."""
    return {"interpolation": error_norms(interpolant(d.space, d.exact.u), d.exact, [TRACE])[TRACE]}


def bounds(d: Discretisation) -> Row:
    """Return enclosures of the contact set, and the force on the boundary with its bound."""
    sup = error_norms(d.u_h, d.exact, ["Linf", "W1_inf"])
    terms = EnergyTerms(reaction=1.0, load=d.exact.load)
    bound, force = energy_bound(d, terms), float(d.flux.sum())
    x = d.system.vector_of(d.u_h)
    total = d.comm.allreduce(float(d.system.multiplier(x).sum()))
    x.destroy()
    return {
        "enclosure": asdict(enclosures(d, sup["Linf"], sup["W1_inf"])),
        "force": {
            "error": abs(force - float(total)),
            "bound": bound.total,
            "dual": dual_force_bound(d, sup["Linf"], bound.total),
        },
        "energy": error_norms(d.u_h, d.exact, ["H1"])["H1"],
    }


def shape(d: Discretisation) -> Row:
    """Return the shape of the cells."""
    domain = d.space.mesh
    return {"shape": triangulations.shape(domain), "angle": triangulations.largest_angle(domain)}


def dual(d: Discretisation) -> Row:
    """Return the chains of Section 5."""
    domain = friedrichs_keller(d.comm, REFINEMENT * (len(d.curve.s) // 4))
    fine = Discretisation(d.example, domain)
    chains = dual_chains(d, fine)
    fine.destroy()
    return {
        name: asdict(chain) | {"slack": chain.slack}
        for name, chain in zip(("plus", "minus"), chains, strict=True)
    }


def powers(comm: MPI.Comm, n: int, p: float) -> Row:
    """Return errors of problem (3).

    Args:
        comm: The communicator that shares the mesh.
        n: Cells per side.
        p: The exponent of the regularity.
    """
    problem = solved_power_problem(comm, p, n)
    boundary = gather_contact_boundary(problem)
    components = 0
    if boundary is not None:
        (chain,) = boundary.chains()
        held = boundary.values[chain, 1] == 0.0
        components = int(np.count_nonzero(held[1:-1] & ~held[:-2]))
    row: Row = {"errors": error_norms(problem.u, problem.exact, ERROR_NORMS)}
    if math.isfinite(p):
        norm = f"W1_{critical_exponent(p)!r}"
        row["critical"] = error_norms(problem.u, problem.exact, [norm])[norm]
    row["components"] = int(comm.bcast(components))
    problem.destroy()
    return row


def unknown(comm: MPI.Comm, n: int, pole: bool) -> Row:
    """Return what is measured on a problem without known solution.

    Args:
        comm: The communicator that shares the mesh.
        n: Cells per side.
        pole: Whether the load is in L^2 only.
    """
    problem = UnknownProblem(friedrichs_keller(comm, n), pole)
    first = problem.solve(rtol=THEORY_RTOL).copy()
    row: Row = {"second": second_seminorms(first, SECOND)}
    point = max(detachment_points(problem), key=lambda p: p.position[1])
    found = stress_intensity(problem, point, problem.terms)
    row["factors"] = {"half": found.half, "three_halves": found.three_halves}
    row["uniqueness"] = _second_solution(problem, first) if n <= ITERATED else None
    problem.destroy()
    return row


def _second_solution(problem: SignoriniProblem, first: Any) -> float:
    """How far from a solution another one is, found by TAO from a start far away."""
    start = first.copy()
    start.x.array[:] = 1.0 + np.abs(first.x.array)
    other = problem.solve("bncg", start=start, rtol=TIGHT_RTOL, warm_start=False)
    system = problem.system
    x, y = system.vector_of(difference(first, other)), system.vector_of(first)
    sizes = []
    for vector in (x, y):
        image = vector.duplicate()
        system.A.mult(vector, image)
        sizes.append(float(image.dot(vector)))
        image.destroy()
        vector.destroy()
    return float(np.sqrt(max(sizes[0], 0.0) / sizes[1]))
