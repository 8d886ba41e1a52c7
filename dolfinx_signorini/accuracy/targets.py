"""Targets of an accuracy: a norm of the error, or a functional of the solution."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms.analysis import extract_type
from ufl.core.expr import Expr

from dolfinx_signorini.accuracy.cells import cell_norms, largest_on_boundary
from dolfinx_signorini.base import compiled
from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.data.formula_values import components
from dolfinx_signorini.norms.error_norms import error_norms
from dolfinx_signorini.norms.names import Norm, parse_norm
from dolfinx_signorini.norms.orders import Numbers, singular_order
from dolfinx_signorini.norms.pointwise import Quantity, quantity_of, returned
from dolfinx_signorini.norms.power_sums import total

Functional = Callable[[Expr], ufl.Form]


@dataclass(frozen=True)
class Target:
    """What is to be accurate.

    Two examples, a norm and the mean of the solution:

        target("W1_4")
        target(lambda v: v * ufl.dx)

    Attributes:
        name: What the target is called.
        norm: The norm of the error; None for a functional.
        functional: The functional, linear in its argument; None for a norm.
        of: The quantity of the first derivatives whose norm is meant, with a W^{1,p} norm as
            `norm`, for such norms are of its kind; None for the solution itself.
        rough: Whether the functional has derivatives on facets, as the flux through a side has. The
            dual solution jumps there: no order of convergence is gained from the dual solution.
    """

    name: str
    norm: Norm | None = None
    functional: Functional | None = None
    of: Quantity | None = None
    rough: bool = False

    @property
    def weighted(self) -> bool:
        """Whether a dual solution tells how errors of cells add up.

        The error in an L^p norm at one place comes from cells at other places, too. In W^{1,p} and
        in sup norms most of the error of a cell is that of the cell itself.
        """
        norm = self.norm
        return norm is None or (norm.derivatives < 1 and not math.isinf(norm.p))

    @property
    def has_own(self) -> bool:
        """Whether one cell alone may have most of the error: in L^p of the domain, and sup norms.

        In such norms the highest derivatives tell the errors of single cells.
        """
        norm = self.norm
        if norm is None:
            return False
        return math.isinf(norm.p) or (norm.derivatives == 0 and not norm.boundary)

    @property
    def of_facets(self) -> bool:
        """Whether the target is the sup norm of the boundary."""
        return self.norm is not None and self.norm.boundary and math.isinf(self.norm.p)

    @property
    def in_domain(self) -> "Target":
        """The same norm of the domain, of a norm of the boundary."""
        return target("Linf") if self.of_facets else self

    @property
    def power(self) -> float:
        """The exponent with which the indicators of cells add up."""
        return 1.0 if self.weighted or self.norm is None else self.norm.p

    @property
    def exponent(self) -> float:
        """The exponent with which errors at separate places add up.

        The dual solution of an L^p norm of the boundary looks where the error is large: when the
        error at some cells falls by a factor, what these cells add falls by the p-th power of the
        factor. In the domain, the norms of cells tell that.
        """
        norm = self.norm
        alone = norm is None or (self.weighted and not norm.boundary)
        return 1.0 if alone or norm is None else norm.p

    def order(self, degree: int) -> float:
        """Return the order of convergence for smooth solutions.

        Args:
            degree: The degree of the elements.
        """
        if self.weighted or self.norm is None:
            return float(self.order_of_products(np.array(degree), np.array(degree)))
        return degree + 1.0 - self.norm.derivatives

    def order_of_products(self, order: Array, dual: Array) -> Array:
        """Return the order of what cells add, products of parts of both solutions in energy.

        The load of the dual solution of a norm is the error, another one on each mesh: such a dual
        solution adds what its norm gains on the energy, at most. One that jumps adds nothing.

        Args:
            order: The order of the solution in energy; without a dual solution, of what cells add.
            dual: That of the dual solution.
        """
        return order + np.minimum(dual, self._gain)

    def order_in_energy(self, order: Array) -> Array:
        """Return the order in energy of two solutions of one order whose products have an order."""
        return np.maximum(0.5 * order, order - self._gain)

    @property
    def _gain(self) -> float:
        """The order that a dual solution adds at most."""
        if not self.weighted or self.rough:
            return 0.0
        return math.inf if self.norm is None else 1.0 - self.norm.derivatives

    def singular_order(self, exponent: Numbers, dual: Numbers, dimension: int = 2) -> Array:
        """Return the orders in which divisions towards a singular point reduce the error.

        Args:
            exponent: The exponents a of solutions like r^a.
            dual: The exponents of the dual solutions.
            dimension: That of the space in which r is the distance, see `orders.is_finite`.
        """
        if self.weighted or self.norm is None:
            both = (np.asarray(each) - 1.0 + 0.5 * dimension for each in (exponent, dual))
            return self.order_of_products(*both)
        return np.asarray(singular_order(self.norm, exponent, dimension))

    def on_cells(self, f: fem.Function) -> Array:
        """Return the norm that is meant of a function on each owned cell; collective."""
        assert self.norm is not None
        if self.of_facets:
            return largest_on_boundary(f)
        norm = self.norm if self.of is None else replace(self.norm, derivatives=0.0)
        return cell_norms(f, norm, self.of)


def target(norm: str | Functional, of: Quantity | None = None) -> Target:
    """Return the target that a norm's name or a functional means.

    Args:
        norm: The name, or the functional.
        of: The quantity of the solution whose norm is meant; by default the solution itself.

    Raises:
        InputError: The name is that of no norm, or of none that is known of quantities.
    """
    if of is not None and (not isinstance(norm, str) or not re.fullmatch("L[^_]+", norm)):
        raise InputError("of a quantity L^p norms of the domain are known, such as L2", "norm")
    if callable(norm) and not isinstance(norm, Expr):

        def form(u: Expr) -> ufl.Form:
            return returned(norm, u, ufl.Form, "the functional returned no form", "a form", "norm")

        return Target(getattr(norm, "__name__", "functional"), functional=form)
    if not isinstance(norm, str):
        raise InputError(f"must be a name or a function, not {type(norm).__name__}", "norm")
    parsed = parse_norm(norm)
    if of is not None:
        return Target(norm, replace(parsed, derivatives=1.0), of=of)
    return Target(norm, parsed)


def size(error: fem.Function, target: Target) -> float:
    """Return the norm of a function, or the size of the functional; the call is collective."""
    comm, norm = error.function_space.mesh.comm, target.norm
    if norm is None:
        assert target.functional is not None
        return abs(compiled.integral(target.functional(error)))
    if norm.boundary:
        return error_norms(error, None, [target.name])[target.name]
    return total(target.on_cells(error), norm.p, comm)


def checked_target(target: Target, space: fem.FunctionSpace) -> Target:
    """Return a target with what functions of a space tell of the target; the call is collective.

    Args:
        target: What is to be accurate; nothing is checked for a norm of the solution.
        space: The space.

    Raises:
        InputError: The functional is not linear, has derivatives of higher order, is not finite, or
            0 for all functions of the space; the quantity is not one of the first derivatives
            alone, or not linear.
    """
    if target.of is not None:
        _check_quantity(target.of, space)
    if target.functional is None:
        return target
    form = target.functional(ufl.TestFunction(space))
    values = np.zeros(0)
    if not form.empty():
        for part in form.integrals():
            _check_derivatives(part.integrand(), "norm")
        compiled.check_linear(form, "norm")
        values = np.abs(compiled.assembled(compiled.form(form, "norm"), space).x.array)
    largest = highest(space.mesh.comm, np.nan_to_num(values, nan=np.inf))
    if not 0.0 < largest < math.inf:
        said = "not a finite number" if largest > 0.0 else "0 for all functions"
        raise InputError(f"the functional is {said} on the first mesh", "norm")
    on_facets = [part.integrand() for part in form.integrals() if "facet" in part.integral_type()]
    slopes = [each for part in on_facets for each in extract_type(part, ufl.classes.Derivative)]
    return replace(target, rough=any(extract_type(each, ufl.Argument) for each in slopes))


def _check_quantity(of: Quantity, space: fem.FunctionSpace) -> None:
    v = ufl.TestFunction(space)
    found = quantity_of(of, v)
    if not extract_type(found, ufl.Argument):
        raise InputError("does not depend on the function", "of")
    _check_derivatives(found, "of")
    compiled.check_linear(sum(components(found)) * ufl.dx, "of")
    slope = ufl.grad(v)
    flat = ufl.replace(found, {slope: ufl.classes.Zero(slope.ufl_shape)})
    if extract_type(flat, ufl.Argument):
        raise InputError("must depend on derivatives alone, and not on values", "of")


def _check_derivatives(expression: Expr, name: str) -> None:
    """Refuse derivatives of higher order of the function, which has a kink between any cells."""
    for slope in extract_type(expression, ufl.classes.Derivative):
        inner = extract_type(slope.ufl_operands[0], ufl.classes.Derivative)
        if any(extract_type(each, ufl.Argument) for each in inner):
            raise InputError("has derivatives of higher order; first ones are known", name)
