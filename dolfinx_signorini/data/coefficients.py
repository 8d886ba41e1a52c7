"""The coefficients and the load of -div(A grad u) + c u = f as formulas."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.data.formulas import ONE, ZERO, Formula, Node, evaluated


@dataclass(frozen=True)
class Coefficients:
    """What is known of an equation in the domain:

        Coefficients(load=parse("sin(pi*x)"), reaction=None, diffusion=())

    Attributes:
        load: f; None for 0.
        reaction: c; None for 0.
        diffusion: The rows of A; one entry stands for a multiple of the identity, none for 1.
    """

    load: Formula | None
    reaction: Formula | None
    diffusion: tuple[tuple[Formula, ...], ...]

    @property
    def entries(self) -> tuple[Formula, ...]:
        """The entries of A."""
        return tuple(entry for row in self.diffusion for entry in row)

    def diffusion_at(self, x: Array) -> Array:
        """Return A at points, shape (..., dimension); the indices of the matrix come first."""
        rows = tensor(self.diffusion, x.shape[-1])
        return np.array([[evaluated(node, x) for node in row] for row in rows])


def tensor(rows: Sequence[Sequence[Formula]], dimension: int) -> list[list[Node]]:
    """Return all entries of A, whose rows are given as `Coefficients` has them."""
    entries = [[entry.root for entry in row] for row in rows] or [[ONE]]
    if len(entries) > 1:
        return entries
    every = range(dimension)
    return [[entries[0][0] if i == j else ZERO for j in every] for i in every]
