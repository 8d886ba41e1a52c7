"""The energy of the scene `floor` of the benchmark collection to twelve digits, without a mesh.

    python3 benchmarks/floor_energy.py

Without the floor the solution is y^2 - 1. What the floor adds to y^2 - 1 is harmonic, 0 at the top
and without flux through the sides. A series of cosines gives its values w on the bottom from the
contact pressure there:

    w(x) = integral of G(x, s) pressure(s) ds
    G(x, s) = 1 + 2 sum over k of tanh(k pi)/(k pi) cos(k pi x) cos(k pi s)

With t = cos(pi x), and 1 in place of tanh, G is 1 - log(2 |t(x) - t(s)|)/pi, whose integrals
against Chebyshev polynomials over sqrt(1 - tau^2) are known in closed form; the rest of the series
converges like exp(-2 k pi). The pressure is a sum of such terms, with tau in [-1, 1] along the
contact interval, and the interval is the one at both of whose ends the pressure is 0.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

# The energy of y^2 - 1.
FREE_ENERGY = -2.0 / 3.0
TERMS = np.arange(1, 13)


@dataclass(frozen=True)
class Floor:
    """The solution of the scene: `solve().energy` is its energy.

    Attributes:
        energy: a(u, u)/2 - L(u).
        ends: The abscissas between which the membrane touches the floor.
    """

    energy: float
    ends: npt.NDArray[np.float64]


def lift(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return how far the free solution lies below the floor at abscissas of the bottom."""
    return 0.5 - 2.0 * (x - 0.4) ** 2


def pressure(ends: npt.NDArray[np.float64], count: int) -> tuple[npt.NDArray[np.float64], float]:
    """Return the pressure with which the membrane touches the floor on an interval.

    Args:
        ends: The abscissas of both ends.
        count: The number of Chebyshev polynomials and of points.

    Returns:
        The coefficients of the polynomials, and the work of the pressure along the lift.
    """
    middle, half = np.mean(np.cos(np.pi * ends)), 0.5 * abs(np.diff(np.cos(np.pi * ends))[0])
    nodes = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    polynomials = np.polynomial.chebyshev.chebvander(nodes, count - 1)
    x = np.arccos(middle + half * nodes) / np.pi
    logarithms = np.append(-np.log(half), 1.0 / np.arange(1, count))
    waves = np.cos(np.pi * np.outer(x, TERMS))
    rest = 1.0 + (waves * (2.0 * (np.tanh(np.pi * TERMS) - 1.0) / (np.pi * TERMS))) @ waves.T
    weight = np.pi / count
    coefficients = np.linalg.solve(polynomials * logarithms + weight * rest @ polynomials, lift(x))
    return coefficients, float(weight * (polynomials @ coefficients) @ lift(x))


def solve(count: int = 40) -> Floor:
    """Return the solution with so many Chebyshev polynomials; Newton's method finds the ends."""
    signs = (-1.0) ** np.arange(count)

    def at_ends(ends: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        coefficients = pressure(ends, count)[0]
        return np.array([coefficients.sum(), signs @ coefficients])

    ends, shifts = np.array([0.2, 0.6]), 1e-6 * np.eye(2)
    for _ in range(8):
        slopes = [(at_ends(ends + shift) - at_ends(ends - shift)) / 2e-6 for shift in shifts]
        ends = ends - np.linalg.solve(np.transpose(slopes), at_ends(ends))
    return Floor(FREE_ENERGY + 0.5 * pressure(ends, count)[1], ends)


def main() -> None:
    """Print the energy and the ends of contact for growing numbers of polynomials."""
    for count in (10, 20, 40, 80):
        floor = solve(count)
        print(f"{count:3d} polynomials: {floor.energy:.13f}, contact on {floor.ends}")


if __name__ == "__main__":
    main()
