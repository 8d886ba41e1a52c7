"""The strong form of a problem: read from the forms of the problem, or stated."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, TypeAlias

import numpy as np
import ufl
from dolfinx import fem, mesh
from ufl.algorithms.analysis import extract_coefficients, extract_type
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array, LocalIndices
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.base.kinds import check, data, indices, instance, on_mesh, optional, sequence
from dolfinx_signorini.base.ranks import function_with
from dolfinx_signorini.data.form_data import cells_of, facets_of
from dolfinx_signorini.data.formulas import Formula
from dolfinx_signorini.data.interfaces import rules
from dolfinx_signorini.data.interfaces.singular_sets import margins
from dolfinx_signorini.data.reading import Unreadable, lowered, more_coordinates, roots
from dolfinx_signorini.data.readings import Reading
from dolfinx_signorini.meshes.elements import discontinuous_space
from dolfinx_signorini.meshes.sided_meshes import boundary_facets, facet_count
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.problem.dirichlet import data_of_condition
from dolfinx_signorini.problem.values import Data

Scalar: TypeAlias = Expr | float

STATED = "the bound then needs the strong form, as `EnergyTerms`"


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

    Bounds read the strong form from the forms of a problem. Where a form has something else in the
    place of the data, such as an interpolated load, the terms state the problem itself. The signs
    are the signs of the problem, for lower and for upper obstacles. Boundary facets that are named
    nowhere, and are not contact facets, have flux 0:

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


def strong_form(problem: BoundConstrainedProblem, terms: EnergyTerms | None = None) -> EnergyTerms:
    """Return the strong form of a scalar problem, as stated or read from the forms; collective.

    The arguments u = v = 1 leave the reaction c of the integrand of a(u, v) in cells, and the
    slopes grad u = e_j, grad v = e_i leave the entry A_ij of the diffusion; v = 1 leaves the load
    of L(v). Fluxes on facets with Dirichlet data say nothing, and are left out.

    Args:
        problem: The problem.
        terms: The strong form as it is stated; None to read it.

    Raises:
        InputError: The terms are of another mesh or kind; or a form has other terms or is not
            readable, or Dirichlet data are not those of `dirichlet`, so that data between the nodes
            are not known.
    """
    check(terms=(terms, optional(instance(EnergyTerms, "the terms of the problem, EnergyTerms"))))
    if terms is not None:
        terms.check_on(problem.space.mesh)
        return terms
    known = [data_of_condition(condition) for condition in problem.bcs]
    dirichlet = [(data.value, data.facets) for data in known if data is not None]
    told = len(dirichlet) == len(known)
    require(problem.comm, told, f"have a condition that `dirichlet` has not made; {STATED}", "bcs")
    a, L = _Coefficients(problem.a, "a"), _Coefficients(problem.L, "L")
    slopes = range(1, problem.space.mesh.geometry.dim + 1)
    A = [[a.in_cells([i, j]) for j in slopes] for i in slopes]
    isotropic = all(A[i][j] == (A[0][0] if i == j else 0.0) for i, j in np.ndindex(len(A), len(A)))
    held = [np.empty(0, dtype=np.int32), *(facets for _, facets in dirichlet)]
    return EnergyTerms(
        diffusion=A[0][0] if isotropic else ufl.as_matrix(A),
        reaction=a.in_cells([0, 0]),
        load=L.in_cells([0]),
        neumann=L.on_facets([0], np.concatenate(held)),
        robin=a.on_facets([0, 0], np.concatenate(held)),
        dirichlet=dirichlet,
    )


class _Coefficients:
    """The coefficients that a form has in front of its arguments:

        load = _Coefficients(problem.L, "L").in_cells([0])

    What stands for the arguments is given by the numbers of `Reading`.

    Args:
        form: A linear or bilinear form.
        name: The name of the form.

    Raises:
        InputError: The form has terms that `EnergyTerms` has not, or such as are not readable.
    """

    def __init__(self, form: ufl.Form, name: str):
        self._reading, self._integrals = Reading(form), form.integrals()
        self._domain = form.arguments()[0].ufl_function_space().mesh
        dimension, count = self._domain.geometry.dim, len(form.arguments())
        for i, integral in enumerate(self._integrals):
            kind = integral.integral_type()
            slopes = 2 if kind == "cell" and count == 2 else 0
            every = product(range(dimension + 1), repeat=count)
            others = [chosen for chosen in every if np.count_nonzero(chosen) not in (0, slopes)]
            found = [
                self._reading.formula(place, chosen, normal, functions=True)
                for place, chosen in product(self._reading.places(i), others)
                for normal in range(dimension)
            ]
            good = all(formula is not None and formula.constant == 0.0 for formula in found)
            good &= kind in ("cell", "exterior_facet")
            require(self._domain.comm, good, f"has a term that is not read; {STATED}", name)

    def in_cells(self, chosen: Sequence[int]) -> Scalar:
        """Return the coefficient of the integrals over cells."""
        total: Scalar = 0.0
        for i, integral in enumerate(self._integrals):
            if integral.integral_type() == "cell":
                total += self._indicators[i] * self._value(i, chosen)
        return total

    def on_facets(
        self, chosen: Sequence[int], held: LocalIndices
    ) -> list[tuple[Scalar, LocalIndices]]:
        """Return the coefficients of the integrals over facets, with the facets but for some."""
        return [
            (self._value(i, chosen), np.setdiff1d(facets_of(self._domain, integral), held))
            for i, integral in enumerate(self._integrals)
            if integral.integral_type() == "exterior_facet"
        ]

    @cached_property
    def _indicators(self) -> list[Scalar]:
        """For each integral 1 in the cells that the integral is over, and 0 in others."""
        space, result = discontinuous_space(self._domain, 0), list[Scalar]()
        for integral in self._integrals:
            cells = None
            if integral.integral_type() == "cell":
                cells = cells_of(self._domain, integral)
            inside = (
                1.0 if cells is None else function_with(space, space.dofmap.list[cells, 0], 1.0)
            )
            result.append(inside)
        return result

    def _value(self, integral: int, chosen: Sequence[int]) -> Scalar:
        """The coefficient of an integral: formulas, and what UFL leaves of other summands."""
        total: Scalar = 0.0
        for place in self._reading.places(integral):
            normals = self._reading.has_normals(place)
            formula = None if normals else self._reading.formula(place, chosen)
            if formula is None:
                total += self._reading.expression(place, chosen)
            elif formula.constant is None:
                total += formula.ufl(ufl.SpatialCoordinate(self._domain))
            else:
                total += formula.constant
        return total


def _with_facets(pair: Any) -> str:
    """The kind of pairs of data and facets."""
    if not (isinstance(pair, tuple | list) and len(pair) == 2):
        return "must have pairs of data and facets"
    given = "" if isinstance(pair[0], FacetPolynomials) else optional(data)(pair[0])
    return indices(pair[1]) or given


def polynomial_degree(
    data: "Data | FacetPolynomials | None", degrees: Mapping[Expr, int] | None = None
) -> int | None:
    """Return the degree of a polynomial in the coordinates on each cell, and None for others.

    Args:
        data: A number, a UFL expression or a callable, which is no polynomial; None counts as 0.
        degrees: The degrees of arguments of forms, and of derivatives.
    """
    if data is None or isinstance(data, int | float | np.number):
        return 0
    if isinstance(data, FacetPolynomials):
        return data.degree
    if not isinstance(data, Expr):
        return None
    expression = lowered(data)
    known = dict.fromkeys(extract_type(expression, ufl.FacetNormal), 0)
    for f in extract_coefficients(expression):
        if isinstance(f, fem.Function):
            known[f] = int(f.function_space.element.basix_element.embedded_superdegree)
    known |= degrees or {}
    places = more_coordinates(3, known)
    every = [1, 1, 1, *(known[part] for part, own in places.items() for _ in own.flat)]
    try:
        (root,) = roots(ufl.as_vector([expression]), places)
    except Unreadable:
        return None
    return None if margins(Formula("", root)) else rules.polynomial_degree(root, every)
