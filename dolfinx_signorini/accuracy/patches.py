"""Fluxes equilibrated on the patches of cells around vertices, many patches at a time.

For the hat function phi of a vertex the patch has the field y, of least distance to
phi A grad u, with

    div y = the projection of phi (c u - f) + grad phi . A grad u    in each cell,
    y.n = 0 where phi vanishes, a given flux on Neumann and contact facets.

The sum of these fields over all vertices is in H(div) and has the divergence c u - f.

Source: Braess and Schoeberl, Math. Comp. 77 (2008) 651-672; Ern and Vohralik, SIAM J. Numer. Anal.
53 (2015) 1058-1081.
"""

import functools
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from dolfinx_signorini.accuracy.condensation import (
    CLOSED,
    DIRICHLET,
    NEUMANN,
    OPEN,
    CellData,
    condensed,
    divergences,
)
from dolfinx_signorini.accuracy.reference_flux import ReferenceFlux

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Marks = npt.NDArray[np.bool_]

MOST_NUMBERS = 4_000_000  # of the matrices that are solved at once


def patch_fluxes(data: CellData, reference: ReferenceFlux, here: Marks, free: Marks) -> Array:
    """Return the moments of the sum of the fields of patches on the facets of each cell.

    Args:
        data: The cells around the vertices, all of them.
        reference: The fields.
        here: Whether the field of a vertex is to be computed, shape (cells, d + 1).
        free: Whether the flux on closed contact facets at a vertex is what costs the least energy,
            of any sign, and not given.

    Returns:
        Shape (cells, d + 1, moments): outward fluxes.
    """
    d = reference.dimension
    if not here.any():
        return np.zeros((len(here), d + 1, reference.per_facet))
    patches = _Patches(data, here, free)
    (energies, forces), divergence = condensed(data, reference), divergences(data, reference)
    known = _known(data, reference, patches, divergence, free)
    total = divergence[:, :, 0] - known[..., 0].sum(axis=2)
    total = patches.balanced(total, data.sizes[:, :1])
    flat = known.reshape(*here.shape, reference.fluxes)
    forces = forces - flat @ energies
    slack = data.strength * data.sizes[:, 0]
    for cells, vertices, unknowns, signs, count, closed in patches.groups(reference):
        others = _others(d)[vertices]  # the facets at the vertex
        moments = others[..., None] * reference.per_facet + np.arange(reference.per_facet)
        moments = moments.reshape(*vertices.shape, -1)
        rows, columns = moments[..., :, None], moments[..., None, :]
        K = energies[cells[..., None, None], rows, columns]
        b = forces[cells[..., None], vertices[..., None], moments]
        x = _solved(K, b, total[cells, vertices], slack[cells], unknowns, signs, count, closed)
        flat[cells[..., None], vertices[..., None], moments] += x
    return flat.sum(axis=1).reshape(len(here), d + 1, -1)


def _others(d: int) -> Indices:
    """For each vertex of a simplex the facets that have this vertex."""
    return np.array([[k for k in range(d + 1) if k != a] for a in range(d + 1)])


