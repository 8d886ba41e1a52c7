"""A feasible function near a solution, for obstacles on the boundary and in the domain; its gap.

The discrete solution is feasible at its nodes. Where that is not enough, the feasible function is a
polynomial of higher degree on each cell: its Bernstein coefficients are raised to those of a lower
obstacle, and lowered to those of an upper one. On facets and in cells that touch all over the
function is the obstacle, and on Dirichlet facets it has the data. What the polynomials miss of
formulas comes on top: on facets in the plane by extensions, see `lifted_energy`, and else by hat
functions that move the function until no obstacle is beyond it.
"""

from dataclasses import dataclass, replace

import basix
import numpy as np
from dolfinx import fem
from ufl.algorithms.analysis import extract_coefficients
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices, Mask
from dolfinx_signorini.base.ranks import anywhere, function_with, highest, largest, marked
from dolfinx_signorini.base.tolerances import ROUNDING, SOLVED
from dolfinx_signorini.bounds.boundary_facets import FacetPoints, facet_points
from dolfinx_signorini.bounds.condensation import DIRICHLET, OPEN
from dolfinx_signorini.bounds.cones import Cones, cones_on, fitted, lattice
from dolfinx_signorini.bounds.frames import Frames, cells_around, on_frames
from dolfinx_signorini.bounds.nearer import nearer
from dolfinx_signorini.bounds.remainders import IN_CELLS, MORE, Solved
from dolfinx_signorini.bounds.strong_form import polynomial_degree
from dolfinx_signorini.meshes.elements import is_bernstein, lagrange_space
from dolfinx_signorini.meshes.polynomials import lowest, others
from dolfinx_signorini.meshes.quadrature import rule
from dolfinx_signorini.problem.assembly import dofs_on_entities, dofs_on_facets
from dolfinx_signorini.problem.values import Data, datum, evaluator

OBSTACLE = "the obstacle is known at points of {} only"
BEYOND = "an obstacle may be beyond Dirichlet data, or beyond the other obstacle, between nodes"
DATA = "Dirichlet data are known at points of facets only"
LOOSE = "Dirichlet data or the obstacle are not those of the problem at a vertex"


@dataclass(frozen=True)
class Side:
    """An obstacle, with the signs of a lower obstacle where the only obstacle is an upper one:

    gap = side.side * (u - side.on(space, dofs))
    """

    side: float  # 1 for a lower obstacle, -1 for an upper one
    data: Data
    sign: float  # times the data

    def on(self, space: fem.FunctionSpace, dofs: LocalIndices) -> Array:
        """Return the coefficients of the obstacle at all dofs of this rank, from owned dofs."""
        return self.sign * _coefficients(space, self.data, dofs)


@dataclass(frozen=True)
class Feasible:
    """What is to be added to a solution for a feasible function, with signs of a lower obstacle.

    Where nothing is missing, u plus the change is feasible, but for the cones in the plane:

        near = feasible(solved, kinds, closed, partly)
        v = problem.sign * problem.u.x.array + near.change.x.array

    Attributes:
        change: A function.
        cones: What comes on top in the plane; None for nothing.
        gap: On contact facets in the plane polynomials whose positive parts are the gap, in terms
            of `FacetPoints.polynomials`, and what they miss; None where u plus the change has the
            gap.
        missing: Why no feasible function is found; "" if one is found.
        notes: What is known at points only.
    """

    change: fem.Function
    cones: Cones | None = None
    gap: tuple[Array, Array] | None = None
    missing: str = ""
    notes: tuple[str, ...] = ()

    @property
    def target(self) -> fem.Function | None:
        """The change, or None for nothing; collective."""
        comm = self.change.function_space.mesh.comm
        return self.change if highest(comm, np.abs(self.change.x.array)) > 0.0 else None


def sides_of(solved: Solved) -> list[Side]:
    """Return the obstacles of a problem."""
    sign = solved.problem.sign
    return [Side(sign * each.sign, each.data, sign) for each in solved.problem.obstacles]


def known(data: Data | None, degree: int) -> bool:
    """Return whether data are polynomials of a degree on each cell, and continuous."""
    found = polynomial_degree(data)
    if found is None or found > degree:
        return False
    if isinstance(data, fem.Function):
        element = data.function_space.element.basix_element
        return bool(element.family == basix.ElementFamily.P and not element.discontinuous)
    return not (isinstance(data, Expr) and extract_coefficients(data))


