"""Error norms on the domain and on its boundary: L^p, W^{1,p} and H^{1/2}, in parallel.

Every norm is made from one number for each cell, or for each boundary facet.
Norms with p < inf are integrated by quadrature rules, and norms with the same rule share one
evaluation of the error, in blocks of cells. Powers are relative to the largest value in a cell, so
that no p overflows or underflows: p = 1000 works, and so does p = 16 at errors of 1e-20. Sup norms
are maxima, see `dolfinx_signorini.norms.maxima`.

No rule is right for all errors: where none is given, two rules are compared, and cells divided,
until the norms are right to 1e-3, see `controlled`. On many cells that is done for the cells with
the largest errors, and for a sample of cells that tells whether one rule is good enough elsewhere.
The search for maxima then begins at its points.

Definitions:

    L^p        (integral of |e|^p)^{1/p}
    W^{1,p}    (integral of |e|^p plus |de/dx_i|^p for each i)^{1/p}: componentwise
    L^inf      the largest |e|
    W^{1,inf}  the largest |e| or |de/dx_i|, derivatives from inside of each cell
    vectors    |e| and |de/dx_i| are Euclidean lengths; so is |q| of a matrix q, as stresses are
    on the boundary the same with the tangential gradient, and
    H^{1/2}    estimated by interpolation: sqrt(||e||_L2 ||e||_H1) on the boundary; the true
               fractional norm is in `dolfinx_signorini.norms.fractional`
"""

import math
from collections.abc import Collection, Iterator, Sequence
from functools import partial

import numpy as np
import numpy.typing as npt
from dolfinx import fem, mesh

from dolfinx_signorini.base.arrays import Array, LocalIndices, Mask, blocks
from dolfinx_signorini.base.errors import InputError
from dolfinx_signorini.base.kinds import (
    FUNCTION,
    TEXT,
    callable_,
    check,
    instance,
    optional,
    sequence,
)
from dolfinx_signorini.base.logs import Progress
from dolfinx_signorini.meshes.parts import Parts
from dolfinx_signorini.meshes.points import Points
from dolfinx_signorini.meshes.quadrature import MANY, QuadratureRule, interior_rule
from dolfinx_signorini.meshes.sided_meshes import (
    SAMPLE,
    boundary_facets,
    clockwise,
    facet_cells,
    owned_cells,
    sampled,
)
from dolfinx_signorini.norms.controlled import allowed, controlled
from dolfinx_signorini.norms.fractional import fractional_norm
from dolfinx_signorini.norms.maxima import Maxima
from dolfinx_signorini.norms.names import Norm, parse_norm
from dolfinx_signorini.norms.pointwise import ErrorAtPoints, Quantity, kind_of
from dolfinx_signorini.norms.power_sums import norm_of_all, p_norm
from dolfinx_signorini.norms.references import Reference

HIGHEST = {1: 31, 2: 20, 3: 12}  # degree of a rule that is chosen here, by dimension
LARGE = 16.0  # times the mean of the p-th powers: what is more in a cell gets the larger rule


def error_norms(
    u_h: fem.Function,
    exact: Reference | None,
    norms: Collection[str],
    rule: QuadratureRule | None = None,
    boundary_rule: QuadratureRule | None = None,
    *,
    of: Quantity | None = None,
) -> dict[str, float]:
    """Compute norms of the error u_h - u.

    Args:
        u_h: The discrete solution, a function in a Lagrange space of scalars or vectors of any
            degree on triangles, tetrahedra, quadrilaterals or hexahedra.
        exact: The known solution, on the mesh of u_h; None for the norms of u_h itself.
        norms: Names of the norms, see `parse_norm`.
        rule: Quadrature rule of the volume norms with p < inf, on cells. None for as many points as
            make the norms right to 1e-3, see `controlled.controlled`.
        boundary_rule: The same for the boundary norms, on facets.
        of: What of the solution is meant, a function that returns a UFL expression, linear in its
            argument and the first derivatives: for example its stress, of which the L^p norms are
            known. By default the solution itself.

    Returns:
        The value of each norm, by name, the same on all ranks.

    Raises:
        InputError: A norm is unknown, or the error is of a kind that no norm is known of.
        FloatingPointError: The error is not a number at some point of evaluation, or the norm is
            infinite.
    """
    rule_kind = optional(instance(QuadratureRule, "a QuadratureRule"))
    check(
        u_h=(u_h, FUNCTION),
        norms=(norms, sequence(TEXT, "a list of names of norms")),
        exact=(exact, optional(instance(Reference, "a known solution"))),
        rule=(rule, rule_kind),
        boundary_rule=(boundary_rule, rule_kind),
        of=(of, optional(callable_)),
    )
    if exact is not None and exact.mesh != u_h.function_space.mesh:
        raise InputError("lives on another mesh than u_h", "exact")
    wanted = {name: parse_norm(name) for name in norms}
    if of is not None and any(norm.derivatives for norm in wanted.values()):
        raise InputError("only L^p norms of a quantity are known", "norms")
    values: dict[Norm, float] = {}
    for boundary, given in ((False, rule), (True, boundary_rule)):
        here = [n for n in wanted.values() if n.boundary == boundary and not n.spectral]
        values |= _norms(u_h, exact, here, given, of) if here else {}
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
    found = _integrated(error, owned_cells(error.domain), norms, rule)
    return {n: norm_of_all(error.domain.comm, values, n.p) for n, values in found.items()}


