"""A proven bound of the energy error of a solved problem, from an equilibrated flux.

The proof is in docs/accuracy.md.
"""

import math
from dataclasses import dataclass, field

import basix
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinx_signorini.bounds.boundary_facets import (
    FacetPoints,
    facet_kinds,
    facet_points,
)
from dolfinx_signorini.bounds.boundary_fluxes import given_fluxes, robin_energy
from dolfinx_signorini.bounds.cell_values import (
    CellValues,
    cell_data,
    cell_values,
    flux_values,
    function_values,
    quadrature_degree,
)
from dolfinx_signorini.bounds.condensation import (
    CLOSED,
    DIRICHLET,
    OPEN,
    CellData,
    coefficients,
)
from dolfinx_signorini.bounds.equilibration import equilibrated
from dolfinx_signorini.bounds.frames import Frames, cell_frames
from dolfinx_signorini.bounds.lifting import Feasible, feasible
from dolfinx_signorini.bounds.reference_flux import ReferenceFlux, reference_flux
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.bounds.transport import transported
from dolfinx_signorini.errors import require
from dolfinx_signorini.problem import SignoriniProblem

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Marks = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class EnergyBound:
    """A bound of the energy norm of u - u_h, with its parts.

    A bound is proven up to what is known at points only:

        bound = energy_bound(problem, EnergyTerms(reaction=1.0, load=f))
        print(bound.total, "sampled" if bound.sampled else "proven", bound.notes)

    Attributes:
        flux: The distance of the flux of u_h from the equilibrated one.
        data: What is left of load and fluxes beside polynomials on cells and facets.
        contact: The root of sigma, the integral of contact flux times gap.
        mean: What the algebraic error and the quadrature of the discrete problem leave.
        lifting: The energy norm of the difference from u_h to a feasible function.
        total: The bound; infinite where there is none.
        cells: The share of each owned cell.
        sampled: Whether data are known at points only, so that nothing is proven between them.
        notes: What is sampled, and why there is no bound.
    """

    flux: float
    data: float
    contact: float
    mean: float
    lifting: float
    total: float
    cells: Array = field(repr=False)
    sampled: bool = False
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Parts:
    """The parts of the bound on each cell: norms, and for contact the integral sigma."""

    flux: Array
    data: tuple[Array, Array]
    mean: Array
    lifting: Array
    contact: Array


def energy_bound(problem: SignoriniProblem, terms: EnergyTerms) -> EnergyBound:
    """Return a bound of the energy norm of u - u_h for a solved problem.

    Args:
        problem: The solved problem, of any degree on triangles or tetrahedra; the call is
            collective.
        terms: Its strong form.

    Raises:
        InputError: The terms contradict each other, or the mesh has curved or other cells.
    """
    domain, degree = problem.space.mesh, problem.space.element.basix_element.degree
    _check_mesh(problem)
    reference, frames = reference_flux(domain.topology.dim, degree), cell_frames(domain)
    kinds, touching = facet_kinds(problem, terms, frames)
    quadrature, notes = quadrature_degree(terms, frames.dimension, degree)
    values = cell_values(problem, terms, frames, quadrature)
    fluxes, missed, more = given_fluxes(problem, terms, frames, degree)
    near = feasible(problem, terms, frames, kinds)
    points, gap = _gaps(problem, near, kinds, frames)
    means = _gap_means(points, gap, degree)
    data = cell_data(values, kinds, touching, fluxes, means, reference)
    moments = equilibrated(domain, data, reference)
    moments, reason = _without_defects(domain.comm, values, data, moments)
    field = coefficients(data, reference, moments)
    parts = _Parts(
        flux=_distance(values, flux_values(values, field, reference)),
        data=_oscillation(values, missed, degree),
        mean=_residual(values, data, field, reference),
        lifting=_lifted(problem, terms, values, near),
        contact=_contact(points, gap, moments, degree),
    )
    weak = values.gradient_weight <= values.l2_weight
    notes = [*notes, *more, *near.notes]
    return _bound(domain.comm, parts, weak, near.missing or reason, notes)


