"""Defects on the boundary: the distance of a solution from its data between the nodes of the mesh.

A solution meets the obstacle and Dirichlet data at nodes. Where an obstacle has a kink or a pin
between the nodes, or Dirichlet data are like a root there, no comparison of discrete solutions
shows the error, but the data themselves do: the trace of the error is at least what the solution
lies below the obstacle, the distance to the obstacle on facets in contact, and the distance to
Dirichlet data. In a norm of the boundary such a distance is the error itself. From the facet the
error reaches about half as far into the domain as the facet is long; the mean of the distance to
Dirichlet data reaches as far as a dual solution tells.
"""

import math
from collections.abc import Iterator
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_signorini.accuracy.cells import cell_norms, collected, joined
from dolfinx_signorini.accuracy.contact_ends import SAMPLES, contact_on_entities, facet_lattice
from dolfinx_signorini.accuracy.terms import Dual, Solved
from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.ranks import summed
from dolfinx_signorini.meshes.elements import facet_dofs
from dolfinx_signorini.meshes.points import FormulaAtPoints, Points
from dolfinx_signorini.meshes.sided_meshes import (
    boundary_facets,
    facet_cells,
    facet_scale,
    owned_cells,
)
from dolfinx_signorini.norms.names import Norm
from dolfinx_signorini.problem.assembly import dofs_on_entities
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.problem.constraint import Obstacle
from dolfinx_signorini.problem.dirichlet import data_of_condition
from dolfinx_signorini.problem.values import Data, called, evaluator
from dolfinx_signorini.solvers.result import SolveResult

# For each problem the last result, and how far the solution is from its Dirichlet data.
_off: WeakKeyDictionary[
    BoundConstrainedProblem, tuple[SolveResult | None, list[tuple[LocalIndices, Array]]]
] = WeakKeyDictionary()


def obstacle_defects(solved: Solved, dual: Dual | None) -> Array:
    """Return what the distance to the obstacles adds to the error on each cell, see `terms.Term`.

    The parts are zero for functionals, and for derivatives on facets in space, where differences
    along a facet are not formed.
    """
    problem, norm = solved.fine, solved.target.norm
    parts: Array = np.zeros(len(solved.parents))
    if norm is None or (norm.boundary and problem.in_domain):
        return np.zeros((2, solved.count))
    for side, obstacle in enumerate(problem.obstacles):
        entities, _, touching = contact_on_entities(problem, side)
        if isinstance(obstacle.data, int | float | np.number):
            continue  # a constant is met everywhere, and nodes show what is beyond
        if problem.in_domain:
            off = _off_in_cells(problem, obstacle, touching)
            parts = joined(parts, cell_norms(off, norm), norm.p)
            continue
        points = Points(problem.space.mesh, entities, facet_lattice(problem.space))
        u, lengths = problem.towards_obstacle()
        bound = _values(obstacle.data, points, {})
        if lengths is not None:
            bound = bound / points.values(lengths)[0]
        gap = obstacle.sign * (points.values(u)[0] - bound)
        held = touching.all(axis=1).reshape(-1, 1)
        off_facets = np.where(held, gap, np.minimum(gap, 0.0))
        parts = joined(parts, _defects(problem, entities, off_facets, norm), norm.p)
    return solved.in_norm(solved.unit * parts)


def _off_in_cells(
    problem: BoundConstrainedProblem, obstacle: Obstacle, touching: npt.NDArray[np.bool_]
) -> fem.Function:
    """The distance to an obstacle in cells in contact, and what lies beyond it in all cells.

    The obstacle is interpolated by elements of the next degree.
    """
    space = problem.space
    finer = fem.functionspace(space.mesh, ("Lagrange", space.element.basix_element.degree + 1))
    off, u = fem.Function(finer, name="off"), fem.Function(finer)
    u.interpolate(problem.u)
    layout = problem.system.layout
    dofs = dofs_on_entities(finer, layout.dim, layout.entities)
    gap = obstacle.sign * (u.x.array[dofs] - evaluator(finer, obstacle.data, dofs)())
    held = np.zeros(len(off.x.array), dtype=bool)
    held[finer.dofmap.list[layout.owned_entities[touching.all(axis=1)]]] = True
    off.x.array[dofs] = np.where(held[dofs], gap, np.minimum(gap, 0.0))
    off.x.scatter_forward()
    return off


def dirichlet_defects(solved: Solved, dual: Dual | None) -> Array:
    """Return what the distance to Dirichlet data adds to the error, see `obstacle_defects`."""
    problem, norm = solved.fine, solved.target.norm
    if norm is None:
        return np.zeros((2, solved.count))
    found = [_defects(problem, pairs, off, norm) for pairs, off in _off_dirichlet_data(problem)]
    return solved.in_norm(np.max([np.zeros(len(solved.parents)), *found], axis=0))


