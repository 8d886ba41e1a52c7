"""Named quadrature rules: what is integrated, and with which points, is always said."""

import math
from dataclasses import dataclass
from typing import Any

import basix
import numpy as np

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.kinds import check, integer
from dolfinx_signorini.meshes.polynomials import CELLS, barycentric

SCHEMES = {
    "default": basix.QuadratureType.default,
    "Gauss-Jacobi": basix.QuadratureType.gauss_jacobi,
    "Xiao-Gimbutas": basix.QuadratureType.xiao_gimbutas,
}


@dataclass(frozen=True)
class QuadratureRule:
    """A quadrature rule of the reference cell, by the names that Basix and UFL use.

    The metadata of a measure name the rule, so that UFL estimates no degree:

        dx = ufl.dx(metadata=QuadratureRule("Gauss-Jacobi", 7).metadata)

    Attributes:
        scheme: Name of the rule: "Gauss-Jacobi", "default", "Xiao-Gimbutas" on triangles and
            tetrahedra up to degree 15, or in forms "vertex".
        degree: Degree of the polynomials that the rule integrates exactly.

    Raises:
        InputError: The scheme is unknown, or the degree is no integer from 0 to `MAX_DEGREE`.
    """

    scheme: str
    degree: int

    def __post_init__(self) -> None:
        check(degree=(self.degree, integer(0, MAX_DEGREE)))
        if not isinstance(self.scheme, str) or self.scheme not in (*SCHEMES, "vertex"):
            raise InputError(f"unknown {self.scheme!r}", "scheme")

    @property
    def metadata(self) -> dict[str, Any]:
        """The rule as metadata of a UFL measure."""
        return {"quadrature_rule": self.scheme, "quadrature_degree": self.degree}

    def points(self, cell: basix.CellType, reverse: bool = False) -> tuple[Array, Array]:
        """Return the rule on a reference cell.

        Args:
            cell: The cell.
            reverse: Whether the points are laid out for the reverse order of the cell's vertices,
                which matters for rules without the symmetry of the cell, such as Gauss-Jacobi.

        Returns:
            The points, shape (q, dim), and the weights, shape (q,).

        Raises:
            InputError: The scheme is known in forms only.
        """
        if self.scheme not in SCHEMES:
            known = ", ".join(SCHEMES)
            raise InputError(f"{self.scheme!r} is known in forms only; known are {known}", "rule")
        rule = basix.make_quadrature(cell, self.degree, rule=SCHEMES[self.scheme])
        points, weights = (np.asarray(part, dtype=np.float64) for part in rule)
        if reverse:
            points = np.ascontiguousarray(barycentric(points)[:, ::-1][:, 1:])
        return points, weights

    def __str__(self) -> str:
        return f"{self.scheme} rule of degree {self.degree}"


def interior_rule(cell: basix.CellType, degree: int) -> QuadratureRule:
    """Return a small rule of a degree with positive weights and no point on the boundary of a cell.

    Data that jump on facets have the value of the other side at points there, and with negative
    weights an integral of positive numbers may be negative. Of the default rules those of
    tetrahedra have such points or weights for some degrees.

    Args:
        cell: The cell.
        degree: Degree of the polynomials that the rule integrates exactly.
    """
    other = cell == basix.CellType.tetrahedron and degree in (3, 4, 5, 7, 8)
    return QuadratureRule("Xiao-Gimbutas" if other else "default", degree)


def rule(dimension: int, degree: int) -> tuple[Array, Array]:
    """Return the points and weights of `interior_rule` for means: the weights add up to 1.

    Args:
        dimension: The dimension of the simplex.
        degree: Degree of the polynomials whose means are exact.
    """
    points, weights = interior_rule(CELLS[dimension], degree).points(CELLS[dimension])
    return points, weights * math.factorial(dimension)


MAX_DEGREE = 400  # more points would fill the memory

# The default on cells, for data that are no polynomials and for norms: 16 points of a triangle.
CELL_RULE = QuadratureRule("Gauss-Jacobi", 7)

# The default on facets of plane domains. The error of the gradient is like the root of the distance
# to the detachment point in one facet, which dominates H^1: 16 points there, too.
FACET_RULE = QuadratureRule("Gauss-Jacobi", 31)

MANY = 50_000  # cells on all ranks, from which on rules of fewer points save time