def _check_mesh(problem: SignoriniProblem) -> None:
    domain = problem.space.mesh
    kind = domain.topology.cell_type.name
    good = kind in ("triangle", "tetrahedron") and domain.geometry.cmap.degree == 1
    good &= domain.geometry.dim == domain.topology.dim
    require(problem.comm, good, "a bound needs straight-sided triangles or tetrahedra", "mesh")
    family = problem.space.element.basix_element.family
    good = family == basix.ElementFamily.P
    require(problem.comm, good, "a bound needs continuous Lagrange elements", "space")


def _distance(values: CellValues, y: Array) -> Array:
    """The norm of A^(1/2) grad u_h - A^(-1/2) y on each cell."""
    apart = values.current - y
    return np.sqrt(values.integrals((apart * values.diffusion.divided(apart)).sum(axis=2)))


def _oscillation(values: CellValues, missed: Array, degree: int) -> tuple[Array, Array]:
    """What load and fluxes have beside polynomials, as bounds for each cell."""
    frames, d, a = values.frames, values.frames.dimension, values.diffusion.lowest
    weight = np.minimum(values.gradient_weight, values.l2_weight)
    on_cells = weight * np.sqrt(values.integrals(values.rest(degree) ** 2))
    square = frames.facet_sizes / frames.volumes[:, None] * frames.diameters[:, None] ** 2
    square *= (1.0 / math.pi + 2.0 / d) / math.pi / a[:, None]
    return on_cells, (np.sqrt(square) * missed).sum(axis=1)


def _defects(data: CellData, moments: Array) -> Array:
    """The integrals of f - c u + div y over the cells."""
    return np.asarray(moments[:, :, 0].sum(axis=1) + data.source[:, 0])


def _residual(values: CellValues, data: CellData, field: Array, reference: ReferenceFlux) -> Array:
    """What is left of the polynomial f - c u + div y in cells with a reaction, as a bound."""
    inner = field[:, reference.fluxes : reference.given] + data.source[:, 1:]
    first = field[:, : reference.fluxes : reference.per_facet].sum(axis=1) + data.source[:, 0]
    size = np.sqrt((np.square(inner).sum(axis=1) + first**2) / values.frames.volumes)
    return np.asarray(np.where(np.isfinite(values.l2_weight), values.l2_weight, 0.0) * size)


def _without_defects(
    comm: MPI.Comm, values: CellValues, data: CellData, moments: Array
) -> tuple[Array, str]:
    """Carry away what is left in cells without much reaction; also return why not, or ""."""
    exits, moments = data.kinds == DIRICHLET, moments.copy()
    ends = values.l2_weight <= _size(comm, values.frames) / np.sqrt(values.diffusion.lowest)
    if not comm.allreduce(bool(ends.any() or exits.any()), op=MPI.LOR):
        ends = values.least_reaction > 0.0
    wanted = np.where(ends, 0.0, -_defects(data, moments))
    if not comm.allreduce(bool((wanted != 0.0).any()), op=MPI.LOR):
        return moments, ""
    if not comm.allreduce(bool(ends.any() or exits.any()), op=MPI.LOR):
        contact = data.kinds >= OPEN
        force = comm.allreduce(float(moments[contact, 0].sum()))
        factor = 1.0 + comm.allreduce(float(wanted.sum())) / (force or math.inf)
        if force <= 0.0 or factor < 0.0:
            return moments, "the contact flux is too small to take up the residual"
        moments[contact] *= factor
        wanted, ends[:1] = -_defects(data, moments), comm.rank == 0  # the sum is 0 now
    change, found = transported(comm, data.facets, wanted, exits, ends)
    moments[:, :, 0] += change
    return moments, "" if found else "a residual has no way out of a part without a reaction"