def sufficient_degree(domain: mesh.Mesh, degree: int, norm: Norm) -> int:
    """Return the degree of a rule that integrates smooth errors well, for a norm with p < inf.

    The error of a smooth solution is nearly a polynomial of one degree more than the elements. The
    rule is exact for its p-th power, up to p = 8 and `HIGHEST`.

    Args:
        domain: The mesh.
        degree: The degree of the elements, on quadrilaterals and hexahedra in each direction.
        norm: The norm.
    """
    simplex = domain.topology.cell_name() in ("triangle", "tetrahedron")
    dim = domain.topology.dim - norm.boundary
    needed = max(2, min(math.ceil(norm.p), 8)) * (degree + 1) + (0 if simplex else dim)
    return min(needed, HIGHEST[dim])


def _norms(
    u_h: fem.Function,
    exact: Reference | None,
    norms: Sequence[Norm],
    rule: QuadratureRule | None,
    of: Quantity | None,
) -> dict[Norm, float]:
    """Norms that are all on the domain or all on its boundary."""
    ends = [Norm(0.0, 2.0, True), Norm(1.0, 2.0, True)]  # of the interpolation of H^{1/2}
    half = [norm for norm in norms if norm.derivatives == 0.5]
    simple = [norm for norm in norms if norm not in half] + (ends if half else [])
    error = ErrorAtPoints(u_h, exact, any(norm.derivatives for norm in simple), of)
    domain, comm = error.domain, error.domain.comm
    places = owned_cells(domain)
    if norms[0].boundary:
        places = facet_cells(domain, boundary_facets(domain))
    finite = [norm for norm in simple if math.isfinite(norm.p)]
    tops = None
    if rule is not None:
        parts = _integrated(error, places, finite, rule)
    elif places.ndim == 1 and comm.allreduce(len(places)) > MANY:
        parts, tops = _mostly(error, places, finite)
    else:
        parts = _controlled(error, places, finite)
    result = {norm: norm_of_all(comm, values, norm.p) for norm, values in parts.items()}
    maxima = Maxima(error, places, exact.singular if exact is not None else (), tops)
    for norm in [norm for norm in simple if math.isinf(norm.p)]:
        largest = maxima.largest(norm.derivatives > 0.0, str(norm))
        result[norm] = norm_of_all(comm, np.array([largest]), norm.p)
    for norm in half:
        result[norm] = math.sqrt(result[ends[0]]) * math.sqrt(result[ends[1]])
    return result


