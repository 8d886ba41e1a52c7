"""Convex quadratic programs with sparse matrices, by an interior point method.

Source: Nocedal and Wright, Numerical Optimization, 2006, Section 16.6 (predictor and corrector).
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from dolfinx_signorini.base.arrays import Array, Indices
from dolfinx_signorini.base.tolerances import HALF_OF_THE_DIGITS, HALVINGS, SOLVED
from dolfinx_signorini.bounds.reference_flux import MOST_NUMBERS
from dolfinx_signorini.solvers.linear.projected import SYMMETRIC

# By dimension: entries of the matrices of all cells of a program. In space the factors fill up
# faster: the bowl with P1 on the cube has programs of this size up to 14 cells per side, and its
# bound without them is 1.15 times the error with 16.
MOST_ENTRIES = {2: MOST_NUMBERS, 3: MOST_NUMBERS // 2}
UZAWA = 3  # each gains about half of the digits of the equations
SHORT = 0.995  # of the way to the next bound


def assembled(
    places: Indices, matrices: Array, vectors: Array, size: int
) -> tuple[sp.csc_matrix, Array]:
    """Return the sum of the matrices and vectors of cells.

    Args:
        places: The places of the numbers of each cell, shape (cells, n); `size` for none.
        matrices: The matrices of the cells, shape (cells, n, n).
        vectors: The vectors of the cells, shape (cells, n).
        size: How many numbers there are in all.
    """
    rows, columns = np.broadcast_arrays(places[:, :, None], places[:, None, :])
    used = (rows < size) & (columns < size)
    H = sp.coo_matrix((matrices[used], (rows[used], columns[used])), (size, size)).tocsc()
    h = np.bincount(places.ravel(), vectors.ravel(), size + 1)[:size]
    return H, np.asarray(h, dtype=np.float64)


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
        for _ in range(HALVINGS):  # about 15 are needed
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
        weight = np.abs(self.H.diagonal()).max(initial=0.0) / HALF_OF_THE_DIGITS
        try:
            factor = splu((stiff + weight * self.C.T @ self.C).tocsc(), **SYMMETRIC)
        except RuntimeError:  # a singular matrix
            return None

        def solved(right: Array) -> tuple[Array, Array]:
            """The z with given C z, and the multipliers, by the augmented Lagrangian."""
            moved, multipliers = 0.0 * z, 0.0 * y
            for _ in range(UZAWA if len(y) else 1):
                left = self.C.T @ (multipliers - weight * primal)
                moved = factor.solve(right + left)
                multipliers = multipliers - weight * (primal + self.C @ moved)
            return moved, multipliers

        def change(target: Array | float) -> tuple[Array, Array, Array, Array]:
            ahead = -nu + target / b - nu / b * apart
            dz, dy = solved(self.E.T @ ahead - dual)
            moved = self.E @ dz
            return dz, dy, moved + apart, ahead - nu / b * moved

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
