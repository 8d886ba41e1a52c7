"""A feasible function near a solution, nowhere below the obstacle on contact facets; its gap.

The discrete solution is feasible at its nodes. Where that is not enough,

- in space, with degree 2 and an obstacle of degree 2: values at the middles of edges are raised, by
  the least that makes the Bernstein coefficients of the gap non-negative;
- in the plane: the solution is set to the obstacle on closed contact facets and to the
  larger of both on the others, and to the data on Dirichlet facets, see `cones`;
- otherwise in space: the solution is set to the same values at the nodes of elements of higher
  degree only; where polynomials for the obstacle are known, hat functions raise the
  function above the obstacle everywhere.

An upper obstacle is a lower one for -u.
"""

import math
from dataclasses import dataclass, replace

import basix
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.ranks import highest, marked, summed
from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.bounds.boundary_facets import (
    FacetPoints,
    contact_closures,
    facet_points,
    on_parts,
)
from dolfinx_signorini.bounds.condensation import CLOSED, DIRICHLET, OPEN
from dolfinx_signorini.bounds.cones import (
    Cones,
    cones_on,
    data_defects,
    fitted,
    lattice,
    loose_ends,
)
from dolfinx_signorini.bounds.frames import Frames
from dolfinx_signorini.bounds.reference_flux import lowest, others
from dolfinx_signorini.bounds.remainders import MORE, Solved
from dolfinx_signorini.bounds.strong_form import polynomial_degree
from dolfinx_signorini.problem.assembly import dofs_on_facets
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.problem.values import evaluator

OBSTACLE = "the obstacle is known at points of facets only"
BELOW = "what is below the obstacle is known at points of facets only"
DATA = "Dirichlet data are known at points of facets only"


@dataclass(frozen=True)
class Feasible:
    """What is to be added to a solution for a feasible function.

    Where nothing is missing, u plus the change is feasible, but for the cones in the plane:

        near = feasible(solved, kinds)
        v = problem.sign * problem.u.x.array + near.change.x.array

    Attributes:
        change: A function.
        cones: What comes on top in the plane; None for nothing.
        gap: Polynomials on contact facets with what they miss of the gap, or in the plane of a
            function whose positive part is the gap, in terms of `FacetPoints.polynomials`; None
            where u plus the change has the gap.
        meets: Whether the feasible function is the obstacle on closed contact facets.
        missing: Why no feasible function is found; "" if one is found.
        notes: What is known at points only.
    """

    change: fem.Function
    cones: Cones | None = None
    gap: tuple[Array, Array] | None = None
    meets: bool = True
    missing: str = ""
    notes: tuple[str, ...] = ()


def feasible(solved: Solved, kinds: Indices) -> Feasible:
    """Return what makes a solution feasible, with the signs of a lower obstacle.

    Args:
        solved: The problem; the call is collective.
        kinds: The kinds of the facets of the cells.
    """
    problem, frames, rest, comm = solved.problem, solved.frames, solved.rest, solved.comm
    space, d, degree = problem.space, solved.dimension, solved.degree
    change, order = _pressed(problem, frames, kinds), degree + MORE[d]
    u = problem.sign * problem.u.x.array + change.x.array
    tiny = ROUNDING * highest(comm, np.abs(u))
    exact = _within(problem.obstacle_data, degree)
    more = order if d == 2 else degree  # polynomials that are met exactly
    unknown = rest.obstacle is None and not _within(problem.obstacle_data, more)
    unknown &= rest.obstacle_in_space is None
    unmet = not all(_within(data, more) for data, _ in solved.terms.dirichlet)
    unmet &= rest.dirichlet is None
    notes = (OBSTACLE,) * unknown + (DATA,) * unmet
    defects = data_defects(solved, u)
    far = comm.allreduce(bool(any((np.abs(w) > tiny).any() for _, w in defects)), op=MPI.LOR)
    touching = lattice(frames, kinds >= OPEN, order)
    gap = touching.function(space, u) - problem.sign * touching.values(problem.obstacle_data)
    low = lowest(d - 1, order, fitted(touching, gap, order))
    above = comm.allreduce(bool((low >= -tiny).all()), op=MPI.LAND)
    if exact and above and not far and rest.dirichlet is None:
        return Feasible(change, notes=notes)
    if exact and degree == 2 and not far and d == 3:
        missing = _raise_edges(problem, frames, kinds, change, tiny)
        return Feasible(change, missing=missing, notes=notes)
    if d == 3:
        notes = (BELOW,) * exact + notes
        near = Feasible(_filled(solved, kinds), meets=False, notes=notes)
        return near if rest.obstacle_in_space is None else _raised(solved, kinds, near)
    below = [*[(*defect, rest.dirichlet) for defect in defects], (touching, -gap, rest.obstacle)]
    cones = cones_on(frames, below, kinds, order, tiny)
    missing = loose_ends(comm, [*defects, (touching, np.maximum(-gap, 0.0))], tiny)
    unseen = np.zeros(len(gap)) if rest.obstacle is None else rest.obstacle[0][kinds >= OPEN]
    pair = fitted(touching, gap, order), unseen
    return Feasible(change, cones, pair, missing=missing, notes=notes)


