"""A feasible function near a solution: nowhere below the obstacle on the contact boundary.

The discrete solution is feasible at its nodes. Where that is not enough,

- degree 2 and an obstacle of degree 2: values at the middles of edges are raised, by the least
  that makes the gap non-negative (in space: that makes its Bernstein coefficients non-negative);
- otherwise in the plane: the solution is set to the obstacle on closed contact facets and to the
  larger of both on the others. From a facet, what is added goes on to the opposite vertex as a
  function that is homogeneous of degree 1 about this vertex. Dirichlet data likewise;
- otherwise in space: the values at vertices are raised by the largest defect next to them.

An upper obstacle is a lower one for -u.
"""

from dataclasses import dataclass

import basix
import numpy as np
import numpy.typing as npt
from dolfinx import fem, la
from mpi4py import MPI

from dolfinx_signorini.accuracy.boundary_facets import FacetPoints, contact_closures, on_frames
from dolfinx_signorini.accuracy.frames import Frames
from dolfinx_signorini.accuracy.patches import CLOSED, OPEN
from dolfinx_signorini.accuracy.reference_flux import CELLS, barycentric, lowest
from dolfinx_signorini.accuracy.strong_form import EnergyTerms, polynomial_degree
from dolfinx_signorini.problem import SignoriniProblem

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Marks = npt.NDArray[np.bool_]

ROUNDING = 1e-11  # of the largest |u|: defects that are none
MORE = 6  # by how much polynomials that stand for data are of higher degree than the solution


