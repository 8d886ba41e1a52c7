"""Values of data at dofs: numbers, UFL expressions, functions and callables."""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from ufl.algorithms import extract_coefficients
from ufl.classes import (
    Derivative,
    GeometricQuantity,
    RealValue,
    Restricted,
    SpatialCoordinate,
    Zero,
)
from ufl.core.expr import Expr
from ufl.corealg.traversal import unique_pre_traversal

from dolfinx_signorini.base import compat
from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.errors import InputError, together
from dolfinx_signorini.base.ranks import marked
from dolfinx_signorini.data.formula_values import values_at
from dolfinx_signorini.meshes.elements import (
    coefficients_of,
    control_points,
    is_bernstein,
    nodal_space,
)
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.sided_meshes import cells_with_dofs, covering_cells

Data: TypeAlias = float | Expr | fem.Function | Callable[[Array], Array]


def evaluator(
    space: fem.FunctionSpace, value: Data, dofs: LocalIndices, name: str = "obstacle"
) -> Callable[[], Array]:
    """Return a function that evaluates data at dofs, each time with the present values.

    In the Bernstein basis the values of the dofs are the coefficients of the interpolant of the
    data at the control points. A UFL expression is evaluated on few cells that together have all of
    the dofs.

    Args:
        space: A scalar Lagrange space.
        value: A number, a UFL expression, a function of the space or of another one on its mesh,
            or a callable of the coordinates, shape (3, n), which returns shape (n,).
        dofs: Dofs of this rank: all of them on some facets, or in some cells.
        name: The name of the argument, for messages.

    Raises:
        InputError: The data have several values where cells meet.
    """
    if isinstance(value, int | float | np.number | RealValue | Zero):  # UFL's have no mesh
        return lambda: np.full(len(dofs), float(value))
    if isinstance(value, fem.Function) and value.function_space == space:
        return lambda: value.x.array[dofs].copy()
    if is_bernstein(space):
        return _coefficients(space, value, dofs, name)
    if isinstance(value, Expr):
        _check_continuous(value, name)
    g = fem.Function(space)
    wanted = np.zeros(len(g.x.array), dtype=bool)
    wanted[dofs] = True
    cells = covering_cells(space, wanted, cells_with_dofs(space, wanted))
    if callable(value) and not isinstance(value, Expr):
        x = control_points(space, cells)[dofs].T
        return lambda: called(space.mesh.comm, value, x, name)
    points = Points(space.mesh, cells, compat.interpolation_points(space.element))
    values = values_at(space.mesh, [value], inside=False)

    def evaluate() -> Array:
        (g.x.array[space.dofmap.list[cells]],) = values(points)
        return g.x.array[dofs].copy()

    return evaluate


def _check_continuous(value: Expr, name: str) -> None:
    """Refuse data that have several values at a dof: which one is taken would be left to chance."""
    parts = list(unique_pre_traversal(value))
    slopes = [e for e in parts if isinstance(e, Derivative)]
    broken = [f for f in extract_coefficients(value) if f.ufl_element() not in ufl.H1]
    of_cells = [
        e
        for e in parts
        if isinstance(e, GeometricQuantity) and not isinstance(e, SpatialCoordinate)
    ]
    if any(isinstance(e, Restricted) for e in parts):
        raise InputError("has a value on each side of a facet, which no node tells apart", name)
    if broken or of_cells or any(map(extract_coefficients, slopes)):
        what = "quantities of cells" if of_cells else "derivatives of functions"
        what = "discontinuous functions" if broken else what
        raise InputError(
            f"{what} have several values at a node between cells; interpolate into a continuous "
            "space, for a lower obstacle the largest value around each node",
            name,
        )


def _coefficients(
    space: fem.FunctionSpace, value: Data, dofs: LocalIndices, name: str
) -> Callable[[], Array]:
    """As `evaluator`, in the Bernstein basis; the call is collective."""
    wanted = marked(space, dofs)
    known = np.flatnonzero(wanted).astype(np.int32)
    cells, nodal = cells_with_dofs(space, wanted), nodal_space(space)
    values_at = evaluator(nodal, value, known, name)

    def evaluate() -> Array:
        values = np.zeros(len(wanted))
        values[known] = values_at()
        return coefficients_of(space, values, cells)[dofs]

    return evaluate


def datum(domain: mesh.Mesh, value: Data) -> Callable[[Points], Array]:
    """Return a function with the values of data at points of cells or of facets.

    The values have the shape (places, points), or (1, 1) for a number.

    Args:
        domain: The mesh.
        value: The data, see `evaluator`. The values of a callable, and of a UFL expression that is
            no formula, are asked for by collective calls.
    """
    if isinstance(value, int | float | np.number):
        number = np.full((1, 1), float(value))
        return lambda points: number
    if isinstance(value, Expr):
        formula = values_at(domain, [value])
        return lambda points: formula(points)[0]

    def called_at(points: Points) -> Array:
        shape, x = points.x[0].shape, np.zeros((3, points.x[0].size))
        x[: len(points.x)] = [coordinate.ravel() for coordinate in points.x]
        return called(domain.comm, value, x).reshape(shape)

    return called_at


def called(
    comm: MPI.Comm, value: Callable[[Array], Any], x: Array, name: str = "obstacle"
) -> Array:
    """Return the values of a callable at points, shape (n,).

    Args:
        comm: The communicator; the call is collective.
        value: The callable, which returns one value for each point or one for all; a callable is
            not called where this rank has no point.
        x: The points, shape (3, n).
        name: The name of the argument.

    Raises:
        InputError: The callable raises an exception on some rank, or returns no such values; the
            subject is the name of the argument.
    """
    values = np.zeros(x.shape[1])
    with together(comm, name, "the callable returned no values:"):
        found = np.asarray(value(x) if len(values) else 0.0)
        if np.iscomplexobj(found):
            raise TypeError("the values are complex")
        values[:] = np.broadcast_to(found.astype(np.float64), values.shape)
    return values