def _size(comm: MPI.Comm, frames: Frames) -> float:
    """The longest side of the box around the domain."""
    ends = np.concatenate((frames.corners, -frames.corners), axis=2)
    largest = np.max(comm.allgather(ends.max(axis=(0, 1), initial=-np.inf)), axis=0)
    return float((largest[: frames.dimension] + largest[frames.dimension :]).max())


def _lifted(
    problem: SignoriniProblem, terms: EnergyTerms, values: CellValues, near: Feasible
) -> Array:
    """The energy norm of v - u_h on each cell."""
    w, gradient = function_values(near.change, values.frames, values.points)
    if near.cones is not None:
        more, slopes = near.cones.at(values.points)
        w, gradient = w + more, gradient + slopes
    energy = (gradient * values.diffusion.times(gradient)).sum(axis=2) + values.reaction * w**2
    on_facets = robin_energy(problem, terms, values.frames, near.change)
    return np.sqrt(values.integrals(energy) + on_facets)


def _gaps(
    problem: SignoriniProblem, near: Feasible, kinds: Indices, frames: Frames
) -> tuple[FacetPoints, Array]:
    """The gap of the feasible function at points of contact facets."""
    degree = problem.space.element.basix_element.degree
    points = facet_points(problem.space.mesh, frames, kinds >= OPEN, 2 * degree + 8)
    v = problem.sign * points.function(problem.space, problem.u.x.array)
    v += points.function(near.change.function_space, near.change.x.array)
    gap = np.maximum(v - problem.sign * points.values(problem.obstacle_data), 0.0)
    if near.meets:
        gap[kinds[points.cells, points.facets] == CLOSED] = 0.0
    return points, gap


def _gap_means(points: FacetPoints, gap: Array, degree: int) -> Array:
    """The means of gap times polynomial, shape (cells, d + 1, moments)."""
    p = points.polynomials(degree)
    means = np.zeros((*points.frames.order.shape, p.shape[1]))
    means[points.cells, points.facets] = np.einsum("q,nq,njq->nj", points.weights, gap, p)
    return means


def _contact(points: FacetPoints, gap: Array, moments: Array, degree: int) -> Array:
    """The integrals of contact flux times gap over the contact facets of each cell."""
    own = moments[points.cells, points.facets]
    flux = np.einsum("nj,njq->nq", own, points.polynomials(degree))
    sums = np.maximum(flux, 0.0) * gap @ points.weights
    return np.asarray(np.bincount(points.cells, sums, len(moments)), dtype=np.float64)


def _bound(
    comm: MPI.Comm, parts: _Parts, weak: Marks, missing: str, notes: list[str]
) -> EnergyBound:
    """Put the parts together: those tested with grad e, and those tested with c^(1/2) e."""
    on_cells, on_facets = parts.data
    by_gradient = parts.flux + on_facets + np.where(weak, on_cells, 0.0)
    # What is left of the polynomial part is orthogonal to the rest.
    square = by_gradient**2 + parts.mean**2 + np.where(weak, 0.0, on_cells) ** 2

    def root(values: Array) -> float:
        return math.sqrt(comm.allreduce(float(values.sum())))

    eta, contact, lifting = root(square), root(parts.contact), root(parts.lifting**2)
    total = 0.5 * (eta + math.sqrt(eta**2 + 4.0 * contact**2))
    if lifting > 0.0:
        total = math.sqrt(eta**2 + 2.0 * contact**2 + lifting**2)
    return EnergyBound(
        flux=root(parts.flux**2),
        data=root((on_cells + on_facets) ** 2),
        contact=contact,
        mean=root(parts.mean**2),
        lifting=lifting,
        total=math.inf if missing else total,
        cells=np.sqrt(square + parts.contact + parts.lifting**2),
        sampled=bool(notes),
        notes=(missing, *notes) if missing else tuple(notes),
    )
