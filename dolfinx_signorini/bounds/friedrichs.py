"""The constant of Friedrichs: how large functions are whose gradients are known.

A constant C has ||e|| <= C ||A^(1/2) grad e|| for all functions e that vanish on the Dirichlet
facets. Two ways lead to such a constant:

- A direction in which the domain may be left through Dirichlet facets only. On each segment inside
  of the domain in this direction, e vanishes at one end, and 2/pi times the length of the segment
  is a constant; 1/pi times where e vanishes at both ends.
- A field y of divergence 1 without flux through other boundary facets. The integral of e^2 is that
  of e^2 div y, which is the integral of -2 e y.grad e, and C = 2 max |A^(-1/2) y|.

Source: Repin, A Posteriori Estimates for Partial Differential Equations (2008), Section 1.4.
"""

import math
from itertools import product

import numpy as np
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.base.tolerances import SOLVED
from dolfinx_signorini.bounds.condensation import DIRICHLET, INTERIOR
from dolfinx_signorini.bounds.frames import Frames
from dolfinx_signorini.bounds.transport import transported

ANGLES = 48  # of directions in the plane that are tried


def friedrichs(
    comm: MPI.Comm, frames: Frames, kinds: Indices, ends: Mask, lowest: Array, reaction: Array
) -> float:
    """Return C with ||e|| <= C ||e||_a on all cells but some with enough reaction.

    Args:
        comm: The communicator; the call is collective.
        frames: The cells.
        kinds: The kinds of the facets, shape (cells, d + 1).
        ends: The cells with enough reaction.
        lowest: The smallest eigenvalue of the diffusion on each cell.
        reaction: The smallest reaction on each cell.

    Returns:
        The constant; infinity where none is found.
    """
    least = comm.allreduce(float(lowest.min(initial=np.inf)), op=MPI.MIN)
    constant = _by_directions(comm, frames, kinds) / math.sqrt(least)
    if math.isfinite(constant):
        return constant
    return _by_a_field(comm, frames, kinds == DIRICHLET, ends, lowest, reaction)


def _by_directions(comm: MPI.Comm, frames: Frames, kinds: Indices) -> float:
    """The constant of the best direction for A = 1."""
    d = frames.dimension
    if d == 2:
        angle = 2.0 * math.pi * np.arange(ANGLES) / ANGLES
        ways = np.column_stack((np.cos(angle), np.sin(angle)))
    else:
        ways = np.array([way for way in product((-1.0, 0.0, 1.0), repeat=d) if any(way)])
        ways /= np.linalg.norm(ways, axis=1)[:, None]
    places = frames.corners @ ways.T
    extent = np.stack((places, -places)).max(axis=(1, 2), initial=-np.inf)
    free = (kinds != INTERIOR) & (kinds != DIRICHLET)
    normals = -frames.gradients[free]
    slope = normals @ ways.T / np.linalg.norm(normals, axis=1)[:, None]
    leaves = np.stack((slope, -slope)).max(axis=1, initial=-np.inf) > SOLVED
    width = np.max(comm.allgather(extent), axis=0).sum(axis=0)
    forth, back = np.any(comm.allgather(leaves), axis=0)
    constants = np.where(forth, np.inf, np.where(back, 2.0, 1.0) / math.pi * width)
    return float(constants.min())


def _by_a_field(
    comm: MPI.Comm, frames: Frames, exits: Mask, ends: Mask, lowest: Array, reaction: Array
) -> float:
    """The constant by a field of divergence 1, but on the ends, where e^2 div y is left."""
    wanted, sinks = np.where(ends, 0.0, frames.volumes), np.where(ends, np.inf, 0.0)
    fluxes, found = transported(comm, frames, lowest, wanted, exits, sinks)
    if not found:
        return math.inf
    sums = fluxes.sum(axis=1)
    # The field is linear in a cell, so that its largest values are at the vertices.
    at = frames.corners * sums[:, None, None]
    at -= np.einsum("nk,nka->na", fluxes, frames.corners)[:, None]
    size = np.linalg.norm(at, axis=2).max(axis=1, initial=0.0)
    size /= frames.dimension * frames.volumes * np.sqrt(lowest)

    inner, c = highest(comm, size[~ends]), reaction[ends]
    slope = highest(comm, size[ends] / np.sqrt(c))
    sink = highest(comm, -sums[ends] / frames.volumes[ends] / c)
    return inner + math.sqrt(inner**2 + 2.0 * slope + sink)
