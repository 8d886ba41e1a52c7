"""A proven bound of the energy error of a solved problem, from an equilibrated flux.

The proofs are in docs/method/energy_bound.md and, for obstacles in the domain, in
energy_bound_in_cells.md.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import basix
import numpy as np

from dolfinx_signorini.base.arrays import Array, Indices, Mask
from dolfinx_signorini.base.errors import require
from dolfinx_signorini.base.kinds import check
from dolfinx_signorini.base.ranks import anywhere, highest
from dolfinx_signorini.bounds.better_fluxes import better_fluxes
from dolfinx_signorini.bounds.boundary_facets import facet_kinds
from dolfinx_signorini.bounds.boundary_fluxes import given_fluxes
from dolfinx_signorini.bounds.cell_pressure import with_pressure, without_defects
from dolfinx_signorini.bounds.cell_scales import CellScales
from dolfinx_signorini.bounds.cell_values import (
    cell_data,
    cell_values,
    quadrature_degree,
)
from dolfinx_signorini.bounds.condensation import DIRICHLET, CellData, joined
from dolfinx_signorini.bounds.contact import contact_of
from dolfinx_signorini.bounds.enclosed_data import EnclosedData
from dolfinx_signorini.bounds.equilibration import equilibrated
from dolfinx_signorini.bounds.flux_parts import (
    FluxParts,
    Oscillation,
    flux_parts,
    least_flux,
    oscillation,
    with_better,
)
from dolfinx_signorini.bounds.friedrichs import friedrichs
from dolfinx_signorini.bounds.gaps import gap_means, gaps
from dolfinx_signorini.bounds.lifted_energy import cone_norms, lifted_energy, robin_energy
from dolfinx_signorini.bounds.reference_flux import reference_flux
from dolfinx_signorini.bounds.remainders import Solved
from dolfinx_signorini.bounds.strong_form import EnergyTerms, strong_form
from dolfinx_signorini.bounds.transport import HIDDEN
from dolfinx_signorini.data.interfaces.facet_jumps import data_jumps
from dolfinx_signorini.data.reading import formula_of
from dolfinx_signorini.meshes.sided_meshes import is_straight, longest_side
from dolfinx_signorini.problem.bound_constrained import BoundConstrainedProblem
from dolfinx_signorini.problem.signorini import one_sided

TORN = "the Dirichlet data jump: no solution has finite energy"
# Of the strongest reaction, where no cell has a strong one: with all of it, and with a hundredth,
# bounds are the same to 0.7 % for six reactions and degrees 1 to 3.
NEAR = 0.25
MEANS = "without Dirichlet data or a reaction, the mean of the load is known at points only"


@dataclass(frozen=True)
class EnergyBound:
    """A bound of the energy norm of u - u_h, with its parts.

    A bound is proven up to what is known at points only:

        bound = energy_bound(problem)
        print(bound.total, "sampled" if bound.sampled else "proven", bound.notes)

    Attributes:
        flux: The distance of the flux of u_h from the equilibrated one; with an obstacle in the
            domain, of the flux of the feasible function.
        data: What is left of load and fluxes beside polynomials on cells and facets.
        contact: The root of sigma, the integral of contact flux or pressure times gap.
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


def energy_bound(problem: BoundConstrainedProblem, terms: EnergyTerms | None = None) -> EnergyBound:
    """Return a bound of the energy norm of u - u_h for a solved problem.

    Formulas among the data are enclosed so well that what is hidden between the points of rules is
    at most a share of the flux part. Data are formulas if they are numbers or UFL expressions of
    the coordinates.

    Args:
        problem: The solved problem, of any degree on triangles or tetrahedra, with an obstacle on
            the boundary, or one or two in the domain; the call is collective.
        terms: The strong form; None to read it from the forms of the problem, see `strong_form`.

    Raises:
        InputError: The terms contradict each other or are not readable, the mesh has curved or
            other cells, or data have changed since the solve.
    """
    check(problem=(problem, with_bound))
    problem.check_unchanged()
    _check_mesh(problem)
    terms = strong_form(problem, terms)
    data = EnclosedData(problem, terms)
    bound = bound_by_flux(data.enclosed(HIDDEN * data.size))
    if data.hidden > 2.0 * HIDDEN * bound.flux > 0.0:
        bound = bound_by_flux(data.enclosed(HIDDEN * bound.flux))
    read = [(formula_of(given), on) for given, on in terms.dirichlet]
    if data_jumps(problem.space.mesh, [(given, on) for given, on in read if given is not None]):
        return replace(bound, total=math.inf, notes=(*bound.notes, TORN))
    return bound


