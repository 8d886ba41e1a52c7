"""The contact boundary of a solved scene, gathered on rank 0 for summary, CSV and pictures."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinx_signorini.meshes import facet_cells
from dolfinx_signorini.scenes.solving import SceneResult

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

# Gaps relative to the largest |u|: what is rounding, and, times (h / L)^{3/2} with the mesh width h
# and the size L of the boundary, what a mesh cannot tell from contact (a gap opens like r^{3/2}).
TOUCHING = 1e-6
CLEAR = 0.3
ROUNDING = 1e-12  # of coordinates, relative to L
NEAR = 3  # pieces from the end of a contact set to a clear gap, at its detachment point


@dataclass(frozen=True)
class ContactBoundary:
    """Points and straight pieces of the contact boundary.

    Attributes:
        points: Coordinates of the contact dofs, shape (points, dimension), sorted.
        values: u, gap and pressure density there, shape (points, 3); the pressure is NaN where
            u has Dirichlet data, whose force it would be part of.
        pieces: The facets as indices of points, shape (pieces, dimension); a facet of degree 2 in
            the plane is two pieces.
        touching: Whether the gap of a point is (but for rounding) zero.
        clear: Whether it is large against the accuracy of the mesh.
    """

    points: Array
    values: Array
    pieces: Indices
    touching: npt.NDArray[np.bool_]
    clear: npt.NDArray[np.bool_]

    @property
    def sizes(self) -> Array:
        """Length or area of each piece."""
        x = self.points[self.pieces]
        edges = x[:, 1:] - x[:, :1]
        gram = np.einsum("fik,fjk->fij", edges, edges)
        return np.sqrt(np.linalg.det(gram)) / (1.0 if self.points.shape[1] == 2 else 2.0)

    @property
    def in_contact(self) -> npt.NDArray[np.bool_]:
        """Whether a piece touches the obstacle with all of its points."""
        return np.asarray(self.touching[self.pieces].all(axis=1))

    @property
    def undecided(self) -> npt.NDArray[np.bool_]:
        """Whether a piece is not in contact, but nowhere clear of the obstacle either."""
        return np.asarray(~self.in_contact & ~self.clear[self.pieces].any(axis=1))

    @property
    def detachment_points(self) -> Array:
        """The ends of the contact set where u leaves the obstacle, in the plane; shape (n, 2)."""
        contact = self.in_contact
        ends = np.intersect1d(self.pieces[contact], self.pieces[~contact])
        near = self.clear.copy()
        for _ in range(NEAR):
            near[self.pieces[near[self.pieces].any(axis=1)]] = True
        return self.points[ends[near[ends]]]

    def chains(self) -> list[Indices]:
        """Return the points in order along each connected part of a plane contact boundary."""
        links: dict[int, list[int]] = {}
        for piece in self.pieces:
            a, b = int(piece[0]), int(piece[1])
            links.setdefault(a, []).append(b)
            links.setdefault(b, []).append(a)
        chains = []
        # Ends first; what is left are closed curves.
        for start in sorted(links, key=lambda i: (len(links[i]) != 1, i)):
            if not links[start]:
                continue
            chain = [start]
            while links[chain[-1]]:
                following = links[chain[-1]].pop(0)
                links[following].remove(chain[-1])
                chain.append(following)
            chains.append(np.array(chain, dtype=np.int64))
        return chains


def gather_boundary(result: SceneResult) -> ContactBoundary | None:
    """Gather the contact boundary; None on all ranks but 0. The call is collective."""
    problem = result.posed.problem
    space = problem.space
    domain, index_map = space.mesh, space.dofmap.index_map
    tdim = domain.topology.dim
    count = domain.topology.index_map(tdim - 1).size_local
    pairs = facet_cells(domain, problem.contact[problem.contact < count])
    closures = np.array(space.element.basix_element.entity_closure_dofs[tdim - 1])
    local = space.dofmap.list[pairs[:, 0, None], closures[pairs[:, 1]]]
    fixed = fem.Function(space)
    fixed.x.array[problem.fixed_dofs] = 1.0
    fixed.x.scatter_forward()
    pieces = local[:, :tdim]
    if tdim == 2 and space.element.basix_element.degree == 2 and len(local):
        pieces = np.concatenate((local[:, [0, 2]], local[:, [2, 1]]))
    used = np.unique(local)
    pressure = result.pressure.x.array[used].copy()
    pressure[fixed.x.array[used] > 0.0] = np.nan
    data = (
        index_map.local_to_global(used),
        space.tabulate_dof_coordinates()[used][:, :tdim],
        np.stack((result.u.x.array[used], result.gap.x.array[used], pressure), axis=1),
        index_map.local_to_global(pieces.flatten()).reshape(-1, tdim),
    )
    parts = domain.comm.gather(data, root=0)
    return None if parts is None else _merge(parts)


def _merge(parts: list[tuple[Indices, Array, Array, Indices]]) -> ContactBoundary:
    """Number the points of all ranks by their place, so that the number of ranks does not show."""
    numbers, points, values, pieces = (np.concatenate(item) for item in zip(*parts, strict=True))
    numbers, first = np.unique(numbers, return_index=True)
    points, values = points[first], values[first]
    order = np.lexsort(np.round(points, 12).T[::-1])
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    pieces = np.sort(place[np.searchsorted(numbers, pieces)], axis=1)
    pieces = pieces[np.lexsort(pieces.T[::-1])]
    points, values = points[order], values[order]
    size, gap = float(np.abs(values[:, 0]).max(initial=0.0)), values[:, 1]
    widths = np.linalg.norm(points[pieces[:, 1]] - points[pieces[:, 0]], axis=1)
    extent = float(np.ptp(points, axis=0).max())
    points[np.abs(points) < ROUNDING * extent] = 0.0
    clear = gap > CLEAR * size * (float(widths.max()) / extent) ** 1.5
    return ContactBoundary(points, values, pieces, gap <= TOUCHING * size, clear)
