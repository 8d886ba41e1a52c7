"""Sup norms: the largest error, or derivative of it, over closed cells or boundary facets.

An error oscillates inside of cells, and may be smallest where it is easily sampled: the error of
elements of degree 2 nearly vanishes at vertices and midpoints. The maximum is searched for in two
steps. First every cell is sampled on a lattice that includes vertices and facets; if values at some
points of many cells are known, only the cells with the largest values are. Then boxes around the
largest local maxima of the samples, and around the singular points of the solution, are sampled and
made smaller until the maximum stands. Derivatives are one-sided, from inside of each cell.
"""

import functools
import math
from collections.abc import Iterable

import basix
import numpy as np
from mpi4py import MPI
from scipy.spatial import KDTree

from dolfinx_signorini.base.arrays import Array, Indices, LocalIndices, Mask, blocks
from dolfinx_signorini.base.ranks import anywhere, highest
from dolfinx_signorini.base.tolerances import HALF_OF_THE_DIGITS, HALVINGS, ROUNDING, SOLVED
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.sided_meshes import SAMPLE, cell_corners
from dolfinx_signorini.norms.pointwise import ErrorAtPoints, kind_of

SIDE, FOLLOWED = 5, 8  # samples along each side of a box, boxes that are followed to the end
# Cells in which maxima are followed: share of all, or samples in boxes. The same share is sampled
# at all where values in all cells are known.
SHARE, BOXED = 0.03, 2500
SHRINKING = 0.6  # of the boxes in every step: with less than 1/2 a maximum could be lost
# Steps at least: a maximum is flat, and in so small a box values are the same to half the digits.
FIRST = math.ceil(0.5 * math.log(HALF_OF_THE_DIGITS, SHRINKING))
RINGS = 10.0 ** (-1.0 - 0.5 * np.arange(8))  # radii, in steps of the lattice
GROWING = 0.95  # from ring to ring, relative to the growth before: an unbounded function grows so