def feasible(solved: Solved, kinds: Indices, closed: list[LocalIndices], partly: Mask) -> Feasible:
    """Return what makes a solution feasible.

    Args:
        solved: The problem; the call is collective.
        kinds: The kinds of the facets of the cells.
        closed: For each obstacle the facets or cells of this rank that touch all over.
        partly: The cells of this rank that touch an obstacle in the domain in part.
    """
    degree, d, in_cells = solved.degree, solved.dimension, solved.problem.in_domain
    if d == 2 and not in_cells:
        return _on_facets(solved, kinds)
    given = [side.data for side in sides_of(solved)] + [data for data, _ in solved.terms.dirichlet]
    if all(known(data, degree) for data in given):
        near = _feasible(solved, closed, partly, degree)
        size = highest(solved.comm, np.abs(near.change.x.array))
        if size <= solved.tiny:
            near.change.x.array[:] = 0.0
            return near
        if not in_cells:
            return near
    more = IN_CELLS if in_cells else MORE
    near = _feasible(solved, closed, partly, degree + more[d])
    if in_cells:
        return _moved(solved, replace(near, cones=_beside_data(solved)))
    return near if solved.rest.obstacle_in_space is None else _raised(solved, kinds, near)


def in_cells(solved: Solved) -> list[tuple[Data, Array]]:
    """Return what stands for each obstacle in the domain, and how far apart both may be on cells.

    What Dirichlet data have beside polynomials, with its extensions, counts as apart, too: so much
    may the feasible function be off its own polynomials.
    """
    rest, sides = solved.rest, sides_of(solved)
    cones = np.zeros(len(solved.frames.order))
    if rest.dirichlet is not None:
        cones += rest.dirichlet[0].sum(axis=1)
    told = rest.obstacles_in_cells or [None] * len(sides)
    pairs = zip(sides, told, strict=True)
    return [(side.data, cones) if t is None else (t[0], t[1] + cones) for side, t in pairs]


def _feasible(solved: Solved, closed: list[LocalIndices], partly: Mask, degree: int) -> Feasible:
    """What makes a solution feasible, of a degree."""
    problem, frames = solved.problem, solved.frames
    space, sides, tiny = problem.space, sides_of(solved), solved.tiny
    dim = solved.dimension - (not problem.in_domain)
    if degree > max(1, solved.degree) or not (degree == 1 or is_bernstein(space)):
        space = lagrange_space(space.mesh, degree, basix.LagrangeVariant.bernstein)
    u = fem.Function(space)
    u.interpolate(problem.u)
    u.x.array[:] *= problem.sign
    owned = dofs_on_entities(space, dim, problem.contact)
    here = marked(space, owned)
    obstacles = [side.on(space, owned) for side in sides]
    limits = [np.full(len(here), np.inf) * sign for sign in (-1.0, 1.0)]
    for side, g in zip(sides, obstacles, strict=True):
        limits[int(side.side < 0.0)] = np.where(here, g, -side.side * np.inf)
    # Interpolants of obstacles with kinks may cross where the obstacles meet.
    limits = [func(*limits) for func in (np.minimum, np.maximum)]
    around = cells_around(solved.comm, frames.vertices, partly[:, None])
    cells = np.flatnonzero(around & (degree > solved.degree))
    v, changed = nearer(solved, space, cells, u.x.array, (limits[0], limits[1]))
    v = np.clip(v, *limits)
    for g, entities in zip(obstacles, closed, strict=True):
        touching = marked(space, dofs_on_entities(space, dim, entities))
        v = np.where(touching & ~changed, g, v)
    met, given, loose = here.copy(), np.zeros_like(here), False
    for data, facets in solved.terms.dirichlet:
        dofs, fixed = dofs_on_facets(space, facets), u.x.array
        if data is not None:
            fixed = problem.sign * _coefficients(space, data, dofs)
        at = marked(space, dofs)
        loose |= bool((np.abs(v - fixed)[at & given] > tiny).any())
        v, met, given = np.where(at, fixed, v), met | at, given | at
    beyond = [side.side * (g - v)[here] for side, g in zip(sides, obstacles, strict=True)]
    held = highest(solved.comm, np.array(beyond)) > tiny
    change = fem.Function(space)
    change.x.array[:] = v - u.x.array
    if is_bernstein(space) and not problem.in_domain:
        # Zero at all other nodes: where the reaction is strong, nearer than by other coefficients.
        nodal = fem.Function(lagrange_space(space.mesh, degree, basix.LagrangeVariant.gll_warped))
        nodal.interpolate(change)
        nodal.x.array[~met] = 0.0
        change = nodal
    loose = anywhere(solved.comm, loose)
    return Feasible(
        change, missing=LOOSE * loose, notes=_unknown(solved, degree) + (BEYOND,) * held
    )


