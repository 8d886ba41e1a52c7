"""Indicators: which cells the error of a solution comes from.

A solution u_h is compared with the solution w on the mesh with every cell divided. The difference
w - u_h estimates the error of u_h, and w is the better solution. Three kinds of indicators tell
where the difference comes from:

    W^{1,p}      the norm of w - u_h on each cell;
    L^inf        the largest w - I w on each cell, where I interpolates on the undivided mesh;
    otherwise    the terms of the identity of the error on each cell, where a dual solution tells
                 how much an error at one place matters for the whole, see `terms`.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_signorini.accuracy.boundary_defects import (
    data_between_nodes,
    data_defects,
    forces_over_gaps,
)
from dolfinx_signorini.accuracy.cells import over, powers_tested
from dolfinx_signorini.accuracy.contact_ends import unknown_ends
from dolfinx_signorini.accuracy.derivatives import left_by_derivatives, lost_order
from dolfinx_signorini.accuracy.negative_pressure import negative_pressure
from dolfinx_signorini.accuracy.targets import Target, size
from dolfinx_signorini.accuracy.terms import (
    TERMS,
    Dual,
    Solved,
    Term,
    algebra,
    assembled,
    dual_solution,
    met,
    product,
    quadrature,
)
from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.meshes.elements import (
    coefficients_of,
    component_arrays,
    values_at_control_points,
)
from dolfinx_signorini.meshes.quadrature import FACET_RULE
from dolfinx_signorini.norms.pointwise import length
from dolfinx_signorini.norms.power_sums import joined, total

# Terms of the error of w, which no comparison shows.
UNSEEN: tuple[Term, ...] = (
    quadrature,
    data_between_nodes,
    data_defects,
    negative_pressure,
    forces_over_gaps,
    unknown_ends,
)


@dataclass(frozen=True)
class Indicators:
    """How far two solutions are apart, and where.

    For example:

        found = indicators(Solved(coarse, fine, refinement.parents, target("L4")))
        worst = found.cells.argmax()

    Attributes:
        difference: The norm of the difference, in the sup norm of values without known data; for a
            functional the sum of the sizes of what cells add to the functional of the difference.
        cells: For each owned cell of the coarse mesh what the cell adds to the difference; the
            power with which these numbers add up is that of the target.
        local: For each cell the part of `cells` that the solution alone tells: with a dual
            solution about the energy of w - I w, and else the whole.
        unseen: What the terms add to the error of w that no comparison shows.
        lost: How much order is lost, see `lost_order`; with the dual solution of a functional the
            mean of both solutions.
        left: What the derivatives of w tell of its error on the cell, see `Target.has_own`; 0 for
            other targets.
        signed: With a dual solution what each cell adds to J(w - u_h), with its sign; else 0.
        algebra: With a dual solution, what the iterations of the solve leave in the target; else 0.
    """

    difference: float
    cells: Array
    local: Array
    unseen: Array
    lost: Array
    left: Array
    signed: Array | float = 0.0
    algebra: float = 0.0


def indicators(solved: Solved) -> Indicators:
    """Compare a solution with the solution on the divided mesh; the call is collective.

    Args:
        solved: The two solutions.
    """
    fine, target, detail = solved.fine, solved.target, solved.detail
    norm, lost = target.norm, _lost(solved, fine.u, detail)
    left: Array = np.zeros(solved.count)
    if target.has_own:
        assert norm is not None
        parts = left_by_derivatives(detail, norm.derivatives, norm.p)
        left = solved.unit * solved.collected(parts)
    if target.weighted:
        apart = solved.distance
        load = _derivative(solved.error, target)
        dual = dual_solution(solved, load, None if norm is None else apart)
        terms = TERMS if norm is not None else (*TERMS, met)
        signed, cells = np.sum([term(solved, dual) for term in terms], axis=0)
        if norm is None:
            # Basis functions cancel inside of cells on all meshes, and cells each other by chance.
            apart = max(apart, total(np.abs(signed), 1.0, fine.comm))
            cells *= apart / (total(cells, 1.0, fine.comm) or 1.0)
            if not target.rough:
                lost = 0.5 * (lost + _lost(solved, dual.z, dual.detail))
        local = np.sqrt(solved.on_cells(product(solved.residual, detail))[1])
        iterated = abs(fine.comm.allreduce(float(algebra(solved, dual)[0].sum())))
        found = Indicators(apart, cells, local, _unseen(solved, dual), lost, left)
        return replace(found, signed=signed, algebra=iterated)
    assert norm is not None
    rest = _unseen(solved, None)
    if not math.isinf(norm.p):
        cells = solved.norms(solved.error)
        return Indicators(solved.distance, cells, cells, rest, lost, left)
    if norm.derivatives:
        cells = solved.norms(detail)
        return Indicators(solved.distance, cells, cells, rest, lost, left)
    # Data are known in values, and what data leave is added.
    error, cells = solved.beside_data(solved.error), solved.felt(solved.beside_data(detail))
    left *= over(cells, solved.collected(target.in_domain.on_cells(detail)))
    return Indicators(size(error, target), cells, cells, rest, lost, left)


def _unseen(solved: Solved, dual: Dual | None) -> Array:
    """What the terms of the error that no comparison shows add at most on each cell."""
    parts: Array = np.zeros(solved.count)
    for term in UNSEEN:
        parts = joined(parts, term(solved, dual)[1], solved.target.power)
    return np.asarray(solved.reach * parts)


def _lost(solved: Solved, f: fem.Function, detail: fem.Function) -> Array:
    return lost_order(f, detail, solved.coarse.u.function_space.mesh, solved.parents)


def _derivative(error: fem.Function, target: Target) -> fem.Function:
    """The load of the dual problem: the derivative of the norm at the error, up to a factor."""
    space, norm = error.function_space, target.norm
    v = ufl.TestFunction(space)
    if target.functional is not None:
        return assembled(target.functional(v), space)
    assert norm is not None
    if not norm.boundary:
        return powers_tested(error, norm.p)
    density = fem.Function(space)
    values = [values_at_control_points(space, part) for part in component_arrays(error)]
    sizes = np.abs(length(values))
    factors = (sizes / (highest(space.mesh.comm, sizes) or 1.0)) ** (norm.p - 1.0)
    for part, each in zip(component_arrays(density), values, strict=True):
        part[:] = coefficients_of(space, factors * over(each, sizes))
    return assembled(ufl.inner(density, v) * ufl.ds(metadata=FACET_RULE.metadata), space)
