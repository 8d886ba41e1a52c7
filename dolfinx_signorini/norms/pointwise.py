"""The error u_h - u and its derivatives at any points of cells and facets."""

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias, TypeVar

import basix
import numpy as np
import ufl
from dolfinx import fem, mesh
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.errors import InputError, together
from dolfinx_signorini.data.formula_values import FormulaAtPoints
from dolfinx_signorini.data.reading import lowered
from dolfinx_signorini.meshes.points import Points, basix_element
from dolfinx_signorini.norms.references import Reference, derivatives_of, gradient_of

CELLS = ("triangle", "tetrahedron", "quadrilateral", "hexahedron")

# What of a solution is meant, linear in the solution and its first derivatives: the stress.
Quantity: TypeAlias = Callable[[Expr], Expr]
T = TypeVar("T")


class ErrorAtPoints:
    """The error of a discrete solution as a function of points:

        error = ErrorAtPoints(u_h, exact, derivatives=True)
        e, dx, dy = error(Points(domain, cells, lattice))

    The error of a vector is the Euclidean length of the error, and so is each of its derivatives.
    The construction is collective.

    Args:
        u_h: The discrete solution, a function in a Lagrange space of scalars or vectors.
        exact: The known solution, on the mesh of u_h; None for u_h itself.
        derivatives: Whether the error is followed by its derivatives in each direction of space;
            at points of facets these are those of the tangential gradient.
        of: The quantity whose error is meant, in place of the solution; then without derivatives.

    Attributes:
        domain: The mesh.
        degree: The polynomial degree of u_h, or of a discrete u if that is larger.

    Raises:
        InputError: u_h is no Lagrange function, its cells are of another kind than `CELLS`, or the
            exact solution belongs to another mesh, has another shape, or is no function of
            coordinates and of discrete functions.
    """

    def __init__(
        self,
        u_h: fem.Function,
        exact: Reference | None,
        derivatives: bool,
        of: Quantity | None = None,
    ):
        self.domain, self.degree = u_h.function_space.mesh, _degree(u_h)
        self._u_h, self._derivatives, self._of = u_h, derivatives, of
        self._parts = int(np.prod(u_h.ufl_shape))
        self._quantity: FormulaAtPoints | None = None
        if of is not None:
            quantity = quantity_of(of, u_h)
            self._parts = int(np.prod(quantity.ufl_shape))
            self._quantity = FormulaAtPoints(self.domain, [quantity])
        self._discrete: fem.Function | None = None
        self._formula: FormulaAtPoints | None = None
        if exact is None:
            return
        if exact.mesh._cpp_object is not self.domain._cpp_object:
            raise InputError("belongs to another mesh than the discrete solution", "exact")
        shape = getattr(exact.u, "ufl_shape", ())
        if shape != u_h.ufl_shape:
            raise InputError(f"has the shape {shape}, and u_h {u_h.ufl_shape}", "exact")
        if of is not None:
            known = {u_h: ufl.as_ufl(exact.u), ufl.grad(u_h): gradient_of(exact)}
            self._formula = FormulaAtPoints(self.domain, [ufl.replace(quantity, known)])
        elif isinstance(exact.u, fem.Function) and tuple(exact.grad) == derivatives_of(exact.u):
            self._discrete = exact.u
            self.degree = max(self.degree, _degree(exact.u))
        else:
            tensors = [exact.u, *(exact.grad if derivatives else ())]
            self._formula = FormulaAtPoints(self.domain, tensors)
        cells = self.domain.topology.index_map(self.domain.topology.dim)
        self._support = np.zeros(cells.size_local + cells.num_ghosts, dtype=bool)
        self._support[exact.support_cells()] = True

    @np.errstate(divide="ignore", invalid="ignore", over="ignore")
    def __call__(self, points: Points) -> list[Array]:
        """Return the error, then its derivatives if there are any, each of shape (n, m)."""
        found = self._values(self._u_h, points)
        if self._discrete is not None:
            exact = self._values(self._discrete, points)
            found = [u_h - u for u_h, u in zip(found, exact, strict=True)]
        elif self._formula is not None:
            rows = np.flatnonzero(self._support[points.cells])
            part = points if len(rows) == len(points.cells) else points.of(rows)
            for component, u in zip(found, self._formula(part), strict=True):
                component[rows] -= u
        each = [found[k :: self._parts] for k in range(self._parts)]
        along = [points.tangential(component[1:]) for component in each]
        return [length(found[: self._parts]), *map(length, zip(*along, strict=True))]

    @property
    def of_u_h(self) -> "ErrorAtPoints":
        """The discrete solution itself in place of the error."""
        return ErrorAtPoints(self._u_h, None, self._derivatives, self._of)

    @property
    def kinds(self) -> int:
        """2 for an error with derivatives, else 1."""
        return 1 + int(self._derivatives)

    def _values(self, function: fem.Function, points: Points) -> list[Array]:
        """The components of a function, and then those of its derivatives in each direction."""
        if self._quantity is not None:
            return self._quantity(points)
        gradients = points.gradients(function) if self._derivatives else []
        slopes = [part for direction in zip(*gradients, strict=True) for part in direction]
        return [*points.values(function), *slopes]


def quantity_of(of: Quantity, u: Expr) -> Expr:
    """Return a quantity of a function, with derivatives carried out; collective.

    Raises:
        InputError: The call fails, or returns no expression.
    """
    found = returned(of, u, Expr, "the quantity is no expression", "an expression", "of")
    return lowered(found)


def returned(
    call: Callable[[Expr], Any], u: Expr, kind: type[T], failed: str, wanted: str, subject: str
) -> T:
    """Return what a function of the user makes of a function of a space; collective.

    Args:
        call: The function of the user.
        u: The function of a space.
        kind: What is to be returned.
        failed: What an exception is called.
        wanted: What is to be returned, in words.
        subject: The name of the argument that the function was given as.

    Raises:
        InputError: The call fails, or returns something else.
    """
    with together(u.ufl_function_space().mesh.comm, subject, f"{failed}:"):
        found = call(u)
        if not isinstance(found, kind):
            raise InputError(f"must return {wanted}, not {type(found).__name__}", subject)
    return found


def length(components: Sequence[Array]) -> Array:
    """Return the Euclidean length of vectors, of which a scalar keeps its sign.

    Args:
        components: The components, arrays of one shape.
    """
    return functools.reduce(np.hypot, components)


def kind_of(domain: mesh.Mesh, places: LocalIndices) -> basix.CellType:
    """Return the kind of cells, or of boundary facets as pairs (cell, local facet)."""
    cell = basix.CellType[domain.topology.cell_name()]
    return basix.cell.subentity_types(cell)[domain.topology.dim + 1 - places.ndim][0]


def _degree(function: fem.Function) -> int:
    cell = function.function_space.mesh.topology.cell_name()
    if cell not in CELLS:
        raise InputError(f"known for meshes of {', '.join(CELLS)}, not of {cell} cells", "norms")
    if len(function.ufl_shape) > 1:
        message = f"must be a scalar or a vector, has the shape {function.ufl_shape}"
        raise InputError(message, "u_h")
    return int(basix_element(function, "u_h").embedded_superdegree)
