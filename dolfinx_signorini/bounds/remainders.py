"""How far data are from the polynomials that stand for the data in a bound, and what that costs.

The proof is in docs/accuracy.md.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinx_signorini.bounds.frames import Frames
from dolfinx_signorini.bounds.strong_form import Scalar
from dolfinx_signorini.bounds.transport import transported

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Marks = npt.NDArray[np.bool_]
Bounds = Array | float  # on cells or facets; a number stands for all of them


@dataclass(frozen=True)
class Remainders:
    """Bounds of what data have beside the polynomials that stand for them in `EnergyTerms`.

    Nothing is missed of data that are polynomials, and all bounds are 0:

        bound = energy_bound(problem, terms, Remainders(load=missed, load_mean=mean))

    Attributes:
        load, load_mean: The L2 norm on each cell, and the absolute value of the mean.
        reaction, diffusion, inverse: The largest value on each cell; of matrices the spectral norm.
            The last one is about the inverse of the diffusion.
        inverse_entries: The polynomials for the inverse of the diffusion, as `EnergyTerms.entries`
            has those of the diffusion; () for a constant diffusion.
        least_reaction: The smallest reaction on each cell; None for the polynomial's at points.
        least_diffusion, largest_diffusion: The same for eigenvalues; None for a constant diffusion.
        flux, flux_mean: As for the load, on the facets of the frames, shape (cells, d + 1).
        obstacle, dirichlet: What the interpolation of degree `cones.MORE` above that of the
            solution misses of the values and of their derivatives from end to end of a facet,
            shape (2, cells, d + 1); None where that is not known.
        sampled: What is known at points only, in words.
    """

    load: Bounds = 0.0
    load_mean: Bounds = 0.0
    reaction: Bounds = 0.0
    diffusion: Bounds = 0.0
    inverse: Bounds = 0.0
    inverse_entries: Sequence[Scalar] = ()
    least_reaction: Array | None = None
    least_diffusion: Array | None = None
    largest_diffusion: Array | None = None
    flux: Bounds = 0.0
    flux_mean: Bounds = 0.0
    obstacle: Array | None = None
    dirichlet: Array | None = None
    sampled: tuple[str, ...] = ()


NOTHING = Remainders()


def friedrichs(
    comm: MPI.Comm, frames: Frames, exits: Marks, ends: Marks, lowest: Array, reaction: Array
) -> float:
    """Return C with ||e|| <= C ||e||_a on all cells but the ends, for e = 0 on the exits.

    With a field y of divergence 1 on these cells, and without flux through the boundary but for the
    exits, the square of ||e|| is the integral of -2 e y.grad e, minus that of e^2 div y over the
    ends. Infinite where no such field is found. The call is collective.

    Args:
        comm: The communicator.
        frames: The cells.
        exits: The facets with Dirichlet data, shape (cells, d + 1).
        ends: The cells with enough reaction.
        lowest: The smallest eigenvalue of the diffusion on each cell.
        reaction: The smallest reaction on each cell.
    """
    wanted = np.where(ends, 0.0, frames.volumes)
    fluxes, found = transported(comm, frames.facets, wanted, exits, ends)
    if not found:
        return math.inf
    sums = fluxes.sum(axis=1)
    # The field is linear in a cell, so that its largest values are at the vertices.
    at = frames.corners * sums[:, None, None]
    at -= np.einsum("nk,nka->na", fluxes, frames.corners)[:, None]
    size = np.linalg.norm(at, axis=2).max(axis=1, initial=0.0)
    size /= frames.dimension * frames.volumes * np.sqrt(lowest)

    def largest(values: Array) -> float:
        return float(comm.allreduce(float(values.max(initial=0.0)), op=MPI.MAX))

    inner, c = largest(size[~ends]), reaction[ends]
    on_ends = largest(size[ends] / np.sqrt(c)), largest(-sums[ends] / frames.volumes[ends] / c)
    return inner + math.sqrt(inner**2 + 2.0 * on_ends[0] + on_ends[1])
