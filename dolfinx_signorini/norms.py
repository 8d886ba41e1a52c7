"""Error norms on the domain and on its boundary: L^p, W^{1,p} and H^{1/2}, in parallel.

Every norm is made from one number for each cell, or for each boundary facet.
Norms with p < inf are integrated by a named quadrature rule, and norms with the same rule share one
evaluation of the error, in blocks of cells. Powers are relative to the largest value in a cell, so
that no p overflows or underflows: p = 1000 works, and so does p = 16 at errors of 1e-20. Sup norms
are maxima, see `dolfinx_signorini.maxima`.

On many cells most of them get a smaller rule, and the search for maxima begins at its points. The
rule of the elements is for the cells with the largest errors, and for a sample of cells that tells
whether the smaller rule is good enough elsewhere.

Definitions:

    L^p        (integral of |e|^p)^{1/p}
    W^{1,p}    (integral of |e|^p plus |de/dx_i|^p for each i)^{1/p}: componentwise
    L^inf      the largest |e|
    W^{1,inf}  the largest |e| or |de/dx_i|, derivatives from inside of each cell
    on the boundary the same with the tangential gradient, and
    H^{1/2}    estimated by interpolation: sqrt(||e||_L2 ||e||_H1) on the boundary; the true
               fractional norm is in `dolfinx_signorini.fractional`
"""

import math
from collections.abc import Collection, Iterator, Sequence

import basix
import numpy as np
import numpy.typing as npt
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_signorini.errors import InputError
from dolfinx_signorini.fractional import fractional_norm
from dolfinx_signorini.kinds import FUNCTION, TEXT, check, instance, optional, sequence
from dolfinx_signorini.logs import Progress
from dolfinx_signorini.maxima import Maxima
from dolfinx_signorini.meshes import boundary_facets, clockwise, facet_cells, owned_cells, sampled
from dolfinx_signorini.norm_names import Norm, parse_norm
from dolfinx_signorini.points import Array, Indices, Points
from dolfinx_signorini.pointwise import ErrorAtPoints
from dolfinx_signorini.power_sums import p_norm
from dolfinx_signorini.quadrature import CELL_RULE, FACET_RULE, MANY, QuadratureRule, interior_rule
from dolfinx_signorini.references import Reference

BLOCK = 131_072  # points whose values are held at a time
HIGHEST = {1: 63, 2: 32, 3: 20}  # degree of a rule that is chosen here, by dimension
LARGE = 16.0  # times the mean of the p-th powers: what is more in a cell gets the larger rule
SAMPLE, CLOSE = 2_000, 2e-3  # cells where both rules are compared; p-th powers may differ so much


def error_norms(
    u_h: fem.Function,
    exact: Reference | None,
    norms: Collection[str],
    rule: QuadratureRule | None = None,
    boundary_rule: QuadratureRule | None = None,
) -> dict[str, float]:
    """Compute norms of the error u_h - u.

    Args:
        u_h: The discrete solution, a scalar function in a Lagrange space of any degree on
            triangles, tetrahedra, quadrilaterals or hexahedra.
        exact: The known solution, on the mesh of u_h; None for the norms of u_h itself.
        norms: Names of the norms, see `parse_norm`.
        rule: Quadrature rule of the volume norms with p < inf, on cells; None for one that suits
            the elements, see `sufficient_rule`.
        boundary_rule: The same for the boundary norms, on facets.

    Returns:
        The value of each norm, by name, the same on all ranks.

    Raises:
        InputError: A norm is unknown or infinite, or the error is of a kind that no norm is known
            of.
        FloatingPointError: The error is not a number at some point of evaluation.
    """
    rule_kind = optional(instance(QuadratureRule, "a QuadratureRule"))
    check(
        u_h=(u_h, FUNCTION),
        norms=(norms, sequence(TEXT, "a list of names of norms")),
        exact=(exact, optional(instance(Reference, "a known solution"))),
        rule=(rule, rule_kind),
        boundary_rule=(boundary_rule, rule_kind),
    )
    if exact is not None and exact.mesh != u_h.function_space.mesh:
        raise InputError("lives on another mesh than u_h", "exact")
    wanted = {name: parse_norm(name) for name in norms}
    values: dict[Norm, float] = {}
    for boundary, given in ((False, rule), (True, boundary_rule)):
        here = [n for n in wanted.values() if n.boundary == boundary and not n.spectral]
        values |= _norms(u_h, exact, here, given) if here else {}
    for norm in wanted.values():
        if norm.spectral:
            values[norm] = fractional_norm(u_h, exact)
    return {name: values[norm] for name, norm in wanted.items()}


