"""Cells with the energies of the fields in them, as functions of their fluxes through facets.

Where the reaction is not strong, a field has a given divergence. Where the reaction is strong, the
field y costs the energy of A^(1/2) grad u - A^(-1/2) y together with that of
c^(-1/2) (f - c u + div y), and the divergence is free: so the bound is good in layers that the mesh
does not resolve.

Source: Smears and Vohralik, ESAIM Math. Model. Numer. Anal. 54 (2020) 1951-1973.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dolfinx_signorini.base.arrays import Array, Indices
from dolfinx_signorini.bounds.reference_flux import (
    ReferenceFlux,
    barycentric,
    others,
    polynomials,
    rule,
)

# Kinds of facets.
INTERIOR, DIRICHLET, NEUMANN, OPEN, PARTLY, CLOSED = range(6)


@dataclass(frozen=True)
class CellData:
    """What patches need to know of cells, whose vertices are in the order of their numbers.

    Arrays have one row for each cell; facet k lies opposite vertex k. Cell data of several ranks
    are put together by rows:

        packed = np.concatenate((mine.packed(), received))
        everything = CellData.unpacked(packed, reference)

    Attributes:
        vertices, facets: Global numbers, shape (cells, d + 1).
        kinds: `INTERIOR`, `DIRICHLET`, `NEUMANN`, or a contact facet that is `OPEN`, `PARTLY` or
            `CLOSED`: the facet touches the obstacle nowhere, in part, or all over.
        touching: Whether a vertex touches the obstacle, shape (cells, d + 1).
        sizes: The size of the cell in the first column, then the sizes of the facets.
        metric: J^T A^-1 J / |det J|, shape (cells, d, d).
        gradient: Coefficients of J^T B A grad u with the mean B of A^-1, shape
            (cells, d, polynomials).
        current: J^-1 times the moments of A grad u, shape (cells, d, polynomials).
        source: The moments of f - c u, shape (cells, polynomials).
        fluxes: The moments of the given flux on Neumann facets, shape (cells, d + 1, moments).
        gaps: The means of gap times polynomial on contact facets, shape (cells, d + 1, moments).
        strength: c where the reaction is strong, so that the divergence of the flux is not given,
            but costs the energy of the reaction; 0 elsewhere.
    """

    vertices: Indices
    facets: Indices
    kinds: Indices
    touching: Indices
    sizes: Array
    metric: Array
    gradient: Array
    current: Array
    source: Array
    fluxes: Array
    gaps: Array
    strength: Array

    def packed(self) -> Array:
        """Return all data as one array with a row for each cell."""
        parts = [np.asarray(part, dtype=np.float64) for part in vars(self).values()]
        return np.concatenate([p.reshape(len(p), math.prod(p.shape[1:])) for p in parts], axis=1)

    @classmethod
    def unpacked(cls, rows: Array, reference: ReferenceFlux) -> "CellData":
        """Return the cell data of an array of `packed`.

        Args:
            rows: The array.
            reference: The fields that the data were made for.
        """
        d, n = reference.dimension, reference.products.shape[1]
        flat: list[tuple[int, ...]] = [(d + 1,)] * 4 + [(d + 2,), (d, d), (d, n), (d, n), (n,)]
        shapes = [*flat, *[(d + 1, reference.per_facet)] * 2, ()]
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes])[:-1]
        parts = np.split(rows, ends, axis=1)
        parts = [p.reshape(len(p), *shape) for p, shape in zip(parts, shapes, strict=True)]
        whole = (np.rint(part).astype(np.int64) for part in parts[:4])
        return cls(*whole, *parts[4:])  # type: ignore[arg-type]


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


def divergences(data: CellData, reference: ReferenceFlux) -> Array:
    """Return the moments of the divergence for each vertex, shape (cells, d + 1, moments).

    Args:
        data: The cells.
        reference: The fields.
    """
    shape = reference.products.shape
    source = (data.source @ reference.products.transpose(1, 0, 2).reshape(shape[1], -1)).reshape(
        -1, shape[0], shape[2]
    )
    return np.asarray(reference.gradients @ data.current - source)


def condensed(data: CellData, reference: ReferenceFlux) -> tuple[Array, Array]:
    """Return the energies of fields of least energy with given fluxes through facets.

    Args:
        data: The cells.
        reference: The fields.

    Returns:
        The matrices, shape (cells, fluxes, fluxes), and the forces for the hat functions of the
        vertices, shape (cells, d + 1, fluxes): the energy of x is x.matrix x / 2 - force.x.
    """
    n, moments = reference.fluxes, divergences(data, reference)
    matrices = np.zeros((len(data.source), n, n))
    forces = np.zeros((len(matrices), reference.dimension + 1, n))
    for cells, given in _groups(data, reference):
        mass, b = _systems(data, reference, moments, cells)
        inner = -np.linalg.solve(mass[:, given:, given:], mass[:, given:, :given])
        b = b[:, :, :given] + b[:, :, given:] @ inner
        mass = mass[:, :given, :given] + mass[:, :given, given:] @ inner
        known = moments[cells][:, :, 1 : 1 + given - n]
        matrices[cells] = mass[:, :n, :n]
        forces[cells] = b[:, :, :n] - known @ mass[:, n:, :n]
    # A contact flux costs its product with the gap.
    forces -= data.gaps.reshape(len(forces), 1, n)
    return matrices, forces


def coefficients(data: CellData, reference: ReferenceFlux, fluxes: Array) -> Array:
    """Return the sum over all vertices of the fields of least energy, shape (cells, fields).

    Args:
        data: The cells.
        reference: The fields.
        fluxes: The moments of the sum on facets, shape (cells, d + 1, moments).
    """
    n, moments = reference.fluxes, divergences(data, reference)
    result = np.zeros((len(fluxes), reference.mass.shape[2]))
    result[:, :n] = fluxes.reshape(len(fluxes), n)
    for cells, given in _groups(data, reference):
        mass, b = _systems(data, reference, moments, cells)
        result[cells, n:given] = -data.source[cells, 1 : 1 + given - n]
        b = b[:, :, given:].sum(axis=1) - (
            mass[:, given:, :given] @ result[cells, :given, None]
        ).squeeze(2)
        result[cells, given:] = np.linalg.solve(mass[:, given:, given:], b[..., None])[..., 0]
    return result


def _groups(data: CellData, reference: ReferenceFlux) -> Iterator[tuple[Indices, int]]:
    """Yield cells with the number of given moments in each cell and on the facets of the cell."""
    for strong in (False, True):
        cells = np.flatnonzero((data.strength > 0.0) == strong)
        if len(cells):
            yield cells, reference.fluxes if strong else reference.given


def _systems(
    data: CellData, reference: ReferenceFlux, moments: Array, cells: Indices
) -> tuple[Array, Array]:
    """The matrices and forces of the energies of all fields in some cells."""
    d, count = reference.dimension, len(cells)
    mass = data.metric[cells].reshape(count, d * d) @ reference.mass.reshape(d * d, -1)
    mass = mass.reshape(count, *reference.mass.shape[2:])
    inner = d * reference.products.shape[1]
    flat = reference.targets.transpose(1, 2, 0, 3).reshape(inner, -1)
    b = (data.gradient[cells].reshape(count, inner) @ flat).reshape(count, d + 1, mass.shape[1])
    # The energy of the reaction, in terms of the moments of the divergence.
    c = data.strength[cells]
    weight = np.where(c > 0.0, 1.0 / np.where(c > 0.0, c, 1.0), 0.0) / data.sizes[cells, 0]
    own = np.arange(reference.fluxes, reference.given)
    mass[:, own, own] += weight[:, None]
    b[:, :, own] += weight[:, None, None] * moments[cells][:, :, 1:]
    return mass, b
