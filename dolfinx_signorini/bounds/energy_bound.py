"""A proven bound of the energy error of a solved problem, from an equilibrated flux.

The proof is in docs/accuracy.md.
"""

import math
from dataclasses import dataclass, field

import basix
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, Mask
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.base.kinds import check, instance
from dolfinx_signorini.bounds.boundary_facets import facet_kinds, facet_points
from dolfinx_signorini.bounds.boundary_fluxes import given_fluxes
from dolfinx_signorini.bounds.cell_values import (
    CellValues,
    cell_data,
    cell_values,
    quadrature_degree,
)
from dolfinx_signorini.bounds.condensation import DIRICHLET, OPEN, CellData, coefficients
from dolfinx_signorini.bounds.equilibration import equilibrated
from dolfinx_signorini.bounds.flux_parts import Oscillation, flux_parts, oscillation
from dolfinx_signorini.bounds.frames import cell_frames, on_frames
from dolfinx_signorini.bounds.friedrichs import friedrichs
from dolfinx_signorini.bounds.lifting import Feasible, feasible, gap_means, gaps
from dolfinx_signorini.bounds.reference_flux import ReferenceFlux, reference_flux
from dolfinx_signorini.bounds.remainders import NOTHING, Remainders, Solved
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.bounds.transport import transported
from dolfinx_signorini.meshes.sided_meshes import longest_side
from dolfinx_signorini.problem.signorini import SignoriniProblem

MEANS = "without Dirichlet data or a reaction, the mean of the load is known at points only"


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
        total: The bound; infinite if no bound is found.
        cells: The share of each owned cell.
        sampled: Whether data are known at points only, so that nothing is proven between them.
        notes: What is sampled, and why no bound is found.
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
    data: Oscillation
    mean: Array
    lifting: Array
    contact: Array


def energy_bound(
    problem: SignoriniProblem, terms: EnergyTerms, rest: Remainders = NOTHING
) -> EnergyBound:
    """Return a bound of the energy norm of u - u_h for a solved problem.

    Args:
        problem: The solved problem, of any degree on triangles or tetrahedra; the call is
            collective.
        terms: The strong form of the problem, where polynomials may stand for other data.
        rest: What the data have beside the polynomials that stand for the data.

    Raises:
        InputError: The terms contradict each other, or the mesh has curved or other cells.
    """
    check(
        problem=(problem, instance(SignoriniProblem, "a solved problem")),
        terms=(terms, instance(EnergyTerms, "the terms of the problem, EnergyTerms")),
        rest=(rest, instance(Remainders, "what the terms have beside polynomials, Remainders")),
    )
    domain, degree = problem.space.mesh, problem.space.element.basix_element.degree
    _check_mesh(problem)
    terms.check_on(domain)
    solved = Solved(problem, terms, cell_frames(domain), rest)
    reference = reference_flux(solved.dimension, degree)
    kinds, touching = facet_kinds(solved)
    quadrature, notes = quadrature_degree(solved, degree)
    values = cell_values(solved, quadrature)
    fluxes, missed, more = given_fluxes(solved)
    near = feasible(solved, kinds)
    points, gap = gaps(solved, near, kinds)
    means = gap_means(points, gap, degree)
    data = cell_data(values, kinds, touching, fluxes, means, reference)
    moments = equilibrated(domain, data, reference)
    ends = _ends(domain.comm, values, kinds == DIRICHLET)
    moments, reason = _without_defects(domain.comm, data, moments, ends)
    field = coefficients(data, reference, moments)
    flux, contact = flux_parts(solved, values, data, field, reference, (points, gap))
    parts = _Parts(
        flux=flux,
        data=oscillation(values, missed, rest, degree),
        mean=_residual(values, data, field, reference, ends),
        lifting=_lifted(solved, values, near),
        contact=contact,
    )
    constant, doubt = _mean_constant(domain.comm, values, data, parts.data.stray, ends)
    notes = [*notes, *more, *near.notes, *rest.sampled, *doubt]
    return _bound(domain.comm, parts, values, ends, constant, near.missing or reason, notes)


def _check_mesh(problem: SignoriniProblem) -> None:
    domain = problem.space.mesh
    kind = domain.topology.cell_type.name
    good = kind in ("triangle", "tetrahedron") and domain.geometry.cmap.degree == 1
    good &= domain.geometry.dim == domain.topology.dim
    require(problem.comm, good, "a bound needs straight-sided triangles or tetrahedra", "mesh")
    family = problem.space.element.basix_element.family
    good = family == basix.ElementFamily.P
    require(problem.comm, good, "a bound needs continuous Lagrange elements", "space")


def _defects(data: CellData, moments: Array) -> Array:
    """The integrals of f - c u + div y over the cells."""
    return np.asarray(moments[:, :, 0].sum(axis=1) + data.source[:, 0])


def _residual(
    values: CellValues, data: CellData, field: Array, reference: ReferenceFlux, ends: Mask
) -> Array:
    """What is left of the polynomial f - c u + div y as a bound; rounding alone outside of ends."""
    inner = field[:, reference.fluxes : reference.given] + data.source[:, 1:]
    first = field[:, : reference.fluxes : reference.per_facet].sum(axis=1) + data.source[:, 0]
    size = np.sqrt((np.square(inner).sum(axis=1) + first**2) / values.frames.volumes)
    return np.asarray(np.where(ends, values.l2_weight, 0.0) * size)


