"""What the interpolation of formulas on segments misses, of values and of derivatives.

The Taylor polynomial of degree n misses E with |E| <= e and |E'| <= e' on the segment, see `discs`.
The interpolation with the Lebesgue constant L misses at most (1 + L) e of the values and, by
Markov's inequality, e' + n^2 L e of the derivatives, on a segment of length 2. Where that is not
known, intervals around the derivatives of the formula on small parts take its place.
"""

import basix
import numpy as np
import numpy.typing as npt

from dolfinx_signorini.bounds.reference_flux import highest_on_parts, polynomials
from dolfinx_signorini.scenes.discs import EDGE, discs
from dolfinx_signorini.scenes.enclosures import enclosed_slopes
from dolfinx_signorini.scenes.fits import REACHES, ROUNDING
from dolfinx_signorini.scenes.formulas import Formula, evaluated
from dolfinx_signorini.scenes.pieces import inside

Array = npt.NDArray[np.float64]

PARTS = 64  # of a segment where a formula is not smooth
JUMP = 1e-6  # of the values: more than continuous data change in `EDGE` of a segment
LEBESGUE = 4.0  # more than the constant of up to 20 Gauss-Lobatto points


def missed_by_interpolation(formula: Formula, corners: Array, degree: int) -> Array:
    """Return what the interpolation at Gauss-Lobatto points misses, shape (3, segments).

    Args:
        formula: The formula.
        corners: The ends of the segments, shape (segments, 2, dimension).
        degree: The degree of the polynomials.

    Returns:
        Bounds of the differences, of their derivatives from end to end, and of the roots of the
        means of the squares of these derivatives.
    """
    n, slope = degree, np.full(len(corners), np.inf)
    for reach in REACHES:
        _, radii = discs(formula, corners, reach)
        value = radii * reach**-n / (reach - 1.0)
        change = radii * reach**-n * ((n + 1) * reach - n) / (reach - 1.0) ** 2
        slope = np.minimum(slope, 2.0 * (change + n**2 * LEBESGUE * value))
    root, rough = slope.copy(), np.isinf(slope)
    slope[rough], root[rough] = _by_intervals(formula, corners[rough], degree)
    slope[broken := _jumps_at_ends(formula, corners)] = np.inf
    root[broken] = np.inf
    # The difference vanishes at both ends.
    return np.stack((0.5 * root, slope, root)) * ROUNDING


def _jumps_at_ends(formula: Formula, corners: Array) -> npt.NDArray[np.bool_]:
    """Whether the values at the ends, where interpolations have nodes, are not those next to them.

    Discs and intervals know of no jump within `EDGE` of an end.
    """
    near = np.array([[0.0], [2.0 * EDGE], [1.0 - 2.0 * EDGE], [1.0]])
    values = evaluated(formula.root, inside(corners, near))
    apart = np.abs(values[::3] - values[1:3]).max(axis=0, initial=0.0)
    return ~(apart <= JUMP * (np.abs(values).max(axis=0, initial=0.0) + JUMP))


def _by_intervals(formula: Formula, corners: Array, degree: int) -> tuple[Array, Array]:
    """The largest derivatives of the differences, and their means, from intervals on parts."""
    kind, method = basix.LatticeType.gll, basix.LatticeSimplexMethod.isaac
    nodes = np.asarray(basix.create_lattice(basix.CellType.interval, degree, kind, True, method))
    values = evaluated(formula.root, inside(corners, nodes)).T
    series = values @ np.linalg.inv(polynomials(1, degree, nodes))
    legendre, scale = np.polynomial.legendre, np.sqrt(2.0 * np.arange(degree + 1) + 1.0)
    slopes = 2.0 * legendre.legder((series * scale).T).T / scale[:-1]
    largest = highest_on_parts(degree - 1, PARTS, slopes)
    least = -highest_on_parts(degree - 1, PARTS, -slopes)
    places = np.linspace(0.0, 1.0, PARTS + 1)[:, None, None]
    points = (1.0 - places) * corners[:, 0] + places * corners[:, 1]
    parts = np.stack((points[:-1], points[1:]), axis=2).reshape(-1, 2, corners.shape[2])
    low, high = PARTS * enclosed_slopes(formula, parts).reshape(2, PARTS, -1).transpose(0, 2, 1)
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.maximum(high - least, largest - low)
        return apart.max(axis=1, initial=0.0), np.sqrt(np.square(apart).mean(axis=1))
