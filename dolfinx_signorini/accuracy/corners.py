"""The cells at corners, and the exponents of the distance that solutions have there.

Around a vertex in the plane, or an edge in space, a solution is like r^a where the angles, the
conditions on both sides and the coefficients of the form tell the exponent, see `norms.sectors`.
Such corners are those of the domain, points where the condition changes, and points inside of the
domain where coefficients jump across a line that bends, or across several lines. A side in contact
has given values, as a Dirichlet side, and a contact side that touches nothing is a Neumann side.

Between two contact sides, one in contact and one not, a solution would be positive on one side and
in contact with the other, but the signs of its gap and of its pressure contradict each other. So
the exponent is that of two sides with the same condition. For the same reason the exponent at a
detachment point inside a straight contact side is 3/2 and not 1/2.

At a corner with given values the data of both sides, and the load, are those of a polynomial by
chance only: integer exponents belong to parts like r^a log r there.

Sources: Christof and Haubner, Theorem 2.3 and Section 2.2; Apel and Nicaise, Results Math. 75
(2020) 75.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import common, mesh

from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask, by_place
from dolfinx_signorini.base.ranks import averaged, largest, marked, summed
from dolfinx_signorini.base.tolerances import SIX_DIGITS
from dolfinx_signorini.data.principal_part import PrincipalPart, mixing, principal_part
from dolfinx_signorini.meshes.angles import cell_angles
from dolfinx_signorini.meshes.elements import facet_dofs
from dolfinx_signorini.meshes.sided_meshes import (
    boundary_facets,
    entity_nodes,
    facet_cells,
    owned_cells,
)
from dolfinx_signorini.norms.orders import SMOOTH
from dolfinx_signorini.norms.sectors import sector_exponent
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.problem.contact import ContactProblem

# A polygon that approximates a smooth curve has angles near pi that are no corners of the curve.
STRAIGHT = math.radians(15.0)


@dataclass(frozen=True)
class Sides:
    """The conditions on boundary facets, for n unknowns:

        sides = conditions_of(problem)
        print(sides.touching.mean())

    Attributes:
        facets: The owned boundary facets.
        given: The projections to the directions of unknowns with Dirichlet data, shape
            (facets, n, n).
        stopped: The projections to the direction that an obstacle bounds; 0 without an obstacle.
        touching: Whether a facet is in contact with its obstacle.
    """

    facets: LocalIndices
    given: Array
    stopped: Array
    touching: Mask


@dataclass(frozen=True)
class _Around:
    """What all ranks know around one vertex or edge: sectors by the angle, and sides."""

    starts: Array
    widths: Array
    tensors: Array
    angles: Array
    given: Array
    stopped: Array
    touching: Any


def exponents_at_corners(problem: BoundConstrainedProblem) -> tuple[Array, Array]:
    """Return for each owned cell the least exponent at one of its corners, and where; collective.

    Args:
        problem: The solved problem.

    Returns:
        The exponents; `SMOOTH` for cells without a corner, and where the coefficients of the form
        are not readable. And the corners, shape (cells, 3); infinity for cells without one, and in
        space, where corners are edges.
    """
    domain, cells = problem.space.mesh, owned_cells(problem.space.mesh)
    exponents = _of_problem(problem, logarithms=True)[corners_of(domain, 0)[cells]]
    least, places = exponents.min(axis=1), np.full((len(cells), 3), np.inf)
    here = np.flatnonzero(np.isfinite(least)) if domain.topology.dim == 2 else cells[:0]
    places[here] = domain.geometry.x[domain.geometry.dofmap[here, exponents[here].argmin(axis=1)]]
    return np.asarray(least), places


def places_below(problem: BoundConstrainedProblem, limit: float) -> list[tuple[Array, float]]:
    """Return the corners, or middles of edges in space, with a smaller exponent; collective.

    Args:
        problem: The solved problem.
        limit: The exponent that is not smaller; 1 where derivatives are finite.

    Returns:
        Points with their exponents, the least first; the same on all ranks.
    """
    domain, exponents = problem.space.mesh, _of_problem(problem)
    dim = domain.topology.dim - 2
    domain.topology.create_connectivity(dim, dim + 2)
    chosen = np.flatnonzero(exponents[: domain.topology.index_map(dim).size_local] < limit)
    middles = mesh.compute_midpoints(domain, dim, chosen.astype(np.int32))
    own = [(point, float(exponents[k])) for k, point in zip(chosen, middles, strict=True)]
    found = [each for parts in domain.comm.allgather(own) for each in parts]
    exponents = np.round([exponent for _, exponent in found], 6)
    return [found[k] for k in by_place([point for point, _ in found], exponents)]


def _of_problem(problem: BoundConstrainedProblem, logarithms: bool = False) -> Array:
    """The exponents at places, see `exponents_at_places`."""
    known = principal_part(problem.a), conditions_of(problem)
    return exponents_at_places(problem.space.mesh, *known, logarithms)


def conditions_of(problem: BoundConstrainedProblem) -> Sides:
    """Return the conditions on the boundary facets of a solved problem; collective."""
    layout, facets = problem.system.layout, boundary_facets(problem.space.mesh)
    nodal, size, fixed = layout.nodal, layout.block, layout.fixed_dofs
    on_facets = facet_dofs(nodal, facet_cells(problem.space.mesh, facets))

    def everywhere(nodes: LocalIndices) -> Mask:
        return np.all(marked(nodal, nodes)[on_facets], axis=1)

    given, stopped = np.zeros((2, len(facets), size, size))
    for k in range(size):
        given[everywhere(fixed[fixed % size == k] // size), k, k] = 1.0
    contact: Mask = np.zeros(len(facets), dtype=bool)
    touching = contact
    for zone in problem.zones:
        # Contact in the domain ends without a singularity, on the boundary, too: slopes are equal.
        if not zone.in_domain:
            contact = everywhere(zone.obstacle_nodes)
            touching = everywhere(np.concatenate([zone.active, layout.held_nodes])) & contact
    units = np.ones((len(facets), 1))
    if isinstance(problem, ContactProblem):
        directions = problem.directions.x.array.reshape(-1, size)
        units = directions[on_facets].mean(axis=1)
        units /= np.maximum(np.linalg.norm(units, axis=1), SIX_DIGITS)[:, None]
    stopped[contact] = (units[:, :, None] * units[:, None])[contact]
    return Sides(facets, given, stopped, touching)


def exponents_at_places(
    domain: mesh.Mesh, part: PrincipalPart | None, sides: Sides, logarithms: bool = False
) -> Array:
    """Return the exponents at vertices in the plane, or edges in space; collective.

    Args:
        domain: A mesh of straight-sided triangles or tetrahedra.
        part: The coefficients of the form; None where they are not readable.
        sides: The conditions on the boundary.
        logarithms: Whether data may be those of no polynomial, so that a solution has a part like
            r^a log r at corners where a scalar has given values.

    Returns:
        The least exponent at each place that this rank knows, see `sector_exponent`; `SMOOTH`
        everywhere where the coefficients are not readable.
    """
    domain.topology.create_entities(domain.topology.dim - 2)
    places = domain.topology.index_map(domain.topology.dim - 2)
    result = np.full(places.size_local + places.num_ghosts, SMOOTH)
    if part is None:
        return result
    chosen = _candidates(domain, part, sides)
    gathered = _gathered(domain, part, sides, chosen)
    found = {place: _exponent(around, logarithms) for place, around in gathered}
    local = places.global_to_local(np.array([*found], dtype=np.int64))
    result[local[local >= 0]] = np.array([*found.values()])[local >= 0]
    return result


def corners_of(domain: mesh.Mesh, codim: int) -> LocalIndices:
    """Return the corners of all cells, or of all facets: vertices in the plane, edges in space.

    Args:
        domain: A mesh of triangles or tetrahedra.
        codim: 0 for cells, 1 for facets.
    """
    topology, tdim = domain.topology, domain.topology.dim
    dim = tdim - codim
    topology.create_connectivity(dim, tdim - 2)
    links = topology.connectivity(dim, tdim - 2).array
    return links.reshape(-1, math.comb(dim + 1, tdim - 1))


def angles_at_places(domain: mesh.Mesh, cells: LocalIndices) -> Array:
    """Return the sums of the angles of cells at places, vertices or edges; the call is collective.

    Args:
        domain: A mesh of triangles or tetrahedra.
        cells: Owned cells.
    """
    places = domain.topology.index_map(domain.topology.dim - 2)
    return summed(places, corners_of(domain, 0)[cells], cell_angles(domain, cells))


def _candidates(domain: mesh.Mesh, part: PrincipalPart, sides: Sides) -> Mask:
    """Where the boundary bends, the condition changes, or coefficients jump."""
    places, every = domain.topology.index_map(domain.topology.dim - 2), owned_cells(domain)
    on_facets, on_cells = corners_of(domain, 1)[sides.facets], corners_of(domain, 0)[every]
    boundary = summed(places, on_facets) > 0.0
    cells = every[boundary[on_cells].any(axis=1)]
    bent = boundary & (np.abs(angles_at_places(domain, cells) - math.pi) >= STRAIGHT)
    conditions = _given(sides.given, sides.stopped, sides.touching)
    mixed = np.einsum("fij,ij->f", conditions, mixing((part.size, part.size)))
    changes = _spread(places, on_facets, np.repeat(mixed[:, None], on_facets.shape[1], axis=1))
    plain = summed(places, on_facets[~sides.stopped.any(axis=(1, 2))]) > 0.0
    chosen = bent | ((changes > SIX_DIGITS) & plain)
    if not part.is_constant:
        values = part.mixed_at_corners(every)
        sizes = largest(places, on_cells.ravel(), np.abs(values).ravel())
        chosen |= _spread(places, on_cells, values) > SIX_DIGITS * sizes
    return chosen


def _spread(places: common.IndexMap, on: LocalIndices, values: Array) -> Array:
    """How far the values that cells or facets have at places are from their mean there."""
    values = np.nan_to_num(values)
    means = averaged(places, on, values)
    return largest(places, on.ravel(), np.abs(values - means[on]).ravel())


def _gathered(
    domain: mesh.Mesh, part: PrincipalPart, sides: Sides, chosen: Mask
) -> Iterator[tuple[int, _Around]]:
    """Yield on each rank the sectors and sides of all ranks around each of the chosen places."""
    places, every = domain.topology.index_map(domain.topology.dim - 2), owned_cells(domain)
    on_cells, on_facets = corners_of(domain, 0)[every], corners_of(domain, 1)[sides.facets]
    row, corner = np.nonzero(chosen[on_cells])
    here = on_cells[row, corner]
    angles, frames = _directions(domain, domain.topology.dim, every[row], here)
    turn = np.mod(angles[:, 1] - angles[:, 0] + math.pi, math.tau) - math.pi
    starts = np.where(turn > 0.0, angles[:, 0], angles[:, 1])
    cells, which = np.unique(every[row], return_inverse=True)
    tensors = part.at_corners(cells.astype(np.int32))[which, corner]
    tensors = np.einsum("mpa,miajb,mqb->mipjq", frames, tensors, frames)
    side, end = np.nonzero(chosen[on_facets])
    there = on_facets[side, end]
    towards, _ = _directions(domain, domain.topology.dim - 1, sides.facets[side], there)
    conditions = sides.given[side], sides.stopped[side], sides.touching[side]
    own = (
        (places.local_to_global(here), starts, np.abs(turn), tensors),
        (places.local_to_global(there), towards[:, 0], *conditions),
    )
    parts = domain.comm.allgather(own)
    sectors, edges = (_sorted(parts_of_all) for parts_of_all in zip(*parts, strict=True))
    for place in np.unique(sectors[0]):
        known = [
            values[slice(*np.searchsorted(names, [place, place + 1]))]
            for names, *arrays in (sectors, edges)
            for values in arrays
        ]
        yield int(place), _Around(*known)


def _sorted(parts: Sequence[tuple[Array, ...]]) -> list[Array]:
    """The arrays of all ranks one after the other, in the order of the first one of them."""
    joined = [np.concatenate(arrays) for arrays in zip(*parts, strict=True)]
    order = np.argsort(joined[0], kind="stable")
    return [values[order] for values in joined]


def _directions(
    domain: mesh.Mesh, dim: int, entities: LocalIndices, places: LocalIndices
) -> tuple[Array, Array]:
    """The angles at which the other vertices of entities lie around places, and the axes for them.

    Around an edge the plane at right angles to the edge counts.
    """
    topology, tdim, gdim = domain.topology, domain.topology.dim, domain.geometry.dim
    for each in (tdim - 2, dim):
        topology.create_connectivity(each, tdim)
    ends = entity_nodes(domain, tdim - 2, places)
    others = entity_nodes(domain, dim, entities)
    away = ~(others[:, :, None] == ends[:, None]).any(axis=2)
    others = others[away].reshape(len(places), dim - tdim + 2)
    x = domain.geometry.x[:, :gdim]
    rays = x[others] - x[ends[:, :1]]
    frames = np.broadcast_to(np.eye(2), (len(places), 2, 2))
    if tdim == 3:
        along = x[ends[:, 1]] - x[ends[:, 0]]
        first = np.argmax(along != 0.0, axis=1)  # of two opposite vectors all ranks take the same
        rows = np.arange(len(along))
        along *= (np.sign(along[rows, first]) / np.linalg.norm(along, axis=1))[:, None]
        away = np.eye(3)[np.argmin(np.abs(along), axis=1)]
        one = away - (away * along).sum(axis=1)[:, None] * along
        one /= np.linalg.norm(one, axis=1)[:, None]
        frames = np.stack([one, np.cross(along, one)], axis=1)
    plane = np.einsum("mpa,mva->mvp", frames, rays)
    return np.arctan2(plane[:, :, 1], plane[:, :, 0]), np.asarray(frames)


def _exponent(around: _Around, logarithms: bool) -> float:
    """The least exponent at a place: of all sectors around a place, or of each chain of them."""
    if not np.isfinite(around.tensors).all():
        return SMOOTH
    if len(around.angles) == 0:
        return _exponent_inside(around)
    return min(_exponent_between(around, k, logarithms) for k in range(len(around.angles)))


def _exponent_inside(around: _Around) -> float:
    order = np.argsort(around.starts)
    jumps = [not _equal(*around.tensors[order[[k - 1, k]]]) for k in range(len(order))]
    order = np.roll(order, -int(np.argmax(jumps)))  # begin at a jump
    widths, tensors = _merged(around.widths[order], around.tensors[order])
    if len(widths) < 2 or abs(widths.sum() - math.tau) > SIX_DIGITS:
        return SMOOTH
    if len(widths) == 2 and abs(widths[0] - math.pi) < STRAIGHT:  # a smooth interface
        widths = np.full(2, math.pi)
    directions = around.starts[order[0]] + np.cumsum([0.0, *widths])
    return sector_exponent(directions, tensors, None)


def _exponent_between(around: _Around, first: int, logarithms: bool) -> float:
    """The exponent of the sectors that begin at a side and end at another one."""
    relative = np.mod(around.starts - around.angles[first] + SIX_DIGITS, math.tau) - SIX_DIGITS
    order, widths, end = np.argsort(relative), list[float](), 0.0
    for k in order:
        if abs(relative[k] - end) > SIX_DIGITS * math.tau:
            break
        widths.append(float(around.widths[k]))
        end += widths[-1]
    away = np.abs(np.mod(around.angles - around.angles[first] - end + math.pi, math.tau) - math.pi)
    away[first] = np.inf
    if not widths or away.min(initial=np.inf) > SIX_DIGITS * math.tau:
        return SMOOTH  # the sectors are on the other side
    ends = [first, int(np.argmin(away))]
    straight = abs(end - math.pi) < STRAIGHT
    merged, tensors = _merged(np.array(widths), around.tensors[order[: len(widths)]])
    scaled = merged * math.pi / end if straight else merged
    directions = around.angles[first] + np.cumsum([0.0, *scaled])
    given, stopped, touching = around.given[ends], around.stopped[ends], around.touching[ends]
    both = stopped.any(axis=(1, 2)).all() and touching[0] != touching[1]
    states: list[Mask] = [np.full(2, s) for s in (False, True)] if both else [touching]
    found = []
    for state in states:
        held = [_range(projection) for projection in _given(given, stopped, state)]
        corner = not straight and tensors.shape[1] == 1 and max(h.shape[1] for h in held) > 0
        found.append(sector_exponent(directions, tensors, held, logarithms and corner))
    return min(found)


def _given(given: Array, stopped: Array, touching: Mask) -> Array:
    """The sums of the projections to directions with given values."""
    return given + touching[:, None, None] * stopped


def _range(projections: Array) -> Array:
    """An orthonormal basis of the range of a sum of projections."""
    values, vectors = np.linalg.eigh(projections)
    return np.asarray(vectors[:, values > SIX_DIGITS])


def _merged(widths: Array, tensors: Array) -> tuple[Array, Array]:
    """Join sectors that follow one another and have the same coefficients."""
    new = [not _equal(tensors[k], tensors[k + 1]) for k in range(len(tensors) - 1)]
    begins = np.flatnonzero([True, *new])
    return np.add.reduceat(widths, begins), tensors[begins]


def _equal(a: Array, b: Array) -> bool:
    return bool(np.abs(a - b).max() <= SIX_DIGITS * np.abs(a).max())
