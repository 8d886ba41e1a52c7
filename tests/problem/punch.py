"""A block with a flat punch on a part of its boundary, with a displacement in closed form.

The half-plane y > 0 carries the pressure P / (pi sqrt(a^2 - x^2)) for |x| < a on its boundary, by
the potential Phi = P / (2 pi i s), s = sqrt(z^2 - a^2): 2 Re Phi = -p. Under the punch the boundary
moves by the same distance everywhere.

Source: Muskhelishvili, Some basic problems of the mathematical theory of elasticity, chapter 19.
"""

import numpy as np
from hertz import KAPPA, MU, displacement_of, gradient_of

A, FORCE = 0.5, 10.0


def _potential(x):
    """z, s, Phi and phi, the integral of Phi."""
    z = x[0] + 1j * np.maximum(x[1], 0.0)  # + 0.0, for the branch above the cut
    s = np.sqrt(z - A) * np.sqrt(z + A)
    factor = -0.5j * FORCE / np.pi
    return z, s, factor / np.where(s == 0.0, 1.0, s), factor * np.log(z + s)


def displacement(x):
    """The displacement at points, shape (2 or 3, n): shape (2, n)."""
    z, _, slope, phi = _potential(x)
    return displacement_of(z, slope, phi)


def gradient(x):
    """The gradient of the displacement, not at (±a, 0): shape (4, n), row by row."""
    z, s, slope, _ = _potential(x)
    return gradient_of(z, slope, -slope * z / s**2)


def pressure(x):
    """The pressure on y = 0, |x| < a."""
    return FORCE / (np.pi * np.sqrt(A**2 - x[0] ** 2))


# How far the boundary may move down under the punch.
GAP = (KAPPA + 1.0) * FORCE * np.log(A) / (4.0 * np.pi * MU)
