"""A block that is pressed against a parabola, with a displacement in closed form (plane strain).

The half-plane y > 0 carries the pressure p0 sqrt(1 - (x/a)^2) of Hertz on its boundary. The
potential of Kolosov and Muskhelishvili is analytic there, Phi = i p0 (s - z)/(2 a) with
s = sqrt(z^2 - a^2): 2 Re Phi = -p on the boundary, and psi' = -z Phi' leaves no shear. On the
boundary the displacement is -(x^2 + a^2 log a)/(2 R) upwards for |x| <= a, the parabola of an
obstacle. Any block in the half-plane with this displacement on its other sides has the solution.

Source: Muskhelishvili, Some basic problems of the mathematical theory of elasticity, chapter 19;
K. L. Johnson, Contact mechanics, section 4.2.
"""

import numpy as np

E, R, FORCE = 200.0, 8.0, 10.0


def constants(poisson):
    """Poisson's ratio, mu, lambda, kappa, E*, the half width of the contact, and p0."""
    mu = E / (2.0 * (1.0 + poisson))
    volume = 2.0 * mu * poisson / (1.0 - 2.0 * poisson)
    plane = E / (1.0 - poisson**2)
    half_width = 2.0 * np.sqrt(R * FORCE / (np.pi * plane))
    peak = 2.0 * FORCE / (np.pi * half_width)
    return poisson, mu, volume, 3.0 - 4.0 * poisson, plane, half_width, peak


NU, MU, LAMBDA, KAPPA, E_STAR, A, P0 = constants(0.3)

# The block as a scene without a mesh: the potential in real and imaginary parts.
SCENE = f"""
[domain]
shape = "polygon"
vertices = [[-2, 0], [2, 0], [2, 2], [-2, 2]]
[define]
a = "{A:.16g}"
p = "{P0:.16g}"
root = "sqrt(hypot(x - a, y)*hypot(x + a, y))"
angle = "0.5*(atan2(y, x - a) + atan2(y, x + a))"
s = "root*cos(angle)"
t = "root*sin(angle)"
slope_re = "-0.5*p/a*(t - y)"
slope_im = "0.5*p/a*(s - x)"
inner_re = "x*s - y*t - a^2*log(hypot(x + s, y + t)) - x^2 + y^2"
inner_im = "x*t + y*s - a^2*atan2(y + t, x + s) - 2*x*y"
scale = "1.3/200"
across = "scale*(-0.25*p/a*(2 - 1.2)*inner_im - 2*y*slope_im)"
down = "scale*(0.25*p/a*(4 - 1.2)*inner_re - 2*y*slope_re)"
[elasticity]
young = 200
poisson = 0.3
[contact]
sides = 1
gap = "(x^2 + a^2*log(a))/16"
direction = [0, -1]
[[dirichlet]]
sides = [2, 3, 4]
value = ["across", "down"]
"""


def _potential(x):
    """z, s, Phi and phi, the integral of Phi."""
    z = x[0] + 1j * np.maximum(x[1], 0.0)  # + 0.0, for the branch above the cut
    s = np.sqrt(z - A) * np.sqrt(z + A)
    factor = 0.5j * P0 / A
    return z, s, factor * (s - z), factor * 0.5 * (z * s - A**2 * np.log(z + s) - z**2)


def displacement(x):
    """The displacement at points, shape (2 or 3, n): shape (2, n)."""
    z, _, slope, phi = _potential(x)
    return displacement_of(z, slope, phi)


def displacement_of(z, slope, phi):
    """The displacement without shear on y = 0 for a potential Phi and its integral phi."""
    w = KAPPA * phi - np.conj(phi) - 2j * z.imag * np.conj(slope)
    return np.stack([w.real, w.imag]) / (2.0 * MU)


def gradient(x):
    """The gradient of the displacement, not at (±a, 0): shape (4, n), row by row."""
    z, s, slope, _ = _potential(x)
    return gradient_of(z, slope, 0.5j * P0 / A * (z / s - 1.0))


def gradient_of(z, slope, curvature):
    """The gradient of the displacement for a potential Phi and its derivative, row by row."""
    curvature = np.conj(curvature)
    along = KAPPA * slope - np.conj(slope) - 2j * z.imag * curvature
    up = 1j * (KAPPA * slope - np.conj(slope)) - 2.0 * z.imag * curvature
    return np.stack([along.real, up.real, along.imag, up.imag]) / (2.0 * MU)


def stress(x):
    """The stress, shape (3, n): xx, yy and xy."""
    xx, xy, yx, yy = gradient(x)
    trace = LAMBDA * (xx + yy)
    return np.stack([2.0 * MU * xx + trace, 2.0 * MU * yy + trace, MU * (xy + yx)])


def pressure(x):
    """The pressure on y = 0."""
    return P0 * np.sqrt(np.maximum(1.0 - (x[0] / A) ** 2, 0.0))


def gap(x):
    """How far y = 0 may move down: the parabola, as high as the solution touches it."""
    return (x[0] ** 2 + A**2 * np.log(A)) / (2.0 * R)
