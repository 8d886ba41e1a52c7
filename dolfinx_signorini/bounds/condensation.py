"""Cells with the energies of the fields in them, as functions of their fluxes through facets.

Where the reaction is not strong, a field has a given divergence. Where the reaction is strong, the
field y costs the energy of A^(1/2) grad u - A^(-1/2) y together with that of
c^(-1/2) (f - c u + div y), and the divergence is free: so the bound is good in layers that the mesh
does not resolve.

Source: Smears and Vohralik, ESAIM Math. Model. Numer. Anal. 54 (2020) 1951-1973.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.bounds.congruence import alike
from dolfinx_signorini.bounds.reference_flux import ReferenceFlux
from dolfinx_signorini.meshes.polynomials import barycentric, others, polynomials
from dolfinx_signorini.meshes.quadrature import rule

Rows = TypeVar("Rows")

# Kinds of facets.
INTERIOR, DIRICHLET, NEUMANN, OPEN, PARTLY, CLOSED = range(6)


@dataclass(frozen=True)
class CellData:
    """What patches need to know of cells, whose vertices are in the order of the frames.

    Arrays have one row for each cell; facet k lies opposite vertex k. Cells of several ranks are
    put together by rows:

        everything = joined(comm.allgather(mine))

    Attributes:
        vertices, facets: Global numbers, shape (cells, d + 1).
        kinds: `INTERIOR`, `DIRICHLET`, `NEUMANN`, or a contact facet that is `OPEN`, `PARTLY` or
            `CLOSED`: the facet touches the obstacle nowhere, in part, or all over.
        touching: Whether a vertex touches the obstacle, shape (cells, d + 1).
        sizes: The size of the cell in the first column, then the sizes of the facets.
        edges: The Jacobian J, whose columns are the edges at the first vertex, shape (cells, d, d).
        metric: J^T A^-1 J / |det J|, shape (cells, d, d).
        gradient: Coefficients of J^T B A grad u with the mean B of A^-1, shape
            (cells, d, polynomials).
        current: J^-1 times the moments of A grad u, shape (cells, d, polynomials).
        source: The moments of f - c u, shape (cells, polynomials).
        fluxes: The moments of the given flux on Neumann facets, shape (cells, d + 1, moments).
        gaps: The means of gap times polynomial on contact facets, shape (cells, d + 1, moments).
        strength: c where the reaction is strong, so that the divergence of the flux is not given,
            but costs the energy of the reaction; infinite where the divergence is free, because
            the pressure of an obstacle in the domain takes up any residual; 0 elsewhere.
        sides: 1 where a lower obstacle may press on a cell, -1 for an upper one, 0 elsewhere.
        rises: The means over cells with a pressure of v - g times polynomial, with the feasible
            function v and the obstacle g, shape (cells, polynomials); 0 elsewhere.
        places: Where the middle of the cell is along the direction of the frames.
    """

    vertices: Indices
    facets: Indices
    kinds: Indices
    touching: Indices
    sizes: Array
    edges: Array
    metric: Array
    gradient: Array
    current: Array
    source: Array
    fluxes: Array
    gaps: Array
    strength: Array
    sides: Indices
    rises: Array
    places: Array

    def some(self, cells: Indices | slice) -> "CellData":
        """Return the data of some cells."""
        return CellData(*(values[cells] for values in vars(self).values()))


def joined(parts: Sequence[Rows]) -> Rows:
    """Return arrays with a row for each cell, put together by rows."""
    if len(parts) == 1:
        return parts[0]
    columns = zip(*(vars(part).values() for part in parts), strict=True)
    return type(parts[0])(*map(np.concatenate, columns))


def vertices_of(facets: Mask) -> Mask:
    """Return the vertices of cells that are on one of some facets of the cell."""
    return np.asarray(facets.sum(axis=1, keepdims=True) - facets > 0)


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
    (vertices, n, _), d = reference.products.shape, reference.dimension
    current = np.einsum("va,jk->ajvk", reference.gradients, np.eye(n)).reshape(d * n, -1)
    moments = data.current.reshape(-1, d * n) @ current
    moments -= data.source @ reference.products.transpose(1, 0, 2).reshape(n, -1)
    return np.asarray(moments.reshape(-1, vertices, n))


@dataclass(frozen=True)
class Shapes:
    """Cells of the same shape, which share the energies of the fields in them.

    A field is given by its fluxes x through facets, and by what drives the other coefficients, z:
    moments of the divergence, or forces where the coefficients are free. The field of least energy
    and the energy of the fluxes, up to a number:

        shapes.products(np.concatenate((x, z), axis=2), shapes.inner)
        x @ shapes.matrices[shapes.number[cell]] @ x / 2 - force @ x

    Attributes:
        number: The number of the shape of each cell.
        matrices: The energies of fluxes, shape (shapes, fluxes, fluxes).
        inner: The other coefficients by x and z, shape (shapes, fields, fields - fluxes).
        through: The forces on x by z, shape (shapes, fields - fluxes, fluxes).
    """

    number: Indices
    matrices: Array
    inner: Array
    through: Array

    def products(self, rows: Array, matrices: Array, cells: slice = slice(None)) -> Array:
        """Return products of rows of some cells, shape (cells, n, k), with matrices of the shapes.

        Shapes that more cells have than there are shapes are taken one by one: few steps in any
        case.
        """
        shape, result = self.number[cells], np.empty((*rows.shape[:2], matrices.shape[2]))
        count = np.bincount(shape, minlength=len(matrices))
        rare = count[shape] <= len(matrices)
        result[rare] = rows[rare] @ matrices[shape[rare]]
        for k in np.flatnonzero(count > len(matrices)):
            of = np.flatnonzero(shape == k)
            flat = rows[of].reshape(-1, rows.shape[2]) @ matrices[k]
            result[of] = flat.reshape(len(of), *result.shape[1:])
        return result


def shapes_of(data: CellData, reference: ReferenceFlux) -> Shapes:
    """Return the shapes of cells.

    Args:
        data: The cells.
        reference: The fields.
    """
    n, given, resistance = reference.fluxes, reference.given, _resistance(data)
    size, length = np.einsum("naa->n", data.metric), data.sizes[:, 0] ** (1.0 / reference.dimension)
    above = data.metric[:, *np.triu_indices(reference.dimension)] / size[:, None]
    edges = (data.edges / length[:, None, None]).reshape(len(size), reference.dimension**2)
    numbers = (edges, np.log2(length), above, np.log2(size), np.log2(1.0 + resistance / size))
    first, number = alike(np.column_stack((*numbers, np.isinf(data.strength))))
    mass = np.asarray(np.tensordot(data.metric[first], reference.mass, 2), dtype=np.float64)
    own = np.arange(n, given)
    mass[:, own, own] += resistance[first, None]
    inner = np.zeros((*mass.shape[:2], mass.shape[2] - n))
    for strong in (False, True):
        of = (data.strength[first] > 0.0) == strong
        free = n if strong else given
        inverse = np.linalg.inv(mass[of, free:, free:])
        inner[of, free:, free - n :] = inverse
        inner[of, :free, free - n :] = -mass[of, :free, free:] @ inverse
        inner[np.ix_(of, own[: free - n], own[: free - n] - n)] = np.eye(free - n)
    matrices = mass[:, :n, :n] + mass[:, :n, n:] @ inner[:, :n].transpose(0, 2, 1)
    return Shapes(number, matrices, inner, -inner[:, n:] @ mass[:, n:, :n])


def forces_of(
    data: CellData, reference: ReferenceFlux, shapes: Shapes, cells: slice = slice(None)
) -> tuple[Array, Array]:
    """Return the forces on fluxes for the hat functions of the vertices, and total fluxes.

    Args:
        data: The cells.
        reference: The fields.
        shapes: The shapes of the cells.
        cells: The cells that are wanted.

    Returns:
        The forces, shape (cells, d + 1, fluxes), and the total fluxes, shape (cells, d + 1).
    """
    some, n, targets = data.some(cells), reference.fluxes, reference.targets
    divergence = divergences(some, reference)
    forces = gradient_products(some.gradient, targets[..., :n])
    # A contact flux costs its product with the gap.
    forces -= some.gaps.reshape(len(forces), 1, n)
    # So does a pressure, which is minus the divergence: a hat function has its share of the gap.
    rises = np.einsum("nj,vjk->nvk", some.rises, reference.products)
    forces[..., :: reference.per_facet] += rises[..., :1]
    drive = _drive(some, reference, targets, divergence, rises)
    forces += shapes.products(drive, shapes.through, cells)
    return forces, divergence[:, :, 0]


def coefficients(data: CellData, reference: ReferenceFlux, fluxes: Array) -> Array:
    """Return the sum over all vertices of the fields of least energy, shape (cells, fields).

    Args:
        data: The cells.
        reference: The fields.
        fluxes: The moments of the sum on facets, shape (cells, d + 1, moments).
    """
    targets, shapes = reference.targets.sum(axis=0, keepdims=True), shapes_of(data, reference)
    # The divergences for all vertices add up to minus the source.
    drive = _drive(data, reference, targets, -data.source[:, None], data.rises[:, None])
    x = fluxes.reshape(len(fluxes), 1, reference.fluxes)
    inner = shapes.products(np.concatenate((x, drive), axis=2), shapes.inner)
    return np.concatenate((x, inner), axis=2)[:, 0]


def _drive(
    data: CellData, reference: ReferenceFlux, targets: Array, divergence: Array, rises: Array
) -> Array:
    """What drives the coefficients that are no fluxes, see `Shapes`."""
    n, given, known = reference.fluxes, reference.given, divergence[:, :, 1:]
    drive = np.concatenate((known, gradient_products(data.gradient, targets[..., given:])), axis=2)
    strong = np.flatnonzero(data.strength)
    costly = _resistance(data)[strong, None, None] * known[strong]
    costly += gradient_products(data.gradient[strong], targets[..., n:given]) + rises[strong, :, 1:]
    drive[strong, :, : given - n] = costly
    return drive


def _resistance(data: CellData) -> Array:
    """What a moment of the divergence costs where the reaction is strong; 0 elsewhere."""
    strong = data.strength > 0.0
    return np.where(strong, 1.0 / np.where(strong, data.strength, 1.0), 0.0) / data.sizes[:, 0]


def gradient_products(gradient: Array, targets: Array) -> Array:
    """Return products of A grad u with fields times hat functions, shape (cells, vertices, fields).

    Args:
        gradient: See `CellData`.
        targets: See `ReferenceFlux`, or the sum over the vertices.
    """
    vertices, d, n, fields = targets.shape
    flat = targets.transpose(1, 2, 0, 3).reshape(d * n, -1)
    products = gradient.reshape(-1, d * n) @ flat
    return np.asarray(products).reshape(len(gradient), vertices, fields)
