"""A proven bound of the energy error of a solved problem, from an equilibrated flux.

The proof is in docs/accuracy.md.
"""

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from dolfinx_signorini.accuracy.boundary_facets import facet_kinds, facet_points, given_fluxes
from dolfinx_signorini.accuracy.equilibration import equilibrated
from dolfinx_signorini.accuracy.frames import Frames, cell_frames, values_at
from dolfinx_signorini.accuracy.patches import CLOSED, OPEN, CellData, matrices
from dolfinx_signorini.accuracy.reference_flux import (
    ReferenceFlux,
    barycentric,
    polynomials,
    reference_flux,
    rule,
)
from dolfinx_signorini.accuracy.strong_form import EnergyTerms, polynomial_degree
from dolfinx_signorini.errors import InputError
from dolfinx_signorini.problem import SignoriniProblem

Array = npt.NDArray[np.float64]

MORE = {2: 10, 3: 6}  # by how much rules for data are better than for polynomials, by dimension


@dataclass(frozen=True)
class EnergyBound:
    """A bound of the energy norm of u - u_h, with its parts.

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
class _Values:
    """The solution and the coefficients at points of the owned cells, for a lower obstacle."""

    points: Array
    weights: Array
    u: Array
    gradient: Array
    diffusion: Array
    inverse: Array
    reaction: Array
    load: Array

    def current(self) -> Array:
        return np.asarray(np.einsum("cqab,cqb->cqa", self.diffusion, self.gradient))


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
    reference = reference_flux(domain.topology.dim, degree)
    frames = cell_frames(domain)
    kinds = facet_kinds(problem, terms, frames)
    quadrature, notes = _quadrature(terms, reference)
    values = _values(problem, terms, frames, quadrature)
    fluxes, missed = given_fluxes(problem, terms, frames, degree, 2 * degree + 8)
    data = _cell_data(frames, kinds, values, fluxes, reference)
    moments = equilibrated(domain, data, reference)
    comm = domain.comm

    y = _field(frames, values, data, moments, reference)
    distance = values.current() - y
    weights = values.weights * frames.volumes[:, None]
    square = np.einsum("cqa,cqab,cqb->cq", distance, values.inverse, distance)
    flux = np.sqrt((square * weights).sum(axis=1))
    rest = _rest(frames, values, reference, degree)
    lowest = np.linalg.eigvalsh(values.diffusion).min(axis=(1, 2))
    c = values.reaction.min(axis=1)
    with np.errstate(divide="ignore"):
        weight = np.minimum(frames.diameters / (math.pi * np.sqrt(lowest)), 1.0 / np.sqrt(c))
    d = reference.dimension
    h2 = frames.diameters[:, None] ** 2
    trace = frames.facet_sizes / frames.volumes[:, None] * h2 * (1 / math.pi**2 + 2 / d / math.pi)
    osc = weight * np.sqrt((rest**2 * weights).sum(axis=1))
    osc += (np.sqrt(trace / lowest[:, None]) * missed).sum(axis=1)
    defect = moments[:, :, 0].sum(axis=1) + data.source[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(defect == 0.0, 0.0, np.abs(defect) / np.sqrt(frames.volumes * c))
    eta = flux + osc + mean
    sigma = 0.0

    def norm(x: Array) -> float:
        return math.sqrt(comm.allreduce(float((x**2).sum())))

    total = norm(eta)
    total = 0.5 * (total + math.sqrt(total**2 + 4 * sigma))
    return EnergyBound(norm(flux), norm(osc), math.sqrt(sigma), norm(mean), 0.0, total, eta, bool(notes), notes)


def _check_mesh(problem):
    pass


def _quadrature(terms, reference):
    return 2 * reference.degree + MORE[reference.dimension], ()


def _values(problem, terms, frames, quadrature):
    space, d = problem.space, frames.dimension
    points, weights = rule(d, quadrature)
    cells = np.arange(len(frames.order))
    entries = terms.entries(d)
    data = [terms.reaction or 0.0, terms.load or 0.0, *entries]
    at = values_at(space.mesh, data, points, cells)
    A = at[:, :, 2:]
    A = A[..., None] * np.eye(d) if len(entries) == 1 else A.reshape(*A.shape[:2], d, d)
    table = space.element.basix_element.tabulate(1, points)[..., 0]
    dofs = problem.sign * problem.u.x.array[space.dofmap.list[: len(cells)]]
    u = dofs @ table[0].T
    gradient = np.einsum("aqi,ci->cqa", table[1:], dofs)
    # The gradient in space: the frames order vertices in another way than the cells of the mesh.
    corners = np.empty_like(frames.corners)
    np.put_along_axis(corners, frames.order[:, :, None], frames.corners, axis=1)
    inverse = np.linalg.inv((corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1))
    gradient = gradient @ inverse
    return _Values(points, weights, u, gradient, A, np.linalg.inv(A), at[:, :, 0], problem.sign * at[:, :, 1])


def _cell_data(frames, kinds, values, fluxes, reference):
    degree = reference.degree
    J, volumes = frames.jacobians, frames.volumes
    metric = np.einsum("cab,cad,cde->cbe", J, np.einsum("q,cqad->cad", values.weights, values.inverse), J)
    det = volumes * math.factorial(reference.dimension)
    m = lambda v: frames.moments(v, values.points, values.weights, degree)
    return CellData(
        frames.vertices,
        frames.facets,
        kinds,
        np.column_stack((volumes, frames.facet_sizes)),
        metric / det[:, None, None],
        J.transpose(0, 2, 1) @ m(values.gradient),
        frames.inverses @ m(values.current()) * volumes[:, None, None],
        m(values.load - values.reaction * values.u) * volumes[:, None],
        fluxes,
    )


def _field(frames, values, data, moments, reference):
    inner, constant = matrices(data, reference).inner
    given = np.concatenate((moments.reshape(len(moments), -1), -data.source[:, 1:]), axis=1)
    coefficients = np.concatenate((given, np.einsum("cij,cj->ci", inner, given) + constant), axis=1)
    result = np.zeros((len(moments), len(values.weights), reference.dimension))
    det = frames.volumes * math.factorial(reference.dimension)
    for cells, order in frames.groups():
        own = barycentric(values.points)[:, order][:, 1:]
        result[cells] = np.tensordot(coefficients[cells], reference.fields(own), (1, 1))
    return np.einsum("cab,cqb->cqa", frames.jacobians / det[:, None, None], result)


def _rest(frames, values, reference, degree):
    """What f - c u has beside its projection."""
    v = values.load - values.reaction * values.u
    means = frames.moments(v, values.points, values.weights, degree)
    rest = np.array(v)
    for cells, order in frames.groups():
        own = barycentric(values.points)[:, order][:, 1:]
        rest[cells] -= means[cells] @ polynomials(reference.dimension, degree, own)
    return rest