def bound_by_flux(solved: Solved) -> EnergyBound:
    """Return the bound from an equilibrated flux and a feasible function.

    Args:
        solved: The solved problem, where polynomials may stand for data; other data count as known
            at points. The call is collective.

    Raises:
        InputError: The terms contradict each other.
    """
    degree, in_cells = solved.degree, solved.problem.in_domain
    reference = reference_flux(solved.dimension, degree)
    kinds, touching = facet_kinds(solved)
    fluxes, missed, sampled = given_fluxes(solved)
    near, sides, rises = contact_of(solved, kinds)
    solved = replace(solved, change=near.target if in_cells else None)
    quadrature, notes = quadrature_degree(solved, degree)
    points, gap = gaps(solved, near, kinds)
    facts = (kinds, touching, fluxes, gap_means(points, gap, degree), sides, rises)
    data, scales, beside = _on_cells(solved, quadrature, facts, missed)
    lifted = lifted_energy(solved, near.change)
    moments = equilibrated(solved.frames.domain, data, reference)
    ends = _ends(solved, scales, exits := kinds == DIRICHLET)
    outlet = anywhere(solved.comm, ends.any() or exits.any())
    more = reference, rises, (points, gap), outlet
    better = better_fluxes(solved, data, moments, *more) if in_cells else None
    if better is not None:
        data, moments = better.into(data, moments)
    least = least_flux(solved, quadrature, data, moments, reference)
    data, moments, reason = without_defects(solved, scales, data, moments, ends, least)
    if not in_cells:  # the divergence stays as it is
        better = better_fluxes(solved, data, moments, *more)
        moments = moments if better is None else better.into(data, moments)[1]
    data, energy = with_pressure(data, moments, reference)
    own = flux_parts(solved, quadrature, data, moments, reference, (points, gap))
    own = replace(own, contact=own.contact + energy)
    if better is not None:
        own = with_better(own, solved, better, moments)
    # Rounding alone outside of ends.
    own = replace(own, left=np.where(ends, scales.l2_weight, 0.0) * own.left)
    # By what the norms of reaction and Robin conditions miss v, where y aims at v.
    robin, cones = robin_energy(solved, near.change), cone_norms(solved, scales, near)
    change, lifting = np.sqrt(in_cells * (lifted[:, 1] + robin)), lifted.sum(axis=1) + robin
    constant, doubt = _mean_constant(solved, scales, kinds, beside.stray, ends)
    notes = [*notes, *sampled, *near.notes, *solved.rest.sampled, *doubt]
    parts = own, beside, np.sqrt(lifting), cones, change
    return _bound(solved, parts, scales, ends, constant, near.missing or reason, notes)


def with_bound(value: Any) -> str:
    """The kind of problems that have a bound."""
    if not isinstance(value, BoundConstrainedProblem):
        return one_sided(value)
    if value.space.dofmap.bs > 1:
        return "has displacements, whose bound needs a symmetric equilibrated stress: not known"
    if value.u in value.L.coefficients():
        return (
            "has a load that depends on the function that it fills, as in a time step: the load of "
            "this solution is gone; keep the last solution in a function of its own"
        )
    if len(value.zones) > 1:
        return "has obstacles in the domain and on the boundary: no bound is known for both at once"
    return "" if value.in_domain else one_sided(value)


def _on_cells(
    solved: Solved, quadrature: int, facts: tuple[Any, ...], missed: Array
) -> tuple[CellData, CellScales, Oscillation]:
    """What cells tell before there is a flux, batch by batch.

    Args:
        solved: The problem.
        quadrature: The degree of the rule.
        facts: What is known of the cells, in the order of `cell_data`.
        missed: What polynomials miss of the fluxes on facets.
    """
    found = []
    for cells, values in cell_values(solved, quadrature).batches():
        data = cell_data(values, solved.degree, *(part[cells] for part in facts))
        beside = oscillation(values, missed[cells], data.source, solved.degree)
        found.append((data, values.scales, beside))
    every, scales, beside_all = zip(*found, strict=True)
    return joined(every), joined(scales), joined(beside_all)


