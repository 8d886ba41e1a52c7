"""References that errors are measured against: a function and its gradient on one mesh.

A reference is a closed form, a closed form interpolated into finite elements, or a much more
accurate discrete solution carried over from another mesh.
"""

from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
import ufl
from dolfinx import fem, mesh
from ufl.core.expr import Expr

from dolfinx_signorini.base import compat
from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.kinds import (
    MESH,
    ball,
    check,
    coordinates,
    instance,
    integer,
    on_mesh,
    optional,
    sequence,
)
from dolfinx_signorini.data.formula_values import values_at
from dolfinx_signorini.meshes.between_meshes import interpolate_between
from dolfinx_signorini.meshes.elements import HIGHEST_DEGREE, LARGEST_DEGREE
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.sided_meshes import cells_near_ball, owned_cells


@dataclass(frozen=True)
class Reference:
    """What the error of a discrete solution is measured against.

    The expressions use the coordinates of one mesh:

        x = ufl.SpatialCoordinate(domain)
        reference = Reference(domain, x[0] ** 2, (2.0 * x[0], 0.0 * x[0]))
        error_norms(u_h, reference, ["L2", "H1"])

    Attributes:
        mesh: The mesh whose coordinates the expressions use.
        u: The function: a scalar, or a vector with a component for each coordinate.
        grad: The derivatives of u in each direction of space, each of the shape of u.
        support: Centre and radius of a ball outside of which the function vanishes, or None. Errors
            evaluate the expressions on the cells that meet the ball and nowhere else.
        singular: Points at which the gradient is not smooth and sup norms look closely.

    Raises:
        InputError: An attribute is of another kind.
    """

    mesh: mesh.Mesh
    u: Expr
    grad: tuple[Expr, ...]
    support: tuple[tuple[float, ...], float] | None = field(default=None, kw_only=True)
    singular: tuple[tuple[float, ...], ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        check(mesh=(self.mesh, MESH))
        kind = on_mesh(self.mesh, vectors=True)
        check(u=(self.u, kind), grad=(self.grad, sequence(kind, "a tuple of the components")))
        dimension = self.mesh.geometry.dim
        if len(self.grad) != dimension:
            raise InputError(f"has {len(self.grad)} components", "grad")
        if any(_shape(slope) != _shape(self.u) for slope in self.grad):
            raise InputError(f"has components that are not of the shape {_shape(self.u)}", "grad")
        points = sequence(coordinates(dimension), "a tuple of points")
        check(support=(self.support, optional(ball(dimension))), singular=(self.singular, points))

    def support_cells(self) -> LocalIndices:
        """Return the owned cells on which u may be non-zero (all of them without a support)."""
        if self.support is None:
            return owned_cells(self.mesh)
        return cells_near_ball(self.mesh, *self.support)


R = TypeVar("R", bound=Reference)


def interpolant(
    space: fem.FunctionSpace, expression: Expr, cells: LocalIndices | None = None
) -> fem.Function:
    """Return the interpolant of an expression.

    Args:
        space: A space of Lagrange elements.
        expression: A UFL expression on the mesh of the space.
        cells: The cells of this rank to interpolate on; dofs of no such cell are 0. None for all.
    """
    function, nodes = fem.Function(space), compat.interpolation_points(space.element)
    if cells is None:
        cells = np.arange(len(space.dofmap.list), dtype=np.int32)
    points = Points(space.mesh, cells, nodes)
    values = values_at(space.mesh, [expression], inside=False)(points)
    function.interpolate(lambda _: np.stack(values).reshape(len(values), -1), cells0=cells)
    function.x.scatter_forward()
    return function


def interpolated(reference: R, degree: int) -> R:
    """Return a reference whose u is interpolated into continuous Lagrange elements.

    Near a detachment point u is only r^{3/2}-smooth, so that the interpolant differs from u by
    O(h^{3/2}) for every degree: the interpolant serves where a closed form is too expensive.

    Args:
        reference: The function to interpolate; whatever else belongs to it is kept.
        degree: Polynomial degree, 1 to 8.

    Raises:
        InputError: An argument is of another kind.
    """
    check(
        reference=(reference, instance(Reference, "a known solution")),
        degree=(degree, integer(1, LARGEST_DEGREE)),
    )
    shape = _shape(reference.u)
    u = interpolant(fem.functionspace(reference.mesh, ("Lagrange", degree, shape)), reference.u)
    return replace(reference, u=u, grad=derivatives_of(u))


def discrete(u: fem.Function) -> Reference:
    """Return a discrete function as a reference for others on the same mesh, of any degree."""
    return Reference(u.function_space.mesh, u, derivatives_of(u))


def carried(u: fem.Function, domain: mesh.Mesh, degree: int = HIGHEST_DEGREE) -> Reference:
    """Return a function on another mesh as a reference.

    On each cell of the mesh the function and its gradient are interpolated by polynomials.

    Args:
        u: The function, much more accurate than what is to be measured.
        domain: The mesh to carry the function to.
        degree: The degree of these polynomials.
    """
    source = u.function_space
    dim = source.mesh.geometry.dim
    whole, lower = (*u.ufl_shape, dim), source.element.basix_element.degree - 1
    slopes = fem.functionspace(source.mesh, ("DG", lower, whole))
    cells = owned_cells(domain)
    value, slope = (
        fem.Function(fem.functionspace(domain, ("DG", degree, shape)))
        for shape in (u.ufl_shape, whole)
    )
    interpolate_between([(u, value), (interpolant(slopes, ufl.grad(u)), slope)], cells)
    return Reference(domain, value, _along_axes(slope))


def derivatives_of(u: Expr) -> tuple[Expr, ...]:
    """Return the derivatives of a function in each direction of space, of the shape of u."""
    return _along_axes(ufl.grad(u))


def gradient_of(reference: Reference) -> Expr:
    """Return the gradient of a reference, for vectors with a row for each component."""
    slopes, shape = reference.grad, _shape(reference.u)
    if not shape:
        return ufl.as_vector(slopes)
    return ufl.as_matrix([[slope[k] for slope in slopes] for k in range(*shape)])


def _along_axes(gradient: Expr) -> tuple[Expr, ...]:
    """The columns of a gradient, or the entries of that of a scalar."""
    *shape, dim = gradient.ufl_shape
    if not shape:
        return tuple(gradient)
    rows = range(shape[0])
    return tuple(ufl.as_vector([gradient[k, i] for k in rows]) for i in range(dim))


def _shape(value: Any) -> tuple[int, ...]:
    return tuple(getattr(value, "ufl_shape", ()))
