"""Fluxes equilibrated on the patches of cells around vertices, many patches at a time.

For the hat function phi of a vertex the patch has the field y, of least distance to
phi A grad u, with

    div y = the projection of phi (c u - f) + grad phi . A grad u    in each cell,
    y.n = 0 where phi vanishes, a given flux on Neumann and contact facets.

The sum of these fields over all vertices is in H(div) and has the divergence c u - f.

Source: Braess and Schoeberl, Math. Comp. 77 (2008) 651-672; Ern and Vohralik, SIAM J. Numer. Anal.
53 (2015) 1058-1081.
"""

import math

import numpy as np

from dolfinx_signorini.base.arrays import Array, Indices, Mask, blocks
from dolfinx_signorini.bounds.condensation import (
    CLOSED,
    NEUMANN,
    OPEN,
    PARTLY,
    CellData,
    contact_shapes,
    forces_of,
    hats,
    shapes_of,
)
from dolfinx_signorini.bounds.patch_groups import FREE, SPREAD, Group, Patches
from dolfinx_signorini.bounds.reference_flux import ReferenceFlux
from dolfinx_signorini.meshes.polynomials import others


def patch_fluxes(
    data: CellData, reference: ReferenceFlux, here: Mask, modes: Indices, guess: Array
) -> Array:
    """Return the moments of the fields of patches on the facets at the vertices of each cell.

    Args:
        data: The cells around the vertices, all of them.
        reference: The fields.
        here: Whether the field of a vertex is to be computed, shape (cells, d + 1).
        modes: The contact facets at a vertex where the flux is the one that costs the least energy,
            of any sign, and not given: closed and partly closed facets for `FREE`, closed ones for
            `HALF`, none for `SPREAD`.
        guess: Total fluxes where any flux is balanced, shape (cells, d + 1, d).

    Returns:
        The moments of the outward fluxes, shape (cells, vertices d + 1, facets d, moments), in the
        order of `others`.
    """
    d, n, at = reference.dimension, reference.fluxes, others(reference.dimension)
    result = np.zeros((*here.shape, d, reference.per_facet))
    if not here.any():
        return result
    patches, shapes = Patches(data, here, modes), shapes_of(data, reference)
    forces, total = np.empty_like(result), np.empty(here.shape)
    for cells in blocks(len(here), n * (d + 1)):
        force, total[cells] = forces_of(data, reference, shapes, cells)
        forces[cells] = _at_vertices(force.reshape(*force.shape[:2], d + 1, -1))
    rim = np.flatnonzero((data.kinds == NEUMANN).any(axis=1) | (data.kinds >= OPEN).any(axis=1))
    known = _known(data, reference, patches, total, modes, guess, rim)
    total[rim] -= known[..., 0].sum(axis=2)
    flat = known.reshape(len(rim), d + 1, n)
    more = flat @ shapes.matrices[shapes.number[rim]]
    forces[rim] -= _at_vertices(more.reshape(known.shape))
    result[rim] = _at_vertices(known)
    balanced = patches.balanced(total, data.sizes[:, 0])
    slack = (data.strength * data.sizes[:, 0])[patches.cells]
    own = (at[..., None] * reference.per_facet + np.arange(reference.per_facet)).reshape(d + 1, -1)
    right, fluxes = (values.reshape(here.size, -1) for values in (forces, result))
    for group in patches.groups(data.facets, shapes.number, right.shape[1]):
        corners, first = group.corners, group.corners[group.first]
        moments, shape = own[patches.local[first]], shapes.number[patches.cells[first]]
        K = shapes.matrices[shape[..., None, None], moments[..., :, None], moments[..., None, :]]
        b = right[patches.corners[corners]]
        fluxes[patches.corners[corners]] += _solved(K, b, balanced[corners], slack[first], group)
    return result


def _at_vertices(values: Array) -> Array:
    """What belongs to the facets at each vertex, of arrays of (cells, vertices, facets, ...)."""
    at = others(values.shape[1] - 1)
    return values[:, np.arange(len(at))[:, None], at]


def _known(
    data: CellData,
    reference: ReferenceFlux,
    patches: Patches,
    total: Array,
    modes: Indices,
    guess: Array,
    rim: Indices,
) -> Array:
    """The given moments on facets of cells at the rim, shape (cells, d + 1, d + 1, moments)."""
    known = np.einsum("ckj,akjl->cakl", data.fluxes[rim], hats(reference))
    force = total.copy()
    force[rim] -= known[..., 0].sum(axis=2)
    known += _pressing(data, reference, patches, patches.sums(force, rim), modes, guess[rim], rim)
    known[~patches.here[rim]] = 0.0
    return known


