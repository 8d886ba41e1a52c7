"""The diffusion as a bound needs it: polynomials, and bounds of what these miss.

Where the diffusion jumps, the polynomials follow one side in each cell, and the other side is what
the share of the cell may have where the formula chooses otherwise, see `choices`.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from dolfinx import fem, mesh
from ufl import SpatialCoordinate, as_matrix
from ufl.core.expr import Expr

from dolfinx_signorini.base.arrays import Array, Indices
from dolfinx_signorini.base.ranks import anywhere, function_with
from dolfinx_signorini.bounds.cell_values import BEST
from dolfinx_signorini.bounds.feasible import known
from dolfinx_signorini.bounds.remainders import Remainders
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.data.approximations import KINKED, followed_in_parts
from dolfinx_signorini.data.branches import Decided, decided
from dolfinx_signorini.data.formulas import Formula
from dolfinx_signorini.data.matrices import eigenvalues, inverse_entries
from dolfinx_signorini.meshes.elements import discontinuous_space
from dolfinx_signorini.meshes.polynomials import polynomials

DEGREES = {2: (3, 6), 3: (2, 4)}  # of the polynomials that are tried, by dimension
# Of cells where discs tell little: 4, as for obstacles, give the same bound in five times the time.
DIVISIONS = 2
ROUGH = 0.3  # of the diffusion: what polynomials may miss


def with_enclosed_diffusion(
    terms: EnergyTerms,
    given: Sequence[Formula | None],
    domain: mesh.Mesh,
    corners: Array,
    order: int,
) -> tuple[EnergyTerms, Remainders]:
    """Return the strong form with polynomials in place of the diffusion, and what these miss.

    Args:
        terms: The strong form.
        given: The entries of the diffusion, row by row; None for one that is no formula.
        domain: The mesh; the call is collective.
        corners: The vertices of the cells of this rank, shape (cells, d + 1, d).
        order: The degree of the solution.

    Returns:
        The strong form as it is where the diffusion is constant, or has no good enclosure.
    """
    entries = [entry for entry in given if entry is not None]
    if len(entries) < len(given):
        return terms, Remainders()
    if all(entry.constant is not None for entry in entries):
        least, _ = eigenvalues(entries, corners)
        return terms, Remainders(least_diffusion=np.maximum(least, 0.0))  # negative: refused later
    parts = decided(entries, corners)
    least, largest, thin = _spectra(parts, corners)
    others = inverse_entries(entries)
    own = [(part.cells, part.formulas) for part in parts]
    inverse = [(part.cells, inverse_entries(part.formulas)) for part in parts]
    d = domain.topology.dim
    first, last = DEGREES[d]
    for degree in (first, min(last, (BEST[d] + 2 - 2 * order) // 3)):
        data, missed = _polynomials(domain, corners, entries, own, degree)
        inverses, inverse_missed = _polynomials(domain, corners, others, inverse, degree)
        far = (missed > KINKED * least) | (inverse_missed * least > KINKED)
        if not anywhere(domain.comm, far):
            break
    rough = ~(missed < ROUGH * least) | ~np.isfinite(inverse_missed)
    rough |= ~(thin[1] > 0.0) | ~np.isfinite(largest + thin[2])
    if anywhere(domain.comm, rough):
        return terms, Remainders()  # the notes of a bound tell
    n = math.isqrt(len(entries))
    matrix = data[0] if n == 1 else as_matrix([data[n * i : n * i + n] for i in range(n)])
    return replace(terms, diffusion=matrix), Remainders(
        diffusion=missed,
        inverse=inverse_missed,
        inverse_entries=tuple(inverses),
        least_diffusion=np.minimum(least, thin[1]),
        largest_diffusion=largest,
        thin=thin,
    )


def _spectra(parts: list[Decided], corners: Array) -> tuple[Array, Array, Array]:
    """The extreme eigenvalues of the diffusion on cells, and see `Remainders.thin`."""
    count = len(corners)
    least, largest = np.zeros(count), np.zeros(count)
    thin = np.array([[0.0], [np.inf], [0.0]]) * np.ones(count)
    for part in parts:
        cells, open_ = part.cells, part.cells[part.shares > 0.0]
        least[cells], largest[cells] = eigenvalues(part.formulas, corners[cells])
        thin[0, cells] = part.shares
        for formulas in part.others:
            low, high = eigenvalues(formulas, corners[open_])
            thin[1, open_] = np.minimum(thin[1, open_], low)
            thin[2, open_] = np.maximum(thin[2, open_], high)
    return least, largest, thin


def _polynomials(
    domain: mesh.Mesh,
    corners: Array,
    entries: Sequence[Formula],
    parts: list[tuple[Indices, list[Formula]]],
    degree: int,
) -> tuple[list[Expr], Array]:
    """Entries, or polynomials in their places, and what the matrix of them misses on each cell.

    The formulas of the entries are given as they are on parts of the cells.
    """
    data: list[Expr] = []
    missed = np.zeros((len(corners), len(entries)))
    d = domain.topology.dim
    for k, entry in enumerate(entries):
        expression = entry.ufl(SpatialCoordinate(domain))
        if known(expression, 2 * DEGREES[d][0]):
            data.append(expression)
            continue
        coefficients = np.zeros((len(corners), math.comb(degree + d, d)))
        for cells, formulas in parts:
            found = followed_in_parts(formulas[k], corners[cells], degree, DIVISIONS)
            coefficients[cells], missed[cells, k] = found
        data.append(cell_function(domain, coefficients, degree))
    return data, np.asarray(np.linalg.norm(missed, axis=1))


def cell_function(domain: mesh.Mesh, coefficients: Array, degree: int) -> fem.Function:
    """Return a function on a mesh with given polynomials on the cells of this rank; collective.

    Args:
        domain: The mesh.
        coefficients: In terms of `reference_flux.polynomials`, shape (cells, polynomials).
        degree: The degree of the polynomials.
    """
    space = discontinuous_space(domain, degree)
    table = polynomials(domain.topology.dim, degree, space.element.basix_element.points)
    return function_with(space, space.dofmap.list[: len(coefficients)], coefficients @ table)
