"""Values of UFL expressions at any points of cells and facets.

The expressions are read as formulas, in which the components of discrete functions and of their
derivatives are more coordinates, and NumPy evaluates the formulas: nothing is compiled, and the
points are data, the same ones for all cells or other ones for each cell.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem, mesh
from ufl.algorithms.analysis import extract_coefficients, extract_constants, extract_type
from ufl.algorithms.signature import compute_expression_signature
from ufl.classes import Grad
from ufl.core.expr import Expr
from ufl.domain import extract_domains

from dolfinx_signorini.base import compat, compiled
from dolfinx_signorini.base.arrays import Array, blocks
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.data.formulas import Node, nodes, together
from dolfinx_signorini.data.reading import Unreadable, lowered, more_coordinates, roots
from dolfinx_signorini.data.readings import known_of
from dolfinx_signorini.meshes.points import Points

# Of the largest value in a cell: a point that moves inwards as `Points.inside` has it changes the
# square root of the distance from a vertex by much less.
JUMP = SOLVED ** (1.0 / 3.0)


class FormulaAtPoints:
    """UFL expressions whose points are data:

        formula = FormulaAtPoints(domain, [exact.u, *exact.grad])
        u, *gradient = formula(Points(domain, cells, lattice))

    Args:
        domain: The mesh of the expressions.
        expressions: Expressions of any shape, whose components are evaluated in turn, row by row:
            of the coordinates, of constants, of the normals of facets and of Lagrange functions
            with their first derivatives.
        inside: Whether on a facet where an expression jumps the values are those from inside of
            each cell; otherwise they are the values at the point itself.

    Raises:
        InputError: An expression depends on something else, for example on the size of cells.
    """

    def __init__(self, domain: mesh.Mesh, expressions: Sequence[Expr], inside: bool = True):
        self._domain, self._inside, self._vector = domain, inside, _vector(expressions)
        self._constants = extract_constants(self._vector)
        self._functions = extract_coefficients(self._vector)
        terminals = [*extract_domains(self._vector), *self._functions, *self._constants]
        numbers = {each: k for k, each in enumerate(terminals)}
        self._signature = compute_expression_signature(self._vector, numbers)
        self._parts()

    def _parts(self) -> "_Parts":
        """Return the expressions as formulas, in which constants have their present values."""
        known = known_of(self._signature, self._constants)
        if _Parts not in known:
            known[_Parts] = self._read()
        if isinstance(known[_Parts], str):
            message = f"must depend on coordinates and functions only, not on {known[_Parts]}"
            raise InputError(message, "u")
        found: _Parts = known[_Parts]
        return found

    def _read(self) -> "_Parts | str":
        """Read the expressions; return what is not readable where there is such a part."""
        vector, functions = lowered(self._vector), self._functions
        slopes = extract_type(vector, Grad)
        steep = [k for k, f in enumerate(functions) if ufl.grad(f) in slopes]
        normals = list(extract_type(vector, ufl.FacetNormal))
        parts = [*normals, *functions, *(ufl.grad(functions[k]) for k in steep)]
        try:
            found = roots(vector, more_coordinates(self._domain.geometry.dim, parts))
        except Unreadable as rest:
            return str(rest)
        jumps = any(n.operation.breaks for root in found for n in nodes(root) if n.args)
        return _Parts(found, jumps, bool(normals), steep)

    def __call__(self, points: Points) -> list[Array]:
        """Return the values of each component at the points, each of shape (n, m)."""
        parts = self._parts()
        values = self._at(parts, points, points.x)
        if not (self._inside and parts.jumps and points.at_ends):
            return values
        for at, within in zip(values, self._at(parts, points, points.inside), strict=True):
            size = np.abs(within).max(axis=1, initial=0.0, keepdims=True)
            with np.errstate(invalid="ignore"):
                other = (np.abs(at - within) > JUMP * size) & np.isfinite(at)
            at[other] = within[other]
        return values

    def _at(self, parts: "_Parts", points: Points, x: Sequence[Array]) -> list[Array]:
        """The values at points for other coordinates that are nearly the same."""
        data = [*x, *(points.normals if parts.normals else [])]
        for function in self._functions:
            data += points.values(function)
        for k in parts.slopes:
            gradients = points.gradients(self._functions[k])
            data += [part for component in gradients for part in component]
        columns = [np.ravel(column) for column in data]
        result = np.empty((len(parts.roots), columns[0].size))
        for some in blocks(result.shape[1], 1):
            part = np.stack([column[some] for column in columns])
            result[:, some] = together(parts.roots, part.T)
        return list(result.reshape(len(result), *x[0].shape))


@dataclass(frozen=True)
class _Parts:
    """What is known of expressions of one kind on all meshes.

    Attributes:
        roots: The components as formulas, whose coordinates are those of space, then the components
            of the normal, of the functions and of the derivatives.
        jumps: Whether an operation may jump.
        normals: Whether the normal is among the coordinates.
        slopes: The numbers of the functions whose derivatives are among them.
    """

    roots: list[Node]
    jumps: bool
    normals: bool
    slopes: list[int]


def values_at(
    domain: mesh.Mesh, expressions: Sequence[Expr], inside: bool = True
) -> Callable[[Points], list[Array]]:
    """Return a function with the values of any expressions, see `FormulaAtPoints`.

    Of what is no formula, such as the size of cells, DOLFINx compiles the values at points that are
    the same in each place; the call of the function is collective.
    """
    try:
        return FormulaAtPoints(domain, expressions, inside)
    except InputError:
        pass
    # A coordinate comes last: DOLFINx 0.11 refuses expressions that are the same everywhere.
    vector = _vector([*expressions, ufl.SpatialCoordinate(domain)[0]])

    def compiled_at(points: Points) -> list[Array]:
        with compiled.remembered():
            expression = fem.Expression(vector, points.at, comm=domain.comm)
        found = compat.evaluate(expression, domain, points.places)
        shape = len(points.places), len(points.at), len(vector)
        return list(np.moveaxis(found.reshape(shape), 2, 0)[:-1].copy())

    return compiled_at


def _vector(expressions: Sequence[Expr]) -> Expr:
    """The components of expressions in turn, as one vector."""
    return ufl.as_vector([part for e in expressions for part in components(e)])


def components(u: Expr) -> list[Expr]:
    """Return the components of a tensor of any rank, row by row; a scalar has one."""
    return [u[index] if index else u for index in np.ndindex(getattr(u, "ufl_shape", ()))]
