"""Functions on facets of a plane domain, each extended to the cell of the facet.

A function that vanishes at the ends of a facet is extended to the opposite vertex as a function
that is homogeneous of degree 1 about this vertex. The extension vanishes on the other two facets.
"""

from dataclasses import dataclass

import basix
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinx_signorini.bounds.boundary_facets import FacetPoints, on_frames
from dolfinx_signorini.bounds.condensation import CLOSED, OPEN
from dolfinx_signorini.bounds.frames import Frames
from dolfinx_signorini.bounds.reference_flux import CELLS, barycentric, lowest
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.problem import SignoriniProblem

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Marks = npt.NDArray[np.bool_]

MORE = 6  # by how much polynomials that stand for data are of higher degree than the solution


@dataclass(frozen=True)
class Cones:
    """Functions on facets in the plane, each with its extension to the cell of the facet.

    The extensions are added up at points:

        values, gradients = cones.at(points)

    Attributes:
        frames: The cells.
        cells, facets: The facets, shape (n,).
        coefficients: Legendre coefficients of the functions, shape (n, polynomials).
        positive: Whether only the positive part of a function counts.
    """

    frames: Frames
    cells: Indices
    facets: Indices
    coefficients: Array
    positive: Marks

    def at(self, points: Array) -> tuple[Array, Array]:
        """Return the sum of the extensions, with its gradient, at points of all cells.

        Args:
            points: Points of the reference cell of the mesh.
        """
        count, d = len(self.frames.order), self.frames.dimension
        values, gradients = np.zeros((count, len(points))), np.zeros((count, len(points), d))
        ends = np.array([[j for j in range(d + 1) if j != k] for k in range(d + 1)])[self.facets]
        order = np.take_along_axis(self.frames.order[self.cells], ends, axis=1)
        a, b = barycentric(points).T[order].transpose(1, 0, 2)
        t = b / np.where(a + b > 0.0, a + b, 1.0)
        legendre = np.polynomial.legendre
        scale = np.sqrt(2.0 * np.arange(self.coefficients.shape[1]) + 1.0)
        series = (self.coefficients * scale).T
        w = legendre.legval(2.0 * t.T - 1.0, series[:, None], tensor=False).T
        slope = (
            2.0 * legendre.legval(2.0 * t.T - 1.0, legendre.legder(series)[:, None], tensor=False).T
        )
        kept = (w > 0.0) | ~self.positive[:, None]
        w, slope = np.where(kept, w, 0.0), np.where(kept, slope, 0.0)
        own = np.take_along_axis(self.frames.gradients[self.cells], ends[:, :, None], axis=1)
        both = own.sum(axis=1)[:, None]
        np.add.at(values, self.cells, (a + b) * w)
        part = both * w[..., None] + slope[..., None] * (own[:, 1][:, None] - t[..., None] * both)
        np.add.at(gradients, self.cells, part)
        return values, gradients


def lattice(problem: SignoriniProblem, frames: Frames, marked: Marks, degree: int) -> FacetPoints:
    """Return points of facets, the corners among them, that tell a polynomial of a degree.

    Args:
        problem: The problem.
        frames: The cells of its mesh.
        marked: The facets, shape (cells, d + 1).
        degree: The degree.
    """
    d = frames.dimension - 1
    kind, method = basix.LatticeType.gll, basix.LatticeSimplexMethod.isaac
    points = np.asarray(basix.create_lattice(CELLS[d], degree, kind, True, method))
    none = np.zeros(len(points))
    cells, facets = np.nonzero(marked)
    return FacetPoints(problem.space.mesh, frames, cells, facets, points, none)


def fitted(points: FacetPoints, values: Array, degree: int) -> Array:
    """Return the coefficients of the polynomials on facets with given values at a lattice.

    Args:
        points: The lattice.
        values: Shape (facets, points).
        degree: The degree of the polynomials.
    """
    table = points.polynomials(degree).transpose(0, 2, 1)
    return np.asarray(np.linalg.solve(table, values[..., None])[..., 0])


def data_defects(
    problem: SignoriniProblem, terms: EnergyTerms, frames: Frames, u: Array
) -> list[tuple[FacetPoints, Array]]:
    """Return Dirichlet data minus the solution at points of the facets with data.

    Args:
        problem: The problem; the call is collective.
        terms: Its strong form.
        frames: The cells of its mesh.
        u: The solution at the dofs of this rank, with the signs of a lower obstacle.
    """
    order = problem.space.element.basix_element.degree + MORE
    result = []
    for data, facets in terms.dirichlet:
        if data is not None:
            marked = on_frames(problem.space.mesh, frames, [facets])
            points = lattice(problem, frames, marked, order)
            value = problem.sign * points.values(data)
            result.append((points, value - points.function(problem.space, u)))
    return result


def loose_ends(comm: MPI.Comm, defects: list[tuple[FacetPoints, Array]], tiny: float) -> str:
    """Return why a solution cannot be made feasible on facets alone; "" where it can.

    Args:
        comm: The communicator; the call is collective.
        defects: Lattices with what the solution lacks there, for a plane domain.
        tiny: Differences that are rounding.
    """
    loose = False
    for points, values in defects:
        ends = np.abs(points.reference[:, 0] - 0.5) > 0.5 - 1e-9
        loose |= bool((np.abs(values[:, ends]) > tiny).any())
    if comm.allreduce(loose, op=MPI.LOR):
        return "Dirichlet data or the obstacle are not those of the problem at a vertex"
    return ""


def cones_on(
    frames: Frames, defects: list[tuple[FacetPoints, Array]], kinds: Indices, order: int
) -> Cones:
    """Return what is to be added on facets in the plane, with its extensions.

    Args:
        frames: The cells.
        defects: Lattices with values there; only positive parts count on contact facets
            that are not closed.
        kinds: The kinds of the facets of cells.
        order: The degree that the lattices have been made for.
    """
    cells = np.concatenate([points.cells for points, _ in defects])
    facets = np.concatenate([points.facets for points, _ in defects])
    series = np.concatenate([fitted(points, values, order) for points, values in defects])
    positive = (kinds[cells, facets] >= OPEN) & (kinds[cells, facets] != CLOSED)
    high = -lowest(1, order, -series)
    used = np.where(positive, high > 0.0, np.abs(series).max(axis=1, initial=0.0) > 0.0)
    return Cones(frames, cells[used], facets[used], series[used], positive[used])
