"""Error norms on the domain and on its boundary: L^p, W^{1,p} and H^{1/2}, in parallel.

All norms that are asked for share one evaluation of the error at the points of a named quadrature
rule, cell by cell in blocks. The p-th powers are summed relative to the largest error met so far,
so that no p overflows or underflows: p = 1000 works, and so does p = 16 at errors of 1e-20.

Definitions (those that reproduce the tables of Christof and Haubner):
    L^p        (integral of |e|^p)^{1/p}
    W^{1,p}    (integral of |e|^p plus |de/dx_i|^p for each i)^{1/p}: componentwise
    L^inf      the largest |e| at the vertices and edge midpoints of all cells
    W^{1,inf}  the largest |e| or |de/dx_i| at the quadrature points
    on the boundary the same with the tangential gradient, and
    H^{1/2}    estimated by interpolation: sqrt(||e||_L2 ||e||_H1) on the boundary; the true
               fractional norm is in `dolfinx_signorini.fractional`
"""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import basix
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinx_signorini import compat
from dolfinx_signorini.errors import InputError
from dolfinx_signorini.fractional import fractional_norm
from dolfinx_signorini.meshes import (
    boundary_facets,
    clockwise,
    facet_cells,
    facet_scale,
    owned_cells,
)
from dolfinx_signorini.power_sums import PowerSum
from dolfinx_signorini.quadrature import CELL_RULE, FACET_RULE, QuadratureRule
from dolfinx_signorini.references import Reference

BLOCK = 8192  # cells whose point values are held at a time
Array: TypeAlias = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Norm:
    """A norm, whose name is its text:

        assert str(Norm(1.0, 4.0)) == "W1_4"

    Attributes:
        derivatives: Order of differentiability: 0 (L^p), 1 (W^{1,p}) or 0.5 (H^{1/2}).
        p: Exponent, from 1 to infinity; 2 for H^{1/2}.
        boundary: Whether the norm is taken on the boundary of the domain.
        spectral: For H^{1/2}: the true fractional norm in place of the interpolation estimate.
    """

    derivatives: float
    p: float
    boundary: bool = False
    spectral: bool = False

    def __str__(self) -> str:
        where = "_boundary" if self.boundary else ""
        if self.derivatives == 0.5:
            return f"H1_2{where}" + ("_spectral" if self.spectral else "")
        exponent = "inf" if math.isinf(self.p) else f"{self.p:.12g}"
        return f"L{exponent}{where}" if self.derivatives == 0 else f"W1_{exponent}{where}"


def parse_norm(name: str) -> Norm:
    """Return the norm of a name such as L4, Linf, W1_4, W1_inf, L2_boundary or H1_2_boundary.

    H1 stands for W1_2, H1_2_boundary for the interpolation estimate of the H^{1/2} norm and
    H1_2_boundary_spectral for the norm itself.

    Raises:
        ValueError: The name is unknown or p is smaller than 1.
    """
    if name in ("H1_2_boundary", "H1_2_boundary_spectral"):
        return Norm(0.5, 2.0, boundary=True, spectral=name.endswith("spectral"))
    match = re.fullmatch(r"(?:(L|W1_)(inf|[0-9.]+(?:e[+-]?[0-9]+)?)|(H1))(_boundary)?", name)
    try:
        if match is None:
            raise ValueError
        p = 2.0 if match[3] else float(match[2])
    except ValueError:
        raise ValueError(
            f"unknown norm {name!r}; known are Lp and W1_p with 1 <= p <= inf (L4, Linf, W1_16, "
            "W1_inf), H1, each with or without _boundary, H1_2_boundary, H1_2_boundary_spectral"
        ) from None
    if not p >= 1.0:
        raise ValueError(f"norm {name!r}: p must be at least 1")
    return Norm(0.0 if match[1] == "L" else 1.0, p, boundary=match[4] is not None)


