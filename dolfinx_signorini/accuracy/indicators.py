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
from dataclasses import dataclass

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
from dolfinx_signorini.accuracy.derivatives import highest_derivatives, left_by_derivatives
from dolfinx_signorini.accuracy.negative_pressure import negative_pressure
from dolfinx_signorini.accuracy.targets import Target
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
from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.meshes.elements import (
    coefficients_of,
    component_arrays,
    values_at_control_points,
)
from dolfinx_signorini.meshes.quadrature import FACET_RULE
from dolfinx_signorini.norms.pointwise import length
from dolfinx_signorini.norms.power_sums import collected, joined, total

AWAY = 2.0  # sizes of a cell: so near are singular points to cells that do not resolve them
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
        difference: The norm of the difference, without the share of `known`; for a functional the
            sum of the sizes of what cells add to the functional of the difference.
        cells: For each owned cell of the coarse mesh what the cell adds to the difference; the
            power with which these numbers add up is that of the target.
        known: With a dual solution of a norm, what each cell adds at dofs where both solutions meet
            known data, see `terms.met`; else 0.
        local: For each cell the part of `cells` that the solution alone tells: with a dual
            solution about the energy of w - I w, and else the whole.
        moved: In sup norms the larger one of `cells` and the norm of w - u_h on the cell; otherwise
            `cells`.
        left: In sup norms what the derivatives of w tell of its error on the cell; otherwise 0.
        unseen: What the terms add to the error of w that no comparison shows.
        algebra: With a dual solution, what the iterations of the solve leave in the target; else 0.
        resolved: Whether the solutions are smooth in the cell, as far as their derivatives tell.
        signed: With a dual solution what each cell adds to J(w - u_h), with its sign; else 0.
    """

    difference: float
    cells: Array
    known: Array
    local: Array
    moved: Array
    left: Array
    unseen: Array
    algebra: float
    resolved: Mask
    signed: Array


def indicators(solved: Solved) -> Indicators:
    """Compare a solution with the solution on the divided mesh; the call is collective.

    Args:
        solved: The two solutions.
    """
    fine, parents, target, count = solved.fine, solved.parents, solved.target, solved.count
    zero, norm, resolved = np.zeros(count), target.norm, _resolved(solved, fine.u, solved.detail)
    if target.weighted:
        apart = solved.distance
        load = _derivative(solved.error, target)
        dual = dual_solution(solved, load, None if norm is None else apart)
        terms = TERMS if norm is not None else (*TERMS, met)
        signed, cells = np.sum([term(solved, dual) for term in terms], axis=0)
        known = zero
        if norm is not None:
            known = met(solved, dual)[1]
            both = total(cells + known, 1.0, fine.comm)
            apart *= total(cells, 1.0, fine.comm) / (both or 1.0)
        else:
            # Basis functions cancel inside of cells on all meshes, and cells each other by chance.
            apart = max(apart, total(np.abs(signed), 1.0, fine.comm))
            cells *= apart / (total(cells, 1.0, fine.comm) or 1.0)
            if not target.rough:
                resolved &= _resolved(solved, dual.z, dual.detail)
        local = np.sqrt(solved.on_cells(product(solved.residual, solved.detail))[1])
        rest, left = _unseen(solved, dual), algebra(solved, dual)[0].sum()
        iterated = abs(fine.comm.allreduce(float(left)))
        return Indicators(apart, cells, known, local, cells, zero, rest, iterated, resolved, signed)
    assert norm is not None
    rest = _unseen(solved, None)
    moved, detail = solved.norms(solved.error), solved.detail
    apart = total(moved, norm.p, fine.comm)
    if not math.isinf(norm.p):
        return Indicators(apart, moved, zero, moved, moved, zero, rest, 0.0, resolved, zero)
    cells = solved.norms(detail)
    left = solved.unit * left_by_derivatives(detail, norm.derivatives)
    left = collected(left, parents, count, norm.p)
    if target.on_boundary:  # so much as is there of the detail
        left *= over(cells, collected(target.on_cells(detail), parents, count, norm.p))
    moved = np.maximum(cells, moved)
    return Indicators(apart, cells, zero, cells, moved, left, rest, 0.0, resolved, zero)


def _unseen(solved: Solved, dual: Dual | None) -> Array:
    """What the terms of the error that no comparison shows add at most on each cell."""
    parts: Array = np.zeros(solved.count)
    for term in UNSEEN:
        parts = joined(parts, term(solved, dual)[1], solved.target.power)
    return parts


def _resolved(solved: Solved, f: fem.Function, detail: fem.Function) -> Mask:
    """Tell in which cells the highest derivatives of a function hardly change.

    At the distance m h from a singular point, h the size of the cell, the derivatives of the degree
    k and the next one have about the ratio k / (m h), and those of degree k change by a third of
    this, times h, from a part of the cell to the whole. At the point itself both are of one size.
    The dual solution of a norm changes from cell to cell, as the error does.

    Args:
        solved: The two solutions.
        f: A function on the divided mesh.
        detail: What f has beyond its interpolation on the undivided mesh.
    """
    result = np.ones(solved.count, dtype=bool)
    near = solved.fine.space.element.basix_element.degree / (3.0 * AWAY)
    sizes, changes = (highest_derivatives(part, 0.0) for part in (f, detail))
    result[solved.parents[changes > near * sizes]] = False
    return result


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