def _within(data: object, degree: int) -> bool:
    found = polynomial_degree(data)  # type: ignore[arg-type]
    return found is not None and found <= degree


def _pressed(problem: BoundConstrainedProblem, frames: Frames, kinds: Indices) -> fem.Function:
    """What sets the solution to the obstacle at all dofs of closed contact facets."""
    _, _, dofs = contact_closures(problem, frames, np.where(kinds == CLOSED, kinds, 0))
    change = fem.Function(problem.space)
    change.x.array[:] = np.where(marked(problem.space, dofs), -problem.gap.x.array, 0.0)
    return change


def _raise_edges(
    problem: BoundConstrainedProblem,
    frames: Frames,
    kinds: Indices,
    change: fem.Function,
    tiny: float,
) -> str:
    """Raise a function of degree 2 at the middles of edges; return why that fails, or ""."""
    space, d = problem.space, frames.dimension
    element = space.element.basix_element
    gap = np.maximum(problem.gap.x.array + change.x.array, 0.0)
    inside = basix.cell.sub_entity_connectivity(element.cell_type)[d - 1]
    edges = np.array([facet[1] for facet in inside])
    closures = np.array(element.entity_closure_dofs[1])
    cells, facets = np.nonzero(kinds >= OPEN)
    local = closures[edges[frames.order[cells, facets]]]
    dofs = np.take_along_axis(
        space.dofmap.list[cells], local.reshape(len(cells), local[0].size if len(local) else 3), 1
    ).reshape(-1, 3)
    a, b, middle = gap[dofs].T
    least = (a + b) / 4.0  # then the Bernstein coefficient (4 middle - a - b) / 2 is 0
    lack, edges = np.maximum(least - middle, 0.0), dofs[:, 2]
    raised = summed(space.dofmap.index_map, edges, lack)
    change.x.array[:] += raised / np.maximum(summed(space.dofmap.index_map, edges), 1.0)
    held = bool((raised[problem.fixed_dofs] > tiny).any())
    found = problem.comm.allreduce(held, op=MPI.LOR)
    return "the obstacle is above the solution where Dirichlet data hold the solution" * found


def _raised(solved: Solved, kinds: Indices, near: Feasible) -> Feasible:
    """Raise a function in space by hat functions until nothing is below the obstacle."""
    assert solved.rest.obstacle_in_space is not None
    problem, frames = solved.problem, solved.frames
    obstacle, missed = solved.rest.obstacle_in_space
    change = near.change
    order = max(change.function_space.element.basix_element.degree, obstacle.degree)
    points, unseen = lattice(frames, kinds >= OPEN, order), missed[kinds >= OPEN]
    own = points.function(problem.space, problem.u.x.array) - points.values(obstacle)

    def series() -> Array:
        more = points.function(change.function_space, change.x.array)
        return fitted(points, problem.sign * own + more, order)

    lack = np.maximum(unseen - lowest(2, order, series()), 0.0)
    hats = fem.Function(fem.functionspace(problem.space.mesh, ("Lagrange", 1)))
    corners = others(3)[points.facets]
    local = np.take_along_axis(frames.order[points.cells], corners, axis=1)
    dofs = np.take_along_axis(hats.function_space.dofmap.list[points.cells], local, axis=1)
    # At least the largest of the facets at a vertex.
    hats.x.array[:] = summed(hats.function_space.dofmap.index_map, dofs, lack[:, None])
    fixed = dofs_on_facets(
        hats.function_space, frames.local_facets[kinds == DIRICHLET].astype(np.int32)
    )
    held = problem.comm.allreduce(bool((hats.x.array[fixed] > 0.0).any()), op=MPI.LOR)
    if held:
        return replace(near, notes=(OBSTACLE, *near.notes))
    more = fem.Function(change.function_space)
    more.interpolate(hats)
    change.x.array[:] += more.x.array
    return replace(near, gap=(series(), unseen))