def sampled_norms(
    u_h: fem.Function, exact: Reference | None, norms: Sequence[Norm], rule: QuadratureRule
) -> dict[Norm, float]:
    """Compute norms of the error u_h - u from its values at the points of a rule only.

    Args:
        u_h: The discrete solution.
        exact: The known solution, on the mesh of u_h; None for the norms of u_h itself.
        norms: L^p and W^{1,p} norms on the domain; for p = inf the largest at the points.
        rule: The rule on cells.

    Raises:
        FloatingPointError: The error is not a number at some point of the rule.
    """
    error = ErrorAtPoints(u_h, exact, any(norm.derivatives for norm in norms))
    values = _integrated(error, owned_cells(error.domain), norms, rule)
    return {norm: _total(error.domain.comm, array, norm.p) for norm, array in values.items()}


def sufficient_rule(domain: mesh.Mesh, degree: int, norm: Norm) -> QuadratureRule:
    """Return a quadrature rule for a norm of an error with p < inf.

    Up to degree 2 on triangles and tetrahedra the rules are the default ones. Otherwise the rule is
    exact for the p-th power of polynomials of one degree more, up to p = 8 and `HIGHEST`.

    Args:
        domain: The mesh.
        degree: The degree of the elements, on quadrilaterals and hexahedra in each direction.
        norm: The norm.
    """
    base = FACET_RULE if norm.boundary else CELL_RULE
    simplex = domain.topology.cell_name() in ("triangle", "tetrahedron")
    if simplex and degree <= 2:
        return base
    dim = domain.topology.dim - norm.boundary
    needed = min(math.ceil(norm.p), 8) * (degree + 1) + (0 if simplex else dim)
    return QuadratureRule(base.scheme, max(base.degree, min(needed, HIGHEST[dim])))


def _norms(
    u_h: fem.Function, exact: Reference | None, norms: Sequence[Norm], rule: QuadratureRule | None
) -> dict[Norm, float]:
    """Norms that are all on the domain or all on its boundary."""
    ends = [Norm(0.0, 2.0, True), Norm(1.0, 2.0, True)]  # of the interpolation of H^{1/2}
    half = [norm for norm in norms if norm.derivatives == 0.5]
    simple = [norm for norm in norms if norm not in half] + (ends if half else [])
    error = ErrorAtPoints(u_h, exact, any(norm.derivatives for norm in simple))
    domain, comm = error.domain, error.domain.comm
    places = owned_cells(domain)
    if norms[0].boundary:
        places = facet_cells(domain, boundary_facets(domain))
    finite = [norm for norm in simple if math.isfinite(norm.p)]
    small, tops = _smaller_rule(error, places, finite) if rule is None else None, None
    if small is None:
        parts = _integrated(error, places, finite, rule)
    else:
        parts, tops = _mostly(small, error, places, finite)
    result = {norm: _total(comm, values, norm.p) for norm, values in parts.items()}
    maxima = Maxima(error, places, exact.singular if exact is not None else (), tops)
    for norm in [norm for norm in simple if math.isinf(norm.p)]:
        largest = maxima.largest(norm.derivatives > 0.0, str(norm))
        result[norm] = _total(comm, np.array([largest]), norm.p)
    for norm in half:
        result[norm] = math.sqrt(result[ends[0]]) * math.sqrt(result[ends[1]])
    return result


def _smaller_rule(
    error: ErrorAtPoints, places: Indices, norms: Sequence[Norm]
) -> QuadratureRule | None:
    """Return a rule of fewer points than `sufficient_rule`, where that saves time; collective.

    The rule is exact for the p-th power of polynomials of one degree more.
    """
    if places.ndim == 2 or error.domain.topology.cell_name() not in ("triangle", "tetrahedron"):
        return None
    degree = max([math.ceil(min(norm.p, 8.0)) for norm in norms] or [2]) * (error.degree + 1)
    many = error.domain.comm.allreduce(len(places)) > MANY
    if not many or degree >= CELL_RULE.degree:
        return None
    return interior_rule(basix.CellType[error.domain.topology.cell_name()], degree)


