"""The diffusion at points of cells, and numbers that bound functions in the cells."""

import math
from dataclasses import dataclass

import numpy as np

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.tolerances import SOLVED


@dataclass(frozen=True)
class Diffusion:
    """The diffusion A at points of cells: a multiple of the identity, or a symmetric matrix."""

    values: Array  # shape (cells, points, 1), or (cells, points, d, d); (1, 1, ...) for constants
    inverses: Array  # of the values, with the same shape
    lowest: Array  # the smallest eigenvalue at the points of each cell
    upper: Array  # what A at the points of each cell does not exceed, shape (cells, d, d)

    @property
    def symmetric(self) -> bool:
        """Whether A is symmetric at all points, up to rounding."""
        if self.values.ndim == 3:
            return True
        apart = np.abs(self.values - self.values.swapaxes(2, 3)).max(axis=(2, 3))
        return bool((apart <= SOLVED * np.abs(self.values).max(axis=(2, 3))).all())

    def times(self, vectors: Array) -> Array:
        """Return the products of A with vectors, shape (cells, points, d)."""
        return _product(self.values, vectors)

    def divided(self, vectors: Array) -> Array:
        """Return the products of the inverse of A with vectors, shape (cells, points, d)."""
        return _product(self.inverses, vectors)


def stacked(entries: list[Array], dimension: int) -> Array:
    """Return numbers or matrices at points from the values of each entry."""
    shape = (1,) if len(entries) == 1 else (dimension, dimension)
    values = np.stack(np.broadcast_arrays(*entries), axis=2)
    return values.reshape(*values.shape[:2], *shape)


def diffusion_at(values: Array, dimension: int, cells: int) -> Diffusion:
    """Return the diffusion with given values, see `stacked`, on some number of cells."""
    spectrum = values if values.ndim == 3 else np.linalg.eigvalsh(values)
    lowest = spectrum.min(axis=(1, 2), initial=np.inf)
    upper = spectrum.max(axis=(1, 2), initial=-np.inf)[:, None, None] * np.eye(dimension)
    if values.ndim == 4:
        same = (values == values[:, :1]).all(axis=(1, 2, 3))[:, None, None]
        upper = np.where(same, values[:, 0], upper)
    inverses = values
    if (lowest > 0.0).all():
        inverses = np.asarray(1.0 / values if values.ndim == 3 else np.linalg.inv(values), float)
    upper = np.broadcast_to(upper, (cells, dimension, dimension))
    return Diffusion(values, inverses, np.broadcast_to(lowest, cells), upper)


def dots(one: Array, other: Array) -> Array:
    """Return the products of vectors at points of cells, shape (cells, points)."""
    return np.asarray(np.einsum("nqa,nqa->nq", one, other))


def means(values: Array, weights: Array) -> Array:
    """Return means over cells of functions, which may have one value for all points of a cell."""
    same = values.shape[1] == 1
    return np.asarray(values[:, 0] if same else np.tensordot(values, weights, (1, 0)), float)


def mean_matrices(values: Array, weights: Array, dimension: int) -> Array:
    """Return means over cells of multiples of the identity or of matrices, shape (cells, d, d)."""
    mean = means(values, weights)
    return mean if mean.ndim == 3 else np.asarray(mean[..., None] * np.eye(dimension))


def _product(matrices: Array, vectors: Array) -> Array:
    if matrices.ndim == 3:
        return np.asarray(matrices * vectors)
    return np.asarray((matrices @ vectors[..., None])[..., 0])


@dataclass(frozen=True)
class CellScales:
    """Numbers of each cell that bound functions in the cell.

    For example the integral of c w^2 over each cell for |w| <= 1 is at most

        scales.volumes * scales.largest_reaction

    Attributes:
        volumes, diameters: The sizes of the cells, and the lengths of the longest edges.
        lowest: The smallest eigenvalue of the diffusion, as far as that is known.
        upper: A matrix that the diffusion does not exceed, shape (cells, d, d).
        least_reaction, largest_reaction: The extrema of c, as far as they are known.
    """

    volumes: Array
    diameters: Array
    lowest: Array
    upper: Array
    least_reaction: Array
    largest_reaction: Array

    @property
    def l2_weight(self) -> Array:
        """The L2 norm of w on each cell is at most this times that of c^(1/2) w."""
        with np.errstate(divide="ignore"):
            return np.asarray(1.0 / np.sqrt(self.least_reaction))

    @property
    def gradient_weight(self) -> Array:
        """The L2 norm of w - mean(w) is at most this times that of A^(1/2) grad w.

        Source: Payne and Weinberger, Arch. Rational Mech. Anal. 5 (1960) 286-292.
        """
        return self.diameters / (math.pi * np.sqrt(self.lowest))

    @property
    def weak(self) -> Mask:
        """Whether the reaction is weak, so that functions are tested with gradients."""
        return np.asarray(self.gradient_weight <= self.l2_weight)
