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
import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.bounds.condensation import (
    CLOSED,
    DIRICHLET,
    NEUMANN,
    OPEN,
    PARTLY,
    CellData,
    condensed,
    contact_shapes,
    divergences,
    hats,
)
from dolfinx_signorini.bounds.reference_flux import MOST_NUMBERS, ReferenceFlux, others

# What is free on contact facets, see `patch_fluxes`.
FREE, HALF, SPREAD = range(3)


def patch_fluxes(data: CellData, reference: ReferenceFlux, here: Mask, modes: Indices) -> Array:
    """Return the moments of the sum of the fields of patches on the facets of each cell.

    Args:
        data: The cells around the vertices, all of them.
        reference: The fields.
        here: Whether the field of a vertex is to be computed, shape (cells, d + 1).
        modes: The contact facets at a vertex where the flux is the one that costs the least energy,
            of any sign, and not given: closed and partly closed facets for `FREE`, closed ones for
            `HALF`, none for `SPREAD`.

    Returns:
        The moments of the outward fluxes, shape (cells, d + 1, moments).
    """
    if not here.any():
        return np.zeros((*here.shape, reference.per_facet))
    guess = np.zeros((*here.shape, reference.dimension + 1))
    if (here & (modes > FREE)).any():
        free = _fields(data, reference, here, np.zeros_like(modes), guess)
        guess = free.reshape(*guess.shape, reference.per_facet)[..., 0]
    sums = _fields(data, reference, here, modes, guess).sum(axis=1)
    return sums.reshape(*here.shape, reference.per_facet)


def _fields(
    data: CellData, reference: ReferenceFlux, here: Mask, modes: Indices, guess: Array
) -> Array:
    """The moments on facets for each cell and vertex, shape (cells, d + 1, fluxes).

    The guess has total fluxes for each cell, vertex and facet, where any flux is balanced.
    """
    d = reference.dimension
    patches = _Patches(data, here, modes)
    (energies, forces), divergence = condensed(data, reference), divergences(data, reference)
    known = _known(data, reference, patches, divergence, modes, guess)
    total = divergence[:, :, 0] - known[..., 0].sum(axis=2)
    total = patches.balanced(total, data.sizes[:, :1])
    flat = known.reshape(*here.shape, reference.fluxes)
    forces = forces - flat @ energies
    slack = data.strength * data.sizes[:, 0]
    for cells, vertices, unknowns, signs, count, closed in patches.groups(reference):
        at_vertex = others(d)[vertices]
        moments = at_vertex[..., None] * reference.per_facet + np.arange(reference.per_facet)
        moments = moments.reshape(*vertices.shape, -1)
        rows, columns = moments[..., :, None], moments[..., None, :]
        K = energies[cells[..., None, None], rows, columns]
        b = forces[cells[..., None], vertices[..., None], moments]
        x = _solved(K, b, total[cells, vertices], slack[cells], unknowns, signs, count, closed)
        flat[cells[..., None], vertices[..., None], moments] += x
    return flat


class _Patches:
    """Which cells form the patch of which vertex."""

    def __init__(self, data: CellData, here: Mask, modes: Indices):
        self.shape = here.shape
        self.slack = (data.strength > 0.0)[:, None] & here
        corners = np.flatnonzero(here)  # pairs of a cell and one of its vertices
        self.names, vertex = np.unique(data.vertices.ravel()[corners], return_inverse=True)
        order = np.argsort(vertex, kind="stable")
        self.corners, self.vertex = corners[order], vertex[order].ravel()
        self.number = np.zeros(here.size, dtype=np.int64)
        self.number[self.corners] = self.vertex
        self.here = here
        at = others(here.shape[1] - 1)[self.corners % here.shape[1]]
        cells = self.corners // here.shape[1]
        self.facets, self.kind = data.facets[cells[:, None], at], data.kinds[cells[:, None], at]
        mode = modes.ravel()[self.corners][:, None]
        free = ((self.kind == CLOSED) & (mode < SPREAD)) | ((self.kind == PARTLY) & (mode == FREE))
        self.kind[free] = DIRICHLET  # any flux is balanced on both

    def sums(self, values: Array) -> Array:
        """The sums over patches of values for cells and vertices, as such values again."""
        weights = values.ravel()[self.corners]
        total = np.bincount(self.vertex, weights, len(self.names))
        return np.where(self.here, total[self.number].reshape(self.shape), 0.0)

    @functools.cached_property
    def held(self) -> Mask:
        """Whether the patch of a cell and vertex has a facet at the vertex with any flux."""
        count = np.zeros(self.shape)
        count.ravel()[self.corners] = (self.kind == DIRICHLET).sum(axis=1)
        return np.asarray(self.sums(count) > 0.0)

    def _at_vertex(self, values: npt.NDArray[np.generic]) -> Array:
        """For each vertex of a cell the sum of values of facets over the facets with the vertex."""
        sums = values.sum(axis=1, dtype=np.float64)[:, None] - values
        return np.asarray(sums)

    def at_vertex(self, values: Array) -> Array:
        """The sums over the facets at a vertex, in the whole patch."""
        return self.sums(self._at_vertex(values))

    def balanced(self, total: Array, sizes: Array) -> Array:
        """Return total outward fluxes of cells that add up to zero where no facet is free.

        Args:
            total: The total flux of each cell for each vertex, shape (cells, d + 1).
            sizes: The sizes of the cells, which share what is left over, shape (cells, 1).
        """
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
            and whether the sum of the total fluxes of the cells in a patch is given.
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
    data: CellData,
    reference: ReferenceFlux,
    patches: _Patches,
    divergence: Array,
    modes: Indices,
    guess: Array,
) -> Array:
    """The given moments on facets, shape (cells, vertices d + 1, facets d + 1, moments)."""
    d = reference.dimension
    known = np.zeros((len(data.kinds), d + 1, d + 1, reference.per_facet))
    given = np.flatnonzero((data.kinds == NEUMANN).any(axis=1))
    known[given] = np.einsum("ckj,akjl->cakl", data.fluxes[given], hats(reference))
    force = patches.sums(divergence[:, :, 0] - known[..., 0].sum(axis=2))
    cells = np.flatnonzero((data.kinds >= OPEN).any(axis=1))
    known[cells] += _pressing(data, reference, patches, force, modes, guess, cells)
    known[~patches.here] = 0.0
    return known