def _filled(solved: Solved, kinds: Indices) -> fem.Function:
    """What meets data and obstacle at the nodes of elements of higher degree."""
    problem, frames = solved.problem, solved.frames
    space = fem.functionspace(frames.domain, ("Lagrange", solved.degree + MORE[3]))
    u, change = fem.Function(space), fem.Function(space)
    u.interpolate(problem.u)
    closed = np.zeros(len(change.x.array), dtype=bool)
    closed[dofs_on_facets(space, frames.local_facets[kinds == CLOSED].astype(np.int32))] = True
    dofs = dofs_on_facets(space, problem.contact)
    defect = evaluator(space, problem.obstacle_data, dofs)() - u.x.array[dofs]
    defect *= problem.sign
    change.x.array[dofs] = np.where(closed[dofs], defect, np.maximum(defect, 0.0))
    for data, facets in solved.terms.dirichlet:
        dofs, values = dofs_on_facets(space, facets), u.x.array
        if data is not None:
            values = np.zeros_like(values)
            values[dofs] = evaluator(space, data, dofs)()
        change.x.array[dofs] = problem.sign * (values[dofs] - u.x.array[dofs])
    change.x.scatter_forward()
    return change


def gaps(solved: Solved, near: Feasible, kinds: Indices) -> tuple[FacetPoints, Array]:
    """Return the gap of a feasible function at points of contact facets, or more than the gap.

    Args:
        solved: The problem; the call is collective.
        near: What makes the solution feasible.
        kinds: The kinds of the facets of cells.

    Returns:
        The points, with a rule for the gap times polynomials of the degree of the solution, and the
        values.
    """
    problem, frames = solved.problem, solved.frames
    if near.gap is not None:
        series, missed = near.gap
        if frames.dimension == 2:
            points, gap = on_parts(frames, kinds >= OPEN, series)
        else:
            points, gap = _in_space(frames, kinds >= OPEN, series)
        gap += missed[:, None]
    else:
        points = facet_points(frames, kinds >= OPEN, 2 * solved.degree + 8)
        v = problem.sign * points.function(problem.space, problem.u.x.array)
        v += points.function(near.change.function_space, near.change.x.array)
        gap = np.maximum(v - problem.sign * points.values(problem.obstacle_data), 0.0)
    if near.meets:
        gap[kinds[points.cells, points.facets] == CLOSED] = 0.0
    return points, gap


def _in_space(frames: Frames, marked: Mask, series: Array) -> tuple[FacetPoints, Array]:
    """Polynomials on facets at points of a rule for their products with polynomials."""
    order = round((math.sqrt(8.0 * series.shape[1] + 1.0) - 3.0) / 2.0)
    points = facet_points(frames, marked, 2 * order)
    return points, np.einsum("nj,njq->nq", series, points.polynomials(order))


def gap_means(points: FacetPoints, gap: Array, degree: int) -> Array:
    """Return the means of gap times polynomial, shape (cells, d + 1, moments).

    Args:
        points, gap: See `gaps`.
        degree: The degree of the polynomials.
    """
    p = points.polynomials(degree)
    means = np.zeros((*points.frames.order.shape, p.shape[1]))
    means[points.cells, points.facets] = np.einsum("q,nq,njq->nj", points.weights, gap, p)
    return means


def contact_energy(points: FacetPoints, gap: Array, moments: Array, degree: int) -> Array:
    """Return the integrals of contact flux times gap over the contact facets of each cell.

    Args:
        points, gap: See `gaps`.
        moments: The moments of the flux on facets, shape (cells, d + 1, moments).
        degree: The degree of the flux.
    """
    own = moments[points.cells, points.facets]
    flux = np.einsum("nj,njq->nq", own, points.polynomials(degree))
    sums = np.maximum(flux, 0.0) * gap @ points.weights
    return np.asarray(np.bincount(points.cells, sums, len(moments)), dtype=np.float64)
