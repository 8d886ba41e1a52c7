"""The last solutions of a problem, from which the next one is guessed.

In a loop over time steps or loads the solution moves steadily. The values are extrapolated
linearly. At an end of the contact set the pressure is like the root of the distance to the end, and
the gap like its power 3/2. So the square of the pressure and the power 2/3 of the gap move linearly
with the end: their extrapolations predict the end to the dof.

Source: Christof and Haubner, Section 2.2, for the singularity.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from dolfinx_signorini.system import System

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class _Solution:
    values: Array
    held: Mask
    gap: Array
    force: Array


class History:
    """The last two solutions.

    For example:

        history = History()
        history.add(system, x)
        for values, held in history.guesses(system):
            ...
    """

    def __init__(self) -> None:
        self._last: list[_Solution] = []

    def add(self, system: System, x: PETSc.Vec) -> None:
        """Remember a solution, and forget the one before the last.

        Args:
            system: The system.
            x: Its solution.
        """
        held = system.touching(x)
        gap = np.where(held, 0.0, x.array_r[system.contact_dofs] - system.obstacle)
        force = np.where(held, np.maximum(system.multiplier(x), 0.0), 0.0)
        self._last = [*self._last[-1:], _Solution(x.array_r.copy(), held, gap, force)]

    def guesses(self, system: System) -> list[tuple[Array, Mask]]:
        """Return guesses of the values of the owned dofs and of the active set.

        Args:
            system: The system to be solved.

        Returns:
            The last solution and, after two solutions, their extrapolation; nothing before the
            first solution.
        """
        if not self._last:
            return []
        last = self._last[-1]
        found = [(last.values, last.held)]
        if len(self._last) > 1:
            before = self._last[0]
            # 2 force^2 >= force'^2 and 2 gap^(2/3) < gap'^(2/3), without powers that overflow.
            pressed = 2.0**0.5 * last.force >= before.force
            met = 2.0**1.5 * last.gap < before.gap
            held = np.where(last.held, pressed, met)
            found.append((2.0 * last.values - before.values, held))
        dofs = system.contact_dofs
        return [(v, held | (v[dofs] < system.obstacle)) for v, held in found]
