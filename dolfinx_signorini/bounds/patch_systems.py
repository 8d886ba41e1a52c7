"""The linear systems of many patches with equal numbers of cells and facets."""

import math

import numpy as np

from dolfinx_signorini.base.arrays import Array, Indices


def solved(
    K: Array,
    b: Array,
    total: Array,
    slack: Array,
    unknowns: Indices,
    signs: Indices,
    count: int,
    closed: bool,
) -> Array:
    """Return the fluxes of least energy for given total fluxes of the cells of patches.

    Where a cell has slack, other total fluxes are allowed, and cost energy.

    Args:
        K, b: Matrices and forces of the cells, shape (patches, cells, d moments, ...).
        total: The total outward fluxes of the cells.
        slack: The slack of the cells.
        unknowns, signs, count, closed: See `patches`.

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
