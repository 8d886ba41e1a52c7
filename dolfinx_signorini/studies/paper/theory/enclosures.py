"""Enclosures of the contact set and of the force, from a bound of the sup error.

Where u_h exceeds a bound of the sup error, u > 0: no contact. Where du_h/dn exceeds a bound of the
error of the gradient, du/dn > 0: contact. At a detachment point u is like b r^{3/2}, du/dn like
3/2 b r^{1/2}, so that the enclosures are about (e / b)^{2/3} and (e' / (3/2 b))^2 wide.

The error of the force on the boundary is (u - u_h, 1)_H1. Let G hold the contact sets of u and u_h,
and let psi be 1 on G and of the smallest H^1 norm. 1 - psi_h vanishes on G, and so does the contact
pressure off G: (u - u_h, 1 - psi_h)_H1 = 0 as for linear problems, and

    |(u - u_h, 1)_H1| <= |(u - u_h, psi)_H1| + ||u - u_h||_H1 ||psi - psi_h||_H1,
    |(u - u_h, psi)_H1| <= max |u - u_h| times the integral of dpsi/dn, which is that of psi.
"""

from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.bounds.energy_bound import energy_bound
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.problem.signorini import SignoriniProblem
from dolfinx_signorini.studies.paper.theory.discretisation import (
    THEORY_RTOL,
    Discretisation,
)


@dataclass(frozen=True)
class Enclosure:
    """An interval of the bottom side in which contact begins:

        found = enclosures(discretisation, 1e-4, 1e-1)
        assert found.outer <= 0.5 <= found.inner

    Attributes:
        outer: Contact begins at this place or later.
        inner: Contact has begun at this place; the right end of the side where no flux tells.
    """

    outer: float
    inner: float


def enclosures(discretisation: Discretisation, value: float, slope: float) -> Enclosure:
    """Return the enclosure of the first contact right of the largest u_h on the bottom side.

    Args:
        discretisation: The problem of the paper's solution.
        value: A bound of the sup error.
        slope: A bound of the components of the error of the gradient.
    """
    d, curve = discretisation, discretisation.curve
    count = int(np.count_nonzero(curve.s <= 1.0 + ROUNDING))  # of nodes on the bottom side
    s, u = curve.s[:count], curve.values(d.u_h)[:count]
    top, outer, inner = int(np.argmax(u)), 0.0, 1.0
    if u[top] > value:
        after = np.flatnonzero(u[top:] <= value) + top
        outer = float(s[-1])
        if len(after):
            a, b = after[0] - 1, after[0]
            outer = float(s[a] + (u[a] - value) / (u[a] - u[b]) * (s[b] - s[a]))
    flux = -curve.samples([ufl.grad(d.u_h)[1]], np.array([0.5]))[: count - 1, 0, 0]
    pressed = np.flatnonzero((flux > slope) & (np.arange(count - 1) >= top))
    if len(pressed):
        inner = float(s[pressed[0]])
    return Enclosure(outer, inner)


def dual_force_bound(discretisation: Discretisation, value: float, energy: float) -> float:
    """Return a bound of the error of the force on the boundary, by a dual problem.

    Args:
        discretisation: The problem, solved; its bilinear form is (u, v)_H1.
        value: A bound of the sup error.
        energy: A bound of the H^1 error.
    """
    d, space = discretisation, discretisation.space
    low = d.curve.values(d.u_h) <= value
    facets = d.curve.facets_between(low | np.roll(low, -1))  # the edges with such a node
    nothing = fem.Constant(space.mesh, np.float64(0.0)) * ufl.TestFunction(space) * ufl.dx
    # psi solves a Signorini problem, too: the flux of psi pushes wherever psi = 1.
    dual = SignoriniProblem(d.a, nothing, contact=facets, obstacle=1.0)
    psi = dual.solve(rtol=THEORY_RTOL)
    missed = energy_bound(dual, EnergyTerms(reaction=1.0)).total
    whole = compiled.integral(psi * ufl.dx)
    dual.destroy()
    return energy * missed + value * (whole + missed)
