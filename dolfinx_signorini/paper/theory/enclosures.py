"""Where contact is, enclosed: from bounds of the error on the bottom side.

Where u_h exceeds a bound of the sup error, u > 0: no contact. Where du_h/dn exceeds a bound of the
error of the gradient, du/dn > 0: contact. At a detachment point u is like b r^{3/2}, du/dn like
3/2 b r^{1/2}, so that the enclosures are about (e / b)^{2/3} and (e' / (3/2 b))^2 wide.
"""

from dataclasses import dataclass

import numpy as np

from dolfinx_signorini.paper.theory.discretisation import Discretisation


@dataclass(frozen=True)
class Enclosure:
    """An interval of the bottom side in which contact begins:

        found = enclosures(discretisation, 1e-4, 1e-1)
        assert found.outer <= 0.5 <= found.inner

    Attributes:
        outer: Contact begins at this place or later.
        inner: Contact has begun at this place; the right end of the side where no flux tells.
        value: The bound of the error.
        slope: The bound of the error of the gradient.
    """

    outer: float
    inner: float
    value: float
    slope: float


def enclosures(discretisation: Discretisation, value: float, slope: float) -> Enclosure:
    """Return the enclosure of the first contact right of the largest u_h on the bottom side.

    Args:
        discretisation: The problem of the paper's solution, solved.
        value: A bound of the sup error.
        slope: A bound of the components of the error of the gradient.
    """
    curve, u = discretisation.curve, discretisation.curve.values(discretisation.u_h)
    nodes = np.flatnonzero(curve.s <= 1.0 + 1e-12)
    top = int(np.argmax(u[nodes]))
    above = u[nodes] > value
    last = top + int(np.argmin(np.append(above[top:], False))) - 1  # the last node above the bound
    a, b = nodes[last], nodes[min(last + 1, len(nodes) - 1)]
    part = (u[a] - value) / (u[a] - u[b]) if u[a] > u[b] else 0.0
    outer = curve.s[a] + part * (curve.s[b] - curve.s[a]) if above[top] else 0.0
    flux = curve.gradients(discretisation.u_h)[nodes[:-1], 1]
    pressed = np.flatnonzero(-flux > slope)
    pressed = pressed[pressed >= top]
    inner = curve.s[nodes[pressed[0]]] if len(pressed) else 1.0
    return Enclosure(float(outer), float(inner), value, slope)