@dataclass(frozen=True)
class Cones:
    """Functions on facets in the plane, each with its extension to the cell of the facet.

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


@dataclass(frozen=True)
class Feasible:
    """A feasible function: dofs of the space, and in the plane what is added to them from facets.

    Attributes:
        dofs: At the dofs of this rank, with the signs of a lower obstacle.
        cones: What is added; None for nothing.
        missing: Why there is no feasible function; "" where there is one.
        notes: What is known at points only.
    """

    dofs: Array
    cones: Cones | None
    missing: str = ""
    notes: tuple[str, ...] = ()


def feasible(
    problem: SignoriniProblem, terms: EnergyTerms, frames: Frames, kinds: Indices
) -> Feasible:
    """Return a feasible function near the solution of a problem.

    Args:
        problem: The solved problem; the call is collective.
        terms: Its strong form.
        frames: The cells of its mesh.
        kinds: The kinds of the facets of the cells.
    """
    space, d, comm = problem.space, frames.dimension, problem.comm
    u, degree = _pressed(problem, frames, kinds), space.element.basix_element.degree
    tiny = ROUNDING * max(comm.allgather(float(np.abs(u).max(initial=0.0))))
    order = degree + MORE
    exact = _within(polynomial_degree(problem.obstacle_data), degree)
    notes = () if exact else ("the obstacle is known at points of facets only",)
    defects = _data_defects(problem, terms, frames, u)
    far = comm.allreduce(bool(any((np.abs(w) > tiny).any() for _, w in defects)), op=MPI.LOR)
    if not all(_within(polynomial_degree(data), degree) for data, _ in terms.dirichlet):
        notes += ("Dirichlet data are known at points of facets only",)
    touching = _lattice(problem, frames, kinds >= OPEN, order)
    gap = touching.function(space, u) - problem.sign * touching.values(problem.obstacle_data)
    low = lowest(d - 1, order, _fitted(touching, gap, order))
    if exact and not far and comm.allreduce(bool((low >= -tiny).all()), op=MPI.LAND):
        return Feasible(u, None, notes=notes)
    if exact and not far and degree == 2:
        dofs, missing = _raised_edges(problem, frames, kinds, u, tiny)
        return Feasible(dofs, None, missing, notes)
    if d == 2:
        missing = _loose_ends(comm, defects, tiny)
        cones = _cones(frames, [*defects, (touching, -gap)], kinds, order)
        return Feasible(u, cones, missing, notes)
    if far:
        return Feasible(u, None, "Dirichlet data in space are no polynomials of the degree", notes)
    dofs, missing = _raised_vertices(problem, touching, gap, u, tiny)
    return Feasible(dofs, None, missing, notes)


def _pressed(problem: SignoriniProblem, frames: Frames, kinds: Indices) -> Array:
    """The solution, at the obstacle at all dofs of closed contact facets."""
    _, _, dofs = contact_closures(problem, frames, np.where(kinds == CLOSED, kinds, 0))
    closed = fem.Function(problem.space)
    closed.x.array[dofs] = 1.0
    closed.x.scatter_reverse(la.InsertMode.add)
    closed.x.scatter_forward()
    u, gap = problem.sign * problem.u.x.array, problem.gap.x.array
    return np.asarray(np.where(closed.x.array > 0.0, u - gap, u))


def _within(found: int | None, degree: int) -> bool:
    return found is not None and found <= degree


def _lattice(problem: SignoriniProblem, frames: Frames, marked: Marks, degree: int) -> FacetPoints:
    """Points of facets, the corners among them, at which a polynomial of a degree is known."""
    d = frames.dimension - 1
    kind, method = basix.LatticeType.gll, basix.LatticeSimplexMethod.isaac
    points = basix.create_lattice(CELLS[d], degree, kind, True, method)
    none = np.zeros(len(points))
    return FacetPoints(problem.space.mesh, frames, *np.nonzero(marked), points, none)


def _fitted(points: FacetPoints, values: Array, degree: int) -> Array:
    """The coefficients of the polynomials on facets with given values at a lattice."""
    table = points.polynomials(degree).transpose(0, 2, 1)
    return np.asarray(np.linalg.solve(table, values[..., None])[..., 0])


def _data_defects(
    problem: SignoriniProblem, terms: EnergyTerms, frames: Frames, u: Array
) -> list[tuple[FacetPoints, Array]]:
    """Dirichlet data minus the solution at points of the facets with data."""
    order = problem.space.element.basix_element.degree + MORE
    result = []
    for data, facets in terms.dirichlet:
        if data is not None:
            marked = on_frames(problem.space.mesh, frames, [facets])
            points = _lattice(problem, frames, marked, order)
            value = problem.sign * points.values(data)
            result.append((points, value - points.function(problem.space, u)))
    return result


def _loose_ends(comm: MPI.Comm, defects: list[tuple[FacetPoints, Array]], tiny: float) -> str:
    loose = False
    for points, values in defects:
        ends = np.isin(points.reference[:, 0], (0.0, 1.0))
        loose |= bool((np.abs(values[:, ends]) > tiny).any())
    if comm.allreduce(loose, op=MPI.LOR):
        return "Dirichlet data differ from those of the problem at a vertex"
    return ""


def _cones(
    frames: Frames, defects: list[tuple[FacetPoints, Array]], kinds: Indices, order: int
) -> Cones:
    """What is to be added on facets in the plane, given by values at lattices."""
    cells = np.concatenate([points.cells for points, _ in defects])
    facets = np.concatenate([points.facets for points, _ in defects])
    series = np.concatenate([_fitted(points, values, order) for points, values in defects])
    positive = kinds[cells, facets] == OPEN
    high = -lowest(1, order, -series)
    used = np.where(positive, high > 0.0, np.abs(series).max(axis=1, initial=0.0) > 0.0)
    return Cones(frames, cells[used], facets[used], series[used], positive[used])


def _raised_edges(
    problem: SignoriniProblem, frames: Frames, kinds: Indices, u: Array, tiny: float
) -> tuple[Array, str]:
    """Values of degree 2 that are raised at the middles of edges, with a message of failure."""
    space, d = problem.space, frames.dimension
    element = space.element.basix_element
    gap = np.maximum(problem.gap.x.array + u - problem.sign * problem.u.x.array, 0.0)
    inside = basix.cell.sub_entity_connectivity(element.cell_type)[d - 1]
    edges = np.array([facet[1] for facet in inside])
    closures = np.array(element.entity_closure_dofs[1])
    cells, facets = np.nonzero(kinds >= OPEN)
    local = closures[edges[frames.order[cells, facets]]]
    dofs = np.take_along_axis(
        space.dofmap.list[cells], local.reshape(len(cells), local[0].size if len(local) else 3), 1
    ).reshape(-1, 3)
    a, b, middle = gap[dofs].T
    least = (np.sqrt(a) - np.sqrt(b)) ** 2 / 4.0 if d == 2 else (a + b) / 4.0
    raised, count = fem.Function(space), fem.Function(space)
    raised.x.array[dofs[:, 2]] = np.maximum(least - middle, 0.0)
    count.x.array[dofs[:, 2]] = 1.0
    for function in (raised, count):
        function.x.scatter_reverse(la.InsertMode.add)
        function.x.scatter_forward()
    change = raised.x.array / np.maximum(count.x.array, 1.0)
    held = bool((change[problem.fixed_dofs] > tiny).any())
    return u + change, _held(problem, held)


def _raised_vertices(
    problem: SignoriniProblem, points: FacetPoints, gap: Array, u: Array, tiny: float
) -> tuple[Array, str]:
    """Values that are raised by hat functions of contact vertices, with a message of failure."""
    space, frames = problem.space, points.frames
    linear = fem.functionspace(space.mesh, ("Lagrange", 1))
    defect = np.maximum(-gap, 0.0).max(axis=1, initial=0.0)
    d = frames.dimension
    others = np.array([[j for j in range(d + 1) if j != k] for k in range(d + 1)])
    local = np.take_along_axis(frames.order[points.cells], others[points.facets], axis=1)
    dofs = np.take_along_axis(linear.dofmap.list[points.cells], local, axis=1)
    used = defect > tiny
    index_map = linear.dofmap.index_map
    numbers = index_map.local_to_global(dofs[used].ravel())
    parts = problem.comm.allgather((numbers, np.repeat(defect[used], d)))
    hats = fem.Function(linear)
    for numbers, values in parts:
        place = index_map.global_to_local(numbers)
        np.maximum.at(hats.x.array, place[place >= 0], values[place >= 0])
    raised = fem.Function(space)
    raised.interpolate(hats)
    raised.x.scatter_forward()
    held = bool((raised.x.array[problem.fixed_dofs] > tiny).any())
    return u + raised.x.array, _held(problem, held)


def _held(problem: SignoriniProblem, held: bool) -> str:
    found = problem.comm.allreduce(held, op=MPI.LOR)
    return "the obstacle is above the solution where Dirichlet data hold the solution" * found
