"""The last solutions of a problem, from which the next one is guessed.

In a loop over time steps or loads the solution moves steadily. The guess is the last solution plus
the multiples of its backward differences whose residual and obstacle are nearest to what is asked
for: with unchanged data the last solution, and in steady motion an extrapolation of third order.
The guess holds the dofs where the combined forces exceed the combined gaps.

Source: Fischer, Comput. Methods Appl. Mech. Eng. 163 (1998) 193-204, for starts of linear solvers
from earlier solutions.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.solvers.system import System

KEPT = 5  # solutions


@dataclass(frozen=True)
class Guess:
    """A guess of a solution.

    Attributes:
        values: The values of the owned dofs.
        held: The active set, one entry per contact dof of this rank.
        doubtful: The contact dofs where the guess may be rough, because the last solutions and the
            guess do not agree about contact.
    """

    values: Array
    held: Mask
    doubtful: Mask


class History:
    """The last solutions, as the last one and its backward differences.

    For example:

        history = History()
        history.add(system, x, multiplier)
        guess = history.guess(system)
    """

    def __init__(self) -> None:
        self._values: list[Array] = []
        self._inner: list[Array] = []  # A times the values, zero at contact dofs
        self._contact: list[Array] = []  # A times the values at contact dofs
        self._obstacle: list[Array] = []
        self._held: list[Mask] = []
        self._assembled = 0  # how often the matrix of the products had been assembled

    def add(self, system: System, x: PETSc.Vec, multiplier: PETSc.Vec) -> None:
        """Remember a solution, and forget an old one.

        Args:
            system: The system; the call is collective.
            x: The solution of the system.
            multiplier: A x - b.
        """
        self._renew(system)
        inner, contact = _split(system, multiplier.array_r + system.b.array_r)
        self._values = _differences(x.array_r.copy(), self._values)
        self._inner = _differences(inner, self._inner)
        self._contact = _differences(contact, self._contact)
        self._obstacle = _differences(system.obstacle.copy(), self._obstacle)
        self._held = [system.touching(x), *self._held[: KEPT - 1]]

    def guess(self, system: System) -> Guess | None:
        """Return a guess of the solution of a system, or None before the first solution.

        Args:
            system: The system to be solved; the call is collective.
        """
        if not self._held:
            return None
        self._renew(system)
        steps = self._steps(system)
        values = _combined(self._values, steps)
        dofs = system.contact_dofs
        force = system.signs * (_combined(self._contact, steps) - system.b.array_r[dofs])
        held = force > system.scaled_gap(values[dofs])
        doubtful = np.any([other != held for other in self._held], axis=0)
        return Guess(values, held, doubtful)

    def _renew(self, system: System) -> None:
        """Multiply the values by the matrix again if the matrix is another one."""
        if system.assembled != self._assembled and self._values:
            x, y = system.A.createVecs()
            for i, values in enumerate(self._values):
                x.array_w[:] = values
                system.A.mult(x, y)
                self._inner[i], self._contact[i] = _split(system, y.array_r.copy())
            x.destroy()
            y.destroy()
        self._assembled = system.assembled

    def _steps(self, system: System) -> Array:
        """Return the factors of the backward differences in the guess.

        The sum of squares of the residual, at dofs that no solution holds, and of what is missing
        of the obstacle, in the unit of forces, is smallest.
        """
        dofs, held = system.contact_dofs, np.zeros(system.A.getLocalSize()[0], dtype=bool)
        held[dofs[np.any(self._held, axis=0)]] = True
        free = ~held[dofs]
        inner, contact = _split(system, system.b.array_r.copy())
        missing = np.concatenate((contact - self._contact[0], system.obstacle - self._obstacle[0]))
        known = [np.concatenate(pair) for pair in zip(self._contact, self._obstacle, strict=True)]
        weights = np.concatenate((free, system.contact_diagonal))
        far = [*self._inner[1:], inner - self._inner[0]]
        near = [weights * column for column in (*known[1:], missing)]
        with np.errstate(over="ignore", invalid="ignore"):  # of an obstacle that came from far away
            products = _products(far) + _products(near)
        system.comm.Allreduce(MPI.IN_PLACE, products, op=MPI.SUM)
        return _least_squares(products)


def _split(system: System, force: Array) -> tuple[Array, Array]:
    """Forces away from the contact dofs, and at the contact dofs; overwritten."""
    contact = force[system.contact_dofs]
    force[system.contact_dofs] = 0.0
    return force, contact


def _differences(new: Array, old: Sequence[Array]) -> list[Array]:
    """The backward differences of a sequence, whose last element is new, from those before."""
    found = [new]
    for difference in old[: KEPT - 1]:
        found.append(found[-1] - difference)
    return found


def _combined(differences: Sequence[Array], steps: Array) -> Array:
    found = differences[0].copy()
    for step, difference in zip(steps, differences[1:], strict=True):
        found += step * difference
    return found


def _products(columns: Sequence[Array]) -> Array:
    """The inner products of columns, which are too long to be copied side by side."""
    found = np.zeros((len(columns), len(columns)))
    for k, column in enumerate(columns):
        found[k, : k + 1] = found[: k + 1, k] = [column @ other for other in columns[: k + 1]]
    return found


def _least_squares(products: Array) -> Array:
    """The factors of all columns but the last whose combination is nearest to the last.

    Args:
        products: The inner products of the columns.
    """
    size = np.sqrt(np.diag(products)[:-1])
    if not np.isfinite(products).all():  # the squares have left the range of numbers
        return np.zeros(len(size))
    size[size == 0.0] = 1.0
    matrix = products[:-1, :-1] / np.outer(size, size)
    inverse = np.linalg.pinv(matrix, ROUNDING, hermitian=True)
    return np.asarray(inverse @ (products[:-1, -1] / size) / size)
