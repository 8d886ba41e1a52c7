"""The diffusion of a scene as a bound needs it: polynomials, and bounds of what these miss.

Where the diffusion jumps, the polynomials follow one side in each cell, and the other side is what
the share of the cell may have where the formula chooses otherwise, see `choices`.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from dolfinx import mesh
from mpi4py import MPI
from ufl import SpatialCoordinate, as_matrix
from ufl.core.expr import Expr

from dolfinx_signorini.bounds.remainders import Remainders
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.scenes.cell_polynomials import cell_function, is_polynomial
from dolfinx_signorini.scenes.choices import Decided, decided
from dolfinx_signorini.scenes.fits import followed
from dolfinx_signorini.scenes.formulas import Formula
from dolfinx_signorini.scenes.matrices import eigenvalues, inverse_entries
from dolfinx_signorini.scenes.scene import Scene

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

DEGREES = {2: 3, 3: 2}  # of the polynomials, by dimension
ROUGH = 0.3  # of the diffusion: what polynomials may miss


def with_known_diffusion(
    terms: EnergyTerms, scene: Scene, domain: mesh.Mesh, corners: Array
) -> tuple[EnergyTerms, Remainders]:
    """Return the strong form with polynomials in place of the diffusion, and what these miss.

    Args:
        terms: The strong form.
        scene: The scene.
        domain: The mesh; the call is collective.
        corners: The vertices of the cells of this rank, shape (cells, d + 1, d).

    Returns:
        The strong form as it is where the diffusion has no good enclosure.
    """
    entries = [entry for row in scene.diffusion for entry in row]
    if all(entry.constant is not None for entry in entries):
        return terms, Remainders()
    parts = decided(entries, corners)
    data, missed = _polynomials(domain, corners, entries, [(p.cells, p.formulas) for p in parts])
    inverses, inverse_missed = _polynomials(
        domain,
        corners,
        inverse_entries(entries),
        [(p.cells, inverse_entries(p.formulas)) for p in parts],
    )
    least, largest, thin = _spectra(parts, corners)
    rough = ~(missed < ROUGH * least) | ~np.isfinite(inverse_missed)
    rough |= ~(thin[1] > 0.0) | ~np.isfinite(largest + thin[2])
    if domain.comm.allreduce(bool(rough.any()), op=MPI.LOR):
        return terms, Remainders()  # the notes of a bound tell
    n = len(scene.diffusion)
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
) -> tuple[list[Expr], Array]:
    """Entries, or polynomials in their places, and what the matrix of them misses on each cell.

    Args:
        domain: The mesh.
        corners: The vertices of the cells.
        entries: The formulas.
        parts: Cells with the formulas as they are there.
    """
    data: list[Expr] = []
    missed = np.zeros((len(corners), len(entries)))
    d = domain.topology.dim
    degree = DEGREES[d]
    for k, entry in enumerate(entries):
        if is_polynomial(entry, domain, 2 * degree):
            data.append(entry.ufl(SpatialCoordinate(domain)))
            continue
        coefficients = np.zeros((len(corners), math.comb(degree + d, d)))
        for cells, formulas in parts:
            found = followed(formulas[k], corners[cells], degree)
            coefficients[cells], missed[cells, k] = found
        data.append(cell_function(domain, coefficients, degree))
    return data, np.asarray(np.linalg.norm(missed, axis=1))