def listed_norms(text: str) -> tuple[str, ...]:
    """Return the names in a list such as "L4,Linf", as the option --norms takes it.

    Raises:
        InputError: One of them is not the name of a norm.
    """
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        try:
            parse_norm(name)
        except ValueError as error:
            raise InputError(str(error), "--norms") from None
    return names


def error_norms(
    u_h: fem.Function,
    exact: Reference | None,
    norms: Iterable[str],
    rule: QuadratureRule = CELL_RULE,
    boundary_rule: QuadratureRule = FACET_RULE,
) -> dict[str, float]:
    """Compute norms of the error u_h - u, all of them from one evaluation at the rule's points.

    Args:
        u_h: The discrete solution.
        exact: The known solution, on the mesh of u_h; None for the norms of u_h itself.
        norms: Names of the norms, see `parse_norm`.
        rule: Quadrature rule of the volume norms, on cells.
        boundary_rule: Quadrature rule of the boundary norms, on facets.

    Returns:
        The value of each norm, by name, the same on all ranks.

    Raises:
        ValueError: A norm is unknown.
        FloatingPointError: The error is not a number at some quadrature point.
    """
    wanted = {name: parse_norm(name) for name in norms}
    volume = [n for n in wanted.values() if not n.boundary]
    boundary = [n for n in wanted.values() if n.boundary and not n.spectral]
    values = _volume_norms(u_h, exact, volume, rule)
    values |= _boundary_norms(u_h, exact, boundary, boundary_rule)
    for norm in wanted.values():
        if norm.spectral:
            values[norm] = fractional_norm(u_h, exact)
    return {name: values[norm] for name, norm in wanted.items()}


def _volume_norms(
    u_h: fem.Function,
    exact: Reference | None,
    norms: Sequence[Norm],
    rule: QuadratureRule,
) -> dict[Norm, float]:
    domain = u_h.function_space.mesh
    cell = basix.CellType[domain.topology.cell_name()]
    gradient = any(n.derivatives == 1 for n in norms)
    integrated = [n for n in norms if n.derivatives == 1 or not math.isinf(n.p)]
    sums = _power_sums(integrated)
    if sums:
        scale = abs(ufl.JacobianDeterminant(domain))
        for cells, components in _error_on_cells(u_h, exact, gradient):
            # The rule follows the counterclockwise order of vertices, not that of their numbers.
            turned = clockwise(domain, cells)
            for reverse in (False, True):
                points, weights = rule.points(cell, reverse)
                part = cells[turned == reverse]
                for _, values in _sample([*components, scale], domain, points, part):
                    factors = values[:, :, -1]
                    if (factors == factors[:, :1]).all():  # affine cells
                        factors = factors[:, 0]
                    _add(sums, values[:, :, :-1], weights, factors)
    result = _roots(integrated, sums, domain.comm)
    if any(n.derivatives == 0 and math.isinf(n.p) for n in norms):
        lattice = basix.create_lattice(cell, 2, basix.LatticeType.equispaced, True)
        result[Norm(0.0, math.inf)] = _largest(u_h, exact, np.asarray(lattice, dtype=np.float64))
    return result


def _boundary_norms(
    u_h: fem.Function,
    exact: Reference | None,
    norms: Sequence[Norm],
    rule: QuadratureRule,
) -> dict[Norm, float]:
    if not norms:
        return {}
    domain = u_h.function_space.mesh
    tdim = domain.topology.dim
    facet = basix.cell.subentity_types(basix.CellType[domain.topology.cell_name()])[tdim - 1][0]
    points, weights = rule.points(facet)
    simple = [n for n in norms if n.derivatives != 0.5]
    if len(simple) < len(norms):  # the ends of the interpolation
        simple += [Norm(0.0, 2.0, True), Norm(1.0, 2.0, True)]
    sums = _power_sums(simple)
    error, gradient = _error(u_h, exact)
    normal = ufl.FacetNormal(domain)
    tangential = gradient - ufl.dot(gradient, normal) * normal
    components = [error, *(tangential[i] for i in range(domain.geometry.dim))]
    facets = facet_cells(domain, boundary_facets(domain))
    scale = facet_scale(domain, facets)
    for block, values in _sample(components, domain, points, facets):
        _add(sums, values, weights, scale[block])
    result = _roots(simple, sums, domain.comm)
    if len(simple) > len(norms):
        ends = result[Norm(0.0, 2.0, True)], result[Norm(1.0, 2.0, True)]
        result[Norm(0.5, 2.0, True)] = math.sqrt(ends[0]) * math.sqrt(ends[1])
    return result