def _moved(solved: Solved, near: Feasible) -> Feasible:
    """Move a function in cells by hat functions until no obstacle is beyond it."""
    change, rest = near.change, in_cells(solved)
    if highest(solved.comm, np.array([apart for _, apart in rest])) == 0.0:
        return near
    rows = np.flatnonzero(np.isin(solved.frames.cells, solved.problem.contact))
    frames = solved.frames.some(rows)
    lacks, more = _lacks(solved, change), fem.Function(change.function_space)
    for side, lack in zip(sides_of(solved), lacks, strict=True):
        hats = _hats(frames, frames.order, lack)
        for _, facets in solved.terms.dirichlet:
            fixed = dofs_on_facets(hats.function_space, facets)
            hats.x.array[marked(hats.function_space, fixed)] = 0.0
        more.interpolate(hats)
        change.x.array[:] += side.side * more.x.array
    tiny = solved.tiny + ROUNDING * highest(solved.comm, np.array(lacks))
    held = highest(solved.comm, np.array(_lacks(solved, change))) > tiny
    return replace(near, notes=tuple(dict.fromkeys((*near.notes, *(BEYOND,) * held))))


def _lacks(solved: Solved, change: fem.Function) -> list[Array]:
    """How far obstacles may be beyond a function, on each cell of this rank that has obstacles.

    The interpolant stands for an obstacle that is known at points only, and is not beyond.
    """
    problem, d, result = solved.problem, solved.dimension, []
    rows = np.flatnonzero(np.isin(solved.frames.cells, problem.contact))
    frames = solved.frames.some(rows)
    for side, (data, apart) in zip(sides_of(solved), in_cells(solved), strict=True):
        known_degree = polynomial_degree(data)
        if known_degree is None:
            result.append(apart[rows])
            continue
        obstacle = datum(frames.domain, data)
        order = max(change.function_space.element.basix_element.degree, known_degree)
        points, weights = rule(d, 2 * order)
        at = frames.points(points)
        v = problem.sign * at.values(problem.u)[0] + at.values(change)[0]
        gap = frames.moments(side.side * (v - side.sign * obstacle(at)), points, weights, order)
        result.append(np.maximum(apart[rows] - lowest(d, order, gap), 0.0))
    return result


def _beside_data(solved: Solved) -> Cones | None:
    """What Dirichlet data in the plane have beside the polynomials of a feasible function."""
    missed = solved.rest.dirichlet
    if missed is None:
        return None
    cells, facets = np.nonzero(missed[0])
    nothing, any_sign = np.zeros((len(cells), 2)), np.zeros(len(cells), dtype=bool)
    rest = missed[:, cells, facets]
    return Cones(solved.frames, cells, facets, nothing, rest, any_sign, 0.0)


def _hats(frames: Frames, vertices: Indices, heights: Array) -> fem.Function:
    """The sum of hat functions that has at least some heights at vertices of cells.

    Args:
        frames: The cells; the call is collective.
        vertices: Local vertices of each cell in the mesh, shape (cells, vertices).
        heights: For each cell.
    """
    hats = fem.Function(fem.functionspace(frames.domain, ("Lagrange", 1)))
    space = hats.function_space
    dofs = np.take_along_axis(space.dofmap.list[frames.cells], vertices, axis=1)
    heights = np.broadcast_to(heights[:, None], dofs.shape)
    hats.x.array[:] = largest(space.dofmap.index_map, dofs, heights)
    return hats


def _unknown(solved: Solved, degree: int) -> tuple[str, ...]:
    """Which data are no polynomials of a degree, and known at points only."""
    rest, sides = solved.rest, sides_of(solved)
    told = [rest.obstacle is not None or rest.obstacle_in_space is not None] * len(sides)
    if rest.obstacles_in_cells:
        told = [each is not None for each in rest.obstacles_in_cells]
    unknown = not all(t or known(side.data, degree) for t, side in zip(told, sides, strict=True))
    unmet = not all(known(value, degree) for value, _ in solved.terms.dirichlet)
    where = "cells" if solved.problem.in_domain else "facets"
    found = (OBSTACLE.format(where),) * unknown
    return found + (DATA,) * (unmet and rest.dirichlet is None)