def dirichlet_data(solved: Solved, dual: Dual | None) -> Array:
    """Return -G(u_D - w) on each cell: what Dirichlet data between nodes are in J(u - w).

    The force that holds the dual solution on a facet times the mean distance to the data there.
    """
    if dual is None:
        return np.zeros((2, solved.count))
    problem = solved.fine
    space, index_map = problem.space, problem.space.dofmap.index_map
    result = np.zeros((2, len(owned_cells(space.mesh))))
    for pairs, off in _off_dirichlet_data(problem):
        dofs, sizes = facet_dofs(space, pairs), facet_scale(space.mesh, pairs)[:, None]
        around = summed(index_map, dofs, np.broadcast_to(sizes, dofs.shape))
        shares = sizes / np.where(around > 0.0, around, 1.0)[dofs]
        parts = -(dual.forces.x.array[dofs] * shares).sum(axis=1) * off.mean(axis=1)
        for row, values in zip(result, (parts, np.abs(parts)), strict=True):
            np.add.at(row, pairs[:, 0], values)
    return solved.on_parents(result)


def _off_dirichlet_data(problem: BoundConstrainedProblem) -> list[tuple[LocalIndices, Array]]:
    """The facets of conditions, and the distances of their data from the solution at points."""
    if problem not in _off or _off[problem][0] is not problem.result:
        _off[problem] = problem.result, list(_distances(problem))
    return _off[problem][1]


def _distances(problem: BoundConstrainedProblem) -> Iterator[tuple[LocalIndices, Array]]:
    domain, lattice = problem.space.mesh, facet_lattice(problem.space)
    if problem.space.dofmap.bs > 1:  # the data of vectors are known at nodes alone
        return
    boundary, formulas = boundary_facets(domain), dict[Expr, FormulaAtPoints]()
    for known in map(data_of_condition, problem.bcs):
        if known is None or isinstance(known.value, int | float | np.number):
            continue
        facets = np.intersect1d(known.facets, boundary).astype(np.int32)
        points = Points(domain, facet_cells(domain, facets), lattice)
        off = _values(known.value, points, formulas) - points.values(problem.u)[0]
        yield points.places, np.where(np.isfinite(off), off, 0.0)


def _defects(
    problem: BoundConstrainedProblem, pairs: LocalIndices, off: Array, norm: Norm
) -> Array:
    """What distances on facets, of the shape (facets, points), are in a norm of the error."""
    domain = problem.space.mesh
    defects, dim = np.zeros(len(owned_cells(domain))), domain.topology.dim
    if norm.derivatives and dim > 2:
        return defects
    scale = facet_scale(domain, pairs)
    slopes = np.diff(off, axis=1) * SAMPLES / scale[:, None]
    # The facet itself, or what is near the facet.
    volume = scale if norm.boundary else 0.5 * scale ** (dim / (dim - 1.0))
    parts = _norms(slopes if norm.derivatives == 1 else off, volume, norm.p)
    if norm.derivatives == 0.5:  # interpolated between those of values and slopes
        parts = np.sqrt(parts * (parts + _norms(slopes, volume, norm.p)))
    return np.asarray(collected(parts, pairs[:, 0], len(defects), norm.p))


def _norms(values: Array, volume: Array, p: float) -> Array:
    """The L^p norms over volumes of what has values at points, shape (volumes, points)."""
    largest = np.abs(values).max(axis=1, initial=0.0)
    if math.isinf(p):
        return np.asarray(largest)
    shares = np.abs(values) / np.where(largest > 0.0, largest, 1.0)[:, None]
    means = (shares**p).mean(axis=1) if values.shape[1] else np.zeros(len(values))
    return np.asarray(largest * (means * volume) ** (1.0 / p))


def _values(data: Data, points: Points, formulas: dict[Expr, FormulaAtPoints]) -> Array:
    """Data at points, shape (facets, points); the formulas are those that have been made so far."""
    if isinstance(data, fem.Function):
        return points.values(data)[0]
    if isinstance(data, Expr):
        if data not in formulas:
            formulas[data] = FormulaAtPoints(points.domain, [data])
        return formulas[data](points)[0]
    assert callable(data)
    shape = points.x[0].shape
    x = np.zeros((3, points.x[0].size))
    x[: len(points.x)] = [coordinate.ravel() for coordinate in points.x]
    return called(points.domain.comm, data, x).reshape(shape)