def _power_sums(norms: Iterable[Norm]) -> dict[tuple[float, bool], PowerSum]:
    """One sum per exponent for the values and, for W^{1,p}, one for the derivatives."""
    keys = {(n.p, False) for n in norms} | {(n.p, True) for n in norms if n.derivatives == 1}
    return {key: PowerSum(key[0]) for key in keys}


def _add(
    sums: dict[tuple[float, bool], PowerSum], errors: Array, weights: Array, factors: Array
) -> None:
    """Add point errors, shape (cells, points, 1 or 1 + dim), to the sums."""
    for i in range(errors.shape[2]):
        values = np.abs(errors[:, :, i])
        largest = float(values.max(initial=0.0))
        for (_, derivative), power_sum in sums.items():
            if derivative == (i > 0):
                power_sum.add(values, largest, weights, factors)


def _roots(
    norms: Iterable[Norm], sums: dict[tuple[float, bool], PowerSum], comm: MPI.Comm
) -> dict[Norm, float]:
    total = {key: sums[key].reduce(comm) for key in sorted(sums)}
    result = {}
    for norm in norms:
        power_sum = PowerSum(norm.p)
        power_sum.merge(total[norm.p, False])
        if norm.derivatives == 1:
            power_sum.merge(total[norm.p, True])
        result[norm] = power_sum.root
    return result


def _error(u_h: fem.Function, exact: Reference | None) -> tuple[Expr, Expr]:
    if exact is None:
        return u_h, ufl.grad(u_h)
    return u_h - exact.u, ufl.grad(u_h) - ufl.as_vector(exact.grad)


def _error_on_cells(
    u_h: fem.Function, exact: Reference | None, gradient: bool
) -> Iterator[tuple[npt.NDArray[np.int32], list[Expr]]]:
    """Yield the error with its derivatives where u may be non-zero, and u_h's own elsewhere."""
    cells = owned_cells(u_h.function_space.mesh)
    support = cells if exact is None else exact.support_cells()
    rest = np.setdiff1d(cells, support, assume_unique=True)
    for part, reference in ((support, exact), (rest, None)):
        error, derivatives = _error(u_h, reference)
        dim = u_h.function_space.mesh.geometry.dim if gradient else 0
        yield part, [error, *(derivatives[i] for i in range(dim))]


def _sample(
    components: Sequence[Expr], domain: mesh.Mesh, points: Array, entities: npt.NDArray[np.int32]
) -> Iterator[tuple[slice, Array]]:
    """Yield blocks of the entities, and the components' values (entities, points, components)."""
    compiled = fem.Expression(ufl.as_vector(components), points, comm=domain.comm)
    for start in range(0, len(entities), BLOCK):
        block = slice(start, start + BLOCK)
        values = compat.evaluate(compiled, domain, entities[block])
        yield block, values.reshape(-1, len(points), len(components))


def _largest(u_h: fem.Function, exact: Reference | None, points: Array) -> float:
    domain = u_h.function_space.mesh
    power_sum = PowerSum(math.inf)
    for cells, components in _error_on_cells(u_h, exact, gradient=False):
        for _, values in _sample(components, domain, points, cells):
            power_sum.include(float(np.abs(values).max(initial=0.0)))
    return power_sum.reduce(domain.comm).root
