"""What the interpolation of formulas on segments misses, of values and of derivatives.

The Taylor polynomial of degree n misses E with |E| <= e and |E'| <= e' on the segment, see `discs`.
The interpolation with the Lebesgue constant L misses at most (1 + L) e of the values and, by
Markov's inequality, e' + n^2 L e of the derivatives, on a segment of length 2. Where that is not
known, an interval around the derivatives of the formula takes its place.
"""

import basix
import numpy as np
import numpy.typing as npt

from dolfinx_signorini.bounds.reference_flux import lowest, polynomials
from dolfinx_signorini.scenes.discs import discs
from dolfinx_signorini.scenes.enclosures import enclosed_slopes
from dolfinx_signorini.scenes.fits import REACHES, ROUNDING
from dolfinx_signorini.scenes.formulas import Formula, evaluated
from dolfinx_signorini.scenes.pieces import inside

Array = npt.NDArray[np.float64]

LEBESGUE = 4.0  # more than the constant of up to 20 Gauss-Lobatto points


def missed_by_interpolation(formula: Formula, corners: Array, degree: int) -> Array:
    """Return what the interpolation at Gauss-Lobatto points misses, shape (2, segments).

    Args:
        formula: The formula.
        corners: The ends of the segments, shape (segments, 2, dimension).
        degree: The degree of the polynomials.

    Returns:
        Bounds of the differences, and of their derivatives from end to end.
    """
    n, result = degree, np.full((2, len(corners)), np.inf)
    for reach in REACHES:
        _, radii = discs(formula, corners, reach)
        value = radii * reach**-n / (reach - 1.0)
        change = radii * reach**-n * ((n + 1) * reach - n) / (reach - 1.0) ** 2
        change = 2.0 * (change + n**2 * LEBESGUE * value)
        better = change < result[1]
        result[:, better] = np.stack(((1.0 + LEBESGUE) * value, change))[:, better]
    result[1] = np.minimum(result[1], _by_intervals(formula, corners, degree))
    # The difference vanishes at both ends.
    result[0] = np.minimum(result[0], 0.5 * result[1])
    return result * ROUNDING


def _by_intervals(formula: Formula, corners: Array, degree: int) -> Array:
    """Bounds of the differences of the derivatives: those of the formula, and the polynomials'."""
    low, high = enclosed_slopes(formula, corners)
    kind, method = basix.LatticeType.gll, basix.LatticeSimplexMethod.isaac
    nodes = np.asarray(basix.create_lattice(basix.CellType.interval, degree, kind, True, method))
    values = evaluated(formula.root, inside(corners, nodes)).T
    series = values @ np.linalg.inv(polynomials(1, degree, nodes))
    legendre, scale = np.polynomial.legendre, np.sqrt(2.0 * np.arange(degree + 1) + 1.0)
    slopes = 2.0 * legendre.legder((series * scale).T).T / scale[:-1]
    least, largest = lowest(1, degree - 1, slopes), -lowest(1, degree - 1, -slopes)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.maximum(high - least, largest - low))
