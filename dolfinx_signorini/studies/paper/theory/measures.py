"""Measurements of a solved problem, each a part of a row; all that checks read is an entry."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from dolfinx import fem

from dolfinx_signorini.accuracy.stress_intensity import stress_intensity
from dolfinx_signorini.accuracy.terms import difference
from dolfinx_signorini.base.records import Row
from dolfinx_signorini.bounds.energy_bound import energy_bound
from dolfinx_signorini.meshes.box_meshes import friedrichs_keller
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.orders import DETACHMENT_EXPONENT
from dolfinx_signorini.norms.references import interpolant
from dolfinx_signorini.problem.detachment import detachment_points
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.studies import TIGHT_RTOL
from dolfinx_signorini.studies.paper.solution import AMPLITUDE, DETACHMENT, PAPER_RULE
from dolfinx_signorini.studies.paper.tables import paper_table
from dolfinx_signorini.studies.paper.theory import errors, triangulations
from dolfinx_signorini.studies.paper.theory.boundary import (
    BoundaryCurve,
    ContactSet,
    condition_a_h,
    runs,
)
from dolfinx_signorini.studies.paper.theory.discretisation import Discretisation
from dolfinx_signorini.studies.paper.theory.dual import dual_chains
from dolfinx_signorini.studies.paper.theory.enclosures import dual_force_bound, enclosures
from dolfinx_signorini.studies.paper.theory.mixed import PowerProblem, UnknownProblem
from dolfinx_signorini.studies.paper.theory.one_sided import (
    edge_data,
    one_sided_approximation,
    smallest_one_sided,
)
from dolfinx_signorini.studies.paper.theory.proven import TRACE, critical_exponent

ERROR_NORMS = (
    *("L4", "L16", "Linf", "H1", "W1_2.6", "W1_4", "W1_16", "W1_inf"),
    *("H1_2_boundary", TRACE),
)
STABLE = ("W1_2", "W1_16", "W1_inf")  # norms in which R_h is stable
RITZ_NORMS = (
    *("L2", "L3", "L4", "H1", "W1_3", "W1_4"),
    *("L2_boundary", "L3_boundary", "L4_boundary", "H1_2_boundary", TRACE),
)
PLACED = ("L4", "L16", "Linf", "W1_4", "W1_16", "W1_inf", TRACE)
SECOND = (2.0, 3.0, 16.0)  # exponents of the discrete W^{2,p} seminorm
REFINEMENT = 4  # of the mesh of the dual solutions against that of u_h
ITERATED = 51  # cells per side: where TAO alone takes no longer than all others


def _stability(d: Discretisation) -> Row:
    """Norms of R_h(v) over those of v, which are bounded in W^{1,p}, 2 <= p <= inf."""
    zero = error_norms(fem.Function(d.space), d.exact, STABLE)
    found = error_norms(d.ritz, None, STABLE)
    return {"stability": {norm: found[norm] / zero[norm] for norm in STABLE}}


def _supercloseness(d: Discretisation) -> Row:
    """||R_h(u) - u_h||_H1, and its parts near the singular points and away from them."""
    found = errors.near_and_far(d, ["H1"], difference(d.ritz, d.u_h))
    parts = {part: norms["H1"] for part, norms in found.items()}
    return {"supercloseness": errors.supercloseness(d), "supercloseness_parts": parts}


def _one_sided(d: Discretisation) -> Row:
    """The w_h of Lemma 3.5."""
    found, kept = one_sided_approximation(d), ("norm", "distance", "tested", "cases", "outside")
    return {"one_sided": {name: getattr(found, name) for name in kept}}


def _near(d: Discretisation) -> Row:
    """Parts of the error by the paper's rule, and both together in the 16th power."""
    found = errors.near_and_far(d, ["L16", "W1_16"])
    whole = error_norms(d.u_h, d.exact, ["L4", "L16", "W1_4", "W1_16"], PAPER_RULE)
    known = paper_table(1).get(str(_cells(d)), {})
    over = {norm: whole[norm] / float(known[norm]) if known else None for norm in ("L4", "W1_4")}
    both = {
        norm: sum((part[norm] / whole[norm]) ** 16 for part in found.values())
        for norm in ("L16", "W1_16")
    }
    return {"parts": found | {"both": both}, "over_table_1": over}


def _contact(d: Discretisation) -> Row:
    """The contact set of u_h, how far the point of Section 7 is from it, and the trace of u."""
    found, touching = d.contact_set, edge_data(d).u == 0.0
    inner, outer = touching.all(axis=1), touching.any(axis=1)
    distances = {
        name: min((abs(s - DETACHMENT[0]) for s in points), default=None)
        for name, points in (("error", found.detachments), ("first", found.boundary))
    }
    trace = {
        "between": float(d.curve.widths[outer & ~inner].sum()),
        "components": len(runs(inner)),
    }
    corners = d.curve.corners.tolist()
    return {"contact_set": asdict(found) | distances | {"corners": corners}, "trace": trace}


def _factors(d: Discretisation) -> Row:
    """The factors of r^{1/2} and r^{3/2} at the detachment point, and the point corrected."""
    assert d.u_h is d.u
    nearest = min(detachment_points(d), key=lambda p: abs(p.position[0] - DETACHMENT[0]))
    found, exact = (stress_intensity(d, point, d.terms) for point in (nearest, DETACHMENT))
    corrected = found.corrected[0]
    return {
        "factors": {"half": exact.half, "three_halves": exact.three_halves, "corrected": corrected},
        "second": errors.second_seminorms(d.u_h, SECOND),
    }


