"""Polynomials on the cells of a mesh, as functions, and formulas that are such."""

from dolfinx import fem, mesh
from ufl import SpatialCoordinate

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.bounds.reference_flux import polynomials
from dolfinx_signorini.bounds.strong_form import polynomial_degree
from dolfinx_signorini.data.formulas import Formula


def cell_function(domain: mesh.Mesh, coefficients: Array, degree: int) -> fem.Function:
    """Return a function with given polynomials on the cells of this rank.

    Args:
        domain: The mesh; the call is collective.
        coefficients: In terms of `reference_flux.polynomials`, shape (cells, polynomials).
        degree: The degree of the polynomials.
    """
    function = fem.Function(fem.functionspace(domain, ("DG", degree)))
    space = function.function_space
    table = polynomials(domain.topology.dim, degree, space.element.basix_element.points)
    function.x.array[space.dofmap.list[: len(coefficients)]] = coefficients @ table
    function.x.scatter_forward()
    return function


def is_polynomial(formula: Formula | None, domain: mesh.Mesh, most: int | None = None) -> bool:
    """Return whether a formula is a polynomial of at most some degree; None counts as 0.

    Args:
        formula: The formula.
        domain: The mesh.
        most: The degree; None for any.
    """
    if formula is None or formula.constant is not None:
        return True
    degree = polynomial_degree(formula.ufl(SpatialCoordinate(domain)))
    return degree is not None and (most is None or degree <= most)
