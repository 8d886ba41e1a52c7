"""Adaptive sampling of data: so many samples that no narrow peak is between them.

Cells or facets are divided into pieces. The values of a formula at points of a piece and an
enclosure of all values on the piece tell what may be hidden between the points. The pieces that may
hide most are divided again and again, until no piece may hide anything that matters.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.data.enclosures import enclosed_on_boxes, enclosed_on_simplices
from dolfinx_signorini.data.formulas import Formula, evaluated
from dolfinx_signorini.data.interfaces.pieces import (
    FINE,
    MOST_PIECES,
    Numbers,
    corners_of_reference,
    divided,
    inside,
    widths,
)
from dolfinx_signorini.meshes.quadrature import CELL_RULE
from dolfinx_signorini.meshes.sided_meshes import simplex_sizes

# Of the polynomials that follow data which are integrated: about as many points as quadrature has.
DEGREE = (CELL_RULE.degree + 1) // 2
HIDDEN = {"mass": 1e-4, "height": 0.05}  # what a piece may hide, of the norm of the datum


@dataclass(frozen=True)
class Datum:
    """A formula with the part of the domain or of its boundary where the formula is a datum:

        Datum("load", scene.load, "mass", 4, corners, np.arange(len(corners)))

    Attributes:
        name: What the datum is called in notes.
        formula: The formula.
        measure: What counts: "mass" for data that are integrated, "height" for data whose values
            the solution takes.
        degree: The degree of the polynomials that are to follow the datum.
        corners: The vertices of the owned cells or facets, shape (parts, vertices, dimension).
        owners: The cells of these parts.
    """

    name: str
    formula: Formula
    measure: str
    degree: int
    corners: Array
    owners: Numbers


@dataclass
class Samples:
    """The values of a datum at points that no narrow peak is between:

        samples = sample(datum, domain.comm, size=1.0)

    Attributes:
        points: The points, shape (points, dimension).
        values: The values of the datum.
        weights: The weights of the points in integrals.
        owners: The cells around the points.
        unclear: Whether the datum is not known from its values in the piece around the point, as
            where the datum jumps.
        norm: The integral of the size of the datum; for the measure "height" its range.
        hidden: The largest part of the norm that one piece may hide, where the search was ended
            before all pieces were clear; else 0.
    """

    points: Array
    values: Array
    weights: Array
    owners: Numbers
    unclear: Mask
    norm: float
    hidden: float


def sample(datum: Datum, comm: MPI.Comm, size: float) -> Samples:
    """Sample a datum so closely that nothing that matters is between the samples.

    Args:
        datum: The datum.
        comm: The communicator of the mesh; the call is collective.
        size: The width of the domain.
    """
    search = _Search(datum, comm, size)
    while search.divide():
        pass
    return search.samples()


class _Search:
    """The pieces of a datum, with the values at their points, and what each piece may hide."""

    def __init__(self, datum: Datum, comm: MPI.Comm, size: float):
        self.datum, self.comm, self.size = datum, comm, size
        vertices = datum.corners.shape[1]
        self.dimension = vertices - 1
        unit = corners_of_reference(self.dimension)
        b = (1.0 - 1.0 / math.sqrt(self.dimension + 2.0)) / vertices  # exact for degree 2
        self.lattice = np.concatenate((unit, b + (1.0 - vertices * b) * unit))
        pieces, owners = datum.corners, datum.owners
        for _ in range(self._times(self._sum(len(pieces)))):
            pieces, owners = divided(pieces, owners)
        self.pieces, self.owners = pieces, owners
        self.volumes, self.values, self.hidden, self.divisible = self._sampled(pieces)
        self.sharp = np.zeros(len(pieces), dtype=bool)  # whether mean value forms are known
        self.stopped = False

    def divide(self) -> bool:
        """Divide the pieces that may hide most; whether a piece was divided."""
        norm = self._norm()
        self._sharpen(norm)
        # Of the norm or, where that is finite and more, of what one piece may hide.
        finite = np.where(np.isfinite(self.hidden), self.hidden, 0.0)
        threshold = HIDDEN[self.datum.measure] * max(norm, highest(self.comm, finite))
        room = (MOST_PIECES - self._sum(len(self.pieces))) / (2**self.dimension - 1)
        for _ in range(100):
            chosen = self.divisible & (self.hidden > threshold)
            count = self._sum(chosen.sum())
            if count <= room:
                break
            self.stopped, threshold = True, 4.0 * threshold
        if count == 0 or count > room:
            return False
        new, owners = self.pieces[chosen], self.owners[chosen]
        for _ in range(max(self._times(count), 1)):
            new, owners = divided(new, owners)
        every = "pieces", "owners", "volumes", "values", "hidden", "divisible", "sharp"
        found = new, owners, *self._sampled(new), np.zeros(len(new), dtype=bool)
        for name, more in zip(every, found, strict=True):
            setattr(self, name, np.concatenate((getattr(self, name)[~chosen], more)))
        return True

    def _sharpen(self, norm: float) -> None:
        """Use mean value forms where natural enclosures hide much of the norm.

        Where the natural enclosure is infinite, so are the derivatives.
        """
        much = HIDDEN[self.datum.measure] * norm
        rows = np.flatnonzero((self.hidden > much) & np.isfinite(self.hidden) & ~self.sharp)
        if len(rows):
            enclosures = enclosed_on_simplices(self.datum.formula, self.pieces[rows])
            self.hidden[rows] = self._hidden(enclosures, self.values[rows], self.volumes[rows])
            self.sharp[rows] = True

    def _times(self, count: float) -> int:
        """How often pieces are divided at once: to look at few takes as long as at one."""
        return int(math.log(max(FINE / max(count, 1.0), 1.0), 2**self.dimension))

    def samples(self) -> Samples:
        """Return the values at the points of the pieces that count."""
        counted = slice(len(self.lattice) // 2 if self.datum.measure == "mass" else 0, None)
        points = inside(self.pieces, self.lattice[counted]).transpose(1, 0, 2)
        values, norm = self.values[:, counted], self._norm()
        count, known = values.shape[1], np.isfinite(values)
        unclear = self.hidden > HIDDEN[self.datum.measure] * norm
        open_ = self.divisible & self.stopped
        largest = highest(self.comm, np.where(open_, self.hidden, 0.0))
        return Samples(
            points=points.reshape(-1, points.shape[2]),
            values=np.where(known, values, 0.0).ravel(),
            weights=(known * self._weights()[:, counted]).ravel(),
            owners=np.repeat(self.owners, count),
            unclear=np.repeat(unclear, count),
            norm=norm,
            hidden=largest / norm if norm > 0.0 else float(largest > 0.0),
        )

    def _sampled(self, pieces: Array) -> tuple[Array, Array, Array, Mask]:
        """Return volumes, values at the points of pieces, and what is hidden between the points.

        The last array tells which pieces are large enough to be divided.
        """
        formula, volumes = self.datum.formula, simplex_sizes(pieces)
        values = evaluated(formula.root, inside(pieces, self.lattice)).T
        enclosures = enclosed_on_boxes(formula, pieces.min(axis=1), pieces.max(axis=1))
        divisible = widths(pieces) > SOLVED * self.size
        return volumes, values, self._hidden(enclosures, values, volumes), divisible

    def _hidden(self, enclosures: Array, values: Array, volumes: Array) -> Array:
        """What pieces hide between their points at most, by enclosures of all values on them."""
        least, most = _extremes(values, 1)
        above, below = enclosures[1] - most, least - enclosures[0]
        hidden = np.nan_to_num(np.maximum(np.maximum(above, below), 0.0), nan=np.inf, posinf=np.inf)
        return np.asarray(hidden * volumes if self.datum.measure == "mass" else hidden)

    def _norm(self) -> float:
        if self.datum.measure == "mass":
            sizes = np.where(np.isfinite(self.values), np.abs(self.values), 0.0)
            return self._sum((sizes * self._weights()).sum())
        least, most = _extremes(self.values, None)
        ends = np.max(self.comm.allgather((most, -least)), axis=0)
        return max(float(ends.sum()), 0.0)

    def _weights(self) -> Array:
        vertices = self.dimension + 1
        shares = np.repeat((0.0, 1.0 / vertices), vertices)
        return np.asarray(self.volumes[:, None] * shares)

    def _sum(self, value: Any) -> float:
        return float(self.comm.allreduce(float(value)))


def _extremes(values: Array, axis: int | None) -> tuple[Array, Array]:
    """The least and the largest finite values."""
    known = np.isfinite(values)
    least = np.where(known, values, np.inf).min(axis=axis, initial=np.inf)
    return least, np.where(known, values, -np.inf).max(axis=axis, initial=-np.inf)
