"""Marking: how often each cell is to be divided, and the mesh that follows.

The cells with the largest remaining errors are divided until the predicted error is small enough,
each so often that its parts are no worse than the parts of other cells. A cell with a singular
point is divided towards the point: only the part at the point is divided again. A point that is no
vertex, an end of contact, is known up to a part of the cell: so the parts that are as near to the
point as their size are divided again.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from dolfinx import mesh

from dolfinx_signorini.accuracy.cells import summed_at_vertices, volumes
from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask
from dolfinx_signorini.base.lookups import Lookup
from dolfinx_signorini.base.ranks import averaged, highest
from dolfinx_signorini.base.tolerances import (
    HALF_OF_THE_DIGITS,
    HALVINGS,
    PRECISION,
    ROUNDING,
    TINY,
)
from dolfinx_signorini.meshes.balance import balanced
from dolfinx_signorini.meshes.refinement import refined
from dolfinx_signorini.meshes.sided_meshes import SidedMesh, cell_corners, owned_cells
from dolfinx_signorini.norms.power_sums import collected

# By how much what measured rates say may be off, of errors, sizes and seconds.
SAFETY = 1.3
# The largest ratio of the numbers of cells of successive meshes: all together have 3/2 times the
# cells of the last one, if they grow so.
GROWTH = 3.0
DEEP = 2  # divisions once rates were measured, except at singular points that were seen twice
# Divisions towards an end of contact, whose place is known up to 0.3 widths of the cell. With 2 of
# them requests near 1e-9 take two steps more, and with 4 to 6 up to three times the unknowns.
LOCATED = 3
NOTABLE = 0.5  # of the largest value: smaller ones, and differences that are smaller, may be chance


@dataclass(frozen=True)
class Prediction:
    """What the cells of a mesh leave in the error, and what divisions are going to change.

    The rates of the cells tell:

        marks = mark(sided, rates.prediction(cells), goal=0.5, growth=3.0)

    Attributes:
        remaining: What each owned cell leaves in the error.
        factors: By how much a division of a cell multiplies what the cell leaves in the error.
        singular: Whether the cell has a singular point.
        confirmed: Whether the singular point was seen more than once.
        deepest: For how many divisions the rates are believed, except at confirmed points.
        power: The exponent with which the parts add up.
        exponent: The exponent with which errors at separate places add up: to this power the parts
            fall, see `Target.exponent`.
        places: For each cell the singular point that the cell is known to have; infinity for cells
            without one.
    """

    remaining: Array
    factors: Array
    singular: Mask
    confirmed: Mask
    deepest: int
    power: float
    exponent: float
    places: Array


@dataclass(frozen=True)
class Marks:
    """How often the cells of a mesh are to be divided:

        divided = mark(sided, prediction, goal=0.5, growth=4.0).apply(sided)

    Attributes:
        levels: How often each owned cell is to be divided; fractions are bisections, of which as
            many as the mesh has dimensions make a division.
        points: For each cell the point that the cell is divided towards, shape (cells, 3); infinity
            for other cells.
        growth: By how much they are predicted to multiply the number of cells, at most.
    """

    levels: Array
    points: Array
    growth: float = 1.0

    @property
    def singular(self) -> Mask:
        """Whether each cell is divided towards a point."""
        return np.isfinite(self.points[:, 0])

    def apply(
        self, sided: SidedMesh, fit: Callable[[SidedMesh], object] = lambda sided: None
    ) -> "Divided":
        """Return the divided mesh; the call is collective.

        Args:
            sided: The mesh.
            fit: Moves new vertices, after each division: deep inside of the cells of a division,
                vertices have less room.
        """
        comm, dimension = sided.mesh.comm, sided.mesh.topology.dim
        first = sided.mesh.topology.index_map(dimension).local_range[0]
        owners = Lookup(comm, len(self.levels), first + np.arange(len(self.levels)))
        levels: Array = np.zeros(len(self.levels))
        no_vertex = apart(sided, self.points)
        while True:
            # What has been divided for the sake of other cells need not be divided again.
            wanted, points, between = map(owners.of, (self.levels, self.points, no_vertex))
            at = _at_points(sided, points, np.where(between, 1.0, HALF_OF_THE_DIGITS))
            singular = np.isfinite(points[:, 0])
            tip = singular & ~between
            left: Array = np.rint(dimension * (wanted - levels))  # bisections
            left = np.where(singular & ~at & (levels > 0.0), 0.0, left)  # each cell, at least once
            if highest(comm, left) == 0.0:
                return Divided(sided, owners, np.round(levels, 3), singular & ~at)
            tips, whole = _numbers(tip & (left > 0)), _numbers(~tip & (left >= dimension))
            halved = _numbers(~tip & (left > 0) & (left < dimension))
            step = balanced(refined(sided, whole, (tips, points[tips]), halved))
            shares = step.parents.of(volumes(sided.mesh)) / volumes(step.sided.mesh)
            levels = step.parents.of(levels) + np.log2(shares) / dimension
            fit(step.sided)
            sided, owners = step.sided, owners.through(step.parents)


def apart(sided: SidedMesh, points: Array) -> Mask:
    """Return for each owned cell whether its point is no vertex; False for cells without one."""
    return np.isfinite(points[:, 0]) & ~_at_points(sided, points, HALF_OF_THE_DIGITS)


def _at_points(sided: SidedMesh, points: Array, reach: Array | float) -> Mask:
    """Whether each owned cell has a vertex so many sizes of the cell from its point, or nearer."""
    domain = sided.mesh
    x = domain.geometry.x[domain.geometry.dofmap[owned_cells(domain)]]
    distance = np.linalg.norm(x - points[:, None], axis=2).min(axis=1)
    size = volumes(domain) ** (1.0 / domain.topology.dim)
    return np.asarray(distance < reach * size)


@dataclass(frozen=True)
class Divided:
    """A mesh after the divisions of `Marks`, whose cells the ranks may share anew:

        divided = marks.apply(sided)
        old = divided.owners.of(values)

    Attributes:
        sided: The mesh with its sides.
        owners: Asks for the cell around each owned cell before the divisions.
        levels: How often that cell has been halved in every direction on the way to this one.
        away: Whether that cell has a singular point, which this cell does not have.
    """

    sided: SidedMesh
    owners: Lookup
    levels: Array
    away: Mask

    def collected(self, values: Array, power: float) -> Array:
        """Put values of cells together for each cell before the divisions, see `collected`."""
        return collected(self.owners.sent(values), self.owners.items, self.owners.count, power)


def _numbers(chosen: Mask) -> LocalIndices:
    return np.flatnonzero(chosen).astype(np.int32)


def _rounded_up(levels: Array, multiple: Array | float) -> Array:
    """The next multiples of numbers of divisions."""
    return np.asarray(np.ceil(levels / multiple) * multiple)


def mark_for_all(
    sided: SidedMesh,
    predictions: Sequence[Prediction],
    goal: float,
    growth: float,
    smallest: float = 0.0,
) -> Marks:
    """Choose how often to divide cells so that several errors fall, the first ones first.

    Args:
        sided, goal: See `mark`.
        predictions: What the cells leave in each of the errors.
        growth: The largest ratio of the numbers of cells, of which later errors have the rest.
        smallest: See `mark`.
    """
    marks = mark(sided, predictions[0], goal, growth, smallest)
    for prediction in predictions[1:]:
        other = mark(sided, prediction, goal, max(growth - marks.growth + 1.0, 1.0), smallest)
        deeper = other.levels > marks.levels
        marks = Marks(
            np.where(deeper, other.levels, marks.levels),
            np.where(deeper[:, None], other.points, marks.points),
            marks.growth + other.growth - 1.0,
        )
    return marks


def mark(
    sided: SidedMesh, prediction: Prediction, goal: float, growth: float, smallest: float = 0.0
) -> Marks:
    """Choose how often to divide the cells of a mesh; the call is collective.

    Args:
        sided: The mesh.
        prediction: What the cells leave in the error, and how fast that falls.
        goal: By how much the error is to be multiplied, in this step or in several ones.
        growth: The largest ratio of the numbers of cells.
        smallest: No cell is to become smaller.
    """
    points = _points(sided.mesh, prediction.remaining, prediction.singular)
    known = prediction.singular & np.isfinite(prediction.places[:, 0])
    points[known] = prediction.places[known]
    singular = np.isfinite(points[:, 0])
    towards = replace(prediction, singular=singular, confirmed=prediction.confirmed | known)
    choice = _Choice(sided.mesh, towards, apart(sided, points), smallest)
    levels = choice.levels_for(goal, math.inf)
    whole = choice.growth(levels)
    if whole > growth > 1.0:  # a short last step would cost as much as others: all have one ratio
        steps = math.ceil(math.log(whole) / math.log(growth))
        levels = choice.levels_for(goal, whole ** (1.0 / steps))
    return Marks(levels, points, choice.growth(levels))


class _Choice:
    """The predictions for numbers of divisions of the cells of a mesh."""

    def __init__(self, domain: mesh.Mesh, prediction: Prediction, between: Mask, smallest: float):
        dimension, self.comm = domain.topology.dim, domain.comm
        far = np.abs(cell_corners(domain)).max(axis=(1, 2))
        room = volumes(domain) ** (1.0 / dimension) / np.maximum(ROUNDING * far, smallest)
        self.singular, self.power = prediction.singular, prediction.power
        self.dimension, remaining = dimension, prediction.remaining
        largest = highest(self.comm, remaining) or 1.0
        sup = math.isinf(self.power)
        power = 1.0 if sup else self.power
        self.exponent = 1.0 if sup else prediction.exponent
        self.parts = np.maximum((remaining / largest) ** power, TINY)
        self.factors = np.clip(prediction.factors**self.exponent, TINY, 1.0 - ROUNDING)
        # What one of the parts of a divided cell has.
        shared = self.factors if sup else self.factors / 2.0**self.dimension
        child = np.where(self.singular, self.factors, shared)
        self._logarithms, self._steps = np.log(self.parts), -np.log(child)
        room = np.floor(np.log2(np.maximum(room, 1.0)))
        deep = np.where(self.singular & prediction.confirmed, np.inf, prediction.deepest)
        self.deepest = np.minimum(np.where(between, LOCATED, deep), room)
        # Bisected cells have other shapes, and the rate of a sup norm is that of the worst one.
        self.finest = np.where(self.singular | sup, 1.0, 1.0 / dimension)
        self.least = self.error(self.deepest)
        self.present = self.error(0 * self.deepest)

    def levels(self, threshold: float) -> Array:
        """The divisions after which no part of a cell is above a threshold."""
        needed = (self._logarithms - math.log(threshold)) / self._steps
        return np.clip(_rounded_up(needed, self.finest), 0.0, self.deepest)

    def levels_for(self, factor: float, growth: float) -> Array:
        """The divisions with the largest threshold that multiply the error by a factor.

        Args:
            factor: The factor.
            growth: The largest ratio of the numbers of cells.
        """
        # One cell may be the worst by chance: in a sup norm those that are nearly so are divided.
        low, high = PRECISION, NOTABLE if math.isinf(self.power) else 1.0
        for _ in range(HALVINGS):
            threshold = math.sqrt(low * high)
            levels = self.levels(threshold)
            if self.is_short_of(factor, threshold, levels) and self.growth(levels) < growth:
                high = threshold
            else:
                low = threshold
        return self.levels(low)

    def error(self, levels: Array) -> float:
        """The error after divisions, to the power."""
        after = self.parts * self.factors**levels
        if math.isinf(self.power):
            return highest(self.comm, after)
        return float(self.comm.allreduce(float(after.sum())))

    def is_short_of(self, factor: float, threshold: float, levels: Array) -> bool:
        """Whether divisions do not multiply the error by a factor, and deeper ones would be better.

        In a sup norm a slow cell hardly spares the others their divisions: in the end they are to
        be below the same number. So many go with the slow cell that the step is worth its price.

        Args:
            factor: The factor that is aimed at.
            threshold: What no part of a cell was to be above.
            levels: The divisions.
        """
        aim = self.present * factor**self.exponent
        if math.isinf(self.power):
            few = self.growth(levels) < SAFETY
            return threshold > aim and (threshold > self.least or few)
        return self.error(levels) > max(aim, SAFETY * self.least)

    def growth(self, levels: Array) -> float:
        """About by how much the number of cells grows."""
        parts = 2**self.dimension
        new = np.where(self.singular, (parts + 1) * levels, parts**levels - 1.0)
        count, old = self.comm.allreduce(np.array([new.sum(), len(new)]))
        return float(1.0 + count / old)


def _points(domain: mesh.Mesh, parts: Array, singular: Mask) -> Array:
    """Find the isolated singular points of a mesh; the call is collective.

    Args:
        domain: The mesh.
        parts: The remaining errors of the owned cells.
        singular: Whether a cell has a slow rate.

    Returns:
        For each owned cell with a singular point the vertex around which the errors are largest,
        and infinity for others. Slow cells side by side, which agree on no vertex, lie along a
        singular line: they are divided like other cells.
    """
    cells = owned_cells(domain)
    vertices = domain.geometry.dofmap[cells]
    largest = highest(domain.comm, parts) or 1.0
    scaled = np.asarray(parts / largest, dtype=np.float64)
    # The mean and not the sum: a corner of the domain has few cells.
    around = averaged(domain.geometry.index_map(), vertices, scaled[:, None])
    worst = around[vertices].argmax(axis=1)
    best = vertices[cells, worst]
    slow = np.flatnonzero(singular & (parts > NOTABLE * largest)).astype(np.int32)
    number = domain.geometry.index_map().local_to_global(best[slow]) + 1.0
    count, first, second = (summed_at_vertices(domain, number**k, slow) for k in range(3))
    mixed = np.abs(count * second - first**2) > 0.5
    isolated = slow[~mixed[vertices[slow]].any(axis=1)]
    points = np.full((len(parts), 3), np.inf)
    points[isolated] = domain.geometry.x[best[isolated]]
    return points
