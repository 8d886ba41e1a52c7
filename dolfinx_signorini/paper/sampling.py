"""The sup norms of the paper's tables: the largest of samples of the error, not its maxima.

The paper's figures of L^inf are the largest error at the vertices and edge midpoints of all
triangles, and those of W^{1,inf} the largest error or derivative at the points of the quadrature
rule. The maxima, which `norms.error_norms` computes, are larger: on the paper's meshes of degree 1
by 1e-9 in L^inf and by 6 % in W^{1,inf}, and for degree 2, whose error is smallest at vertices and
midpoints, by a factor of 3 in both.
"""

import math
from collections.abc import Sequence
from typing import TypeAlias

import basix
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinx_signorini.norm_names import Norm, parse_norm
from dolfinx_signorini.norms import error_norms, sampled_norms
from dolfinx_signorini.quadrature import FACET_RULE, QuadratureRule
from dolfinx_signorini.references import Reference

Array: TypeAlias = npt.NDArray[np.float64]

LINF, W1_INF = "Linf_sampled", "W1_inf_sampled"
PAPER_NAMES = {LINF: "Linf", W1_INF: "W1_inf"}  # in the paper's tables
SAMPLING = (
    "Linf: largest error at vertices and edge midpoints, W1_inf: largest error or derivative at "
    "the quadrature points"
)


class VerticesAndMidpoints(QuadratureRule):
    """The points of the paper's samples of L^inf, without weights:

    points, _ = VerticesAndMidpoints("default", 2).points(basix.CellType.triangle)
    """

    def points(self, cell: basix.CellType, reverse: bool = False) -> tuple[Array, Array]:
        """Return the points of the reference cell, and weights that mean nothing."""
        kind = basix.LatticeType.equispaced
        points = np.asarray(basix.create_lattice(cell, self.degree, kind, True), dtype=np.float64)
        return points, np.ones(len(points))


def paper_errors(
    u_h: fem.Function, exact: Reference | None, names: Sequence[str], rule: QuadratureRule
) -> dict[str, float]:
    """Compute norms of the error u_h - u by the paper's rule, its samples of sup norms included.

    Args:
        u_h: The discrete solution on triangles.
        exact: The known solution; None for the norms of u_h itself.
        names: Names of norms, see `norm_names.parse_norm`, and "Linf_sampled" and "W1_inf_sampled".
        rule: Quadrature rule on cells.

    Returns:
        The values, by name, the same on all ranks.
    """
    known = {name: parse_norm(name) for name in names if name not in PAPER_NAMES}
    inside = {name: n for name, n in known.items() if not (n.boundary or math.isinf(n.p))}
    others = [name for name in known if name not in inside]
    values = error_norms(u_h, exact, others, rule, FACET_RULE)
    if W1_INF in names:
        inside[W1_INF] = Norm(1.0, math.inf)
    found = sampled_norms(u_h, exact, list(inside.values()), rule)
    values |= {name: found[norm] for name, norm in inside.items()}
    if LINF in names:
        sample = Norm(0.0, math.inf)
        lattice = VerticesAndMidpoints("default", 2)
        values[LINF] = sampled_norms(u_h, exact, [sample], lattice)[sample]
    return {name: values[name] for name in names}


def column(norm: str) -> str:
    """Return what a norm is called in tables beside the paper's.

    A sample has the paper's name; a maximum, of which the paper has no figures, is called so.
    """
    if norm in PAPER_NAMES.values():
        return f"{norm} (maximum)"
    return PAPER_NAMES.get(norm, norm)
