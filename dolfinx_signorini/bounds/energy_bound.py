"""A proven bound of the energy error of a solved problem, from an equilibrated flux.

The proof is in docs/method/energy_bound.md.
"""

import math
from dataclasses import dataclass, field

import basix
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.base.kinds import check, instance
from dolfinx_signorini.bounds.boundary_facets import facet_kinds, facet_points
from dolfinx_signorini.bounds.boundary_fluxes import given_fluxes
from dolfinx_signorini.bounds.cell_scales import CellScales, dots
from dolfinx_signorini.bounds.cell_values import (
    CellMoments,
    CellValues,
    cell_data,
    cell_moments,
    cell_values,
    quadrature_degree,
)
from dolfinx_signorini.bounds.condensation import DIRICHLET, OPEN, CellData, joined
from dolfinx_signorini.bounds.equilibration import equilibrated
from dolfinx_signorini.bounds.flux_parts import Oscillation, flux_parts, oscillation
from dolfinx_signorini.bounds.frames import cell_frames, on_frames
from dolfinx_signorini.bounds.friedrichs import friedrichs
from dolfinx_signorini.bounds.lifting import Feasible, feasible, gap_means, gaps
from dolfinx_signorini.bounds.reference_flux import reference_flux
from dolfinx_signorini.bounds.remainders import NOTHING, Remainders, Solved
from dolfinx_signorini.bounds.strong_form import EnergyTerms
from dolfinx_signorini.bounds.transport import transported
from dolfinx_signorini.meshes.sided_meshes import longest_side
from dolfinx_signorini.problem.signorini import SignoriniProblem, one_sided

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
        problem=(problem, one_sided),
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
    fluxes, missed, more = given_fluxes(solved)
    near = feasible(solved, kinds)
    points, gap = gaps(solved, near, kinds)
    means = gap_means(points, gap, degree)
    found, scales, beside, lifted = _on_cells(solved, quadrature, missed, near.change)
    data = cell_data(solved.frames, kinds, touching, fluxes, means, found)
    moments = equilibrated(domain, data, reference)
    ends = _ends(solved, scales, kinds == DIRICHLET)
    moments, reason = _without_defects(solved, scales, data, moments, ends)
    flux, left, contact = flux_parts(solved, quadrature, data, moments, reference, (points, gap))
    parts = _Parts(
        flux=flux,
        data=beside,
        mean=np.where(ends, scales.l2_weight, 0.0) * left,  # rounding alone outside of ends
        lifting=_lifting(solved, scales, near, lifted),
        contact=contact,
    )
    constant, doubt = _mean_constant(solved, scales, kinds, parts.data.stray, ends)
    notes = [*notes, *more, *near.notes, *rest.sampled, *doubt]
    return _bound(domain.comm, parts, scales, ends, constant, near.missing or reason, notes)


def _on_cells(
    solved: Solved, quadrature: int, missed: Array, change: fem.Function
) -> tuple[CellMoments, CellScales, Oscillation, Array]:
    """What cells tell before there is a flux, batch by batch.

    Args:
        solved: The problem.
        quadrature: The degree of the rule.
        missed: What polynomials miss of the fluxes on facets.
        change: What makes the solution feasible.
    """
    found = []
    for cells, values in cell_values(solved, quadrature).batches():
        moments = cell_moments(values, solved.degree)
        beside = oscillation(values, missed[cells], moments.source, solved.degree)
        found.append((moments, values.scales, beside, _lifted_energy(values, change)))
    every, scales, beside_all, lifted = zip(*found, strict=True)
    return joined(every), joined(scales), joined(beside_all), np.concatenate(lifted)


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


def _ends(solved: Solved, scales: CellScales, exits: Mask) -> Mask:
    """Whether cells take up what is left: by a strong reaction, or any if nothing else does."""
    corners = solved.frames.corners.reshape(-1, solved.dimension)
    least = longest_side(solved.comm, corners) / np.sqrt(scales.lowest)
    ends = np.asarray(scales.l2_weight <= least)
    if solved.comm.allreduce(bool(ends.any() or exits.any()), op=MPI.LOR):
        return ends
    return np.asarray(scales.least_reaction > 0.0)


def _without_defects(
    solved: Solved, scales: CellScales, data: CellData, moments: Array, ends: Mask
) -> tuple[Array, str]:
    """Carry away what is left in cells without much reaction; also return why not, or ""."""
    comm, exits = solved.comm, data.kinds == DIRICHLET
    moments, ends = moments.copy(), ends.copy()
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
    change, found = transported(comm, solved.frames, scales.lowest, wanted, exits, ends)
    moments[:, :, 0] += change
    return moments, "" if found else "a residual has no way out of a part without a reaction"


def _mean_constant(
    solved: Solved, scales: CellScales, kinds: Indices, stray: Array, ends: Mask
) -> tuple[float, list[str]]:
    """The constant of Friedrichs where unknown means matter, and why none is found."""
    if not solved.comm.allreduce(bool((stray[~ends] > 0.0).any()), op=MPI.LOR):
        return 0.0, []
    lowest, reaction = scales.lowest, scales.least_reaction
    constant = friedrichs(solved.comm, solved.frames, kinds, ends, lowest, reaction)
    return (0.0, [MEANS]) if math.isinf(constant) else (constant, [])


def _lifted_energy(values: CellValues, change: fem.Function) -> Array:
    """The energy of v - u_h in each cell, without cones and Robin conditions."""
    space, frames, rest = change.function_space, values.frames, values.rest
    if not change.x.array[space.dofmap.list[frames.cells]].any():
        return np.zeros(len(frames.cells))
    points = frames.points(values.points)
    (w,), (slopes,) = points.values(change), points.gradients(change)
    gradient = np.stack(slopes, axis=2)
    energy = values.integrals(dots(gradient, values.diffusion.times(gradient)))
    energy += rest.diffusion * values.integrals(dots(gradient, gradient))
    energy += values.scales.largest_reaction * values.integrals(w**2)
    if rest.thin is not None:
        degree = space.element.basix_element.degree
        energy += _strip(rest) * values.scales.volumes * values.largest(gradient, degree) ** 2
    return energy


def _strip(rest: Remainders) -> Array | float:
    """The share of each cell where A may be larger, times the largest eigenvalue of A."""
    return 0.0 if rest.thin is None else rest.thin[0] * rest.thin[2]


def _lifting(solved: Solved, scales: CellScales, near: Feasible, energy: Array) -> Array:
    """The energy norm of v - u_h on each cell, from the energy of a part."""
    norms = np.sqrt(energy + _robin_energy(solved, near.change))
    if near.cones is not None:
        strip = np.broadcast_to(_strip(solved.rest), norms.shape)
        norms += near.cones.norms(scales.upper, scales.largest_reaction, strip)
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
    scales: CellScales,
    ends: Mask,
    constant: float,
    missing: str,
    notes: list[str],
) -> EnergyBound:
    """Put together the parts that are tested with grad e, and the ones tested with c^(1/2) e."""
    data, weak = parts.data, scales.weak
    by_gradient = parts.flux + data.on_facets
    by_gradient += np.where(weak, data.projected + data.missed, 0.0)
    # What is left of the polynomial part is orthogonal to the rest.
    by_reaction = np.sqrt(parts.mean**2 + np.where(weak, 0.0, data.projected) ** 2)
    stray = np.where(ends, 0.0, data.stray)
    taken = np.where(ends, scales.l2_weight, 0.0) * data.stray
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