def _mostly(
    small: QuadratureRule, error: ErrorAtPoints, places: Indices, norms: Sequence[Norm]
) -> tuple[dict[Norm, Array], Array]:
    """Return norms on each cell, by a small rule where that is enough; collective.

    Returns:
        The norms, and the largest values at the points of the small rule, as `Maxima` takes them.
    """
    comm, tops = error.domain.comm, np.zeros((error.kinds, len(places)))
    parts = _integrated(error, places, norms, small, tops)
    count = comm.allreduce(len(places))
    large = np.zeros(len(places), dtype=bool)
    for norm, values in parts.items():
        mean = _total(comm, values[np.isfinite(values)], norm.p) * count ** (-1.0 / norm.p)
        large |= ~(values <= LARGE ** (1.0 / norm.p) * mean)
    step = max(1, count // SAMPLE)
    sample = np.zeros(len(places), dtype=bool)
    sample[sampled(len(places), step)] = True
    sample &= ~large
    chosen = large | sample
    exact = _integrated(error, places[chosen], norms, None)
    close = True
    for norm, values in parts.items():
        rough = values[sample]
        values[chosen] = exact[norm]
        unit = _total(comm, values, norm.p) or 1.0
        powers = [((v / unit) ** norm.p).sum() for v in (rough, values[sample])]
        close &= step * abs(comm.allreduce(powers[0] - powers[1])) <= CLOSE
    return (parts if close else _integrated(error, places, norms, None)), tops


def _integrated(
    error: ErrorAtPoints,
    places: Indices,
    norms: Sequence[Norm],
    given: QuadratureRule | None,
    tops: Array | None = None,
) -> dict[Norm, Array]:
    """Norms on each of the places of this rank, by quadrature; for p = inf at its points.

    With a given rule `tops` is filled with the largest values at its points.
    """
    rules: dict[QuadratureRule, list[Norm]] = {} if given is None else {given: []}
    for norm in dict.fromkeys(norms):
        rule = given or sufficient_rule(error.domain, error.degree, norm)
        rules.setdefault(rule, []).append(norm)
    result: dict[Norm, Array] = {norm: np.empty(len(places)) for norm in norms}
    for rule, same in rules.items():
        components = {(n.p, k) for n in same for k in range(1 + int(n.derivatives))}
        progress, done = Progress("errors"), 0
        for rows, points, weights in _blocks(error.domain, places, rule):
            progress.at(done / len(places))
            done += len(rows)
            errors = error(points)
            if tops is not None:
                sizes = np.stack([p_norm(e, math.inf) for e in errors])
                tops[:, rows] = sizes[0], *([sizes.max(axis=0)] if len(tops) > 1 else [])
            groups, sizes = (errors[:1], errors[1:]), points.scale * weights
            parts = {(p, k): [p_norm(e, p, sizes) for e in groups[k]] for p, k in components}
            for n in same:
                own = [part for k in range(1 + int(n.derivatives)) for part in parts[n.p, k]]
                result[n][rows] = own[0] if len(own) == 1 else p_norm(np.stack(own, -1), n.p)
    return result


def _blocks(
    domain: mesh.Mesh, places: Indices, rule: QuadratureRule
) -> Iterator[tuple[npt.NDArray[np.int64], Points, Array]]:
    """Yield rows of the places, with the points of a rule and the weights of the points."""
    cell = basix.CellType[domain.topology.cell_name()]
    turned: npt.NDArray[np.bool_] = np.zeros(len(places), dtype=bool)
    if places.ndim == 2:
        cell = basix.cell.subentity_types(cell)[domain.topology.dim - 1][0]
    elif rule.scheme != "default":  # of no symmetry: follows the vertices counterclockwise
        turned = clockwise(domain, places)
    for reverse in (False, True):
        points, weights = rule.points(cell, reverse)
        part, step = np.flatnonzero(turned == reverse), max(1, BLOCK // len(points))
        for start in range(0, len(part), step):
            rows = part[start : start + step]
            yield rows, Points(domain, places[rows], points), weights


def _total(comm: MPI.Comm, values: Array, p: float) -> float:
    """The norm over all places of all ranks, from the norms on the places of this rank.

    Raises:
        FloatingPointError: The norm is not a number on some rank.
    """
    total = float(p_norm(np.array(comm.allgather(float(p_norm(values, p)))), p))
    if not math.isfinite(total):
        raise FloatingPointError(f"the error is {total} at a point of evaluation")
    return total
