"""The energy of the difference from a solution to a feasible function."""

import numpy as np
from dolfinx import fem

from dolfinx_signorini.base.arrays import Array
from dolfinx_signorini.bounds.boundary_facets import facet_points
from dolfinx_signorini.bounds.cell_scales import CellScales, dots
from dolfinx_signorini.bounds.cell_values import BEST, cell_values, quadrature_degree
from dolfinx_signorini.bounds.feasible import Feasible
from dolfinx_signorini.bounds.frames import on_frames
from dolfinx_signorini.bounds.remainders import Remainders, Solved


def lifted_energy(solved: Solved, change: fem.Function) -> Array:
    """Return the energy of v - u_h in each cell, without cones and Robin conditions.

    Args:
        solved: The problem; the call is collective.
        change: The difference v - u_h.

    Returns:
        The energies of the gradient and of the reaction, shape (cells, 2).
    """
    space, frames, d = change.function_space, solved.frames, solved.dimension
    cells = np.flatnonzero(change.x.array[space.dofmap.list[frames.cells]].any(axis=1))
    result, degree = np.zeros((len(frames.cells), 2)), space.element.basix_element.degree
    if not solved.comm.allreduce(len(cells)):
        return result
    some, quadrature = solved.some(cells), quadrature_degree(solved, solved.degree)[0]
    every = cell_values(some, min(max(quadrature, 2 * degree), BEST[d]))
    for batch, values in every.batches():
        rest, points = values.rest, values.frames.points(values.points)
        (w,), (slopes,) = points.values(change), points.gradients(change)
        gradient = np.stack(slopes, axis=2)
        energy = values.integrals(dots(gradient, values.diffusion.times(gradient)))
        energy += rest.diffusion * values.integrals(dots(gradient, gradient))
        if rest.thin is not None:
            energy += _strip(rest) * values.scales.volumes * values.largest(gradient, degree) ** 2
        reaction = values.scales.largest_reaction * values.integrals(w**2)
        result[cells[batch]] = np.column_stack((energy, reaction))
    return result


def _strip(rest: Remainders) -> Array | float:
    """The share of each cell where A may be larger, times the largest eigenvalue of A."""
    return 0.0 if rest.thin is None else rest.thin[0] * rest.thin[2]


def cone_norms(solved: Solved, scales: CellScales, near: Feasible) -> Array:
    """Return the energy norm of the cones in v - u_h on each cell.

    Args:
        solved: The problem.
        scales: What bounds functions in the cells.
        near: The difference.
    """
    norms = np.zeros(len(scales.volumes))
    if near.cones is not None:
        strip = np.broadcast_to(_strip(solved.rest), norms.shape)
        norms += near.cones.norms(scales.upper, scales.largest_reaction, strip)
    return norms


def robin_energy(solved: Solved, w: fem.Function) -> Array:
    """Return the integrals of k w^2, for the Robin coefficient k, over the facets of each cell.

    Args:
        solved: The problem; the call is collective.
        w: The function.
    """
    result = np.zeros(len(solved.frames.order))
    for data, facets in solved.terms.robin:
        marked = on_frames(solved.frames, [facets])
        degree = 2 * w.function_space.element.basix_element.degree + 4
        points = facet_points(solved.frames, marked, degree)
        square = points.points.values(w)[0] ** 2
        sums = points.values(data) * square @ points.weights * points.sizes
        result += np.bincount(points.cells, sums, len(result))
    return result
