"""The summands of integrands as formulas, read once for forms that are alike on all meshes.

An integrand of L(v) is linear in v and grad v. For v = 1 and grad v = 0 the integrand is the load,
and for v = 0 and a unit vector as grad v a component of what acts on grad v. Integrands of a(u, v)
have the reaction and the entries of the diffusion by the same substitution.

The loop poses forms of one kind on many meshes. Formulas know of no mesh: what one of these forms
has been found to be, all forms with its signature and with the same values of constants are. The
same holds for expressions.
"""

from collections.abc import Callable, Hashable, Iterable, Sequence
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import ufl
from ufl.algorithms.check_arities import ArityMismatch, check_integrand_arity
from ufl.classes import Grad
from ufl.core.expr import Expr
from ufl.corealg.traversal import traverse_unique_terminals, unique_pre_traversal

from dolfinx_signorini.base.sums_of_squares import summands
from dolfinx_signorini.data.formulas import ZERO, Formula
from dolfinx_signorini.data.reading import lowered, more_coordinates, read

T = TypeVar("T")
Place = tuple[int, int]  # an integral of a form, and a summand of its integrand
Known = dict[Hashable, Any]

# What is known of forms and expressions by their signatures, with the values of the constants.
_known: dict[str, tuple[list[bytes], Known]] = {}


def known_of(signature: str, constants: Iterable[Any]) -> Known:
    """Return what is known of forms or expressions of a kind, to which a caller may add.

    Args:
        signature: The signature of UFL, which does not tell meshes and functions from one another.
        constants: The constants, of whose last values alone something is known.
    """
    values = [np.asarray(getattr(c, "value", np.nan)).tobytes() for c in constants]
    if signature not in _known or _known[signature][0] != values:
        _known[signature] = values, {}
    return _known[signature][1]


class Reading:
    """The summands of the integrands of a form, and what they are for certain arguments.

    For example, the load, which the first summand of the first integral has in front of v:

        load = Reading(problem.L).formula((0, 0), [0])

    What stands for an argument is given by a number: 0 for the value 1 with the slope 0, and k for
    the value 0 with the slope 1 in the direction k. For vectors of n components c + n k, with c
    from 0 on, stands for the same with the component c, where the others are 0.

    Args:
        form: The form.
    """

    def __init__(self, form: ufl.Form):
        self.form = form
        self._known = known_of(form.signature(), form.constants())

    @cached_property
    def terms(self) -> list[list[Expr]]:
        """The summands of each integral, lowered."""
        return [summands(lowered(integral.integrand())) for integral in self.form.integrals()]

    def places(self, integral: int) -> list[Place]:
        """Return the places of the summands of an integral."""
        count = self.once(("count", integral), lambda: len(self.terms[integral]))
        return [(integral, k) for k in range(count)]

    def has_normals(self, place: Place) -> bool:
        """Return whether a summand depends on the normal."""

        def found() -> bool:
            parts = traverse_unique_terminals(self.terms[place[0]][place[1]])
            return any(isinstance(part, ufl.FacetNormal) for part in parts)

        return self.once(("normals", place), found)

    def orders(self, place: Place) -> set[int]:
        """Return the orders of derivatives, 0 and 1, that a summand has of the arguments."""

        def found() -> set[int]:
            term, arguments = self.terms[place[0]][place[1]], self.form.arguments()
            every = unique_pre_traversal(term)
            parents = [part for part in every if any(a in arguments for a in part.ufl_operands)]
            bare = {0} if term in arguments else set[int]()
            return bare | {int(isinstance(part, Grad)) for part in parents}

        return self.once(("orders", place), found)

    def is_linear_in_normals(self, place: Place) -> bool:
        """Return whether a summand is the sum of components of the normal, each with a factor."""

        def found() -> bool:
            term, arguments = self.terms[place[0]][place[1]], self.form.arguments()
            return is_linear_in_normals(term, self.form.ufl_domain(), arguments)

        return self.once(("linear in normals", place), found)

    def formula(
        self, place: Place, chosen: Sequence[int], normal: int = 0, functions: bool = False
    ) -> Formula | None:
        """Return what a summand is for certain arguments; None if that is not readable.

        Args:
            place: The summand.
            chosen: What stands for each of the arguments.
            normal: The direction of the normal.
            functions: Whether the components of the coefficients of the form are more coordinates
                of the formula, behind those of space; by default they are not readable.
        """
        key = place, tuple(chosen), normal, functions
        return self.once(key, lambda: self._read(place, chosen, normal, functions))

    def total(self, places: Sequence[Place], chosen: Sequence[int], normal: int = 0) -> Formula:
        """Return the sum of the readable ones of some summands; see `formula`."""
        parts = [self.formula(place, chosen, normal) for place in places]
        known = [formula for formula in parts if formula is not None]
        text = " + ".join(formula.text for formula in known)
        return Formula(text, sum((formula.root for formula in known), ZERO))

    def expression(self, place: Place, chosen: Sequence[int]) -> Expr:
        """Return what a summand is for certain arguments in UFL, readable or not."""
        known = {
            part: ufl.as_tensor(values.tolist()) if values.shape else float(values)
            for part, values in self._arguments(chosen).items()
        }
        return ufl.replace(self.terms[place[0]][place[1]], known)

    def _arguments(self, chosen: Sequence[int]) -> dict[Expr, Any]:
        """What stands for the arguments and for their slopes, as arrays."""
        known: dict[Expr, Any] = {}
        for argument, code in zip(self.form.arguments(), chosen, strict=True):
            shape, slope = argument.ufl_shape, ufl.grad(argument)
            size, dim = int(np.prod(shape)), slope.ufl_shape[-1]
            values = np.zeros((size, dim + 1))
            values[code % size, code // size] = 1.0
            known[argument] = values[:, 0].reshape(shape)
            known[slope] = values[:, 1:].reshape(slope.ufl_shape)
        return known

    def _read(
        self, place: Place, chosen: Sequence[int], normal: int, functions: bool
    ) -> Formula | None:
        domain = self.form.ufl_domain()
        dim = len(ufl.SpatialCoordinate(domain))
        known = more_coordinates(dim, self.form.coefficients() if functions else [])
        known[ufl.FacetNormal(domain)] = np.eye(dim)[normal]
        known |= self._arguments(chosen)
        return read(self.terms[place[0]][place[1]], known)

    def once(self, key: Hashable, find: Callable[[], T]) -> T:
        """Return what is known of forms of this kind under a key, or found now."""
        if key not in self._known:
            self._known[key] = find()
        found: T = self._known[key]
        return found


def is_linear_in_normals(term: Expr, domain: Any, arguments: Sequence[Expr] = ()) -> bool:
    """Return whether a lowered term is a sum of components of the normal, each with a factor.

    Args:
        term: The term.
        domain: The mesh.
        arguments: The arguments of a form, in which the term is linear.
    """
    normal = ufl.FacetNormal(domain)
    ufl_domain = ufl.domain.extract_unique_domain(normal)
    space = ufl.FunctionSpace(ufl_domain, ufl_domain.ufl_coordinate_element())
    stands_for_it = ufl.Argument(space, len(arguments))
    try:
        replaced = ufl.replace(term, {normal: stands_for_it})
        check_integrand_arity(replaced, (*arguments, stands_for_it), False)
    except (ArityMismatch, ValueError):  # UFL trips over its own message, see `check_linear`
        return False
    return True