def _check_mesh(problem: BoundConstrainedProblem) -> None:
    good = is_straight(problem.space.mesh)
    require(problem.comm, good, "a bound needs straight-sided triangles or tetrahedra", "mesh")
    family = problem.space.element.basix_element.family
    good = family == basix.ElementFamily.P
    require(problem.comm, good, "a bound needs continuous Lagrange elements", "space")


def _ends(solved: Solved, scales: CellScales, exits: Mask) -> Mask:
    """Whether cells take up what is left: by a strong reaction, or the strongest one if no other.

    A defect that is taken up costs its L2 norm over the root of the reaction: next to nothing is
    gained from cells in which the reaction is many times weaker than elsewhere.
    """
    size = longest_side(solved.frames.domain)
    least = size / np.sqrt(scales.lowest)
    ends = np.asarray(scales.l2_weight <= least)
    if anywhere(solved.comm, ends.any() or exits.any()):
        return ends
    strongest = highest(solved.comm, scales.least_reaction)
    return np.asarray((scales.least_reaction > 0.0) & (scales.least_reaction >= NEAR * strongest))


def _mean_constant(
    solved: Solved, scales: CellScales, kinds: Indices, stray: Array, ends: Mask
) -> tuple[float, list[str]]:
    """The constant of Friedrichs where unknown means matter, and why none is found."""
    if not anywhere(solved.comm, stray[~ends] > 0.0):
        return 0.0, []
    lowest, reaction = scales.lowest, scales.least_reaction
    constant = friedrichs(solved.comm, solved.frames, kinds, ends, lowest, reaction)
    return (0.0, [MEANS]) if math.isinf(constant) else (constant, [])


def _bound(
    solved: Solved,
    parts: tuple[FluxParts, Oscillation, Array, Array, Array],
    scales: CellScales,
    ends: Mask,
    constant: float,
    missing: str,
    notes: list[str],
) -> EnergyBound:
    """Put together the parts that are tested with grad e, and the ones tested with c^(1/2) e."""
    (own, data, lifted, cones, change), weak, comm = parts, scales.weak, solved.comm
    beside = data.on_facets + np.where(weak, data.projected + data.missed, 0.0)
    by_gradient = own.flux + beside
    # What is left of the polynomial part is orthogonal to the rest.
    by_reaction = np.sqrt(own.left**2 + np.where(weak, 0.0, data.projected) ** 2)
    stray = np.where(ends, 0.0, data.stray)
    taken = np.where(ends, scales.l2_weight, 0.0) * data.stray
    by_reaction += np.where(weak, 0.0, data.missed) + taken
    by_reaction += change
    square = by_gradient**2 + by_reaction**2

    def root(values: Array) -> float:
        return math.sqrt(comm.allreduce(float(values.sum())))

    free = constant * root(stray**2)
    far = lifted + cones
    eta, contact, lifting = root(square) + free, root(own.contact), root(far**2)
    total = math.sqrt(eta**2 + lifting**2 + 2.0 * contact**2)
    cells = np.sqrt(square + (constant * stray) ** 2 + far**2 + 2.0 * own.contact)
    if solved.problem.in_domain:
        apart = free + root(cones**2)  # the flux is compared with grad v without cones
        eta = root(square) + apart
        middle = root((own.middle + 0.5 * beside) ** 2 + 0.25 * by_reaction**2) + 0.5 * apart
        total = middle + math.sqrt(0.25 * eta**2 + contact**2)
    cells *= total / (root(cells**2) or 1.0)
    return EnergyBound(
        flux=root(own.flux**2),
        data=root((data.projected + data.missed + data.on_facets + taken) ** 2) + free,
        contact=contact,
        mean=root(own.left**2),
        lifting=lifting,
        total=math.inf if missing else total,
        cells=cells,
        sampled=bool(notes),
        notes=(missing, *notes) if missing else tuple(notes),
    )