def _coefficients(space: fem.FunctionSpace, data: Data, dofs: LocalIndices) -> Array:
    """The coefficients of the interpolant of data at Gauss-Lobatto points, from owned dofs."""
    bernstein = is_bernstein(space)
    degree, variant = space.element.basix_element.degree, basix.LagrangeVariant.gll_warped
    nodal = lagrange_space(space.mesh, degree, variant) if bernstein else space
    g = function_with(nodal, dofs, evaluator(nodal, data, dofs)())
    if not bernstein:
        return np.asarray(g.x.array)
    result = fem.Function(space)
    result.interpolate(g)
    return np.asarray(result.x.array)


def _on_facets(solved: Solved, kinds: Indices) -> Feasible:
    """What makes a solution feasible on the boundary in the plane."""
    problem, frames, rest, comm = solved.problem, solved.frames, solved.rest, solved.comm
    order, tiny, contact = solved.degree + MORE[2], solved.tiny, kinds >= OPEN
    marks = [(data, on_frames(frames, [at]), rest.dirichlet) for data, at in solved.terms.dirichlet]
    marks = [each for each in marks if each[0] is not None]
    parts, loose, far = [], False, False
    for data, marked_facets, missed in [*marks, (problem.obstacle_data, contact, rest.obstacle)]:
        points = lattice(frames, marked_facets, order)
        lack = problem.sign * (points.values(data) - points.points.values(problem.u)[0])
        parts.append((points, fitted(points, lack, order), missed))
        on_contact = marked_facets is contact
        lack = np.maximum(lack, 0.0) if on_contact else np.abs(lack)
        ends = np.abs(points.reference[:, 0] - 0.5) > 0.5 - SOLVED
        loose |= bool((lack[:, ends] > tiny).any())
        far |= bool((lack > tiny).any()) and not on_contact
    series = parts[-1][1]
    far |= bool((lowest(1, order, -series) < -tiny).any())
    far, loose = (anywhere(comm, each) for each in (far, loose))
    change, notes = fem.Function(problem.space), _unknown(solved, order)
    if known(problem.obstacle_data, solved.degree) and not far and rest.dirichlet is None:
        return Feasible(change, notes=notes)
    unseen = np.zeros(len(series)) if rest.obstacle is None else rest.obstacle[0][contact]
    cones = cones_on(frames, parts, kinds, tiny)
    return Feasible(change, cones, (-series, unseen), LOOSE * loose, notes)


def _raised(solved: Solved, kinds: Indices, near: Feasible) -> Feasible:
    """Raise a function in space by hat functions until nothing is below the obstacle."""
    assert solved.rest.obstacle_in_space is not None
    frames, change = solved.frames, near.change
    obstacle, missed = solved.rest.obstacle_in_space
    order = max(change.function_space.element.basix_element.degree, obstacle.degree)
    points = facet_points(frames, kinds >= OPEN, 2 * order)
    p = points.polynomials(order)
    gap = above(solved, near, points)
    low = lowest(2, order, np.einsum("q,nq,njq->nj", points.weights, gap, p))
    lack = np.maximum(missed[kinds >= OPEN] - low, 0.0)
    local = np.take_along_axis(points.owners.order, others(3)[points.facets], axis=1)
    hats = _hats(points.owners, local, lack)
    sides = frames.local_facets[kinds == DIRICHLET].astype(np.int32)
    fixed = hats.x.array[dofs_on_facets(hats.function_space, sides)]
    if anywhere(solved.comm, fixed > 0.0):
        return Feasible(change, notes=(OBSTACLE.format("facets"), *near.notes))
    more = fem.Function(change.function_space)
    more.interpolate(hats)
    change.x.array[:] += more.x.array
    return near


def above(solved: Solved, near: Feasible, points: FacetPoints) -> Array:
    """Return a feasible function minus the obstacle, or minus polynomials for it, at points.

    Args:
        solved: The problem.
        near: What makes the solution feasible.
        points: Points of contact facets.
    """
    problem, told = solved.problem, solved.rest.obstacle_in_space
    v = problem.sign * points.points.values(problem.u)[0] + points.points.values(near.change)[0]
    return v - problem.sign * points.values(problem.obstacle_data if told is None else told[0])
