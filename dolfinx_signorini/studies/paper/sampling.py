"""The norms of the paper's tables that its sample points define: L^inf, W^{1,inf} and H^{1/2}.

The paper's figures of L^inf are the largest error at the vertices and edge midpoints of all
triangles, and those of W^{1,inf} the largest error or derivative at the points of the quadrature
rule. The maxima, which `norms.error_norms` computes, are larger: on the paper's meshes of degree 1
by 5 % in L^inf from N = 201 on and by 6 % in W^{1,inf}, and for degree 2, whose error is smallest
at vertices and midpoints, by a factor of 3 in both.

The paper's figures of H^{1/2} are the interpolation estimate sqrt(L2 (L2 + |.|_H1)) on the
boundary: the H^1 norm is a sum, the seminorm is that of the tangential derivative, and both
integrals are by the closed Newton-Cotes rule with 7 points on each boundary edge. The paper does
not print the rule; every digit of the column that the paper prints says that this is the rule. The
estimate of `norms.error_norms`, with the usual H^1 norm and a finer rule, is about 1 % smaller: in
the edge with the detachment point the derivative is like the root of the distance to that point,
and the 7 points are too few.
"""

import math
from collections.abc import Sequence

import basix
import numpy as np
from dolfinx import fem
from scipy.integrate import newton_cotes

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.meshes.quadrature import QuadratureRule
from dolfinx_signorini.norms.error_norms import error_norms, sampled_norms
from dolfinx_signorini.norms.names import Norm, parse_norm
from dolfinx_signorini.norms.references import Reference
from dolfinx_signorini.studies.paper.solution import PAPER_RULE

LINF, W1_INF, H1_2 = "Linf_sampled", "W1_inf_sampled", "H1_2_boundary_sampled"
PAPER_NAMES = {LINF: "Linf", W1_INF: "W1_inf", H1_2: "H1_2_boundary"}  # in the paper's tables
SAMPLING = {
    LINF: "largest error at vertices and edge midpoints",
    W1_INF: "largest error or derivative at the quadrature points",
    H1_2: "sqrt(L2 (L2 + |.|_H1)) by 7 Newton-Cotes points on each boundary edge",
}


class Equispaced(QuadratureRule):
    """Equispaced points, as many as a polynomial of the degree needs, with weights on an interval:

    vertices_and_midpoints, _ = Equispaced("default", 2).points(basix.CellType.triangle)
    """

    def points(self, cell: basix.CellType, reverse: bool = False) -> tuple[Array, Array]:
        """Return the points, and closed Newton-Cotes weights; on triangles weights mean nothing."""
        kind = basix.LatticeType.equispaced
        points = np.asarray(basix.create_lattice(cell, self.degree, kind, True), dtype=np.float64)
        if cell != basix.CellType.interval:
            return points, np.ones(len(points))
        return points, newton_cotes(self.degree, 1)[0] / self.degree


def paper_errors(
    u_h: fem.Function, exact: Reference | None, names: Sequence[str]
) -> dict[str, float]:
    """Compute norms of the error u_h - u by the paper's rules, where the paper has such a norm.

    Args:
        u_h: The discrete solution on triangles.
        exact: The known solution; None for the norms of u_h itself.
        names: Names of norms, see `names.parse_norm`, and those of `PAPER_NAMES`.

    Returns:
        The values, by name, the same on all ranks.
    """
    known = {name: parse_norm(name) for name in names if name not in PAPER_NAMES}
    inside = {name: n for name, n in known.items() if not (n.boundary or math.isinf(n.p))}
    others = [name for name in known if name not in inside]
    values = error_norms(u_h, exact, others)
    if W1_INF in names:
        inside[W1_INF] = Norm(1.0, math.inf)
    found = sampled_norms(u_h, exact, list(inside.values()), PAPER_RULE)
    values |= {name: found[norm] for name, norm in inside.items()}
    if LINF in names:
        sample, points = Norm(0.0, math.inf), Equispaced("default", 2)
        values[LINF] = sampled_norms(u_h, exact, [sample], points)[sample]
    if H1_2 in names:
        points, ends = Equispaced("default", 6), ["L2_boundary", "H1_boundary"]
        l2, h1 = error_norms(u_h, exact, ends, boundary_rule=points).values()
        values[H1_2] = math.sqrt(l2 * (l2 + math.sqrt(h1**2 - l2**2)))
    return {name: values[name] for name in names}


def column(norm: str) -> str:
    """Return what a norm is called in tables beside the paper's.

    What the paper's points define has the paper's name; a maximum or an estimate by the default
    rule, of which the paper has no figures, is called so.
    """
    if norm in PAPER_NAMES.values():
        return f"{norm} ({'maximum' if math.isinf(parse_norm(norm).p) else 'default rule'})"
    return PAPER_NAMES.get(norm, norm)