class _Patches:
    """Which cells form the patch of which vertex."""

    def __init__(self, data: CellData, here: Marks, free: Marks):
        self.shape = here.shape
        self.slack = (data.strength > 0.0)[:, None] & here
        corners = np.flatnonzero(here)  # pairs of a cell and one of its vertices
        self.names, vertex = np.unique(data.vertices.ravel()[corners], return_inverse=True)
        order = np.argsort(vertex, kind="stable")
        self.corners, self.vertex = corners[order], vertex[order].ravel()
        self.number = np.zeros(here.size, dtype=np.int64)
        self.number[self.corners] = self.vertex
        self.here = here
        at = _others(here.shape[1] - 1)[self.corners % here.shape[1]]
        cells = self.corners // here.shape[1]
        self.facets, self.kind = data.facets[cells[:, None], at], data.kinds[cells[:, None], at]
        free_here = free.ravel()[self.corners][:, None] & (self.kind == CLOSED)
        self.kind[free_here] = DIRICHLET  # any flux is balanced on both

    def sums(self, values: Array) -> Array:
        """The sums over patches of values for cells and vertices, as such values again."""
        weights = values.ravel()[self.corners]
        total = np.bincount(self.vertex, weights, len(self.names))
        return np.where(self.here, total[self.number].reshape(self.shape), 0.0)

    @functools.cached_property
    def held(self) -> Marks:
        """Whether the patch of a cell and vertex has a facet at the vertex with any flux."""
        count = np.zeros(self.shape)
        count.ravel()[self.corners] = (self.kind == DIRICHLET).sum(axis=1)
        return np.asarray(self.sums(count) > 0.0)

    def _at_vertex(self, values: npt.NDArray[np.generic]) -> Array:
        """The sum of values of facets over those facets that have the vertex."""
        sums = values.sum(axis=1, dtype=np.float64)[:, None] - values
        return np.asarray(sums)

    def at_vertex(self, values: Array) -> Array:
        """The sums over the facets at a vertex, in the whole patch."""
        return self.sums(self._at_vertex(values))

    def balanced(self, total: Array, sizes: Array) -> Array:
        """Return total outward fluxes of cells that add up to zero where no facet is free."""
        defect = np.where(self.held, 0.0, self.sums(total))
        shares = np.broadcast_to(sizes, self.shape)
        area = np.where(self.here, self.sums(shares), 1.0)
        return np.asarray(total - defect * shares / area)

    def groups(
        self, reference: ReferenceFlux
    ) -> Iterator[tuple[Indices, Indices, Indices, Indices, int, bool]]:
        """Yield patches with the same numbers of cells and facets.

        Yields:
            Cells and vertices, shape (patches, cells), for each facet at the vertex its number in
            the patch and its sign, shape (patches, cells, d), the number of such facets in a patch,
            and whether the sum of the total fluxes of its cells is given.
        """
        unknown = self.kind <= DIRICHLET
        keys = np.where(unknown, self.vertex[:, None] * (self.facets.max(initial=0) + 1), -1)
        keys = np.where(unknown, keys + self.facets, -1)
        names, first, inverse = np.unique(keys.ravel(), return_index=True, return_inverse=True)
        inverse = inverse.reshape(keys.shape)
        signs = np.where(first[inverse] == np.arange(keys.size).reshape(keys.shape), 1, -1)
        signs[~unknown] = 0
        owner = np.zeros(len(names), dtype=np.int64)
        owner[inverse] = self.vertex[:, None]
        count = np.bincount(owner[names >= 0], minlength=len(self.names))
        start = np.searchsorted(owner[names >= 0], np.arange(len(self.names)))
        start = start + np.count_nonzero(names < 0)
        local = np.where(unknown, inverse - start[self.vertex][:, None], -1)
        cells = np.bincount(self.vertex, minlength=len(self.names))
        begin = np.cumsum(cells) - cells
        free = np.bincount(
            self.vertex, (self.kind == DIRICHLET).sum(axis=1), minlength=len(self.names)
        )
        slack = np.bincount(
            self.vertex, self.slack.ravel()[self.corners], minlength=len(self.names)
        )
        table = np.stack((cells, count, free + slack > 0), axis=1)
        kinds, group = np.unique(table, axis=0, return_inverse=True)
        for k, (n, m, open_) in enumerate(kinds):
            size = int(m) * reference.per_facet + int(n)
            members = np.flatnonzero(group.ravel() == k)
            for part in np.array_split(members, 1 + len(members) * size**2 // MOST_NUMBERS):
                rows = begin[part][:, None] + np.arange(n)
                corner = self.corners[rows]
                yield (
                    corner // self.shape[1],
                    corner % self.shape[1],
                    local[rows],
                    signs[rows],
                    int(m),
                    not open_,
                )


def _known(
    data: CellData, reference: ReferenceFlux, patches: _Patches, divergence: Array, free: Marks
) -> Array:
    """The given moments on facets for each cell and vertex, shape (cells, d + 1, d + 1, moments).

    The force of a contact vertex is spread over the closed facets at the vertex, if there are any,
    and over all contact facets at the vertex otherwise, with the hat function as its shape.
    """
    d = reference.dimension
    known = np.zeros((len(data.kinds), d + 1, d + 1, reference.per_facet))
    shapes = np.zeros((d + 1, d + 1, *reference.facet_products.shape[1:]))
    for a in range(d + 1):
        for k in _others(d)[a]:
            shapes[a, k] = reference.facet_products[a - (a > k)]
    given = np.flatnonzero((data.kinds == NEUMANN).any(axis=1))
    known[given] = np.einsum("ckj,akjl->cakl", data.fluxes[given], shapes)
    contact, closed = data.kinds >= OPEN, data.kinds == CLOSED
    touching = patches.at_vertex(closed.astype(np.float64)) > 0.0
    chosen = np.where(touching[:, :, None], closed[:, None, :], contact[:, None, :])
    chosen = chosen & ~np.eye(d + 1, dtype=bool)
    weights = chosen * data.sizes[:, None, 1:] / d
    area = patches.sums(weights.sum(axis=2))
    force = patches.sums(divergence[:, :, 0] - known[..., 0].sum(axis=2))
    density = np.maximum(force, 0.0) / np.where(area > 0.0, area, np.inf)
    pressing = np.where(patches.held[:, :, None], 0.0, density[:, :, None] * chosen)
    # At a vertex with Dirichlet data any flux is balanced: the flux of u is a good one.
    own = -d * np.einsum("ka,ca->ck", reference.gradients, data.current[:, :, 0])
    own = np.where(closed, np.maximum(own, 0.0) / data.sizes[:, 1:], 0.0)
    guessed = patches.held & ~free
    pressing += np.where(guessed[:, :, None] & chosen, own[:, None, :], 0.0)
    pressed = np.flatnonzero(pressing.any(axis=(1, 2)))
    known[pressed] += np.einsum(
        "cak,ck,akl->cakl", pressing[pressed], data.sizes[pressed, 1:], shapes[:, :, 0]
    )
    known[~patches.here] = 0.0
    return known


def _solved(
    K: Array,
    b: Array,
    total: Array,
    slack: Array,
    unknowns: Indices,
    signs: Indices,
    count: int,
    closed: bool,
) -> Array:
    """Solve patches of one kind: the least energy for given total fluxes of the cells.

    Where a cell has slack, other total fluxes are allowed, and cost energy.

    Returns:
        The moments on the facets at the vertex, shape (patches, cells, d * moments).
    """
    patches, cells, width = b.shape
    if not patches or not count:
        return np.zeros_like(b)
    moments = width // signs.shape[2]
    size, rows = count * moments, cells - closed
    place = np.where(unknowns[..., None] >= 0, unknowns[..., None] * moments, size)
    place = np.where(place < size, place + np.arange(moments), size).reshape(b.shape)
    sign = np.repeat(signs, moments, axis=-1).astype(np.float64)
    patch = np.arange(patches)[:, None, None]
    at = (patch[..., None] * (size + 1) + place[..., :, None]) * (size + 1) + place[..., None, :]
    entries = (K * sign[..., :, None] * sign[..., None, :]).ravel()
    full = np.bincount(at.ravel(), entries, patches * (size + 1) ** 2)
    full = full.reshape(patches, size + 1, size + 1)[:, :size, :size]
    load = np.bincount(
        (patch * (size + 1) + place).ravel(), (b * sign).ravel(), patches * (size + 1)
    ).reshape(patches, size + 1)[:, :size]
    scale = np.einsum("pii->p", full)[:, None] / size
    system = np.zeros((patches, size + rows, size + rows))
    system[:, :size, :size] = full / scale[..., None]
    sums = np.zeros((patches, cells, size + 1))
    np.put_along_axis(sums, place[..., ::moments], sign[..., ::moments], axis=2)
    system[:, size:, :size] = sums[:, :rows, :size]
    system[:, :size, size:] = system[:, size:, :size].transpose(0, 2, 1)
    rest = np.arange(size, size + rows)
    system[:, rest, rest] = -slack[:, :rows] * scale
    right = np.concatenate((load / scale, total[:, :rows]), axis=1)
    try:
        x = np.linalg.solve(system, right[..., None])[:, :size, 0]
    except np.linalg.LinAlgError:  # the cells at a vertex where the domain touches itself
        x = (np.linalg.pinv(system, hermitian=True) @ right[..., None])[:, :size, 0]
    x = np.concatenate((x, np.zeros((patches, 1))), axis=1)
    return np.asarray(np.take_along_axis(x[:, None, :], place, axis=2) * sign)