def _pressing(
    data: CellData,
    reference: ReferenceFlux,
    patches: Patches,
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
    shapes = contact_shapes(data, reference, cells)
    held = patches.held[patches.number[cells]] & patches.here[cells]

    def in_patch(values: Array) -> Array:
        """The sums over patches of values of the cells and vertices."""
        every = np.zeros(data.kinds.shape)
        every[cells] = values
        return patches.sums(every, cells)

    at_vertex = ~np.eye(d + 1, dtype=bool)
    partly, closed = (in_patch((kinds == kind) @ at_vertex) > 0.0 for kind in (PARTLY, CLOSED))
    level = np.where(closed, CLOSED, np.where(partly, PARTLY, OPEN))
    chosen = (kinds[:, None, :] == level[:, :, None]) & at_vertex
    area = in_patch((chosen * sizes[:, None, :] * shapes[..., 0]).sum(axis=2))
    # A force at a vertex above the obstacle is an algebraic error, and would pay for a large gap.
    pressed = (area > 0.0) & ((level > OPEN) | (data.touching[cells] > 0))
    density = np.maximum(force, 0.0) / np.where(pressed, area, np.inf)
    amount = np.where(held, 0.0, density)[:, :, None] * chosen
    # Where some facet is free any other flux is balanced.
    last = (modes[cells] == SPREAD)[:, :, None] & (kinds[:, None, :] == CLOSED)
    last |= (modes[cells] > FREE)[:, :, None] & (kinds[:, None, :] == PARTLY)
    last &= held[:, :, None] & at_vertex
    means = np.where(last, sizes[:, None, :] * shapes[..., 0], 1.0)
    total = np.zeros(means.shape)
    total[:, np.arange(d + 1)[:, None], others(d)] = guess
    amount += np.where(last, np.maximum(total, 0.0) / means, 0.0)
    return np.asarray(amount[..., None] * sizes[:, None, :, None] * shapes)


def _solved(K: Array, b: Array, total: Array, slack: Array, group: Group) -> Array:
    """The fluxes of least energy for given total fluxes of the cells of patches.

    Where a cell has slack, other total fluxes are allowed, and cost energy.

    Args:
        K: The matrices of the cells, for the first patch of each class.
        b: The forces of the cells, shape (patches, cells, d moments).
        total: The total outward fluxes of the cells.
        slack: The slack of the cells of the first patches; infinite where any total is as good.
        group: The patches.

    Returns:
        The moments on the facets at the vertex, shape (patches, cells, d * moments).
    """
    patches, cells, width = b.shape
    if not group.count:
        return np.zeros_like(b)
    moments = width // group.signs.shape[2]
    size, rows = group.count * moments, cells - group.closed
    last = size + rows  # takes up what is given
    place = np.where(group.unknowns[..., None] >= 0, group.unknowns[..., None] * moments, last)
    place = np.where(place < last, place + np.arange(moments), last).reshape(K.shape[:3])
    sign = np.repeat(group.signs, moments, axis=-1).astype(np.float64)
    scale = np.einsum("pcii,pci->p", K, sign**2) / size
    K = K / scale[:, None, None, None] * sign[..., :, None] * sign[..., None, :]
    one, cell = np.arange(len(K))[:, None, None], size + np.arange(rows)[:, None]
    shape = (len(K), last + 1, last + 1)
    pairs = np.ravel_multi_index((one[..., None], place[..., :, None], place[..., None, :]), shape)
    sums = np.bincount(pairs.ravel(), K.ravel(), math.prod(shape))
    system = np.asarray(sums.reshape(shape), dtype=np.float64)
    facet, inward = place[:, :rows, ::moments], sign[:, :rows, ::moments]
    free = np.isinf(slack[:, :rows])  # any total is as good
    inward = np.where(free[..., None], 0.0, inward)
    system[one, cell, facet] = system[one, facet, cell] = inward
    costs = np.where(free, 1.0, slack[:, :rows] * scale[:, None])
    system[:, cell[:, 0], cell[:, 0]] = -costs
    inside = system[:, :last, :last]

    # What the forces and the total fluxes are in the system, and the solution in the cells.
    given = np.concatenate((b.reshape(patches, -1), total[:, :rows]), axis=1)
    enter: Array = np.zeros((len(K), last + 1, given.shape[1]))
    at = place.reshape(len(K), -1)
    enter[one[..., 0], at, np.arange(at.shape[1])] = sign.reshape(at.shape)
    leave = enter[:, :last, : at.shape[1]].transpose(0, 2, 1).copy()
    enter[:, :size] /= scale[:, None, None]
    enter[one[..., 0], cell[:, 0], at.shape[1] + np.arange(rows)] = ~free
    enter = enter[:, :last]
    result, members = np.empty((patches, at.shape[1])), np.diff(np.append(group.first, patches))
    alone = members == 1
    right = enter[alone] @ given[group.first[alone], :, None]
    result[group.first[alone]] = (leave[alone] @ _solution(inside[alone], right))[..., 0]
    for k in np.flatnonzero(members > 1):
        same = slice(group.first[k], group.first[k] + members[k])
        result[same] = given[same] @ (leave[k] @ _solution(inside[k], enter[k])).T
    return result.reshape(b.shape)


def _solution(system: Array, right: Array) -> Array:
    try:
        return np.asarray(np.linalg.solve(system, right), dtype=np.float64)
    except np.linalg.LinAlgError:  # the cells at a vertex where the domain touches itself
        return np.asarray(np.linalg.pinv(system, hermitian=True) @ right, dtype=np.float64)
