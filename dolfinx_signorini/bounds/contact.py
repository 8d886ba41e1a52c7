"""Contact in cells: how cells touch obstacles, which obstacle presses on each, and its gap."""

import math

import numpy as np

from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices, Mask, blocks
from dolfinx_signorini.base.ranks import marked
from dolfinx_signorini.bounds.better_fluxes import RAISED
from dolfinx_signorini.bounds.boundary_facets import weightless
from dolfinx_signorini.bounds.cell_values import BEST, SAMPLED
from dolfinx_signorini.bounds.condensation import CLOSED
from dolfinx_signorini.bounds.feasible import Feasible, feasible, in_cells, sides_of
from dolfinx_signorini.bounds.remainders import Solved
from dolfinx_signorini.bounds.strong_form import polynomial_degree
from dolfinx_signorini.meshes.quadrature import rule
from dolfinx_signorini.problem.assembly import dofs_on_entities
from dolfinx_signorini.problem.values import datum


def contact_of(solved: Solved, kinds: Indices) -> tuple[Feasible, Indices, Array]:
    """Return what makes a solution feasible, and where obstacles in the domain press.

    Args:
        solved: The problem; the call is collective.
        kinds: The kinds of the facets of the cells.

    Returns:
        What makes the solution feasible, and sides and rises of the cells as in `CellData`, the
        latter up to the degree of better fluxes.
    """
    frames = solved.frames
    number: Indices = np.full(len(kinds), -1)
    if solved.problem.in_domain:
        touching, whole = _cells(solved)
        partly = np.asarray((touching > 0).any(axis=0) & ~whole.any(axis=0))
        parts: list[LocalIndices] = [frames.cells[each].astype(np.int32) for each in whole]
        number = np.where((touching > 0).any(axis=0), touching.argmax(axis=0), -1)
    else:
        partly = np.zeros(len(kinds), dtype=bool)
        parts = [frames.local_facets[kinds == CLOSED].astype(np.int32)]
    near = feasible(solved, kinds, parts, partly)
    pressed = np.array([*(side.side for side in sides_of(solved)), 0.0])[number].astype(np.int64)
    return near, pressed, _rises(solved, near, number)


def _cells(solved: Solved) -> tuple[Indices, Mask]:
    """The number of dofs of owned cells that touch each obstacle and may have a force, and which
    cells touch the obstacle all over, both with the shape (sides, cells)."""
    problem, cells, tiny = solved.problem, solved.frames.cells, solved.tiny
    space, u = problem.space, np.asarray(problem.sign * problem.u.x.array, dtype=np.float64)
    owned = dofs_on_entities(space, solved.dimension, problem.contact)
    with_obstacle = np.isin(cells, problem.contact)[:, None]
    dofs = space.dofmap.list[cells]
    free, light = ~marked(space, problem.fixed_dofs)[dofs], weightless(space, solved.dimension)
    touching, closed = [], []
    for side in sides_of(solved):
        gap = side.side * (u - side.on(space, owned))
        touches = (gap <= tiny)[dofs] & with_obstacle
        touching.append((touches & free & ~light).sum(axis=1))
        closed.append((touches | (free & light)).all(axis=1) & (touching[-1] > 0))
    return np.array(touching), np.array(closed)


def _rises(solved: Solved, near: Feasible, number: Indices) -> Array:
    """The means over cells of v - g, or more, times polynomial; 0 where nothing presses.

    Args:
        solved: The problem; the call is collective.
        near: What makes the solution feasible.
        number: The number of the obstacle that presses on each cell, or -1.
    """
    d, change = solved.dimension, near.change
    degree = solved.degree + RAISED[d]
    result = np.zeros((len(number), math.comb(degree + d, d)))
    if not solved.problem.in_domain:
        return result
    order, told = change.function_space.element.basix_element.degree, in_cells(solved)
    degrees = [polynomial_degree(data) for data, _ in told]
    order = max(order, *(n or 0 for n in degrees)) + SAMPLED[d] * (None in degrees)
    points, weights = rule(d, min(degree + order, BEST[d]))
    for k, (side, (data, apart)) in enumerate(zip(sides_of(solved), told, strict=True)):
        obstacle, cells = datum(solved.frames.domain, data), np.flatnonzero(number == k)
        for some in (cells[part] for part in blocks(len(cells), len(weights), solved.comm)):
            frames = solved.frames.some(some)
            at = frames.points(points)
            v = solved.problem.sign * at.values(solved.problem.u)[0] + at.values(change)[0]
            gap = side.side * (v - side.sign * obstacle(at)) + apart[some, None]
            gap = np.maximum(gap, 0.0)
            result[some] = side.side * frames.moments(gap, points, weights, degree)
    return result
