"""Convex quadratic programs with sparse matrices, by an interior point method.

Source: Nocedal and Wright, Numerical Optimization, 2006, Section 16.6 (predictor and corrector).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.tolerances import PRECISION, SOLVED
from dolfinx_signorini.bounds.reference_flux import MOST_NUMBERS

# Of SuperLU, for positive definite matrices: the factors have half of the entries. With equations
# they have more entries than by default.
SYMMETRIC: dict[str, Any] = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.0,
    "options": {"SymmetricMode": True},
}
# By dimension: entries of the matrices of all cells of a program. In space the factors have four
# times as many entries for each entry of the matrix.
MOST_ENTRIES = {2: MOST_NUMBERS, 3: MOST_NUMBERS // 8}
STEPS = 60  # of about 15 that are needed
SHORT = 0.995  # of the way to the next bound


@dataclass(frozen=True)
class QuadraticProgram:
    """Minimise z.H z / 2 - h.z with C z = c and E z >= e:

        z = QuadraticProgram(H, h, C, c, E, e).solution()

    Attributes:
        H: The matrix, symmetric and positive semidefinite.
        h: The linear part.
        C, c: The equations, which have no more rows than there are numbers z.
        E, e: The inequalities.
    """

    H: sp.csc_matrix
    h: Array
    C: sp.csc_matrix
    c: Array
    E: sp.csr_matrix
    e: Array

    def solution(self, slack: Array) -> Array | None:
        """Return the z, up to the method's tolerance; None where none is found.

        Args:
            slack: A guess of E z - e, positive.
        """
        z: Array = np.zeros(len(self.h))
        y: Array = np.zeros(len(self.c))
        b = slack.copy()
        nu: Array = np.full(len(b), np.abs(self.H.diagonal()).max(initial=0.0) * slack.mean())
        first = float(b @ nu)
        for _ in range(STEPS):
            found = self._step(z, y, b, nu)
            if found is None:
                return None
            share, (dz, dy, db, dnu) = found
            z, y, b, nu = z + share * dz, y + share * dy, b + share * db, nu + share * dnu
            if share > 0.9 and float(b @ nu) <= SOLVED * first:
                return z if np.isfinite(z).all() else None
        return None

    def _step(
        self, z: Array, y: Array, b: Array, nu: Array
    ) -> tuple[float, tuple[Array, Array, Array, Array]] | None:
        """The share to take of a change of z, the multipliers, the slack and its multipliers."""
        dual = self.H @ z - self.h - self.C.T @ y - self.E.T @ nu
        primal, apart = self.C @ z - self.c, self.E @ z - self.e - b
        stiff = self.H + self.E.T @ sp.diags(nu / b) @ self.E
        tiny = sp.identity(len(y)) * (PRECISION / max(np.abs(self.H.diagonal()).max(), PRECISION))
        matrix = sp.bmat([[stiff, -self.C.T], [self.C, tiny]]).tocsc()
        try:
            factor = splu(matrix, **(SYMMETRIC if not len(y) else {}))
        except RuntimeError:  # a singular matrix
            return None

        def change(target: Array | float) -> tuple[Array, Array, Array, Array]:
            ahead = -nu + target / b - nu / b * apart
            step = factor.solve(np.concatenate((self.E.T @ ahead - dual, -primal)))
            dz = step[: len(z)]
            moved = self.E @ dz
            return dz, step[len(z) :], moved + apart, ahead - nu / b * moved

        _, _, db, dnu = change(0.0)
        share = min(_most(b, db), _most(nu, dnu))
        gap = float(b @ nu)
        left = float((b + share * db) @ (nu + share * dnu))
        step = change((left / gap) ** 3 * gap / len(b) - db * dnu)
        return SHORT * min(_most(b, step[2]), _most(nu, step[3])), step


def _most(values: Array, change: Array) -> float:
    """The largest share of a change that leaves positive values positive, 1 / SHORT at most."""
    down = change < 0.0
    return float(np.min(-values[down] / change[down], initial=1.0 / SHORT))
