"""Indicators: which cells the error of a solution comes from.

A solution u_h is compared with the solution w on the mesh with every cell divided. The difference
w - u_h estimates the error of u_h, and w is the better solution. Three kinds of indicators tell
where the difference comes from:

    W^{1,p}      the norm of w - u_h on each cell;
    L^inf        the largest w - I w on each cell, where I interpolates on the undivided mesh;
    otherwise    |w - I w|_a |z - I z|_a on each cell, where the dual solution z tells how much an
                 error at one place matters for the norm of the whole error, and what dofs add that
                 are in contact in u_h or in w alone.

Source: Becker and Rannacher, An optimal control approach to a posteriori error estimation in finite
element methods, Acta Numerica 10 (2001) 1-102.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_signorini.accuracy.cells import cell_norms, collected, total
from dolfinx_signorini.accuracy.contact_changes import contact_changes
from dolfinx_signorini.accuracy.derivatives import left_by_derivatives
from dolfinx_signorini.accuracy.negative_pressure import negative_pressure
from dolfinx_signorini.accuracy.targets import Target
from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.meshes.elements import coefficients_of, constants, values_at_control_points
from dolfinx_signorini.meshes.quadrature import FACET_RULE, QuadratureRule
from dolfinx_signorini.meshes.refinement import Transfer
from dolfinx_signorini.meshes.sided_meshes import owned_cells
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.problem.signorini import SignoriniProblem

HIGHEST_POWER = 1000.0  # of an error in a load: larger ones are loads at a point as well


@dataclass(frozen=True)
class Solution:
    """What is kept of the solution on the undivided mesh:

        coarse = Solution(problem.u, problem.forces)

    Attributes:
        u: The solution.
        forces: The contact forces on the dofs.
    """

    u: fem.Function
    forces: fem.Function


@dataclass(frozen=True)
class Indicators:
    """How far two solutions are apart, and where.

    For example:

        found = indicators(coarse, fine, refinement.parents, target("L4"))
        worst = found.cells.argmax()

    Attributes:
        difference: The norm of the difference, or the size of the functional of the difference.
        cells: For each owned cell of the coarse mesh what the cell adds to the difference; the
            power with which these numbers add up is that of the target.
        local: For each cell the part of this number that the solution alone tells: with a dual
            solution |w - I w|_a, which adds up in squares, and else the whole.
        moved: In sup norms the larger one of `cells` and the norm of w - u_h on the cell; otherwise
            `cells`.
        left: In sup norms what the derivatives of w tell of its error on the cell; otherwise 0.
        gaps: In norms of the domain what gaps inside facets in contact add, which w does not see.
    """

    difference: float
    cells: Array
    local: Array
    moved: Array
    left: Array
    gaps: Array


def indicators(
    coarse: Solution, fine: SignoriniProblem, parents: LocalIndices, target: Target
) -> Indicators:
    """Compare a solution with the solution on the divided mesh; the call is collective.

    Args:
        coarse: The solution on the coarse mesh.
        fine: The solved problem on the mesh with every cell divided.
        parents: For each owned cell of this mesh the coarse cell around the cell.
        target: What is to be accurate.
    """
    space = coarse.u.function_space
    transfer = Transfer(space, fine.space, parents)
    error = difference(fine.u, transfer.prolong(coarse.u))
    count = len(owned_cells(space.mesh))
    norm, zero = target.norm, np.zeros(count)
    gaps: Array = zero
    if norm is not None and not norm.boundary:
        gaps = collected(negative_pressure(fine, transfer, norm), parents, count, norm.p)
    if target.weighted:
        apart = size(error, target)
        dual, forces = fine.solve_linearised(_density(error, target, apart))
        details = [_detail(transfer, v) for v in (fine.u, dual)]
        primal, weight = (np.sqrt(found) for found in _energies(fine, details, parents, count))
        released = coarse.forces, transfer.restrict(dual)
        changes = contact_changes(released, (forces, error), parents)
        cells = primal * weight + changes
        return Indicators(apart, cells, primal, cells, zero, gaps)
    assert norm is not None
    norms = cell_norms(error, norm)
    apart, moved = total(norms, norm.p, space.mesh.comm), collected(norms, parents, count, norm.p)
    if not math.isinf(norm.p):
        return Indicators(apart, moved, moved, moved, zero, gaps)
    detail = _detail(transfer, fine.u)
    cells, left = (
        collected(values, parents, count, norm.p)
        for values in (cell_norms(detail, norm), left_by_derivatives(detail, norm.derivatives))
    )
    return Indicators(apart, cells, cells, np.maximum(cells, moved), left, gaps)


def difference(one: fem.Function, other: fem.Function) -> fem.Function:
    """Return the difference of two functions of a space."""
    result = fem.Function(one.function_space)
    result.x.array[:] = one.x.array - other.x.array
    return result


def _detail(transfer: Transfer, f: fem.Function) -> fem.Function:
    """What a fine function has beyond its interpolation on the coarse mesh."""
    return difference(f, transfer.prolong(transfer.restrict(f)))


def size(error: fem.Function, target: Target) -> float:
    """Return the norm of a function, or the size of the functional; the call is collective."""
    comm, norm = error.function_space.mesh.comm, target.norm
    if norm is None:
        assert target.functional is not None
        form = compiled.form(target.functional(error))
        return abs(float(comm.allreduce(fem.assemble_scalar(form))))
    if norm.boundary:
        return error_norms(error, None, [target.name])[target.name]
    return total(cell_norms(error, norm), norm.p, comm)


def _density(error: fem.Function, target: Target, apart: float) -> ufl.Form:
    """The load of the dual problem: the derivative of the norm at the error."""
    space = error.function_space
    v = ufl.TestFunction(space)
    if target.functional is not None:
        return target.functional(v)
    assert target.norm is not None
    p = 2.0 if math.isinf(target.norm.p) else min(target.norm.p, HIGHEST_POWER)
    largest = highest(space.mesh.comm, np.abs(error.x.array))
    density = fem.Function(space)
    if apart > 0.0 and largest > 0.0:
        share = values_at_control_points(space, error.x.array) / largest
        powers = np.abs(share) ** (p - 1.0) * np.sign(share) * (largest / apart) ** (p - 1.0)
        density.x.array[:] = coefficients_of(space, powers)
    if target.norm.boundary:
        return density * v * ufl.ds(metadata=FACET_RULE.metadata)
    rule = QuadratureRule("default", 2 * space.element.basix_element.degree)
    return density * v * ufl.dx(metadata=rule.metadata)


def _energies(
    problem: SignoriniProblem, functions: Sequence[fem.Function], parents: LocalIndices, count: int
) -> Iterator[Array]:
    """The energy a(f, f) of each coarse cell, without the terms on the boundary."""
    trial, test = problem.a.arguments()[::-1]
    f, constant = fem.Function(problem.space), ufl.TestFunction(constants(problem.space.mesh))
    terms = [
        part.reconstruct(ufl.replace(part.integrand(), {trial: f, test: f}) * constant)
        for part in problem.a.integrals_by_type("cell")
    ]
    form = compiled.form(ufl.Form(terms))
    for function in functions:
        f.x.array[:] = function.x.array
        energies = fem.assemble_vector(form).array[: len(parents)]
        yield collected(np.maximum(energies, 0.0), parents, count, 1.0)