def _ends(comm: MPI.Comm, values: CellValues, exits: Mask) -> Mask:
    """Whether cells take up what is left: by a strong reaction, or any if nothing else does."""
    corners = values.frames.corners.reshape(-1, values.frames.dimension)
    least = longest_side(comm, corners) / np.sqrt(values.diffusion.lowest)
    ends = np.asarray(values.l2_weight <= least)
    if comm.allreduce(bool(ends.any() or exits.any()), op=MPI.LOR):
        return ends
    return np.asarray(values.least_reaction > 0.0)


def _without_defects(
    comm: MPI.Comm, data: CellData, moments: Array, ends: Mask
) -> tuple[Array, str]:
    """Carry away what is left in cells without much reaction; also return why not, or ""."""
    exits, moments, ends = data.kinds == DIRICHLET, moments.copy(), ends.copy()
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
        wanted, first = -_defects(data, moments), np.flatnonzero(comm.allgather(len(ends)))[0]
        ends[:1] = comm.rank == first  # the sum is 0 now
    change, found = transported(comm, data.facets, wanted, exits, ends)
    moments[:, :, 0] += change
    return moments, "" if found else "a residual has no way out of a part without a reaction"


def _mean_constant(
    comm: MPI.Comm, values: CellValues, data: CellData, stray: Array, ends: Mask
) -> tuple[float, list[str]]:
    """The constant of Friedrichs where unknown means matter, and why none is found."""
    if not comm.allreduce(bool((stray[~ends] > 0.0).any()), op=MPI.LOR):
        return 0.0, []
    lowest, reaction = values.diffusion.lowest, values.least_reaction
    constant = friedrichs(comm, values.frames, data.kinds, ends, lowest, reaction)
    return (0.0, [MEANS]) if math.isinf(constant) else (constant, [])


def _lifted(solved: Solved, values: CellValues, near: Feasible) -> Array:
    """The energy norm of v - u_h on each cell."""
    rest = solved.rest
    points = values.frames.points(values.points)
    (w,), (slopes,) = points.values(near.change), points.gradients(near.change)
    gradient = np.stack(slopes, axis=2)
    c = values.reaction.max(axis=1, initial=0.0)
    c = c if rest.largest_reaction is None else rest.largest_reaction
    energy = values.integrals((gradient * values.diffusion.times(gradient)).sum(axis=2))
    energy += rest.diffusion * values.integrals(np.square(gradient).sum(axis=2))
    energy += c * values.integrals(w**2)
    strip = 0.0 * c
    if rest.thin is not None:
        strip = rest.thin[0] * rest.thin[2]
        degree = near.change.function_space.element.basix_element.degree
        energy += strip * values.frames.volumes * values.largest(gradient, degree) ** 2
    norms = np.sqrt(energy + _robin_energy(solved, near.change))
    if near.cones is not None:
        norms += near.cones.norms(values.diffusion.upper, c, strip)
    return np.asarray(norms)


def _robin_energy(solved: Solved, w: fem.Function) -> Array:
    """The integrals of k w^2, for the Robin coefficient k, over the facets of each cell."""
    result = np.zeros(len(solved.frames.order))
    for data, facets in solved.terms.robin:
        marked = on_frames(solved.frames, [facets])
        degree = 2 * w.function_space.element.basix_element.degree + 4
        points = facet_points(solved.frames, marked, degree)
        square = points.function(w.function_space, w.x.array) ** 2
        sums = points.values(data) * square @ points.weights * points.sizes
        result += np.bincount(points.cells, sums, len(result))
    return result


def _bound(
    comm: MPI.Comm,
    parts: _Parts,
    values: CellValues,
    ends: Mask,
    constant: float,
    missing: str,
    notes: list[str],
) -> EnergyBound:
    """Put together the parts that are tested with grad e, and the ones tested with c^(1/2) e."""
    data, weak = parts.data, values.weak
    by_gradient = parts.flux + data.on_facets
    by_gradient += np.where(weak, data.projected + data.missed, 0.0)
    # What is left of the polynomial part is orthogonal to the rest.
    by_reaction = np.sqrt(parts.mean**2 + np.where(weak, 0.0, data.projected) ** 2)
    stray = np.where(ends, 0.0, data.stray)
    taken = np.where(ends, values.l2_weight, 0.0) * data.stray
    by_reaction += np.where(weak, 0.0, data.missed) + taken
    square = by_gradient**2 + by_reaction**2

    def root(values: Array) -> float:
        return math.sqrt(comm.allreduce(float(values.sum())))

    free = constant * root(stray**2)
    eta, contact, lifting = root(square) + free, root(parts.contact), root(parts.lifting**2)
    total = math.sqrt(eta**2 + lifting**2 + 2.0 * contact**2)
    return EnergyBound(
        flux=root(parts.flux**2),
        data=root((data.projected + data.missed + data.on_facets + taken) ** 2) + free,
        contact=contact,
        mean=root(parts.mean**2),
        lifting=lifting,
        total=math.inf if missing else total,
        cells=np.sqrt(square + (constant * stray) ** 2 + parts.lifting**2 + 2.0 * parts.contact),
        sampled=bool(notes),
        notes=(missing, *notes) if missing else tuple(notes),
    )
