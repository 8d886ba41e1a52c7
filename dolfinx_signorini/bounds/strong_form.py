"""The strong form of a problem, which its weak forms do not tell."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import ufl
from dolfinx import fem, mesh
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.classes import (
    ComponentTensor,
    ConstantValue,
    Division,
    Indexed,
    IndexSum,
    ListTensor,
    MultiIndex,
    Power,
    Product,
    ScalarValue,
    SpatialCoordinate,
    Sum,
)
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.base.kinds import check, data, indices, on_mesh, optional, sequence
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, facet_count
from dolfinx_signorini.problem.values import Data

Scalar: TypeAlias = Expr | float

SUMS = ComponentTensor | Indexed | IndexSum | ListTensor | Sum


@dataclass(frozen=True)
class FacetPolynomials:
    """A polynomial on each facet of the frames of cells, as data of a Neumann condition.

    For example, on the facets of `FacetPoints`:

        flux = points.values(FacetPolynomials(1, coefficients))

    Attributes:
        degree: The degree of the polynomials.
        coefficients: The polynomials in terms of `FacetPoints.polynomials`, shape
            (cells, d + 1, polynomials).
    """

    degree: int
    coefficients: Array


@dataclass(frozen=True)
class EnergyTerms:
    """The problem -div(A grad u) + c u = f with its boundary conditions.

    The signs are the signs of the problem, for lower and for upper obstacles. Boundary facets that
    are named nowhere, and are not contact facets, have flux 0:

        terms = EnergyTerms(reaction=1.0, load=f, dirichlet=[(0.0, left)])

    Attributes:
        diffusion: The number, scalar or symmetric matrix A; None for 1.
        reaction: The coefficient c >= 0; None for 0.
        load: The right-hand side f; None for 0.
        neumann: Fluxes q = A grad u . n, each with its facets.
        robin: Coefficients k >= 0 with facets, where A grad u . n = q - k u.
        dirichlet: Data with facets; None as data are the values of the solution that was computed.

    Raises:
        InputError: An attribute is of another kind.
    """

    diffusion: Scalar | None = None
    reaction: Scalar | None = None
    load: Scalar | None = None
    neumann: Sequence[tuple[Scalar | FacetPolynomials, LocalIndices]] = ()
    robin: Sequence[tuple[Scalar, LocalIndices]] = ()
    dirichlet: Sequence[tuple[Scalar | None, LocalIndices]] = ()

    def __post_init__(self) -> None:
        for name in ("diffusion", "reaction", "load"):
            check(**{name: (getattr(self, name), optional(data))})
        for name in ("neumann", "robin", "dirichlet"):
            check(**{name: (getattr(self, name), sequence(_with_facets, "a list of pairs"))})

    def check_on(self, domain: mesh.Mesh) -> None:
        """Refuse expressions of another mesh or shape, and facets in the domain; collective.

        Args:
            domain: The mesh.

        Raises:
            InputError: An expression is of another mesh or shape, or an index is no facet on the
                boundary.
        """

        inside, on_facets = optional(on_mesh(domain)), optional(on_mesh(domain, normals=True))
        check(
            diffusion=(self.diffusion, optional(on_mesh(domain, tensor=True))),
            reaction=(self.reaction, inside),
            load=(self.load, inside),
        )
        count, exterior = facet_count(domain), boundary_facets(domain)
        owned = domain.topology.index_map(domain.topology.dim - 1).size_local
        for name in ("neumann", "robin", "dirichlet"):
            known = exposed = True
            for value, facets in getattr(self, name):
                if not isinstance(value, FacetPolynomials):
                    check(**{name: (value, on_facets)})
                given = np.asarray(facets, dtype=np.int64)
                known &= bool(((given >= 0) & (given < count)).all())
                exposed &= bool(np.isin(given[given < owned], exterior).all())
            require(domain.comm, known, "has an index that is no facet of this mesh", name)
            require(domain.comm, exposed, "has a facet inside the domain", name)

    def entries(self, dimension: int) -> list[Scalar]:
        """Return the entries of A, row by row, or one for a multiple of the identity.

        Args:
            dimension: The dimension of the domain.
        """
        A = self.diffusion
        if A is None:
            return [1.0]
        if not isinstance(A, Expr) or A.ufl_shape == ():
            return [A]
        return [A[i, j] for i in range(dimension) for j in range(dimension)]


def _with_facets(pair: Any) -> str:
    """The kind of pairs of data and facets."""
    if not (isinstance(pair, tuple | list) and len(pair) == 2):
        return "must have pairs of data and facets"
    given = "" if isinstance(pair[0], FacetPolynomials) else optional(data)(pair[0])
    return indices(pair[1]) or given


def polynomial_degree(data: "Data | FacetPolynomials | None") -> int | None:
    """Return the degree of a polynomial in the coordinates on each cell, and None for others.

    Args:
        data: A number, a UFL expression or a callable, which is no polynomial; None counts as 0.
    """
    if data is None or isinstance(data, int | float | np.number):
        return 0
    if isinstance(data, FacetPolynomials):
        return data.degree
    if not isinstance(data, Expr):
        return None
    expression = apply_derivatives(apply_algebra_lowering(data))
    return _degree(expression, {})


def _degree(node: Expr, done: dict[int, int | None]) -> int | None:
    if id(node) not in done:  # conditions have no equality
        done[id(node)] = _new_degree(node, done)
    return done[id(node)]


def _new_degree(node: Expr, done: dict[int, int | None]) -> int | None:
    if isinstance(node, SpatialCoordinate):
        return 1
    if isinstance(node, ConstantValue | MultiIndex | ufl.Constant | ufl.FacetNormal):
        return 0
    if isinstance(node, fem.Function):
        return int(node.function_space.element.basix_element.embedded_superdegree)
    if isinstance(node, Power) and isinstance(node.ufl_operands[1], ScalarValue):
        base, power = _degree(node.ufl_operands[0], done), float(node.ufl_operands[1])
        return None if base is None or power < 0 or power % 1 else base * int(power)
    if not isinstance(node, Division | Product | SUMS):
        return None
    parts = [_degree(operand, done) for operand in node.ufl_operands]
    found = [part for part in parts if part is not None]
    if len(found) < len(parts):
        return None
    if isinstance(node, Division):
        return None if found[1] else found[0]
    return sum(found) if isinstance(node, Product) else max(found)