class Maxima:
    """The maxima of an error over cells or facets, collectively on all ranks:

        largest = Maxima(ErrorAtPoints(u_h, exact), owned_cells(domain)).largest(False, "Linf")

    Args:
        error: The error, or the error with its derivatives.
        places: The owned cells, shape (n,), or boundary facets as (cell, local facet), (n, 2).
        singular: Points of space where the derivatives of the solution are not smooth.
        known: The largest values at some points of each place, or NaN, of the shape of `sampled`;
            by default nothing is known.
    """

    def __init__(
        self,
        error: ErrorAtPoints,
        places: LocalIndices,
        singular: Iterable[tuple[float, ...]] = (),
        known: Array | None = None,
    ):
        self._error, self._places, self._singular = error, places, tuple(singular)
        self._known = known
        self._comm = error.domain.comm
        cell = kind_of(error.domain, places)
        corners, self._dim = np.asarray(basix.geometry(cell)).shape
        self._simplex = corners == self._dim + 1
        self._degree = 2 * error.degree + 4
        kind = basix.LatticeType.equispaced
        self._lattice = np.asarray(basix.create_lattice(cell, self._degree, kind, True), np.float64)

    @functools.cached_property
    def _samples(self) -> tuple[Array, Mask]:
        """The largest samples, and whether there are points without a value, both (1 or 2, n)."""
        tops, holes = [], []
        rows = self._screened()
        places = self._places[rows]
        for part in blocks(len(places), len(self._lattice)):
            values = self._values(places[part], self._lattice)
            tops.append(values.max(axis=2))
            holes.append((values < 0.0).mean(axis=2))
        share = np.concatenate(holes, axis=1)
        if highest(self._comm, share) > 0.5:
            raise FloatingPointError("the error is not a number at most points of some cell")
        if self._known is None:
            return np.concatenate(tops, axis=1), share > 0.0
        samples, without = self._known.copy(), np.zeros(self._known.shape, dtype=bool)
        samples[:, rows], without[:, rows] = np.concatenate(tops, axis=1), share > 0.0
        return samples, without

    def _screened(self) -> Indices:
        """The rows of the places that are sampled on the lattice."""
        if self._known is None:
            return np.arange(len(self._places))
        limit = int(SHARE * self._comm.allreduce(len(self._places)))
        unknown = np.isnan(self._known)
        sizes = np.where(unknown, -1.0, self._known)
        chosen = [_largest(self._comm, kind, limit) for kind in sizes]
        near = [self._around(place) for place in self._singular]
        return np.unique(np.concatenate([*chosen, *near, np.flatnonzero(unknown.any(axis=0))]))

    def largest(self, derivatives: bool, name: str) -> float:
        """Return the maximum, the same on all ranks.

        Args:
            derivatives: Whether derivatives count, too.
            name: What the maximum is called in messages.

        Raises:
            FloatingPointError: The error grows without bound.
        """
        kind = int(derivatives)
        tops, holes = (array[kind] for array in self._samples)
        limit = max(BOXED // SIDE**self._dim, int(SHARE * self._comm.allreduce(len(tops))))
        limit = limit if self._known is None else min(limit, SAMPLE)
        chosen = self._places[_largest(self._comm, tops, limit)]
        values = self._values(chosen, self._lattice)[kind]
        row, point = np.nonzero(self._peaks(values))
        kept = _largest(self._comm, values[row, point], 2 * limit)
        starts = [(chosen[row[kept]], self._lattice[point[kept]])]
        if highest(self._comm, holes) > 0.0:  # points without a value may be singular ones
            chosen = self._places[holes][_largest(self._comm, tops[holes], limit)]
            row, point = np.nonzero(self._values(chosen, self._lattice)[kind] < 0.0)
            starts.append((chosen[row], self._lattice[point]))
        for place in self._singular:
            near = self._places[self._around(place)]
            at = np.tile(self._lattice, (len(near), 1))
            starts.append((np.repeat(near, len(self._lattice), axis=0), at))
        found = [self._followed(*start, limit, kind, name) for start in starts]
        return max([*found, highest(self._comm, tops)])

    def _peaks(self, values: Array) -> Mask:
        """Tell which samples on the lattice are not smaller than their neighbours, (n, m)."""
        tree = KDTree(self._lattice)
        neighbours = tree.query_ball_point(self._lattice, 1.5 / self._degree, p=np.inf)
        peaks = [values[:, j] >= values[:, near].max(axis=1) for j, near in enumerate(neighbours)]
        return np.transpose(peaks)

    def _values(self, places: LocalIndices, at: Array) -> Array:
        """The error and the largest component at points, -1 for what is no number: (1 or 2, n, m).

        An error without derivatives has one row.
        """
        values = []
        for part in blocks(len(places), at.shape[-2]):
            here = Points(self._error.domain, places[part], at if at.ndim == 2 else at[part])
            found = [np.abs(component) for component in self._error(here)]
            rows = [found[0], functools.reduce(np.maximum, found)] if len(found) > 1 else found
            values.append(np.stack(rows))
        every = np.concatenate(values, axis=1)
        return np.where(np.isnan(every), -1.0, every)

    def _boxes(self, at: Array, radius: float) -> Array:
        """A grid of SIDE points per direction around each point, within the closed cell."""
        steps = np.meshgrid(*[np.linspace(-radius, radius, SIDE)] * self._dim, indexing="ij")
        result = at[:, None] + np.stack([step.ravel() for step in steps], axis=-1)
        result = np.clip(result, 0.0, 1.0)
        if self._simplex:
            result /= np.maximum(result.sum(axis=-1, keepdims=True), 1.0)
        return result

    def _around(self, point: tuple[float, ...]) -> Indices:
        """The rows of the places whose cells may contain a point."""
        domain, cells = self._error.domain, self._places
        nodes = cell_corners(domain, cells if cells.ndim == 1 else cells[:, 0])
        low, high = (f(nodes[:, :, : len(point)], axis=1) for f in (np.min, np.max))
        margin = SOLVED * (high - low).max(axis=1, keepdims=True, initial=0.0)
        inside = (low - margin <= point) & (np.array(point) <= high + margin)
        return np.flatnonzero(inside.all(axis=1))

    def _followed(self, places: LocalIndices, at: Array, limit: int, kind: int, name: str) -> float:
        """The maximum that boxes around points of places lead to."""
        radius, maxima = 1.0 / self._degree, [0.0]
        for step in range(HALVINGS):
            boxes = self._boxes(at, radius)
            values = self._values(places, boxes)[kind]
            best = np.arange(len(boxes)), values.argmax(axis=1)
            at, tops = boxes[best], values[best]
            maxima.append(max(maxima[-1], highest(self._comm, tops)))
            # Next to a point without a value all samples of a box but one may be farther away.
            holes = (values[tops >= (1.0 - HALF_OF_THE_DIGITS) * maxima[-1]] < 0.0).any()
            settled = step >= FIRST and maxima[-1] <= (1.0 + HALF_OF_THE_DIGITS) * maxima[-5]
            if settled and not anywhere(self._comm, holes):
                break
            radius, limit = SHRINKING * radius, max(limit // 2, FOLLOWED)
            kept = _largest(self._comm, tops, limit)
            places, at, tops = places[kept], at[kept], tops[kept]
        top = np.flatnonzero(tops >= (1.0 - HALF_OF_THE_DIGITS) * maxima[-1])[:1]
        grows = len(top) > 0 and self._grows(places[top], at[top], kind)
        if anywhere(self._comm, grows):
            raise FloatingPointError(f"{name} is infinite: the error grows without bound")
        return maxima[-1]

    def _grows(self, place: LocalIndices, at: Array, kind: int) -> bool:
        """Tell whether the error grows on ever smaller rings around a point, and goes on so."""
        rings = []
        for radius in RINGS / self._degree:
            box = self._boxes(at, radius)
            away = np.abs(box - at[:, None]).max(axis=2) > 0.25 * radius
            rings.append(float(self._values(place, box[away][None])[kind].max()))
        if not np.isfinite(rings).all():
            return True
        growth = np.diff(rings)
        late, before = growth[-2:].sum(), growth[-4:-2].sum()
        return bool((growth[-4:] > 0.0).all() and late > max(GROWING * before, 0.01 * rings[-1]))


def _largest(comm: MPI.Comm, values: Array, limit: int) -> Indices:
    """The rows of the values of this rank that are among the largest ones of all ranks.

    Values that differ by rounding count as the same.
    """
    rows = np.argsort(-values, kind="stable")[:limit]
    everywhere = np.concatenate(comm.allgather(values[rows]))
    if not limit or len(everywhere) <= limit:
        return rows
    last = min(np.partition(everywhere, -limit)[-limit], np.finfo(np.float64).max)
    return rows[values[rows] >= last - ROUNDING * abs(last)]
