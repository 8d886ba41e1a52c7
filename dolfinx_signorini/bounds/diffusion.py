"""The diffusion A at points of cells: a multiple of the identity, or a symmetric matrix."""

from dataclasses import dataclass

import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.tolerances import SOLVED


@dataclass(frozen=True)
class Diffusion:
    """The diffusion A at points of cells.

    For example the energy of a gradient, shape (cells, points):

        (gradient * diffusion.times(gradient)).sum(axis=-1)

    Attributes:
        values: The diffusion, shape (cells, points, 1), or (cells, points, d, d) for matrices.
        inverses: The inverses of the values, with the same shape.
        lowest: The smallest eigenvalue of A at the points of each cell.
        upper: A matrix that A at the points of each cell does not exceed, shape (cells, d, d).
    """

    values: Array
    inverses: Array
    lowest: Array
    upper: Array

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

    def mean_inverse(self, weights: Array, dimension: int) -> Array:
        """Return the mean of the inverse of A over each cell, shape (cells, d, d).

        Args:
            weights: The weights of the points.
            dimension: The dimension of the domain.
        """
        mean = np.asarray(np.tensordot(self.inverses, weights, (1, 0)), dtype=np.float64)
        return mean if mean.ndim == 3 else np.asarray(mean[..., None] * np.eye(dimension))


def diffusion_at(entries: Array, dimension: int) -> Diffusion:
    """Return the diffusion with given entries.

    Args:
        entries: The entries of A at points, shape (cells, points, 1), or (cells, points, d^2).
        dimension: The dimension d of the domain.
    """
    if entries.shape[2] == 1:
        lowest = entries.min(axis=(1, 2), initial=np.inf)
        upper = entries.max(axis=(1, 2), initial=-np.inf)[:, None, None] * np.eye(dimension)
        with np.errstate(divide="ignore"):
            return Diffusion(entries, np.asarray(1.0 / entries, dtype=np.float64), lowest, upper)
    values = entries.reshape(*entries.shape[:2], dimension, dimension)
    spectrum = np.linalg.eigvalsh(values)
    lowest = spectrum.min(axis=(1, 2), initial=np.inf)
    largest = spectrum.max(axis=(1, 2), initial=-np.inf)[:, None, None]
    same = (values == values[:, :1]).all(axis=(1, 2, 3))[:, None, None]
    upper = np.where(same, values[:, 0], largest * np.eye(dimension))
    usable = bool((lowest > 0.0).all())
    inverses: Array = np.asarray(np.linalg.inv(values), dtype=np.float64) if usable else values
    return Diffusion(values, inverses, lowest, upper)


def _product(matrices: Array, vectors: Array) -> Array:
    if matrices.ndim == 3:
        return np.asarray(matrices * vectors)
    return np.asarray((matrices @ vectors[..., None])[..., 0])
