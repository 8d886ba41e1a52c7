"""Remainders: how far data are from the polynomials in place of the data in a bound.

The proof is in docs/method/bound_in_practice.md.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, Indices
from dolfinx_signorini.base.ranks import highest
from dolfinx_signorini.base.tolerances import ROUNDING
from dolfinx_signorini.bounds.frames import Frames
from dolfinx_signorini.bounds.strong_form import EnergyTerms, FacetPolynomials, Scalar
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem

# By dimension: by how much polynomials that stand for boundary data are of higher degree than the
# solution. In space they belong to elements, in the plane to facets alone.
MORE = {2: 6, 3: 3}
# The same for obstacles in cells. For P3 on the square with 32 cells per side the bound is 1.74
# times the error with 3, 1.81 with 2, 1.98 with 1.
IN_CELLS = {2: 3, 3: 1}

Bounds = Array | float  # on cells or facets; a number stands for all of them


@dataclass(frozen=True)
class Remainders:
    """Bounds of what data have beside the polynomials that stand for them in `EnergyTerms`.

    Nothing is missed of data that are polynomials, and all bounds are 0:

        rest = Remainders(load=missed, load_mean=mean)
        bound = bound_by_flux(Solved(problem, terms, cell_frames(domain), rest))

    Attributes:
        load, load_mean: The L2 norm on each cell, and the largest mean of the product with a
            polynomial of the degree of that in its place, and with values of at most 1.
        reaction, reaction_mean: The same, with polynomials of the degree of the solution.
        diffusion, inverse: The largest spectral norm on each cell; the last one is about the
            inverse of the diffusion.
        inverse_entries: The polynomials for the entries of the inverse of the diffusion, in the
            order of `EnergyTerms.entries`; () for a constant diffusion.
        least_reaction, largest_reaction: The extrema of the reaction on each cell; None for the
            extrema of the polynomial at points.
        least_diffusion, largest_diffusion: The same for eigenvalues of the diffusion.
        thin: The share of each cell where the diffusion may not be the one of the terms, with the
            least and the largest eigenvalue on this share, shape (3, cells); None for no share.
        flux, flux_mean: The norm and the mean on each facet of the frames, shape (cells, d + 1).
        obstacle, dirichlet: What the interpolation of degree `MORE`, or `IN_CELLS`, above that of
            the solution misses of the values, of their derivatives from end to end of a facet, and
            the root mean squares of the latter, shape (3, cells, d + 1); None where that is not
            known.
        obstacle_in_space: Polynomials on contact facets of tetrahedra for the obstacle, and the
            largest difference on each facet, shape (cells, d + 1); None where that is not known.
        obstacles_in_cells: For each obstacle in the domain polynomials on cells, and the largest
            difference on each cell; None where that is not known, () for all of them.
        sampled: What is known at points only, in words.
    """

    load: Bounds = 0.0
    load_mean: Bounds = 0.0
    reaction: Bounds = 0.0
    reaction_mean: Bounds = 0.0
    diffusion: Bounds = 0.0
    inverse: Bounds = 0.0
    inverse_entries: Sequence[Scalar] = ()
    least_reaction: Array | None = None
    largest_reaction: Array | None = None
    least_diffusion: Array | None = None
    largest_diffusion: Array | None = None
    thin: Array | None = None
    flux: Bounds = 0.0
    flux_mean: Bounds = 0.0
    obstacle: Array | None = None
    dirichlet: Array | None = None
    obstacle_in_space: tuple[FacetPolynomials, Array] | None = None
    obstacles_in_cells: Sequence[tuple[fem.Function, Array] | None] = ()
    sampled: tuple[str, ...] = ()

    def some(self, cells: Indices | slice) -> "Remainders":
        """Return what is known in some cells, beside obstacle and Dirichlet data."""
        parts: dict[str, Any] = {}
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray) and name not in ("obstacle", "dirichlet"):
                parts[name] = value[:, cells] if name == "thin" else value[cells]
        return replace(self, **parts)


NOTHING = Remainders()


@dataclass(frozen=True)
class Solved:
    """A solved problem with what is known of it beside its weak forms:

        solved = Solved(problem, EnergyTerms(reaction=1.0, load=f), cell_frames(domain))

    Attributes:
        problem: The solved problem.
        terms: Its strong form, where polynomials may stand for other data.
        frames: The cells of its mesh, or some of them.
        rest: What the data have beside these polynomials.
        change: What is to be added to the solution, with the signs of a lower obstacle, where
            fluxes are compared with the gradient of the sum; None where they are compared with that
            of the solution.
    """

    problem: BoundConstrainedProblem
    terms: EnergyTerms
    frames: Frames
    rest: Remainders = NOTHING
    change: fem.Function | None = None

    def some(self, cells: Indices | slice) -> "Solved":
        """Return what concerns some of the cells."""
        return replace(self, frames=self.frames.some(cells), rest=self.rest.some(cells))

    @property
    def comm(self) -> MPI.Comm:
        """The communicator of the mesh."""
        return self.problem.comm

    @functools.cached_property
    def tiny(self) -> float:
        """Which values of the solution are rounding; collective."""
        return ROUNDING * highest(self.comm, np.abs(self.problem.u.x.array))

    @property
    def degree(self) -> int:
        """The degree of the elements."""
        return int(self.problem.space.element.basix_element.degree)

    @property
    def order(self) -> int:
        """The degree of the function whose flux is compared with others, see `change`."""
        if self.change is None:
            return self.degree
        return int(self.change.function_space.element.basix_element.degree)

    @property
    def dimension(self) -> int:
        """The dimension of the domain."""
        return self.frames.dimension
