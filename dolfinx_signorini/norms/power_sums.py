"""Sums of p-th powers that neither overflow nor underflow, for any p and values of any size."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array


def p_norm(values: Array, p: float, weights: Array | float = 1.0) -> Array:
    """Return (sum of w |v|^p)^(1/p) over the last axis, for p = inf the largest |v|.

    The powers are those of |v| / m, m the largest |v|. What is not a number stays so.

    Args:
        values: The values v, of any shape.
        p: The exponent, from 1 to infinity.
        weights: The weights w, broadcast to the shape of the values; unused for p = inf.
    """
    # NumPy is slow along a last axis of a few points.
    sizes = np.ascontiguousarray(np.moveaxis(np.abs(values), -1, 0))
    largest = sizes.max(axis=0, initial=0.0)
    if math.isinf(p):
        return np.asarray(largest)
    with np.errstate(invalid="ignore"):
        sizes /= np.where((largest > 0.0) & np.isfinite(largest), largest, 1.0)
        sizes = power(sizes, p)
        sizes *= np.moveaxis(np.broadcast_to(weights, np.shape(values)), -1, 0)
        total = sizes.sum(axis=0)
    return np.asarray(largest * total ** (1.0 / p))


def norm_of_all(comm: MPI.Comm, values: Array, p: float) -> float:
    """Return the norm over all places of all ranks, from the norms on the places of this rank.

    Args:
        comm: The communicator; the call is collective.
        values: The norms on the places of this rank.
        p: The exponent, from 1 to infinity.

    Raises:
        FloatingPointError: The norm is not a number on some rank.
    """
    norm = total(values, p, comm)
    if not math.isfinite(norm):
        raise FloatingPointError(f"the error is {norm} at a point of evaluation")
    return norm


def total(values: Array, p: float, comm: MPI.Comm) -> float:
    """Return the norm over all places of all ranks as `norm_of_all` does, finite or not."""
    return float(p_norm(np.array(comm.allgather(float(p_norm(values, p)))), p))


def joined(one: Array, other: Array, p: float) -> Array:
    """Return for each place the norm over two values, not negative, that the place has."""
    return p_norm(np.stack((one, other), axis=-1), p)


def collected(values: Array, owners: npt.NDArray[np.integer[Any]], count: int, p: float) -> Array:
    """Return for each place the norm over the values that belong to the place, 0 for none.

    Args:
        values: The values, not negative.
        owners: For each of them its place.
        count: The number of places.
        p: The exponent, from 1 to infinity.
    """
    result = np.zeros(count)
    if math.isinf(p):
        np.maximum.at(result, owners, values)
        return result
    largest = float(values.max(initial=0.0))
    largest = largest if 0.0 < largest < math.inf else 1.0
    sums = np.bincount(owners, (values / largest) ** p, count)
    return np.asarray(largest * sums ** (1.0 / p))


def power(values: Array, p: float) -> Array:
    """Return values^p, for a power of two by squaring (several times faster than pow).

    Args:
        values: The values, which may be overwritten.
        p: The exponent, from 1 on.
    """
    exponent = math.log2(p)
    if exponent != int(exponent):
        return values**p
    for _ in range(int(exponent)):
        values = np.square(values, out=values)
    return values
