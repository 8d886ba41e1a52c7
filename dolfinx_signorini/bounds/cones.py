"""Functions on facets of a plane domain, each extended to the cell of the facet.

A function that vanishes at the ends of a facet is extended to the opposite vertex as a function
that is homogeneous of some degree about this vertex, and vanishes on the other two facets.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.bounds.boundary_facets import FacetPoints, rule_on_parts
from dolfinx_signorini.bounds.condensation import CLOSED, OPEN
from dolfinx_signorini.bounds.frames import Frames
from dolfinx_signorini.bounds.reference_flux import PARTS
from dolfinx_signorini.meshes.polynomials import (
    derivatives,
    gauss_lobatto,
    highest_on_parts,
    largest,
    lowest,
    others,
    polynomials,
)


@dataclass(frozen=True)
class Cones:
    """Functions on facets in the plane, each with its extension to the cell of the facet.

    The energies of the extensions belong to the cells:

        norms = cones.norms(values.diffusion.upper, reaction)

    Attributes:
        frames: The cells.
        cells, facets: The facets, shape (n,).
        coefficients: Polynomials in terms of `FacetPoints.polynomials`, shape (n, polynomials).
        missed: What the functions and their derivatives from end to end have beside the
            polynomials, at most, and the root mean squares of the latter, shape (3, n).
        positive: Whether only the positive part of a function counts.
        tiny: Values that are rounding.
    """

    frames: Frames
    cells: Indices
    facets: Indices
    coefficients: Array
    missed: Array
    positive: Mask
    tiny: float

    def norms(self, diffusion: Array, reaction: Array, strip: Array) -> Array:
        """Return bounds of the energy norms of the extensions on each cell.

        With the share t from end to end, and s = 1 on the facet and 0 at the opposite vertex, the
        extension is s^k w(t), and its gradient s^(k-1) (k w grad s + w' (grad b - t grad s)), where
        b is the barycentric coordinate of the second end. The number k >= 1 is about the best one.

        Args:
            diffusion: A matrix that A does not exceed in each cell, shape (cells, d, d).
            reaction: A number that c does not exceed in each cell.
            strip: The share of each cell where A may be larger, times the largest eigenvalue of A.
        """
        degree, d = self.coefficients.shape[1] - 1, self.frames.dimension
        t, weights = rule_on_parts(2 * degree)
        slopes = derivatives(self.coefficients)
        w = self.coefficients @ polynomials(1, degree, t[:, None])
        slope = slopes @ polynomials(1, degree - 1, t[:, None])
        above = self.coefficients.copy()
        above[:, 0] += self.missed[0]
        kept = ~self.positive[:, None] | (highest_on_parts(PARTS, above) > self.tiny)
        weights = np.repeat(kept, len(t) // PARTS, axis=1) * weights
        ends = others(d)[self.facets]
        frames = self.frames.some(self.cells)
        own = np.take_along_axis(frames.gradients, ends[:, :, None], axis=1)
        both = own.sum(axis=1)[:, None]
        A, c, size = diffusion[self.cells], reaction[self.cells], frames.volumes
        down = both * w[..., None]
        across = slope[..., None] * (own[:, 1][:, None] - t[:, None] * both)

        def means(one: Array, other: Array) -> Array:
            return (np.einsum("nqa,nab,nqb->nq", one, A, other) * weights).sum(axis=1)

        along, mixed, through = means(down, down), means(down, across), means(across, across)
        k = np.sqrt(np.maximum(through / np.where(along > 0.0, along, np.inf), 1.0))
        energy = (
            k * along + 2.0 * mixed + through / k + c / (k + 1.0) * (w**2 * weights).sum(axis=1)
        )
        norms = np.sqrt(energy * size)
        # The same for what the polynomials miss.
        value, _, change = self.missed
        steep = k * value * np.linalg.norm(both[:, 0], axis=1)
        steep += change * np.linalg.norm(own, axis=2).max(axis=1, initial=0.0)
        highest = np.linalg.norm(A, axis=(1, 2))
        norms += np.sqrt(size * (highest * steep**2 / k + c / (k + 1.0) * value**2))
        steep = (
            k * (value + largest(1, degree, self.coefficients)) * np.linalg.norm(both[:, 0], axis=1)
        )
        slope = self.missed[1] + largest(1, degree - 1, slopes)
        steep += slope * np.linalg.norm(own, axis=2).max(axis=1, initial=0.0)
        norms += np.sqrt(size * strip[self.cells]) * steep
        sums = np.bincount(self.cells, norms, len(self.frames.order))
        return np.asarray(sums, dtype=np.float64)


def lattice(frames: Frames, marked: Mask, degree: int) -> FacetPoints:
    """Return points of facets, the corners among them, that tell a polynomial of a degree.

    Args:
        frames: The cells of the mesh.
        marked: The facets, shape (cells, d + 1).
        degree: The degree.
    """
    points = gauss_lobatto(degree)
    none = np.zeros(len(points))
    cells, facets = np.nonzero(marked)
    return FacetPoints(frames, cells, facets, points, none)


def fitted(points: FacetPoints, values: Array, degree: int) -> Array:
    """Return the coefficients of the polynomials on facets with given values at a lattice.

    Args:
        points: The lattice.
        values: The values at the lattice, shape (facets, points).
        degree: The degree of the polynomials.
    """
    table = points.polynomials(degree).transpose(0, 2, 1)
    return np.asarray(np.linalg.solve(table, values[..., None])[..., 0])


def cones_on(
    frames: Frames,
    parts: Sequence[tuple[FacetPoints, Array, Array | None]],
    kinds: Indices,
    tiny: float,
) -> Cones:
    """Return what is to be added on facets in the plane, with its extensions.

    Args:
        frames: The cells.
        parts: Facets, polynomials on them, and what these miss on facets, see `Remainders`; only
            positive parts count on contact facets that are not closed.
        kinds: The kinds of the facets of cells.
        tiny: Values that are rounding.
    """
    cells, facets, series = (
        np.concatenate(values)
        for values in zip(*((at.cells, at.facets, each) for at, each, _ in parts), strict=True)
    )
    nothing = np.zeros((3, *kinds.shape))
    rests = [(at, nothing if rest is None else rest) for at, _, rest in parts]
    missed = np.concatenate([rest[:, at.cells, at.facets] for at, rest in rests], axis=1)
    positive = (kinds[cells, facets] >= OPEN) & (kinds[cells, facets] != CLOSED)
    high = missed[0] - lowest(1, series.shape[1] - 1, -series)
    size = np.abs(series).max(axis=1, initial=0.0) + missed[0]
    used = np.where(positive, high > tiny, size > 0.0)
    own = cells[used], facets[used], series[used], missed[:, used], positive[used]
    return Cones(frames, *own, tiny)
