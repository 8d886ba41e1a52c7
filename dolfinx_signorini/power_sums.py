"""Sums of p-th powers that neither overflow nor underflow, for any p and values of any size."""

import math
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

Array: TypeAlias = npt.NDArray[np.floating[Any]]


class PowerSum:
    """The sum of w |v|^p over point values v, kept as the largest |v| and sum of w (|v| / m)^p.

    The sum is relative to the largest value m met so far:

        power_sum = PowerSum(4.0)
        power_sum.add(values, values.max(), weights, factors)
        norm = power_sum.reduce(comm).root

    Args:
        p: The exponent, from 1 to infinity.

    Attributes:
        largest: The largest |v| so far, m.
        total: The sum of w (|v| / m)^p so far; unused for p = inf.
    """

    def __init__(self, p: float):
        self.p = p
        self.largest = 0.0
        self.total = 0.0

    def add(self, values: Array, largest: float, weights: Array, factors: Array) -> None:
        """Add sum_c factors_c sum_q weights_q |values_cq|^p.

        Args:
            values: Absolute values, shape (cells, points).
            largest: The largest of them.
            weights: Shape (points,).
            factors: Shape (cells,) where they are the same at all points, or (cells, points).
        """
        self.include(largest)
        if largest == 0.0 or math.isinf(self.p) or not math.isfinite(self.largest):
            return
        powers = _power(values / self.largest, self.p)
        if factors.ndim == 2:
            self.total += float(((powers * factors) @ weights).sum())
        else:
            self.total += float(factors @ (powers @ weights))

    def merge(self, other: "PowerSum") -> None:
        """Add another sum for the same p."""
        self.include(other.largest)
        if other.largest > 0.0 and not math.isinf(self.p):
            self.total += other.total * (other.largest / self.largest) ** self.p

    def include(self, largest: float) -> None:
        """Make the sum relative to a value if the value is larger than all before."""
        if largest <= self.largest or math.isnan(self.largest):
            return  # what is not a number is kept, and reported
        if not math.isinf(self.p):
            self.total *= (self.largest / largest) ** self.p
        self.largest = largest

    def reduce(self, comm: MPI.Comm) -> "PowerSum":
        """Return the sum over all ranks.

        Raises:
            FloatingPointError: Some value on some rank is not a finite number.
        """
        result = PowerSum(self.p)
        for largest, total in comm.allgather((self.largest, self.total)):
            if not math.isfinite(largest):
                raise FloatingPointError(f"the error is {largest} at a point of evaluation")
            part = PowerSum(self.p)
            part.largest, part.total = largest, total
            result.merge(part)
        return result

    @property
    def root(self) -> float:
        """The p-th root of the sum; for p = inf the largest value."""
        if math.isinf(self.p) or self.largest == 0.0:
            return self.largest
        return self.largest * self.total ** (1.0 / self.p)


def _power(values: Array, p: float) -> Array:
    """Return values^p, for a power of two by squaring (several times faster than pow)."""
    exponent = math.log2(p)
    if exponent != int(exponent):
        return values**p
    for _ in range(int(exponent)):
        values = np.square(values, out=values)
    return values
