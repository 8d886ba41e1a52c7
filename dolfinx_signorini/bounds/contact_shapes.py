"""The shapes of given fluxes on facets: hat functions, and what presses where a facet touches."""

import numpy as np

from dolfinx_signorini.base.arrays import Array, Indices
from dolfinx_signorini.bounds.condensation import PARTLY, CellData
from dolfinx_signorini.bounds.reference_flux import (
    ReferenceFlux,
    barycentric,
    others,
    polynomials,
    rule,
)


def hats(reference: ReferenceFlux) -> Array:
    """Return means over each facet of hat function times two polynomials, by vertex and facet."""
    d = reference.dimension
    means = np.zeros((d + 1, d + 1, *reference.facet_products.shape[1:]))
    for a in range(d + 1):
        for k in others(d)[a]:
            means[a, k] = reference.facet_products[a - (a > k)]
    return means


def contact_shapes(data: CellData, reference: ReferenceFlux, cells: Indices) -> Array:
    """Return the shapes of contact fluxes, as means with polynomials.

    The shape is the hat function of the vertex; on a partly closed facet with vertices that touch,
    a power of the sum of the hat functions of these vertices.

    Args:
        data: The cells.
        reference: The fields.
        cells: The numbers of the cells that are wanted.

    Returns:
        The means, shape (cells, vertices d + 1, facets d + 1, moments).
    """
    d, degree = reference.dimension, reference.degree
    shapes = np.tile(hats(reference)[:, :, 0], (len(cells), 1, 1, 1))
    points, weights = rule(d - 1, 2 * degree)
    phi, p = barycentric(points), polynomials(d - 1, degree, points)
    place, facet = np.nonzero(data.kinds[cells] == PARTLY)
    vertices = others(d)[facet]
    touching = data.touching[cells[place, None], vertices]
    some = np.asarray(touching.any(axis=1))[:, None, None]
    bumps = np.where(some, ((touching @ phi.T) ** degree)[:, None], phi.T[None])
    means = np.einsum("q,naq,lq->nal", weights, bumps, p)
    shapes[place[:, None], vertices, facet[:, None]] = means
    return shapes
