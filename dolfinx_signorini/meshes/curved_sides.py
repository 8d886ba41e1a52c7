"""Curved sides: refined meshes whose new boundary vertices go onto curves that sides stand for.

A mesh with straight-sided cells has a polygon, or a polyhedron, in place of a curved domain. The
middle of a facet, where refinement puts a vertex, is off the curve, and a projection onto the curve
moves the vertex there. Where no projection is given, the polygon is the domain; facets which bend
like those of a smooth curve tell that this may not be what was meant.
"""

import itertools
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from dolfinx import la

from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices
from dolfinx_signorini.base.errors import InputError, together
from dolfinx_signorini.base.kinds import callable_, check, gmsh_model, integer, optional
from dolfinx_signorini.base.ranks import anywhere, gathered, highest, summed
from dolfinx_signorini.base.tolerances import HALVINGS, ROUNDING, SOLVED
from dolfinx_signorini.meshes.jacobians import determinants
from dolfinx_signorini.meshes.parents import parent_mesh
from dolfinx_signorini.meshes.polynomials import others
from dolfinx_signorini.meshes.sided_meshes import (
    SidedMesh,
    boundary_facets,
    cell_edges,
    entity_nodes,
    facet_cells,
    facet_nodes,
    longest_side,
    owned_cells,
    owned_facets,
    simplex_sizes,
)

# Maps points, shape (3, points), to the nearest ones of a curve or of a surface.
Projection = Callable[[Array], Array]

# Radians. Facets that turn by less are in one line or plane, but for rounding; facets that turn by
# more meet at a corner: those of a pentagon are an arc, and those of a square are none.
FLAT, SHARP = SOLVED**0.5, math.tau / 4.5


# Of a facet: its vertices are that far from the curve at most, which the facet stands for.
ASIDE = 0.1


class TurnedOverError(InputError):
    """Vertices that are moved onto a curve would turn cells over.

    The adaptive loop ends with what it has, if a step is done:

        try:
            curves.fit(sided)
        except TurnedOverError as error:
            print(error.message)
    """

    def __init__(self) -> None:
        message = "moves vertices so far that cells turn over: begin with a finer mesh"
        super().__init__(message, "geometry")


