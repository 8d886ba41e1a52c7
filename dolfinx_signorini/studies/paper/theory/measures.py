"""What rows hold: the measurements of a discretisation, each a part of a row."""

import math
from collections.abc import Callable, Mapping
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
from dolfinx_signorini.studies.paper.theory.one_sided import (
    edge_data,
    one_sided_approximation,
    smallest_one_sided,
)
from dolfinx_signorini.studies.paper.theory.parts import second_seminorms

Row = dict[str, Any]

GRADIENT_NORMS = ("H1", "W1_2.6", "W1_4", "W1_16", "W1_inf")
TRACE = "H1_2_boundary_spectral"
ERROR_NORMS = ("L4", "L16", "Linf", *GRADIENT_NORMS, "H1_2_boundary", TRACE)
SECOND = (2.0, 3.0, 16.0)  # exponents of the discrete W^{2,p} seminorm
REFINEMENT = 4  # of the mesh of the dual solutions against that of u_h
ITERATED = 51  # cells per side: where TAO alone takes no longer than all others


def _one_sided(d: Discretisation) -> Row:
    """The w_h of Lemma 3.5."""
    found = one_sided_approximation(d)
    kept = ("norm", "below", "above", "distance", "tested", "cases")
    return {name: getattr(found, name) for name in kept}


def _trace(d: Discretisation) -> Row:
    """How the trace of u says where u touches 0."""
    touching = edge_data(d).u == 0.0
    inner, outer = touching.all(axis=1), touching.any(axis=1)
    return {
        "between": float(d.curve.widths[outer & ~inner].sum()),
        "components": int(np.count_nonzero(inner & ~np.roll(inner, 1))),
    }


def _factors(d: Discretisation) -> Row:
    """The factors of r^{1/2} and r^{3/2} at the detachment point, and the point corrected."""
    assert d.u_h is d.u
    terms = EnergyTerms(reaction=1.0, load=d.exact.load)
    nearest = min(detachment_points(d), key=lambda p: abs(p.position[0] - DETACHMENT[0]))
    found, exact = (stress_intensity(d, point, terms) for point in (nearest, DETACHMENT))
    corrected = found.corrected[0]
    return {"half": exact.half, "three_halves": exact.three_halves, "corrected": corrected}


def _bounds(d: Discretisation) -> Row:
    """Enclosures of the contact set, and the force on the boundary with its bound."""
    sup = error_norms(d.u_h, d.exact, ["Linf", "W1_inf"])
    bound = energy_bound(d, EnergyTerms(reaction=1.0, load=d.exact.load)).total
    x = d.system.vector_of(d.u_h)
    total = d.comm.allreduce(float(d.system.multiplier(x).sum()))
    x.destroy()
    return {
        "enclosure": asdict(enclosures(d, sup["Linf"], sup["W1_inf"])),
        "force": {
            "error": abs(float(d.flux.sum()) - float(total)),
            "bound": bound,
            "dual": dual_force_bound(d, sup["Linf"], bound),
        },
        "energy": error_norms(d.u_h, d.exact, ["H1"])["H1"],
    }


def _dual(d: Discretisation) -> Row:
    """The chains of Section 5."""
    fine = Discretisation(d.example, friedrichs_keller(d.comm, REFINEMENT * (len(d.curve.s) // 4)))
    chains = dual_chains(d, fine)
    fine.destroy()
    return {
        name: asdict(chain) | {"slack": chain.slack}
        for name, chain in zip(("plus", "minus"), chains, strict=True)
    }


# By the names of measures in `data/experiments.toml`: the entries of a row, and what they are.
MEASURES: Mapping[str, Callable[[Discretisation], Row]] = {
    "errors": lambda d: {
        "errors": error_norms(d.u_h, d.exact, ERROR_NORMS),
        "signed": parts.signed_parts(d),
    },
    "projection": lambda d: {"ritz": ritz.ritz_errors(d)},
    "stability": lambda d: {"stability": ritz.ritz_stability(d)},
    "supercloseness": lambda d: {
        "supercloseness": ritz.supercloseness(d),
        "supercloseness_parts": parts.near_and_far_supercloseness(d),
    },
    "one_sided": lambda d: {"one_sided": _one_sided(d)},
    # On more nodes of the boundary it would take long.
    "infimum": lambda d: {"infimum": smallest_one_sided(d) if len(d.curve.s) < 500 else None},
    "obstacle": lambda d: {"obstacle": asdict(ritz.check_obstacle_problem(d))},
    "near": lambda d: {
        "parts": parts.near_and_far(d, ["L16", "W1_16"]),
        "by_paper_rule": error_norms(d.u_h, d.exact, ["L4", "L16", "W1_4", "W1_16"], PAPER_RULE),
    },
    "contact": lambda d: {"contact_set": asdict(discrete_contact_set(d)), "trace": _trace(d)},
    "factors": lambda d: {"factors": _factors(d), "second": second_seminorms(d.u_h, SECOND)},
    "trace_interpolation": lambda d: {
        "interpolation": error_norms(interpolant(d.space, d.exact.u), d.exact, [TRACE])[TRACE]
    },
    "bounds": _bounds,
    "shape": lambda d: {
        "shape": triangulations.shape(d.space.mesh),
        "angle": triangulations.largest_angle(d.space.mesh),
    },
    "dual": _dual,
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
    sizes = []
    for function in (difference(first, other), first):
        x = problem.system.vector_of(function)
        image = x.duplicate()
        problem.system.A.mult(x, image)
        sizes.append(float(image.dot(x)))
        image.destroy()
        x.destroy()
    return float(np.sqrt(max(sizes[0], 0.0) / sizes[1]))
