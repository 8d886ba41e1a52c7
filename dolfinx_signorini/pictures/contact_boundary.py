"""The contact boundary of a solved problem, or its cells with obstacles, on rank 0."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np
from dolfinx import fem

from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices, Mask, by_place
from dolfinx_signorini.base.ranks import function_with, highest, marked
from dolfinx_signorini.base.tolerances import ROUNDING, SIX_DIGITS
from dolfinx_signorini.meshes.components import components
from dolfinx_signorini.meshes.elements import (
    determined,
    facet_dofs,
    facet_pieces,
    values_at_control_points,
)
from dolfinx_signorini.meshes.sided_meshes import (
    SidedMesh,
    facet_cells,
    owned_cells,
    owned_facets,
    simplex_sizes,
)
from dolfinx_signorini.norms.boundary_edges import edge_chains
from dolfinx_signorini.pictures.triangles import cell_pieces, gathered

# Of the range of u, times (h / L)^{3/2} with the mesh width h and the size L of the boundary: a
# smaller gap is what a mesh cannot tell from contact (a gap opens like r^{3/2}).
CLEAR = 0.3


class Solved(Protocol):
    """The part of a solved problem that this module needs."""

    sign: float
    unknown: str
    space: fem.FunctionSpace
    u: fem.Function

    @property
    def contact(self) -> LocalIndices:
        """The facets, or cells, with an obstacle that this rank knows."""

    @property
    def fixed_dofs(self) -> LocalIndices:
        """The owned dofs with Dirichlet data."""

    @property
    def obstacle_nodes(self) -> LocalIndices:
        """The owned dofs with an obstacle, with or without Dirichlet data."""

    @property
    def gap(self) -> fem.Function:
        """The gap."""

    @property
    def pressure(self) -> fem.Function:
        """The density of the contact pressure."""


@dataclass
class AlongDirection:
    """The contact of a displacement along the direction of the obstacle, as that of a scalar.

    What draws and gathers the contact boundary of scalar problems takes the object:

        boundary = gather_contact_boundary(problem.along_direction)

    Attributes:
        space: The scalar space of one component.
        u: The displacement u.d at the contact nodes, 0 elsewhere, with d as it is given.
        gap, pressure: As those of the problem.
        contact: The contact facets that this rank knows.
        obstacle_nodes: The owned nodes of these facets.
        fixed_dofs: The contact nodes that Dirichlet data hold.
        directions: The unit vectors d at the contact nodes, 0 elsewhere.
        distance: The distance at rest from each contact node to the obstacle along d, 0 elsewhere.
        sign: -1, as of an upper obstacle.
        unknown: The name of u, as matplotlib sets it.
    """

    space: fem.FunctionSpace
    u: fem.Function
    gap: fem.Function
    pressure: fem.Function
    contact: LocalIndices
    obstacle_nodes: LocalIndices
    fixed_dofs: LocalIndices
    directions: fem.Function
    distance: fem.Function
    sign: float = -1.0
    unknown: str = r"u \cdot d"


@dataclass(frozen=True)
class ContactBoundary:
    """Points and straight pieces of the contact boundary.

    The contact boundary of a solved problem, on rank 0:

        boundary = gather_contact_boundary(problem)
        if boundary is not None:
            print(boundary.sizes[boundary.in_contact].sum())

    Attributes:
        points: Coordinates of the contact dofs, shape (points, dimension), sorted.
        values: u, gap and pressure density there, shape (points, 3); the pressure is NaN where it
            is not known, see `Touching`.
        pieces: The facets as indices of points, shape (pieces, dimension); in the plane a facet is
            as many pieces as its degree.
        touching: Whether u is (but for rounding) at the obstacle there.
        clear: Whether the gap is large against the accuracy of the mesh.
        upper: Whether the obstacle is an upper one.
        unknown: The name of u, as matplotlib sets it.
        names: The names of sides.
        sides: For each piece the number of its side in `names`, -1 for none; empty without names.
    """

    points: Array
    values: Array
    pieces: Indices
    touching: Mask
    clear: Mask
    upper: bool
    unknown: str = "u"
    names: tuple[str, ...] = ()
    sides: Indices = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @property
    def sizes(self) -> Array:
        """Length or area of each piece."""
        return simplex_sizes(self.points[self.pieces])

    @property
    def in_contact(self) -> Mask:
        """Whether a piece touches the obstacle with all of its points."""
        return np.asarray(self.touching[self.pieces].all(axis=1))

    @property
    def undecided(self) -> Mask:
        """Whether a piece is not in contact, but nowhere clear of the obstacle either."""
        return np.asarray(~self.in_contact & ~self.clear[self.pieces].any(axis=1))

    def measured(self, points: Sequence[Sequence[float]] = ()) -> tuple[float, float]:
        """Return the sizes of the contact set and of what is undecided.

        In the plane both reach to the points where contact ends, as far as these are known: a piece
        in which contact ends belongs to both sides of its point, and is decided.

        Args:
            points: The positions of detachment points.
        """
        sizes, open_piece = self.sizes, self.undecided
        total = float(sizes[self.in_contact].sum())
        held = self.touching[self.pieces]
        ends = np.flatnonzero(held.any(axis=1) & ~held.all(axis=1))
        inner, outer = (
            self.points[self.pieces[ends, np.where(held[ends, 0] == first, 0, 1)]]
            for first in (True, False)
        )
        for point in points if len(ends) else ():
            end = int(np.argmin(np.linalg.norm(0.5 * (inner + outer) - point, axis=1)))
            total += float((point - inner[end]) @ (outer - inner)[end]) / float(sizes[ends[end]])
            open_piece[ends[end]] = False
        return total, float(sizes[open_piece].sum())

    def chains(self) -> list[Indices]:
        """Return the points in order along each connected part of a plane contact boundary."""
        return [points for points, _ in self.curves()]

    def curves(self) -> list[tuple[Indices, Indices]]:
        """Return the points and the pieces in order along each part, see `chains`."""
        pieces = self.pieces.copy()
        crowded = np.bincount(pieces.ravel())[pieces] > 2  # where a domain touches itself
        pieces[crowded] = len(self.points) + np.arange(np.count_nonzero(crowded))
        found = []
        for rows, ends in (curve.T for curve in edge_chains(pieces)):
            points = np.append(self.pieces[rows[0], ends[0]], self.pieces[rows, 1 - ends])
            found.append((points, rows))
        return found


class ContactRegion(ContactBoundary):
    """Points and simplices of the cells with an obstacle; see `ContactBoundary`.

    The pieces lie between neighbouring dofs in the plane, and are the cells in space.
    """

    def measured(self, points: Sequence[Sequence[float]] = ()) -> tuple[float, float]:
        """Return the size of the contact set; nothing is undecided.

        A piece counts by the share of its points that touch: with linear elements the size is the
        integral of the basis functions of the dofs in contact.

        Args:
            points: None, because contact ends along curves.
        """
        return float(self.sizes @ self.touching[self.pieces].mean(axis=1)), 0.0


Kind = TypeVar("Kind", bound=ContactBoundary)


def gather_contact_region(problem: Solved) -> ContactRegion | None:
    """Return the cells with an obstacle of a solved problem on rank 0, and None on the others.

    Args:
        problem: The problem, with obstacles in the domain; the call is collective.
    """
    space = problem.space
    cells = problem.contact[problem.contact < len(owned_cells(space.mesh))]
    used, pieces = np.unique(space.dofmap.list[cells]), cell_pieces(space, cells)
    return _gathered(ContactRegion, problem, used, pieces, np.full(len(pieces), -1))


def gather_contact_boundary(
    problem: Solved, sides: Mapping[str, LocalIndices] | None = None
) -> ContactBoundary | None:
    """Return the contact boundary of a solved problem on rank 0, and None on the others.

    Args:
        problem: The problem; the call is collective.
        sides: Facets of the mesh by the name of their side, for pictures.

    Raises:
        InputError: The sides have other facets than those of the mesh.
    """
    space = problem.space
    domain = space.mesh
    facets = owned_facets(domain, problem.contact)
    pairs = facet_cells(domain, facets)
    named: Indices = np.full(len(facets), -1)
    sides = SidedMesh(domain, {} if sides is None else sides).sides
    for number, part in enumerate(sides.values()):
        named[np.isin(facets, part)] = number
    pieces, owners = facet_pieces(space, pairs)
    used = np.unique(facet_dofs(space, pairs))
    return _gathered(ContactBoundary, problem, used, pieces, named[owners], tuple(sides))


@dataclass(frozen=True)
class Touching:
    """Where u is at the obstacle, as the dofs of this rank tell; the call is collective:

        touching = determined(contact.space, Touching(contact).nodes)

    The size of u depends on its origin, which is anyone's choice where no reaction has another one.
    What is small is told by the range of u on the obstacle, for each connected part of the mesh:
    one body says nothing about another one.

    Args:
        contact: The solved problem.
    """

    contact: Solved

    @cached_property
    def parts(self) -> Indices:
        """The number of the part of the mesh that each dof belongs to."""
        space, own = self.contact.space, components(self.contact.space).numbers
        numbers = function_with(space, np.arange(len(own)), own)
        return np.rint(numbers.x.array).astype(np.int64)

    @cached_property
    def ranges(self) -> Array:
        """The range of u on the obstacle of the part of the mesh that each dof belongs to."""
        comm, nodes = self.contact.space.mesh.comm, self.contact.obstacle_nodes
        count = 1 + max(comm.allgather(self.parts.max(initial=-1)))
        ends, values = np.full((2, count), -np.inf), self.contact.u.x.array[nodes]
        for found, u in zip(ends, (-values, values), strict=True):
            np.maximum.at(found, self.parts[nodes], u)
        sums = np.max(comm.allgather(ends), axis=0).sum(axis=0)
        return np.asarray(np.maximum(sums, 0.0)[self.parts])

    @cached_property
    def fixed(self) -> Mask:
        """Whether Dirichlet data hold a dof."""
        return marked(self.contact.space, self.contact.fixed_dofs)

    @cached_property
    def nodes(self) -> Mask:
        """Whether the gap vanishes but for rounding; of Dirichlet data, but for six digits."""
        gap, u = self.contact.gap.x.array, self.contact.u.x.array
        tiny = ROUNDING * highest(self.contact.space.mesh.comm, np.abs(u))
        return gap <= np.maximum(np.where(self.fixed, SIX_DIGITS, 0.0) * self.ranges, tiny)

    @cached_property
    def known_pressure(self) -> Mask:
        """Whether the pressure is known at the place of a dof.

        Where Dirichlet data lie at the obstacle, the force is that of the data, of which nobody
        knows the share of the obstacle; in the Bernstein basis it has a share in the values on
        whole facets.
        """
        return determined(self.contact.space, ~(self.fixed & self.nodes))


def _gathered(
    kind: type[Kind],
    problem: Solved,
    used: LocalIndices,
    pieces: LocalIndices,
    sides: Indices,
    names: tuple[str, ...] = (),
) -> Kind | None:
    """The points and pieces of all ranks on rank 0, None on the others.

    Both have the order of their places, so that the number of ranks does not show.

    Args:
        kind: The class of what is returned.
        problem: The problem; the call is collective.
        used: The dofs of the pieces, and more that are wanted.
        pieces: The dofs of each piece of this rank.
        sides: The number of the side of each piece.
        names: The names of the sides.
    """
    space, told = problem.space, Touching(problem)
    fields = problem.u, problem.gap, problem.pressure
    u, gap, pressure = (values_at_control_points(space, field.x.array) for field in fields)
    known = np.where(told.known_pressure, pressure, np.nan)
    columns = u, gap, known, determined(space, told.nodes), told.ranges, told.parts
    rows = np.column_stack([column[used] for column in columns])
    found = gathered(space, used, rows, pieces, sides)
    if found is None:
        return None
    points, rows, corners, sides = found
    order = by_place(points)
    corners = np.sort(np.argsort(order)[corners], axis=1)
    in_order = np.lexsort(corners.T[::-1])
    corners, sides = corners[in_order], sides[in_order]
    points, values, (touching, ranges, parts) = points[order], rows[order, :3], rows[order, 3:].T
    widths = np.linalg.norm(points[corners[:, 1]] - points[corners[:, 0]], axis=1)
    extent = float(np.ptp(points, axis=0).max())
    points[np.abs(points) < ROUNDING * extent] = 0.0
    clear = np.zeros(len(points), dtype=bool)
    for part in np.unique(parts):
        own = parts == part
        length = widths[own[corners[:, 0]]].max() / np.ptp(points[own], axis=0).max()
        clear[own] = values[own, 1] > CLEAR * ranges[own] * length**1.5
    named = problem.sign < 0.0, problem.unknown, names, sides
    return kind(points, values, corners, touching > 0.0, clear, *named)