class CurvedSides:
    """The curves, or curved surfaces, that sides of a mesh stand for:

        hole = lambda x: 0.25 * x / np.hypot(x[0], x[1])
        CurvedSides({"hole": hole}).fit(sided)

    The projections are called on rank 0 alone, where a model of gmsh is, with points of all ranks.

    Args:
        projections: For sides by name the projection onto the curve; None for a side whose facets
            are the domain. "all" stands for the whole boundary.

    Attributes:
        projections: Those of the curved sides.
        known: The names of all sides of which something is known.
    """

    def __init__(self, projections: Mapping[str, Projection | None]):
        self.projections = {name: p for name, p in projections.items() if p is not None}
        self.known = frozenset(projections)

    def check(self, sided: SidedMesh) -> None:
        """Refuse what does not belong to a mesh; the call is collective.

        Raises:
            InputError: There is no such side, a projection is none, vertices of the side are off
                the curve, or the facets are so few that halves of the facets are as far from the
                curve as the facets are.
        """
        names = (*sided.sides, "all")
        for name in sorted(self.known):
            check(geometry=(self.projections.get(name), optional(callable_)))
            if name not in names:
                raise InputError(f"{name!r}: the mesh has the sides {', '.join(names)}", "geometry")
        comm = sided.mesh.comm
        for name, projection in self.projections.items():
            one = CurvedSides({name: projection})
            corners = sided.mesh.geometry.x[facet_nodes(sided.mesh, self._facets(sided, name))]
            edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
            places = np.asarray(corners.reshape(-1, 3), dtype=np.float64)
            off = np.linalg.norm(one._projected(sided, name, places) - places, axis=1)
            beyond = off > ASIDE * np.repeat(edges, corners.shape[1])
            farthest = highest(comm, off[beyond])
            if farthest > 0.0:
                message = f"the mesh has vertices at a distance of {farthest:.2g} from this curve"
                raise InputError(f"{name!r}: {message}", "geometry")
            far, farther = (comm.allreduce(float(one.gaps(sided, n).sum())) for n in (1, 2))
            measure = comm.allreduce(float(simplex_sizes(corners).sum()))
            if farther > max(far, ROUNDING * longest_side(sided.mesh) * measure):
                message = "is followed too roughly by the first mesh, which should be finer there"
                raise InputError(f"{name!r}: {message}", "geometry")

    def fit(self, sided: SidedMesh) -> bool:
        """Move the vertices of the curved sides onto the curves; the call is collective.

        Returns:
            Whether a vertex has moved by more than rounding.

        Raises:
            InputError: A projection fails.
            TurnedOverError: A projection moves vertices so far that cells turn over; the mesh
                stays as it was.
        """
        if not self.projections:
            return False
        domain, comm = sided.mesh, sided.mesh.comm
        x, before = self.placed(sided), determinants(cell_edges(domain, owned_cells(domain)))
        moved = highest(comm, np.abs(x - domain.geometry.x)) > ROUNDING * longest_side(sided.mesh)
        placed, domain.geometry.x[:] = domain.geometry.x.copy(), x
        after = determinants(cell_edges(domain, owned_cells(domain)))
        if anywhere(comm, after * before <= 0.0):
            domain.geometry.x[:] = placed
            raise TurnedOverError
        return moved

    def placed(self, sided: SidedMesh) -> Array:
        """Return where the nodes of this rank belong, shape (nodes, 3); the call is collective."""
        geometry, names = sided.mesh.geometry, list(self.projections)
        index_map, dim = geometry.index_map(), geometry.dim
        owned, found = index_map.size_local, la.vector(index_map, 3)
        x = found.array.reshape(-1, 3)
        x[:] = geometry.x
        on = [
            summed(index_map, facet_nodes(sided.mesh, self._facets(sided, name)))[:owned] > 0.0
            for name in names
        ]
        several = np.sum(on, axis=0) > 1
        again = sided.mesh.comm.allreduce(int(np.count_nonzero(several))) > 0
        for k in range(HALVINGS if again else 1):
            for name, nodes in zip(names, on, strict=True):
                chosen = np.flatnonzero(nodes & several if k else nodes)
                x[chosen, :dim] = self._projected(sided, name, x[chosen])[:, :dim]
        found.scatter_forward()
        return x

    def gaps(self, sided: SidedMesh, parts: int = 1) -> Array:
        """Return about what is between the facets of each owned cell and the curves, as a volume.

        Args:
            sided: The mesh; the call is collective.
            parts: 1 for the facets themselves, 2 for facets with halved edges.
        """
        domain = sided.mesh
        result = np.zeros(len(owned_cells(domain)))
        for name in self.projections:
            facets = self._facets(sided, name)
            corners = domain.geometry.x[facet_nodes(domain, facets)]
            pairs = list(itertools.combinations(range(domain.topology.dim), 2))
            edges = np.concatenate([corners[:, pair] for pair in pairs])
            if parts == 2:
                places = np.concatenate((edges[:, 0], edges[:, 1], edges.mean(axis=1)))
                first, last, middle = np.split(self._projected(sided, name, places), 3)
                halves = (first, middle), (middle, last)
                edges = np.concatenate([np.stack(half, axis=1) for half in halves])
            middles = edges.mean(axis=1)
            ways = self._projected(sided, name, middles) - middles
            shape = len(pairs) * parts, len(facets)
            away = np.linalg.norm(ways, axis=1).reshape(shape).max(axis=0)
            np.add.at(result, facet_cells(domain, facets)[:, 0], away * simplex_sizes(corners))
        return result

    def _facets(self, sided: SidedMesh, name: str) -> LocalIndices:
        """The facets of a side that this rank owns."""
        return owned_facets(sided.mesh, sided.facets((name,)))

    def _projected(self, sided: SidedMesh, name: str, points: Array) -> Array:
        """The projections of points, shape (points, 3); the call is collective."""
        comm = sided.mesh.comm
        parts, answers = comm.gather(points), None
        with together(comm, "geometry"):
            if parts is not None:
                whole = np.concatenate(parts)
                found = self._on_curve(name, whole) if len(whole) else whole
                answers = np.split(found, np.cumsum([len(part) for part in parts])[:-1])
        return np.asarray(comm.scatter(answers))

    def _on_curve(self, name: str, points: Array) -> Array:
        try:
            found = np.asarray(self.projections[name](points.T.copy()), dtype=np.float64)
            if found.shape != points.T.shape:
                raise ValueError(f"returns the shape {found.shape} for points of {points.T.shape}")
            if not np.isfinite(found).all():
                raise ValueError("returns coordinates that are not finite")
        except Exception as error:
            raise InputError(f"{name!r}: {error}", "geometry") from error
        return found.T


def gmsh_projection(model: Any, dimension: int, group: int) -> Projection:
    """Return the projection onto the curves or surfaces of a model of gmsh.

    The model is to be there, on rank 0, for as long as the projection is used:

        geometry = {"hole": gmsh_projection(gmsh.model, 1, 2)}

    Args:
        model: `gmsh.model`.
        dimension: 1 for curves, 2 for surfaces.
        group: The tag of the physical group that has them. A point goes to the nearest one.

    Raises:
        InputError: An argument is of another kind.
    """
    check(
        model=(model, gmsh_model),
        dimension=(dimension, integer(1, 2)),
        group=(group, integer(1)),
    )

    def onto(points: Array) -> Array:
        tags = model.getEntitiesForPhysicalGroup(dimension, group)
        flat = points.T.ravel()
        found = np.array([model.getClosestPoint(dimension, tag, flat)[0] for tag in tags])
        places = found.reshape(len(tags), -1, 3)
        nearest = np.linalg.norm(places - points.T, axis=2).argmin(axis=0)
        return np.asarray(places[nearest, np.arange(len(nearest))].T)

    return onto


