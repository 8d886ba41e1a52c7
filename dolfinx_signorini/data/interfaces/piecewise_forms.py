"""Forms with data that jump inside of cells, and measures whose rules follow the data.

Summands f v of loads and c u v of bilinear forms have projections in place of f and c, see
`jumps.integrable`; so have the components of loads on vectors, and what is in front of derivatives:
the diffusion A in grad u . A grad v, and the stiffness of a body.

A measure may leave its rule to the data, which then get as many points as they ask for, and
projections where points do not help:

    dx = ufl.dx(domain, metadata=BY_DATA)

Measures with rules of their own keep these rules, and a problem has the projections beside them if
the problem is posed in a `with data_in_pieces()` block, as in the adaptive loop.

A problem that is solved without projections tells where its diffusion jumps inside of cells, where
no polynomial follows.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import product
from operator import add, is_, mul
from typing import Any

import numpy as np
import ufl
from dolfinx import mesh
from ufl.algorithms import extract_coefficients
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import LocalIndices
from dolfinx_signorini.base.logs import warn_once
from dolfinx_signorini.base.ranks import anywhere
from dolfinx_signorini.data.form_data import choices_in_diffusion, facets_of, is_everywhere
from dolfinx_signorini.data.formulas import Formula, Node
from dolfinx_signorini.data.interfaces.facet_jumps import integrable_on_facets, jumps_in_cells
from dolfinx_signorini.data.interfaces.jumps import integrable
from dolfinx_signorini.data.interfaces.rules import (
    CellMeasure,
    cell_rule,
    facet_rule,
    measures_for,
)
from dolfinx_signorini.data.interfaces.singular_sets import is_singular
from dolfinx_signorini.data.readings import Place, Reading

BY_DATA = {"quadrature_rule": "data"}  # the metadata of measures whose rules follow the data
# Whether a problem that is posed now integrates data by pieces.
IN_PIECES: ContextVar[bool] = ContextVar("data in pieces", default=False)


@contextmanager
def data_in_pieces() -> Iterator[None]:
    """Let problems that are posed meanwhile integrate data that jump inside of cells by pieces."""
    token = IN_PIECES.set(True)
    try:
        yield
    finally:
        IN_PIECES.reset(token)


def by_data(form: ufl.Form, pieces: bool = False) -> ufl.Form:
    """Return a form with rules, and projections, for the integrals whose rules follow the data.

    Args:
        form: A linear or bilinear form; the call is collective.
        pieces: Whether other integrals have projections, too, of data that jump inside of cells or
            facets. Their rules are the user's where the data are smooth.

    Returns:
        The same form where all measures have rules of their own; the form itself where nothing
        is changed.
    """
    if not pieces and all(integral.metadata() != BY_DATA for integral in form.integrals()):
        return form
    reading, found = Reading(form), list[ufl.Integral]()
    every = [_Integral(reading, number) for number in range(len(form.integrals()))]
    in_cells = [own for own in every if own.given.integral_type() == "cell"]
    products = [(own, own.product) for own in in_cells if own.open]
    known = [(own, product) for own, product in products if product is not None]
    space, divided = form.arguments()[0].ufl_function_space(), len(known) == len(in_cells)
    degree = int(space.element.basix_element.degree)
    measures = measures_for(space.mesh, [product for _, product in known], degree, divided)
    chosen = {own: dx for (own, _), dx in zip(known, measures, strict=True)}
    for own in every:
        if own.open:
            found += own.by_data(chosen.get(own))
        else:
            found += own.apart() if pieces else [own.given]
    same = len(found) == len(every) and all(map(is_, found, form.integrals()))
    return form if same else ufl.Form(found)


@dataclass(frozen=True)
class _Summand:
    """A readable summand of an integrand: formulas times polynomials.

    Attributes:
        formulas: The formulas.
        degree: The degree of the polynomials.
        made: Returns the summand with expressions in place of the formulas.
    """

    formulas: Sequence[Formula]
    degree: int
    made: Callable[[Sequence[Expr]], Expr]

    @property
    def distinct(self) -> dict[Node, Formula]:
        """Each of the formulas once, by their trees."""
        return {formula.root: formula for formula in self.formulas}


class _Integral:
    """An integral of a form, with projections in place of the data that rules do not integrate.

    Args:
        reading: The reading of the form.
        number: The number of the integral.

    Attributes:
        given: The integral as it was given.
        open: Whether its rule follows the data.
    """

    def __init__(self, reading: Reading, number: int):
        self._reading, self._places = reading, reading.places(number)
        self.given: ufl.Integral = reading.form.integrals()[number]
        self.open = self.given.metadata() == BY_DATA
        self._kind = self.given.integral_type()
        self._arguments = reading.form.arguments()
        space = self._arguments[0].ufl_function_space()
        self._domain, self._degree = space.mesh, int(space.element.basix_element.degree)

    @property
    def product(self) -> tuple[list[Formula], int] | None:
        """The formulas of an integral over all cells, and the degree of what they multiply.

        None where something is not readable.
        """
        summands = [summand for summand in self._summands.values() if summand is not None]
        if len(summands) < len(self._places) or not is_everywhere(self.given):
            return None
        distinct = {root: f for summand in summands for root, f in summand.distinct.items()}
        return [*distinct.values()], max(summand.degree for summand in summands)

    def by_data(self, dx: CellMeasure | None) -> list[ufl.Integral]:
        """Return the integral with the rules that its data choose; collective.

        Args:
            dx: The measure of an integral over all cells; None for the rule of all data.
        """
        integrand = self.given.integrand()
        if self.changed:
            integrand = reduce(add, [self.changed.get(p, self._term(p)) for p in self._places])
        if dx is not None:
            return list((integrand * dx).integrals())
        rule = facet_rule(self._domain)
        if self._kind == "cell":
            rule = cell_rule(self._domain, self._needed)
        return [self.given.reconstruct(integrand=integrand, metadata=rule.metadata)]

    def apart(self) -> list[ufl.Integral]:
        """Return the integral of projections beside that of the user; collective."""
        if not self.changed:
            return [self.given]
        kept = [self._term(place) for place in self._places if place not in self.changed]
        parts = [(kept, self.given.metadata()), ([*self.changed.values()], self._rule())]
        return [
            self.given.reconstruct(integrand=reduce(add, terms), metadata=metadata)
            for terms, metadata in parts
            if terms
        ]

    @cached_property
    def changed(self) -> dict[Place, Expr]:
        """The summands whose data have projections in some cell or facet; collective."""
        result = {}
        for place, summand in self._summands.items():
            if summand is None or not any(map(is_singular, summand.distinct.values())):
                continue
            found = {
                root: self._integrable(formula, summand.degree)
                for root, formula in summand.distinct.items()
            }
            if any(map(extract_coefficients, found.values())):  # formulas themselves have none
                result[place] = summand.made([found[each.root] for each in summand.formulas])
        return result

    def _integrable(self, formula: Formula, degree: int) -> Expr:
        if self._kind == "cell":
            return integrable(formula, self._domain, degree)
        return integrable_on_facets(formula, self._domain, self._facets, degree)

    @cached_property
    def _facets(self) -> LocalIndices:
        return facets_of(self._domain, self.given)

    @cached_property
    def _summands(self) -> dict[Place, _Summand | None]:
        """The summands, as far as they are readable."""
        on = self._kind in ("cell", "exterior_facet")
        return {place: self._summand(place) if on else None for place in self._places}

    def _summand(self, place: Place) -> _Summand | None:
        orders, vectors = self._reading.orders(place), self._arguments[0].ufl_shape != ()
        if orders == {0} and not (vectors and len(self._arguments) > 1):
            return self._of_values(place)
        if orders == {1} and len(self._arguments) > 1 and self._kind == "cell":
            return self._of_slopes(place)
        return None

    def _of_values(self, place: Place) -> _Summand | None:
        """A summand with factors of components of v, and of the normal, or of u v."""
        v, *others = self._arguments
        size = v.ufl_shape[0] if v.ufl_shape else 1
        has_normals, n = self._reading.has_normals(place), ufl.FacetNormal(self._domain)
        if has_normals and not self._reading.is_linear_in_normals(place):
            return None
        every = list(product(range(len(n) if has_normals else 1), range(size)))
        read = self._reading.formula
        formulas = _all([read(place, [c] * (1 + len(others)), k) for k, c in every])

        def made(factors: Sequence[Expr]) -> Expr:
            total: Expr = ufl.as_ufl(0.0)
            for (k, c), factor in zip(every, factors, strict=True):
                value = factor * n[k] if has_normals else factor
                total += reduce(mul, others, value * (v[c] if v.ufl_shape else v))
            return total

        degree = (1 + len(others)) * self._degree
        return _Summand(formulas, degree, made) if formulas else None

    def _of_slopes(self, place: Place) -> _Summand | None:
        """A summand grad u . A grad v, where A is a matrix, or the stiffness of a body."""
        v, u = map(ufl.grad, self._arguments)
        size, places = math.prod(v.ufl_shape[:-1]), list(np.ndindex(v.ufl_shape))
        codes = [sum(k[:-1]) + size * (1 + k[-1]) for k in places]
        read = self._reading.formula
        formulas = _all([read(place, both) for both in product(codes, codes)])

        def made(factors: Sequence[Expr]) -> Expr:
            both = zip(product(places, places), factors, strict=True)
            return reduce(add, [A * u[j] * v[i] for (i, j), A in both])

        return _Summand(formulas, 2 * (self._degree - 1), made) if formulas else None

    def _term(self, place: Place) -> Expr:
        return self._reading.terms[place[0]][place[1]]

    @property
    def _needed(self) -> int:
        """The degree of projections, which have the degree of the arguments, with the arguments."""
        return 2 * len(self._arguments) * self._degree

    def _rule(self) -> dict[str, Any]:
        """A rule for projections: the user's if fine."""
        given: dict[str, Any] = self.given.metadata()
        in_cells, named = self._kind == "cell", given.get("quadrature_degree")
        rule = cell_rule(self._domain, self._needed) if in_cells else facet_rule(self._domain)
        fine = isinstance(named, int) and named >= max(self._needed, rule.degree)
        return given if fine else rule.metadata


def _all(read: Sequence[Formula | None]) -> list[Formula]:
    """The formulas that were read; none where one of them is not readable."""
    formulas = [formula for formula in read if formula is not None]
    return formulas if len(formulas) == len(read) else []


def warn_of_cut_coefficients(a: ufl.Form, domain: mesh.Mesh) -> None:
    """Warn, once for each conditional, where the diffusion chooses inside of cells.

    Conditionals that are unreadable, such as those of finite element functions, are passed over.

    Args:
        a: A bilinear form.
        domain: The mesh of the form; the call is collective.
    """
    if domain.topology.cell_name() not in ("triangle", "tetrahedron"):
        return
    for choice, formula, corners in choices_in_diffusion(a):
        if anywhere(domain.comm, jumps_in_cells(formula, corners)):
            warn_once(
                f"a: the coefficient {choice} chooses inside of cells, which leaves an error of "
                "order h^(1/2) in the energy norm for any degree; let facets follow the jump, and "
                'give the coefficient on cells: the page "Coefficients that jump" '
                "(docs/howto/jumps.md)"
            )
