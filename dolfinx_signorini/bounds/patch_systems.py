"""The linear systems of many patches with equal numbers of cells and facets."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]


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
