"""The diffusion A at points of cells: a multiple of the identity, or a symmetric matrix."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Diffusion:
    """A at points of cells.

    For example the energy of a gradient, shape (cells, points):

        (gradient * diffusion.times(gradient)).sum(axis=-1)

    Attributes:
        values: Shape (cells, points, 1), or (cells, points, d, d) for matrices.
        inverses: Those of the values.
        lowest: The smallest eigenvalue of A at the points of each cell.
    """

    values: Array
    inverses: Array
    lowest: Array

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
        with np.errstate(divide="ignore"):
            return Diffusion(entries, np.asarray(1.0 / entries, dtype=np.float64), lowest)
    values = entries.reshape(*entries.shape[:2], dimension, dimension)
    lowest = np.linalg.eigvalsh(values).min(axis=(1, 2), initial=np.inf)
    usable = bool((lowest > 0.0).all())
    inverses: Array = np.asarray(np.linalg.inv(values), dtype=np.float64) if usable else values
    return Diffusion(values, inverses, lowest)


def _product(matrices: Array, vectors: Array) -> Array:
    if matrices.ndim == 3:
        return np.asarray(matrices * vectors)
    return np.asarray((matrices @ vectors[..., None])[..., 0])