def _pressing(
    data: CellData,
    reference: ReferenceFlux,
    patches: _Patches,
    force: Array,
    modes: Indices,
    guess: Array,
    cells: Indices,
) -> Array:
    """The given contact fluxes of some cells, as `_known` returns them.

    The force of a contact vertex is spread over the closed facets at the vertex, or else the partly
    closed ones, or else all contact facets.
    """
    d, kinds, sizes = reference.dimension, data.kinds[cells], data.sizes[cells, 1:]
    shapes, held = contact_shapes(data, reference, cells), patches.held[cells]
    partly, closed = (
        patches.at_vertex((data.kinds == kind).astype(np.float64))[cells] > 0.0
        for kind in (PARTLY, CLOSED)
    )
    level = np.where(closed, CLOSED, np.where(partly, PARTLY, OPEN))
    at_vertex = ~np.eye(d + 1, dtype=bool)
    chosen = (kinds[:, None, :] == level[:, :, None]) & at_vertex
    area = np.zeros(data.kinds.shape)
    area[cells] = (chosen * sizes[:, None, :] * shapes[..., 0]).sum(axis=2)
    area = patches.sums(area)[cells]
    density = np.maximum(force[cells], 0.0) / np.where(area > 0.0, area, np.inf)
    amount = np.where(held, 0.0, density)[:, :, None] * chosen
    # Where some facet is free any other flux is balanced.
    last = (modes[cells] == SPREAD)[:, :, None] & (kinds[:, None, :] == CLOSED)
    last |= (modes[cells] > FREE)[:, :, None] & (kinds[:, None, :] == PARTLY)
    last &= held[:, :, None] & at_vertex
    means = np.where(last, sizes[:, None, :] * shapes[..., 0], 1.0)
    amount += np.where(last, np.maximum(guess[cells], 0.0) / means, 0.0)
    return np.asarray(amount[..., None] * sizes[:, None, :, None] * shapes)


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
    """The fluxes of least energy for given total fluxes of the cells of patches.

    Where a cell has slack, other total fluxes are allowed, and cost energy.

    Args:
        K, b: Matrices and forces of the cells, shape (patches, cells, d moments, ...).
        total: The total outward fluxes of the cells.
        slack: The slack of the cells.
        unknowns, signs, count, closed: See `_Patches.groups`.

    Returns:
        The moments on the facets at the vertex, shape (patches, cells, d * moments).
    """
    patches, cells, width = b.shape
    if not patches or not count:
        return np.zeros_like(b)
    moments = width // signs.shape[2]
    size, rows = count * moments, cells - closed
    last = size + rows  # takes up what is given
    place = np.where(unknowns[..., None] >= 0, unknowns[..., None] * moments, last)
    place = np.where(place < last, place + np.arange(moments), last).reshape(b.shape)
    sign = np.repeat(signs, moments, axis=-1).astype(np.float64)
    scale = np.einsum("pcii,pci->p", K, sign**2) / size
    patch, shape = np.arange(patches)[:, None, None], (patches, last + 1, last + 1)
    at = (patch[..., None] * shape[1] + place[..., :, None]) * shape[1] + place[..., None, :]
    entries = K * (sign / scale[:, None, None])[..., :, None] * sign[..., None, :]
    whole = np.bincount(at.ravel(), entries.ravel(), math.prod(shape)).reshape(shape)
    cell = size + np.arange(rows)[:, None]
    facet, inward = place[:, :rows, ::moments], sign[:, :rows, ::moments]
    whole[patch, cell, facet] = whole[patch, facet, cell] = inward
    whole[:, cell[:, 0], cell[:, 0]] = -slack[:, :rows] * scale[:, None]
    load = b * sign / scale[:, None, None]
    right = np.bincount((patch * shape[1] + place).ravel(), load.ravel(), patches * shape[1])
    right = right.reshape(shape[:2])
    right[:, size:last] = total[:, :rows]
    system, right = whole[:, :last, :last], right[:, :last]
    try:
        x = np.linalg.solve(system, right[..., None])[..., 0]
    except np.linalg.LinAlgError:  # the cells at a vertex where the domain touches itself
        x = (np.linalg.pinv(system, hermitian=True) @ right[..., None])[..., 0]
    x = np.concatenate((x, np.zeros((patches, 1))), axis=1)
    return np.asarray(np.take_along_axis(x[:, None, :], place, axis=2) * sign)