def _bounds(d: Discretisation) -> Row:
    """Enclosures of the contact set, and the force on the boundary with its bound."""
    sup = error_norms(d.u_h, d.exact, ["Linf", "W1_inf"])
    bound = energy_bound(d, d.terms).total
    found = enclosures(d, sup["Linf"], sup["W1_inf"])
    # How far contact may begin too early, in (e / b)^{2/3}.
    width = (DETACHMENT[0] - found.outer) / (sup["Linf"] / AMPLITUDE) ** (1.0 / DETACHMENT_EXPONENT)
    return {
        "enclosure": asdict(found) | {"outer_width": width},
        "force": {
            "error": abs(float(d.curve.values(d.flux).sum()) - d.force),
            "bound": bound,
            "dual": dual_force_bound(d, sup["Linf"], bound),
        },
        "energy": error_norms(d.u_h, d.exact, ["H1"])["H1"],
    }


def _dual(d: Discretisation) -> Row:
    """The chains of Section 5, with the largest quotients of Hoelder's bounds over all epsilon."""
    fine = Discretisation(d.example, friedrichs_keller(d.comm, REFINEMENT * _cells(d)))
    row: Row = {}
    for name, chain in zip(("plus", "minus"), dual_chains(d, fine), strict=True):
        bounds = chain.holder
        row[name] = asdict(chain) | {
            "slack": chain.slack,
            "over_holder": max(chain.interpolation / bound for bound in bounds.values()),
            "over_split": max(bounds[e] / split for e, split in chain.holder_split.items()),
        }
    fine.destroy()
    return row


def _power(problem: PowerProblem) -> Row:
    """Errors of problem (3), and the components of its contact set on the bottom side."""
    curve = BoundaryCurve(problem.space)
    bottom = curve.values(problem.u)[curve.s < 1.0]
    row: Row = {"errors": error_norms(problem.u, problem.exact, ERROR_NORMS)}
    row["components"] = len(runs(bottom == 0.0))
    if math.isfinite(problem.p):
        norm = f"W1_{critical_exponent(problem.p)!r}"
        row["critical"] = error_norms(problem.u, problem.exact, [norm])[norm]
    return row


def _unknown(problem: UnknownProblem) -> Row:
    """Seminorms and factors where u is not known, and how far off a second solution is."""
    first = problem.u.copy()
    point = max(detachment_points(problem), key=lambda p: p.position[1])
    found = stress_intensity(problem, point, problem.terms)
    row: Row = {
        "second": errors.second_seminorms(first, SECOND),
        "factors": {"half": found.half, "three_halves": found.three_halves},
        "uniqueness": None,
    }
    if _cells(problem) <= ITERATED:
        start = first.copy()
        start.x.array[:] = 1.0 + np.abs(first.x.array)
        other = problem.solve("bncg", start=start, rtol=TIGHT_RTOL, warm_start=False)
        apart, size = (
            error_norms(v, None, ["H1"])["H1"] for v in (difference(first, other), first)
        )
        row["uniqueness"] = apart / size
    return row


def _cells(problem: SignoriniProblem) -> int:
    """Cells per side of a Friedrichs-Keller triangulation."""
    return round(math.sqrt(problem.unknowns)) - 1


# By the names of measures in `data/experiments.toml`.
MEASURES: Mapping[str, Callable[[Any], Row]] = {
    "errors": lambda d: {
        "errors": error_norms(d.u_h, d.exact, ERROR_NORMS),
        "signed": errors.signed_parts(d),
    },
    "projection": lambda d: {"ritz": error_norms(d.ritz, d.exact, RITZ_NORMS)},
    "stability": _stability,
    "supercloseness": _supercloseness,
    "one_sided": _one_sided,
    # On more nodes of the boundary it would take long.
    "infimum": lambda d: {"infimum": smallest_one_sided(d) if len(d.curve.s) < 500 else None},
    "obstacle": lambda d: {"obstacle": asdict(errors.check_obstacle_problem(d))},
    "near": _near,
    "contact": _contact,
    "factors": _factors,
    "trace_interpolation": lambda d: {
        "interpolation": error_norms(interpolant(d.space, d.exact.u), d.exact, [TRACE])[TRACE]
    },
    "bounds": _bounds,
    "shape": lambda d: {
        "shape": triangulations.shape(d.space.mesh),
        "angle": triangulations.largest_angle(d.space.mesh),
    },
    "dual": _dual,
    "power": _power,
    "unknown": _unknown,
}


def violations(families: Sequence[Sequence[Row]]) -> int:
    """Return in how many ways the contact sets of one family of meshes violate (A_h)."""
    (rows,) = families
    found = [row["contact_set"] for row in rows]
    sets = [ContactSet(f["length"], tuple(map(tuple, f["intervals"])), ()) for f in found]
    return len(condition_a_h(sets, found[0]["corners"]).violations)


def middle(families: Sequence[Sequence[Row]]) -> float:
    """Return the error with the point at a half of an edge over the largest at other places.

    Args:
        families: The rows of the places 0, 1/4, 1/2, 3/4 of an edge.

    Returns:
        The quotient in the norm where it is largest, on the finest meshes.
    """
    zero, quarter, half, last = (rows[-1]["errors"] for rows in families)
    return max(half[norm] / max(e[norm] for e in (zero, quarter, last)) for norm in PLACED)


TOGETHER: Mapping[str, Callable[[Sequence[Sequence[Row]]], float]] = {
    function.__name__: function for function in (violations, middle)
}
