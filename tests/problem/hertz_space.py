"""A block that is pressed against a paraboloid, with a displacement in closed form (in space).

The half-space z > 0 carries the pressure p0 sqrt(1 - (r/a)^2) of Hertz on its boundary. With the
potentials V of the pressure, the integral of p/R, and X with dX/dz = V, the displacement is

    u_r = -((1 - 2 nu) dX/dr + z dV/dr) / (4 pi mu),    u_z = (2 (1 - nu) V - z dV/dz) / (4 pi mu).

As the Hankel transform of the pressure is the integral of p0 (a^2 - t^2) cos(kt) / (2a) over t from
0 to a, V is the one of points at the complex places (0, 0, -it): the integrals over t of powers of
the distance R, R^2 = r^2 + (z + it)^2, have closed forms.

Sources: Love, Phil. Trans. R. Soc. A 228 (1929) 377-420; K. L. Johnson, Contact mechanics, sections
3.4 and 4.2.
"""

import numpy as np

E, NU, R, DEPTH = 10.0, 0.3, 0.5, 0.02
MU = E / (2.0 * (1.0 + NU))
E_STAR = E / (1.0 - NU**2)
A = np.sqrt(R * DEPTH)
P0 = 2.0 * A * E_STAR / (np.pi * R)
FORCE = 4.0 / 3.0 * E_STAR * A * DEPTH


def displacement(x):
    """The displacement at points with z >= 0, shape (3, n): shape (3, n)."""
    z, r = np.maximum(x[2], 0.0), np.hypot(x[0], x[1])
    far = z + 1j * A
    distance = np.sqrt(r**2 + far**2)
    logarithm = np.log(far + distance)
    apart = np.where(distance == 0.0, 1.0, distance)  # at the ends of the contact, where z is 0
    level = A**2 + z**2 - r**2 / 2.0
    factor = np.pi * P0 / A
    potential = level * logarithm - 2.0 * z * distance + far * distance / 2.0
    outwards = -r * logarithm + r / apart * (level / (far + distance) - 2.0 * z + far / 2.0)
    upwards = 2.0 * z * logarithm + (level - 2.0 * z * far + far**2 / 2.0) / apart - 1.5 * distance
    integral = (
        A**2 * far
        - 1j * A**3 / 3.0
        - (A**2 + z**2 - r**2) * distance
        + z * (far * distance - r**2 * logarithm)
        - distance**3 / 3.0
    )
    at_axis = r < 1e-9 * A
    safe = np.where(at_axis, 1.0, r)
    slope = np.where(at_axis, 0.0, factor * integral.imag / safe)
    radial = -((1.0 - 2.0 * NU) * slope + z * factor * outwards.imag) / (4.0 * np.pi * MU)
    vertical = factor * (2.0 * (1.0 - NU) * potential - z * upwards).imag / (4.0 * np.pi * MU)
    return np.stack([radial * x[0] / safe, radial * x[1] / safe, vertical])


def by_quadrature(x, count=400):
    """The same by Boussinesq's solution for a point force, integrated over the pressure."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    s, w = 0.5 * np.pi * (nodes + 1.0) / 2.0, 0.25 * np.pi * weights  # rho = a sin(s)
    angles = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    rho, about = np.meshgrid(A * np.sin(s), angles, indexing="ij")
    loads = P0 * np.cos(s) * w * A * np.cos(s) * A * np.sin(s) * 2.0 * np.pi / count
    found = []
    for point in x.T:
        off = np.stack([point[0] - rho * np.cos(about), point[1] - rho * np.sin(about)])
        z = point[2]
        length = np.sqrt((off**2).sum(axis=0) + z**2)
        side = z / length**3 - (1.0 - 2.0 * NU) / (length * (length + z))
        down = 2.0 * (1.0 - NU) / length + z**2 / length**3
        parts = [(loads[:, None] * side * off[i]).sum() for i in range(2)]
        found.append([*parts, (loads[:, None] * down).sum()])
    return np.array(found).T / (4.0 * np.pi * MU)


def pressure(x):
    """The pressure on z = 0."""
    return P0 * np.sqrt(np.maximum(1.0 - (x[0] ** 2 + x[1] ** 2) / A**2, 0.0))


def gap(x):
    """How far z = 0 may move down: the paraboloid, pressed in by the depth."""
    return (x[0] ** 2 + x[1] ** 2) / (2.0 * R) - DEPTH