def arcs(sided: SidedMesh, known: frozenset[str] = frozenset()) -> dict[str, float]:
    """Return the sides whose facets bend like those of a smooth curve; the call is collective.

    At both ends (on two edges, in space) such a facet and a neighbour of the facet turn by a small
    angle. Edges of polygons do so only where an edge is a single facet. The facets of a mesh that
    has been refined are parts of those of its parent: the meshes before are looked at, too.

    Args:
        sided: The mesh.
        known: The names of sides that are left out; "all" for none.

    Returns:
        By the name of each side, "all" for the boundary without a name, "edge of R" for what is
        inside of the domain of the boundary of a region R, about how far from the facets a smooth
        curve through their vertices is.
    """
    found = _arcs_of(sided, known)
    while (parent := parent_mesh(sided.mesh)) is not None:
        sided = parent.sided
        found = _arcs_of(sided, known) | found
    return found


def _arcs_of(sided: SidedMesh, known: frozenset[str]) -> dict[str, float]:
    """As `arcs`, of the facets of one mesh."""
    domain, comm = sided.mesh, sided.mesh.comm
    dim, facets = domain.topology.dim, boundary_facets(domain)
    combinations, numbers = sided.combinations(facets)
    names = [
        [*(n for n, yes in zip(sided.sides, each, strict=True) if yes), "all"]
        for each in combinations
    ]
    for region in sided.regions:
        inside = _edge_inside(sided, region)
        facets = np.concatenate((facets, inside))
        numbers = np.concatenate((numbers, np.full(len(inside), len(names))))
        names.append([f"edge of {region}"])
    domain.topology.create_connectivity(dim - 1, dim)
    nodes = entity_nodes(domain, dim - 1, facets.astype(np.int32))
    ids = domain.geometry.index_map().local_to_global(nodes.ravel()).reshape(nodes.shape)
    parts = gathered(comm, ids, domain.geometry.x[nodes], numbers)
    found: dict[str, float] = {}
    if parts is not None:
        for number, distance in _bulges(*parts).items():
            name = names[number][0]  # the first one of a side with several names
            if not known & {*names[number]}:
                found[name] = max(distance, found.get(name, 0.0))
    return dict(comm.bcast(found))


def _edge_inside(sided: SidedMesh, region: str) -> LocalIndices:
    """The owned facets between cells of a region and other cells; collective."""
    topology = sided.mesh.topology
    dim, cells = topology.dim, owned_cells(sided.mesh)
    topology.create_connectivity(dim, dim - 1)
    facets = topology.connectivity(dim, dim - 1).array.reshape(-1, dim + 1)
    index_map, own = topology.index_map(dim - 1), np.intersect1d(sided.regions[region], cells)
    of_region, of_all = (summed(index_map, facets[each]) for each in (own, cells))
    between = (of_region == 1.0) & (of_all == 2.0)
    return np.flatnonzero(between[: index_map.size_local]).astype(np.int32)


def _bulges(ids: Indices, x: Array, sides: Indices) -> dict[int, float]:
    """Return for combinations of sides with arcs how far smooth curves are from the facets.

    Args:
        ids: The vertices of all facets of the boundary, shape (facets, vertices).
        x: Their coordinates, shape (facets, vertices, 3).
        sides: The combination of each facet.
    """
    count, dim = ids.shape
    # Between two facets is a vertex, or an edge in space; altitudes on both sides tell the turn.
    opposite = others(dim - 1)
    ridges = np.concatenate([np.sort(ids[:, o], axis=1) for o in opposite])
    heights = np.concatenate([_heights(x[:, i], x[:, o]) for i, o in enumerate(opposite)])
    keys = np.column_stack((np.tile(sides, dim), ridges))
    order = np.lexsort(keys.T)
    _, first, number = np.unique(keys[order], axis=0, return_index=True, return_counts=True)
    pairs = np.stack((order[first[number == 2]], order[first[number == 2] + 1]), axis=1)
    lengths = np.linalg.norm(heights, axis=1)
    units = heights[pairs] / lengths[pairs][..., None]
    turns = 2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(units.sum(axis=1), axis=1), 1.0))
    bent = (turns > FLAT) & (turns < SHARP)
    pairs, turns = pairs[bent], turns[bent]
    around = np.bincount((pairs % count).ravel(), minlength=count) >= 2
    smooth = around[pairs % count].all(axis=1)
    away = dim * turns * lengths[pairs].max(axis=1) / 16.0  # of a circle, or of a sphere
    result: dict[int, float] = {}
    for side, distance in zip(sides[pairs[smooth, 0] % count], away[smooth], strict=True):
        result[int(side)] = max(float(distance), result.get(int(side), 0.0))
    return result


def _heights(tips: Array, ridges: Array) -> Array:
    """The altitudes from points or edges to the opposite vertices of facets."""
    ways = tips - ridges[:, 0]
    if ridges.shape[1] == 1:
        return np.asarray(ways)
    along = ridges[:, 1] - ridges[:, 0]
    shares = (ways * along).sum(axis=1) / (along**2).sum(axis=1)
    return np.asarray(ways - shares[:, None] * along)
