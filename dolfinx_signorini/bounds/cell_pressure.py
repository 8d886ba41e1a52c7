"""The pressure of an obstacle in the domain, which takes up the residual of a flux in cells.

A pressure pushes away from the obstacle that it belongs to: in a cell with a lower obstacle
f - c u + div y is minus a function that is nowhere negative, as far as possible.

The proof is in docs/method/energy_bound.md.
"""

from dataclasses import replace

import numpy as np

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.ranks import anywhere
from dolfinx_signorini.bounds.cell_scales import CellScales
from dolfinx_signorini.bounds.condensation import DIRICHLET, OPEN, CellData, coefficients
from dolfinx_signorini.bounds.reference_flux import ReferenceFlux
from dolfinx_signorini.bounds.remainders import Solved
from dolfinx_signorini.bounds.transport import HIDDEN, transported
from dolfinx_signorini.meshes.polynomials import lowest


def polynomial_residual(data: CellData, field: Array, reference: ReferenceFlux) -> Array:
    """Return the polynomial f - c u + div y on each cell, in terms of `polynomials`.

    Args:
        data: The cells.
        field: The coefficients of the flux, shape (cells, fields).
        reference: The fields.
    """
    divergence = field[:, reference.fluxes - 1 : reference.given].copy()
    divergence[:, 0] = field[:, : reference.fluxes : reference.per_facet].sum(axis=1)
    return np.asarray((divergence + data.source) / data.sizes[:, :1])


def with_pressure(
    data: CellData, moments: Array, reference: ReferenceFlux
) -> tuple[CellData, Array]:
    """Put the pressure that takes up residuals into the load.

    Let m be minus the residual, in the direction of the pressure. The pressure is the mean of m
    plus the largest share of m - mean(m), 1 at most, with which no Bernstein coefficient is
    negative; 0 if the mean is negative.

    Args:
        data: The cells.
        moments: The moments of a flux on facets.
        reference: The fields.

    Returns:
        The cells, whose source has the pressure and whose divergence is given, and the integrals
        of pressure times gap.
    """
    energy, pressed = np.zeros(len(moments)), np.flatnonzero(data.sides)
    if not len(pressed):
        return data, energy
    some = data.some(pressed)
    side, size = some.sides[:, None], some.sizes[:, 0]
    pressure = _nowhere_negative(free_pressure(some, moments[pressed], reference), reference)
    energy[pressed] = size * (side * pressure * some.rises).sum(axis=1)
    source, strength = data.source.copy(), data.strength.copy()
    source[pressed] += side * pressure * size[:, None]
    strength[pressed] = 0.0
    return replace(data, source=source, strength=strength), np.maximum(energy, 0.0)


def free_pressure(data: CellData, moments: Array, reference: ReferenceFlux) -> Array:
    """Return the pressure of any sign that takes up all of the residual of the best field.

    Args:
        data: Cells with a pressure.
        moments: The moments of a flux on facets.
        reference: The fields.

    Returns:
        The pressures in terms of `polynomials`, shape (cells, polynomials).
    """
    field = coefficients(data, reference, moments)
    return -data.sides[:, None] * polynomial_residual(data, field, reference)


def _nowhere_negative(wanted: Array, reference: ReferenceFlux) -> Array:
    """The part of polynomials that is nowhere negative, see `with_pressure`."""
    mean, low = wanted[:, 0], lowest(reference.dimension, reference.degree, wanted)
    share = np.divide(mean, mean - low, out=np.ones_like(mean), where=low < 0.0)
    pressure = wanted * np.where(mean > 0.0, share, 0.0)[:, None]
    pressure[:, 0] = np.maximum(mean, 0.0)
    return pressure


def _defects(data: CellData, moments: Array) -> Array:
    """The integrals of f - c u + div y over the cells."""
    return np.asarray(moments[:, :, 0].sum(axis=1) + data.source[:, 0])


def without_pressure(data: CellData, marked: Mask) -> CellData:
    """Return cells of which some have no pressure, and a given divergence.

    Args:
        data: The cells.
        marked: These cells.
    """
    return replace(
        data,
        sides=np.where(marked, 0, data.sides),
        strength=np.where(marked, 0.0, data.strength),
        rises=np.where(marked[:, None], 0.0, data.rises),
    )


def without_defects(
    solved: Solved, scales: CellScales, data: CellData, moments: Array, ends: Mask, least: float
) -> tuple[CellData, Array, str]:
    """Carry away what is left in cells without much reaction.

    Where reactions alone take up all that is left for next to nothing, no flux carries anything.

    Args:
        solved: The problem; the call is collective.
        scales: What bounds functions in the cells.
        data: The cells.
        moments: The moments of a flux on facets.
        ends: The cells that take up what is left by their reaction.
        least: What the flux part of the bound is at least, about.

    Returns:
        The cells, where those that an obstacle would have to pull have no pressure any more, the
        moments, and why something is left, or "".
    """
    changed, reason = moments, ""
    while True:  # cells lose their pressure in each round but the first, or the search ends
        pulled = _pulled(data, changed, ends)
        more = anywhere(solved.comm, pulled)
        if changed is not moments and not more:
            return data, changed, reason
        data = without_pressure(data, pulled)
        changed, reason = _carried(solved, scales, data, moments, ends, least)


def _pulled(data: CellData, moments: Array, ends: Mask) -> Mask:
    """Whether an obstacle would have to pull at a cell, where no reaction takes up the residual."""
    return np.asarray((data.sides * _defects(data, moments) > 0.0) & ~ends)


def _carried(
    solved: Solved, scales: CellScales, data: CellData, moments: Array, ends: Mask, least: float
) -> tuple[Array, str]:
    """The moments that carry away what is left in cells without a pressure; or why not.

    The divergence of a strong reaction is free, and what such a cell leaves is not carried away.
    """
    comm, exits = solved.comm, data.kinds == DIRICHLET
    sinks = np.where(ends, scales.least_reaction * scales.volumes, 0.0)
    sinks[data.sides != 0] = np.inf
    moments, settled = moments.copy(), (data.strength > 0.0) | (data.sides != 0)
    wanted = np.where(settled, 0.0, -_defects(data, moments))
    left, takes = wanted != 0.0, sinks > 0.0
    if not anywhere(comm, left & ~takes):
        taken = comm.allreduce(float((wanted[takes] ** 2 / sinks[takes]).sum()))
        if taken <= (HIDDEN * least) ** 2:
            return moments, ""
    if not anywhere(comm, takes.any() or exits.any()):
        contact = data.kinds >= OPEN
        force = comm.allreduce(float(moments[contact, 0].sum()))
        factor = 1.0 + comm.allreduce(float(wanted.sum())) / (force or np.inf)
        if force <= 0.0 or factor < 0.0:
            return moments, "the contact flux is too small to take up the residual"
        moments[contact] *= factor
        wanted, first = -_defects(data, moments), np.flatnonzero(comm.allgather(len(ends)))[0]
        sinks[:1] = np.where(comm.rank == first, np.inf, 0.0)  # the sum is 0 now
    change, found = transported(comm, solved.frames, scales.lowest, wanted, exits, sinks)
    moments[:, :, 0] += change
    return moments, "" if found else "a residual has no way out of a part without a reaction"