def _mostly(
    error: ErrorAtPoints, places: LocalIndices, norms: Sequence[Norm]
) -> tuple[dict[Norm, Array], Array]:
    """Return norms on each cell, by one rule where that is enough; collective.

    Returns:
        The norms, and the largest values at the points of the rule, as `Maxima` takes them.
    """
    comm, tops = error.domain.comm, np.zeros((error.kinds, len(places)))
    wanted = norms or [Norm(0.0, 2.0)]  # for the values in cells, where no norm is asked for
    degrees = [sufficient_degree(error.domain, error.degree, norm) for norm in wanted]
    rule = interior_rule(kind_of(error.domain, places), max(degrees))
    parts = _integrated(error, places, norms, rule, tops=tops)
    count = comm.allreduce(len(places))
    large, step = np.zeros(len(places), dtype=bool), max(1, count // SAMPLE)
    for norm, values in parts.items():
        mean = norm_of_all(comm, values[np.isfinite(values)], norm.p) * count ** (-1.0 / norm.p)
        large |= ~(values <= LARGE ** (1.0 / norm.p) * mean)
    sample = np.zeros(len(places), dtype=bool)
    sample[sampled(len(places), step)] = True
    sample &= ~large
    chosen = large | sample
    exact = _controlled(error, places[chosen], norms)
    close = True
    for norm, values in parts.items():
        rough = values[sample]
        values[chosen] = exact[norm]
        unit = norm_of_all(comm, values, norm.p) or 1.0
        powers = [((v / unit) ** norm.p).sum() for v in (rough, values[sample])]
        close &= step * abs(comm.allreduce(powers[0] - powers[1])) <= allowed(norm.p)
    return (parts if close else _controlled(error, places, norms)), tops


def _integrated(
    error: ErrorAtPoints,
    places: LocalIndices,
    norms: Sequence[Norm],
    rule: QuadratureRule,
    parts: Parts | None = None,
    tops: Array | None = None,
) -> dict[Norm, Array]:
    """Norms on places of this rank or on parts of them, by a rule; for p = inf at its points.

    `tops` is filled with the largest values at the points of the rule on each place.
    """
    parts = parts or Parts.whole(len(places), kind_of(error.domain, places))
    norms = list(dict.fromkeys(norms))
    components = {(n.p, k) for n in norms for k in range(1 + int(n.derivatives))}
    result: dict[Norm, Array] = {norm: np.empty(len(parts.rows)) for norm in norms}
    with Progress("errors", len(parts.rows)) as progress:
        for rows, points, weights in _blocks(error.domain, places, parts, rule):
            errors = error(points)
            if tops is not None:
                sizes = np.stack([p_norm(e, math.inf) for e in errors])
                tops[:, rows] = sizes[0], *([sizes.max(axis=0)] if len(tops) > 1 else [])
            groups, sizes = (errors[:1], errors[1:]), points.scale * (parts.share * weights)
            found = {(p, k): [p_norm(e, p, sizes) for e in groups[k]] for p, k in components}
            for n in norms:
                own = [part for k in range(1 + int(n.derivatives)) for part in found[n.p, k]]
                result[n][rows] = own[0] if len(own) == 1 else p_norm(np.stack(own, -1), n.p)
            progress.advance(len(rows))
    return result


def _blocks(
    domain: mesh.Mesh, places: LocalIndices, parts: Parts, rule: QuadratureRule
) -> Iterator[tuple[npt.NDArray[np.integer], Points, Array]]:
    """Yield numbers of parts, with the points of a rule and the weights of the points."""
    cell = kind_of(domain, places)
    turned: Mask = np.zeros(len(parts.rows), dtype=bool)
    if places.ndim == 1 and rule.scheme != "default":
        # Of no symmetry: follows the vertices counterclockwise.
        turned = clockwise(domain, places[parts.rows])
    for reverse in (False, True):
        points, weights = rule.points(cell, reverse)
        width = (1 if parts.few_maps else 8) * len(points)
        for some in parts.alike(np.flatnonzero(turned == reverse)):
            for rows in (some[part] for part in blocks(len(some), width)):
                at = parts.points(points, rows)
                yield rows, Points(domain, places[parts.rows[rows]], at), weights


def _controlled(
    error: ErrorAtPoints, places: LocalIndices, norms: Sequence[Norm]
) -> dict[Norm, Array]:
    """Norms on each of the places of this rank, by rules that suit the error; collective."""
    comm, cell = error.domain.comm, kind_of(error.domain, places)
    groups: dict[int, list[Norm]] = {}
    for norm in dict.fromkeys(norms):
        groups.setdefault(sufficient_degree(error.domain, error.degree, norm), []).append(norm)
    result: dict[Norm, Array] = {}
    for degree, same in groups.items():
        evaluate = partial(_integrated, error, places, same)
        sizes = partial(_rounded_sizes, error.of_u_h, places, same, degree)
        result |= controlled(evaluate, sizes, (cell, len(places)), same, degree, comm)
    return result


def _rounded_sizes(
    error: ErrorAtPoints, places: LocalIndices, norms: Sequence[Norm], degree: int
) -> dict[Norm, float]:
    """Norms over all places of all ranks, by rules of a degree, that tell how large rounding is.

    On facets they are the norms over the cells behind, as if the values in a cell were those on its
    facet: where coefficients on a facet are 0, the others are what is rounded there.
    """
    domain, comm = error.domain, error.domain.comm
    cells = places if places.ndim == 1 else places[:, 0]
    rules = [interior_rule(kind_of(domain, some), degree) for some in (places, cells)]
    measures = []
    for some, rule in zip((places, cells), rules, strict=True):
        points, weights = rule.points(kind_of(domain, some))
        measures.append((Points(domain, some, points).scale * weights).sum(axis=1))
    found, ratio = _integrated(error, cells, norms, rules[1]), measures[0] / measures[1]
    return {n: norm_of_all(comm, v * ratio ** (1.0 / n.p), n.p) for n, v in found.items()}
